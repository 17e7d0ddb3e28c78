"""Small models with closed loops: a palletiser whose bars keep its wrist level, and a scissor lift on a cylinder.

Both close their loops by `connect` between two sites, are planar in x and z (the palletiser behind its turntable), and
meet their loops at qpos0. Dimensions are ours; the kinds of machine are public: docs.duet3d.com, *Robot 4 axis
palletized*, describes the parallelograms (of a wrist kept level, and of an arm driven from the base).
"""

# Shoulder at 0.8 m, arms of 1.0 m and 1.2 m, lower one upright and upper one level at q = 0. `crank` turns about the
# shoulder as well and moves the upper arm through the bar `drive`; the bars `level1` and `level2` and the `plate` at
# the elbow carry the angle of the turntable to the wrist. Each bar is parallel to its arm. Free: turn, lower, crank,
# flange.
PALLETISER = """
<mujoco model="palletiser">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <geom type="capsule" size="0.03" contype="0" conaffinity="0"/>
    <joint axis="0 1 0" range="-2 2" damping="1" armature="0.5"/>
    <equality solref="0.004 1" solimp="0.999 0.9999 0.001"/>
    <position kp="20000" kv="2000" inheritrange="1"/>
  </default>
  <worldbody>
    <site name="base"/>
    <body name="turntable">
      <joint name="turn" axis="0 0 1" range="-3 3"/>
      <geom name="turntable" type="cylinder" fromto="0 0 0 0 0 0.8" size="0.2" mass="100"/>
      <site name="turntable"/>
      <body name="lower" pos="0 0 0.8">
        <joint name="lower" range="-0.7 1.4"/>
        <geom name="lower" fromto="0 0 0 0 0 1" mass="40"/>
        <body name="upper" pos="0 0 1">
          <joint name="upper"/>
          <geom name="upper" fromto="-0.3 0 0 1.2 0 0" mass="30"/>
          <site name="upper_rear" pos="-0.3 0 0"/>
          <body name="wrist" pos="1.2 0 0">
            <joint name="wrist"/>
            <geom name="wrist" fromto="0 0 0 0 0 0.2" mass="5"/>
            <site name="wrist_lug" pos="0 0 0.2"/>
            <body name="flange">
              <joint name="flange" axis="0 0 1" range="-3 3"/>
              <geom name="flange" type="box" pos="0 0 -0.15" size="0.15 0.1 0.05" mass="10"/>
              <site name="tool" pos="0 0 -0.2"/>
            </body>
          </body>
        </body>
        <body name="plate" pos="0 0 1">
          <joint name="plate"/>
          <geom name="plate" fromto="-0.2 0 0 0 0 0.2" mass="3"/>
          <site name="plate_rear" pos="-0.2 0 0"/>
          <body name="level2" pos="0 0 0.2">
            <joint name="level2"/>
            <geom name="level2" fromto="0 0 0 1.2 0 0" size="0.015" mass="4"/>
            <site name="level2_end" pos="1.2 0 0"/>
          </body>
        </body>
      </body>
      <body name="level1" pos="-0.2 0 0.8">
        <joint name="level1"/>
        <geom name="level1" fromto="0 0 0 0 0 1" size="0.015" mass="4"/>
        <site name="level1_end" pos="0 0 1"/>
      </body>
      <body name="crank" pos="0 0 0.8">
        <joint name="crank" range="-1.2 0.9"/>
        <geom name="crank" fromto="0 0 0 -0.3 0 0" mass="5"/>
        <body name="drive" pos="-0.3 0 0">
          <joint name="drive"/>
          <geom name="drive" fromto="0 0 0 0 0 1" size="0.015" mass="5"/>
          <site name="drive_end" pos="0 0 1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
    <connect name="drive" site1="drive_end" site2="upper_rear"/>
    <connect name="level1" site1="level1_end" site2="plate_rear"/>
    <connect name="level2" site1="level2_end" site2="wrist_lug"/>
  </equality>
  <actuator>
    <position name="turn" joint="turn"/>
    <position name="lower" joint="lower"/>
    <position name="crank" joint="crank"/>
    <position name="flange" joint="flange"/>
  </actuator>
</mujoco>
"""

