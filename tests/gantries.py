"""Small cranes with known oscillations: a cart on a rail, driven stiffly, and what hangs from it."""

from __future__ import annotations

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco

LENGTH = 2.0  # of the pendulum [m]
PENDULUM = f"""<body pos="0 0 0"><joint name="swing" axis="0 1 0" damping="DAMPING"/>
  <geom type="sphere" size="0.001" pos="0 0 -{LENGTH}" mass="5" contype="0" conaffinity="0"/>
  <site name="load" pos="0 0 -{LENGTH}"/></body>"""


def gantry(hanging: str = PENDULUM, damping: float = 0.0, timestep: float = 0.005) -> ls.Arm:
    """A cart with something that hangs from it, as a view; pendulums hang straight at rest."""
    model = mujoco.MjModel.from_xml_string(xml(hanging, damping, timestep))
    return ls.Arm.of(model, mujoco.MjData(model), ["cart"], tip="tip")


def xml(hanging: str = PENDULUM, damping: float = 0.0, timestep: float = 0.005) -> str:
    """Its model."""
    return f"""<mujoco model="gantry"><option timestep="{timestep}" integrator="implicitfast"/>
        <custom><numeric name="velocity_limit" data="2"/><numeric name="acceleration_limit" data="2"/></custom>
        <worldbody><geom name="floor" type="plane" size="9 9 1"/>
        <body name="cart" pos="0 0 5"><joint name="cart" type="slide" axis="1 0 0" range="-10 10"
            armature="1e4"/>
          <geom type="box" size="0.2 0.2 0.1" mass="100"/><site name="tip"/>
          {hanging.replace("DAMPING", str(damping))}</body></worldbody>
        <actuator><position name="cart" joint="cart" kp="4e7" kv="1.2e6"/></actuator></mujoco>"""
