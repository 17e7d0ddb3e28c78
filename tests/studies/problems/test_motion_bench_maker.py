"""Reading MotionBenchMaker's problems."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import FileError
from lieednn_sim.studies.problems.motion_bench_maker import ProblemSets


def test_a_problem_is_an_arm_among_obstacles_with_a_start_and_a_goal(tiny: Path) -> None:
    sets = ProblemSets(tiny)
    arm, start, goal = sets.problem("post", 1)
    assert (sets.robot, arm.joint_names, arm.clearance) == ("tiny", ("torso", "shoulder", "elbow"), 0.0)
    np.testing.assert_array_equal([start, goal], [[0.1, -0.6, 0.0], [0.1, 0.6, 0.0]])
    # Half of the post's length; the box is half a metre along its object's x, which points along the world's y.
    post, box = (arm.model.geom(name) for name in ("obstacle_post-0-0", "obstacle_box-1-0"))
    assert post.type == mujoco.mjtGeom.mjGEOM_CYLINDER
    np.testing.assert_allclose(post.size[:2], [0.05, 0.5])
    np.testing.assert_allclose(box.size, [0.1, 0.2, 0.3])
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.qpos(start)
    mujoco.mj_kinematics(arm.model, data)
    np.testing.assert_allclose(data.geom("obstacle_box-1-0").xpos, [-1.0, 0.5, 0.3], atol=1e-12)
    # The box's x is the world's y.
    np.testing.assert_allclose(data.geom("obstacle_box-1-0").xmat.reshape(3, 3)[:, 0], [0.0, 1.0, 0.0], atol=1e-9)
    # The finger is locked where problems begin: 0.37 m from the elbow.
    np.testing.assert_allclose(data.body("finger").xpos, [0.77 * np.cos(0.6), -0.77 * np.sin(0.6), 0.3], atol=1e-9)


def test_parts_collide_that_the_srdf_does_not_rule_out(tiny: Path, tmp_path: Path) -> None:
    # Neighbours never do; the base stands still. The finger has a joint of its own, so upper is no neighbour of it.
    moving = {("fore", "lift"), ("finger", "lift"), ("finger", "upper")}
    moving |= {("base", "upper"), ("base", "fore"), ("base", "finger")}
    assert colliding(tiny) == moving | {("base", "lift")}
    folder = tmp_path / "tiny"
    shutil.copytree(tiny, folder)
    semantics = (folder / "tiny.srdf").read_text()
    (folder / "tiny.srdf").write_text(semantics.replace('"fore"', '"lift"'))
    assert colliding(folder) == moving - {("finger", "lift")} | {("base", "lift")}
    (folder / "tiny.srdf").unlink()
    assert colliding(folder) == moving, "the import knows a telescope"


def colliding(folder: Path) -> set[tuple[str, ...]]:
    """Names of the bodies that may collide, in pairs."""
    arm = ProblemSets(folder).arm
    names = (sorted(arm.model.body(arm.model.geom_bodyid[g]).name for g in pair) for pair in Collisions(arm).pairs)
    return {tuple(pair) for pair in names}


def test_a_goal_beyond_a_limit_by_rounding_is_on_it(tiny: Path) -> None:
    arm, _, goal = ProblemSets(tiny).problem("easy", 2)
    assert goal[1] == arm.position_limits[1, 1] == 3.14159


def test_the_list_takes_the_sets_in_turn_and_evenly(tiny: Path) -> None:
    sets = ProblemSets(tiny)
    assert sets.selection() == [("easy", 1), ("post", 1), ("easy", 2), ("post", 2)]
    assert sets.selection(2) == [("easy", 1), ("post", 1)]
    sets._files = {(name, number, "request"): tiny for name in ("a", "b", "c") for number in range(1, 101)}
    # Five of a and b, four of c would be 14; from 1 on in steps of 20.
    assert sets.selection(14) == [
        (name, number) for number in (1, 21, 41, 61, 81) for name in ("a", "b", "c") if (name, number) != ("c", 81)
    ]
    assert len(set(sets.selection())) == len(sets.selection()) == 300


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda folder: (folder / "tiny_spherized.urdf").unlink(),
            "or else one *.urdf, got none",
        ),
        (lambda folder: shutil.rmtree(folder / "problems"), "holds no problems: no SET/scene0001.yaml"),
        (
            lambda folder: (folder / "tiny.srdf").write_text("<robot"),
            "is not as MotionBenchMaker writes it (ParseError",
        ),
        (lambda folder: _edit(folder, "scene", lambda world: world.pop("world")), "(KeyError: 'world')"),
        (lambda folder: _edit(folder, "scene", _as_mesh), "post is a mesh or a plane"),
        (lambda folder: _edit(folder, "scene", _in_hand), "post is in the frame 'finger'"),
        (lambda folder: _edit(folder, "request", _other_joint), "is for the joints torso, shoulder, wrist"),
        (lambda folder: _edit(folder, "request", _open_hand), "has grip at other start positions"),
    ],
)
def test_what_is_wrong_with_a_folder_is_said(tiny: Path, tmp_path: Path, change: object, message: str) -> None:
    folder = tmp_path / "tiny"
    shutil.copytree(tiny, folder)
    change(folder)  # type: ignore[operator]
    with pytest.raises(FileError, match=re.escape(message)):
        ProblemSets(folder).problem("post", 1)


def _edit(folder: Path, kind: str, change: object) -> None:
    path = folder / "problems" / "post_tiny" / f"{kind}0001.yaml"
    value = json.loads(path.read_text())
    change(value)  # type: ignore[operator]
    path.write_text(json.dumps(value))


def _as_mesh(world: dict) -> None:  # type: ignore[type-arg]
    world["world"]["collision_objects"][0]["meshes"] = [{}]


def _in_hand(world: dict) -> None:  # type: ignore[type-arg]
    world["world"]["collision_objects"][0]["header"] = {"frame_id": "finger"}


def _other_joint(request: dict) -> None:  # type: ignore[type-arg]
    request["goal_constraints"][0]["joint_constraints"][2]["joint_name"] = "wrist"


def _open_hand(request: dict) -> None:  # type: ignore[type-arg]
    request["start_state"]["joint_state"]["position"][0] = 0.04
