"""
Your own robot at your own table
================================

Plan for a robot from a URDF file among a list of obstacles. This robot has a boom with a tube that slides out; the
script writes its URDF. The import report says how the package interprets the robot, and the page shows how its hand
moves over a box and down between two boxes.
"""

from pathlib import Path

import lieednn_sim as ls

# name, joint, axis, place in the link before, box, its centre, colour, range [m, rad]
PARTS = """
turret revolute  0,0,1  0,0,0    .2,.2,.5     0,0,.25  .3,.3,.35   -2.6 2.6
boom   revolute  0,-1,0 0,0,.56  .7,.12,.12   .3,0,0   .9,.5,.1    -.6  1.2
tube   prismatic 1,0,0  .1,0,0   .6,.08,.08   .3,0,0   .75,.75,.8  0    .5
wrist  revolute  0,1,0  .66,0,0  .14,.06,.06  .04,0,0  .3,.3,.35   -.4  1.8
hand   revolute  1,0,0  .12,0,0  .12,.1,.02   .06,0,0  .1,.5,.7    -1.5 1.5
"""
LINK = """
<link name="{0}">
  <inertial><origin xyz="{5}"/><mass value="3"/>
    <inertia ixx="0.02" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="{5}"/><geometry><box size="{4}"/></geometry></collision>
  <visual><origin xyz="{5}"/><geometry><box size="{4}"/></geometry>
    <material name="{0}"><color rgba="{6} 1"/></material></visual>
</link>
<joint name="{0}_joint" type="{1}">
  <parent link="{9}"/><child link="{0}"/><origin xyz="{3}"/><axis xyz="{2}"/>
  <limit lower="{7}" upper="{8}" effort="300" velocity="1.5"/></joint>
"""
urdf = '<robot name="boom"><mujoco><compiler discardvisual="false"/></mujoco>'
urdf, parent = urdf + '<link name="ground"/>', "ground"
for part in PARTS.strip().splitlines():
    words = [word.replace(",", " ") for word in part.split()]
    urdf, parent = urdf + LINK.format(*words, parent), words[0]
Path("boom.urdf").write_text(urdf + "</robot>")

# %%
# The obstacles are a list of shapes.

Path("table.yaml").write_text("""
obstacles:
  - {shape: box, name: table, size: [0.6, 1.4, 0.05], position: [1.2, 0, 0.4]}
  - {shape: box, name: left box, size: [0.3, 0.1, 0.3], position: [1.2, 0.25, 0.58]}
  - {shape: box, name: right box, size: [0.3, 0.1, 0.3], position: [1.2, -0.25, 0.58]}
""")
arm = ls.Arm.load("boom.urdf", scene="table.yaml", home={"turret_joint": -0.9})
print(arm.import_report)

# %%
# The target is a place between the boxes. A plan that touched anything would be refused.

planned = ls.plan(arm, ls.solve_ik(arm, (1.2, 0.0, 0.55)))
rollout = ls.simulate(arm, planned)
print(planned.network.certificate)
print(f"clearance {ls.evaluate(rollout).clearance_mm:.0f} mm")
ls.render_page(rollout, "motion.html")
