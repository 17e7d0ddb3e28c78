"""Small arms with everything that telescopic_pr has not, motions that need no planner, and runs that tests share."""

import functools

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.evaluation.evaluation import Evaluation
from lieednn_sim.evaluation.metrics import evaluate
from lieednn_sim.planning import CertifiedOptions, plan
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.simulation import Rollout, simulate

# One joint with six dof on a body that is not compensated, and a second link behind it with a servo of gear 2.
COMPOUND = """
<mujoco model="compound">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="base"><geom size="0.05" mass="1" contype="0" conaffinity="0"/><site name="base_frame"/>
      <body name="first" pos="0.1 0 0" gravcomp="{gravcomp}">
        <joint name="x" type="slide" axis="1 0 0" range="-0.5 0.5"/>
        <joint name="y" type="slide" axis="0 1 0" range="-0.5 0.5"/>
        <joint name="z" type="slide" axis="0 0 1" range="-0.5 0.5"/>
        <joint name="tilt" type="ball" range="0 2"/>
        <geom type="box" size="0.1 0.03 0.02" pos="0.1 0 0" mass="2" contype="0" conaffinity="0"/>
        <site name="link1_frame" pos="0.2 0 0"/>
        {second}
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="x" kp="20000" dampratio="1"/>
    <position joint="y" kp="20000" dampratio="1"/>
    <position joint="z" kp="20000" dampratio="1"/>
    <position joint="tilt" gear="1 0 0" kp="500" kv="10"/>
    <position joint="tilt" gear="0 1 0" kp="900" kv="15"/>
    <position joint="tilt" gear="0 0 1" kp="900" kv="15"/>
    {drive}
  </actuator>
</mujoco>
"""
SECOND = """
<body name="second" pos="0.2 0 0" gravcomp="1">
  <joint name="turn" type="hinge" axis="0 1 0" range="-1 1"/>
  <joint name="push" type="slide" axis="1 0 0" range="-0.2 0.2"/>
  <geom type="box" size="0.1 0.03 0.02" pos="0.1 0 0" mass="1" contype="0" conaffinity="0"/>
  <site name="link2_frame" pos="0.2 0 0"/>
</body>
"""
DRIVE = """
<position joint="turn" gear="2" kp="150" kv="4"/>
<general joint="push" gainprm="3000" biastype="affine" biasprm="5 -2500 -60"/>
"""

# A telescope of two stages on a cord, a gripper that the arm does not know, and a ball that lies about.
TELESCOPE = """
<mujoco model="telescope">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="ball" pos="0 2 0.05"><freejoint/><geom size="0.05"/></body>
    <body name="base" pos="0 0 1"><geom size="0.05" mass="1" contype="0" conaffinity="0"/><site name="base_frame"/>
      <body name="mast" gravcomp="1">
        <joint name="turn" type="hinge" axis="0 0 1" range="-2 2" ref="0.25" armature="0.1"/>
        <geom type="box" size="0.1 0.03 0.02" pos="0.1 0 0" mass="2" contype="0" conaffinity="0"/>
        <body name="stage1" gravcomp="1">
          <joint name="stage1" type="slide" axis="1 0 0" range="0 0.3" armature="1"/>
          <geom type="box" size="0.1 0.02 0.02" pos="0.2 0 0" mass="1" contype="0" conaffinity="0"/>
          <body name="stage2" gravcomp="1">
            <joint name="stage2" type="slide" axis="1 0 0" range="0 0.3" armature="0.5"/>
            <geom type="box" size="0.1 0.01 0.01" pos="0.3 0 0" mass="0.5" contype="0" conaffinity="0"/>
            <site name="link1_frame" pos="0.4 0 0"/>
            <body name="finger" pos="0.4 0 0" gravcomp="1">
              <joint name="grip" type="slide" axis="0 1 0" range="0 0.05" damping="1"/>
              <geom type="box" size="0.01 0.01 0.01" mass="0.05" contype="0" conaffinity="0"/>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="stage2" joint2="stage1" polycoef="0 1 0 0 0" solref="0.004 1"/></equality>
  <tendon><fixed name="cord"><joint joint="stage1" coef="1"/><joint joint="stage2" coef="1"/></fixed></tendon>
  <actuator>
    <position name="grip" joint="grip" kp="200" kv="5"/>
    <position name="turn" joint="turn" kp="4000" kv="60"/>
    <position name="cord" tendon="cord" kp="5000" kv="150"/>
  </actuator>
  <keyframe>
    <key name="home" qpos="0 2 0.05 1 0 0 0 0.2 0.1 0.1 0.03" ctrl="0.03 0.2 0.2"/>
  </keyframe>
</mujoco>
"""


def write(directory, name: str, xml: str) -> Arm:
    path = directory / f"{name}.xml"
    path.write_text(xml)
    return Arm.from_xml(path, name)


@pytest.fixture(scope="session")
def small_arms(tmp_path_factory):
    """Arms by name: compound (two links, 8 coordinates), hanging (one link, not compensated), telescope."""
    folder = tmp_path_factory.mktemp("arms")
    return {
        "compound": write(folder, "compound", COMPOUND.format(gravcomp=1, second=SECOND, drive=DRIVE)),
        "hanging": write(folder, "hanging", COMPOUND.format(gravcomp=0, second="", drive="")),
        "telescope": write(folder, "telescope", TELESCOPE),
    }


@pytest.fixture(scope="session")
def travel():
    """A minimum-jerk motion between joint positions, without a network."""

    def make(arm: Arm, start, goal, duration: float = 1.0) -> Motion:
        timestep = arm.model.opt.timestep
        steps = round(duration / timestep)
        t = timestep * np.arange(steps + 1)
        share, slope = minimum_jerk_law(t / t[-1])
        q = start + share[:, None] * (np.asarray(goal) - start)
        qd = slope[:, None] / t[-1] * (np.asarray(goal) - start)
        xi, gap = arm.encode(q), np.zeros((len(t), arm.n_links))
        return Motion(t, t / t[-1], xi, xi[-1], q, qd, gap, gap)

    return make


class SeededRuns:
    """Motions of telescopic_pr to random targets, and what controllers make of them: each is computed once."""

    def __init__(self) -> None:
        self.arm = Arm.load("telescopic_pr")
        self.motion = functools.cache(self._motion)
        self.run = functools.cache(self._run)

    def _motion(self, seed: int) -> tuple[np.ndarray, Motion]:
        """A target and a planned motion of 4 s to it."""
        rng = np.random.default_rng(seed)
        low, high = self.arm.position_limits.T
        while True:
            target = rng.uniform(low + 0.05 * (high - low), high - 0.05 * (high - low))
            if not self.arm.contacts(target):
                return target, plan(
                    self.arm, target, seed=seed, duration=(4.0, 4.0), options=CertifiedOptions(n_networks=6)
                ).motion

    def _run(self, seed: int, controller: str) -> tuple[Rollout, Evaluation]:
        target, motion = self.motion(seed)
        rollout = simulate(self.arm, motion, target=target, controller=controller, hold=0.5)
        return rollout, evaluate(rollout, clearance=False)


@pytest.fixture(scope="session")
def seeded():
    return SeededRuns()