# Four arms of 1 m, at q = 0 in a 3-4-5 triangle (0.8 m wide, two stages of 0.6 m); `rise` turns up, `fall` down. The
# feet and the shoe under the platform slide. The cylinder's barrel stands 0.5 m from its lug on the first arm. One
# degree of freedom; the platform stays level.
SCISSOR_LIFT = """
<mujoco model="scissor_lift">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <default>
    <geom type="capsule" size="0.02" contype="0" conaffinity="0"/>
    <joint axis="0 -1 0" range="-2 2" damping="1"/>
    <equality solref="0.004 1" solimp="0.999 0.9999 0.001"/>
  </default>
  <worldbody>
    <site name="base"/>
    <body name="rise1">
      <joint name="rise1" range="-0.35 0.55"/>
      <geom name="rise1" fromto="0 0 0 0.8 0 0.6" mass="10"/>
      <site name="rise1_middle" pos="0.4 0 0.3"/>
      <site name="rise1_lug" pos="0.6 0 0.45"/>
      <body name="fall2" pos="0.8 0 0.6">
        <joint name="fall2"/>
        <geom name="fall2" fromto="0 0 0 -0.8 0 0.6" mass="10"/>
        <site name="fall2_middle" pos="-0.4 0 0.3"/>
        <body name="platform" pos="-0.8 0 0.6">
          <joint name="platform"/>
          <geom name="platform" type="box" pos="0.4 0 0.05" size="0.6 0.3 0.03" mass="40"/>
          <site name="platform" pos="0.4 0 0.08"/>
          <body name="shoe" pos="0.8 0 0">
            <joint name="shoe" type="slide" axis="1 0 0" range="-0.45 0.2"/>
            <geom name="shoe" type="box" size="0.04 0.04 0.02" mass="1"/>
            <site name="shoe"/>
          </body>
        </body>
      </body>
    </body>
    <body name="foot" pos="0.8 0 0">
      <joint name="foot" type="slide" axis="1 0 0" range="-0.45 0.2"/>
      <geom name="foot" type="box" size="0.04 0.04 0.02" mass="1"/>
      <body name="fall1">
        <joint name="fall1"/>
        <geom name="fall1" fromto="0 0 0 -0.8 0 0.6" mass="10"/>
        <site name="fall1_middle" pos="-0.4 0 0.3"/>
        <body name="rise2" pos="-0.8 0 0.6">
          <joint name="rise2"/>
          <geom name="rise2" fromto="0 0 0 0.8 0 0.6" mass="10"/>
          <site name="rise2_middle" pos="0.4 0 0.3"/>
          <site name="rise2_top" pos="0.8 0 0.6"/>
        </body>
      </body>
    </body>
    <body name="barrel" pos="0.3 0 0.05" xyaxes="0.6 0 0.8 0 1 0">
      <joint name="swivel"/>
      <geom name="barrel" fromto="0 0 0 0.4 0 0" size="0.035" mass="6"/>
      <body name="rod">
        <joint name="stroke" type="slide" axis="1 0 0" range="-0.049 0.147" armature="200"/>
        <geom name="rod" fromto="0.1 0 0 0.5 0 0" mass="4"/>
        <site name="rod_eye" pos="0.5 0 0"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <connect name="middle1" site1="rise1_middle" site2="fall1_middle"/>
    <connect name="middle2" site1="rise2_middle" site2="fall2_middle"/>
    <connect name="top" site1="rise2_top" site2="shoe"/>
    <connect name="cylinder" site1="rise1_lug" site2="rod_eye"/>
  </equality>
  <actuator>
    <position name="stroke" joint="stroke" kp="1e6" kv="5e4" inheritrange="1" forcerange="-3e4 3e4"/>
  </actuator>
</mujoco>
"""
