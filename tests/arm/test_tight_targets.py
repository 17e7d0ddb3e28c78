"""The message where random targets fail because a link always passes near the arm's own fixed base."""

import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import NoSolutionError

_ARM = """<mujoco><worldbody><body name="base"><geom name="stand" type="cylinder" size=".06 .1" pos="0 0 .1"/>
<body name="turret" pos="0 0 .21"><joint name="pan" axis="0 0 1" range="-2 2"/><geom name="box" type="box"
size=".05 .05 .05" pos="0 0 .05"/><body name="rod" pos="0 0 .11"><joint name="lift" axis="0 1 0" range="-1 1"/>
<geom name="tube" type="capsule" size=".03" fromto="0 0 .05 0 0 .3"/></body></body></body></worldbody></mujoco>"""
_TABLE = "obstacles: [{shape: box, name: table, size: [0.2, 0.2, 0.04], position: [0.9, 0, 0.2]}]"


def test_no_random_target_says_that_something_is_too_near(tmp_path):
    (tmp_path / "arm.xml").write_text(_ARM)
    (tmp_path / "near.yaml").write_text(_TABLE)
    arm = Arm.load(tmp_path / "arm.xml", scene=tmp_path / "near.yaml")
    with pytest.raises(NoSolutionError, match="something nearer than 20 mm, in 400; give"):
        draw_target(arm, 0)
