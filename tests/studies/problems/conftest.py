"""A tiny robot with problems as MotionBenchMaker writes them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

_SPHERE = '<collision><origin xyz="{}"/><geometry><sphere radius="0.04"/></geometry></collision>'
_INERTIA = '<inertial><mass value="1"/><inertia ixx="1e-2" iyy="1e-2" izz="1e-2" ixy="0" ixz="0" iyz="0"/></inertial>'


def _link(name: str, *places: str) -> str:
    return f'<link name="{name}">{_INERTIA}{"".join(_SPHERE.format(place) for place in places)}</link>'


def _joint(name: str, kind: str, parent: str, child: str, axis: str, at: str, low: float, high: float) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>'
        f'<origin xyz="{at}"/><limit lower="{low}" upper="{high}" velocity="1" effort="50"/></joint>'
    )


# A lift that carries a planar arm of two links, and a finger that no goal names.
URDF = "".join(
    [
        '<robot name="tiny">',
        # The lift comes into it at its lowest, as the stages of a telescope do, which an import ignores.
        _link("base", "0 0 0.2"),
        _link("lift", "0 0 0"),
        _link("upper", "0.1 0 0", "0.2 0 0", "0.3 0 0"),
        _link("fore", "0.1 0 0", "0.2 0 0", "0.3 0 0"),
        _link("finger", "0 0 0"),
        _joint("torso", "prismatic", "base", "lift", "0 0 1", "0 0 0.2", 0.0, 0.4),
        _joint("shoulder", "revolute", "lift", "upper", "0 0 1", "0 0 0", -3.14159, 3.14159),
        _joint("elbow", "revolute", "upper", "fore", "0 0 1", "0.4 0 0", -2.5, 2.5),
        _joint("grip", "prismatic", "fore", "finger", "1 0 0", "0.35 0 0", 0.0, 0.05),
        "</robot>",
    ]
)
SRDF = '<robot name="tiny"><disable_collisions link1="fore" link2="finger" reason="Adjacent"/></robot>'


def request(start: list[float], goal: list[float], grip: float = 0.02) -> dict[str, Any]:
    """A message of MoveIt: start by all joints, goal by those of the arm, in another order."""
    names = ["torso", "shoulder", "elbow"]
    constraints = [{"joint_name": name, "position": q} for name, q in zip(names, goal, strict=True)]
    return {
        "start_state": {"joint_state": {"name": ["grip", *names], "position": [grip, *start]}},
        "goal_constraints": [{"joint_constraints": constraints}],
    }


def scene(*items: dict[str, Any]) -> dict[str, Any]:
    """A message of MoveIt."""
    return {"world": {"collision_objects": list(items)}}


# A post on the arm's straight way, and a box whose pose is of its object and of its primitive, one after the other.
POST = {
    "id": "post",
    "primitives": [{"type": "cylinder", "dimensions": [1.0, 0.05]}],
    "primitive_poses": [{"position": [0.7, 0.0, 0.5], "orientation": [0.0, 0.0, 0.0, 1.0]}],
}
BOX = {
    "id": "box",
    "header": {"frame_id": "base"},
    "pose": {"position": [-1.0, 0.0, 0.0], "orientation": [0.0, 0.0, 0.7071067811865476, 0.7071067811865476]},
    "primitives": [{"type": "box", "dimensions": [0.2, 0.4, 0.6]}],
    "primitive_poses": [{"position": [0.5, 0.0, 0.3], "orientation": [0.0, 0.0, 0.0, 1.0]}],
}
# From one side of the post to the other; the same into the post; and just beyond a limit that has five decimals.
START, GOAL = [0.1, -0.6, 0.0], [0.1, 0.6, 0.0]
PROBLEMS = {
    ("easy_tiny", 1): (scene(BOX), request(START, GOAL)),
    ("easy_tiny", 2): (scene(BOX), request(START, [0.1, 3.141592653589793, 0.0])),
    ("post_tiny", 1): (scene(POST, BOX), request(START, GOAL)),
    ("post_tiny", 2): (scene(POST), request(START, [0.1, 0.0, 0.0])),
}


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the robot."""
    folder = tmp_path_factory.mktemp("sets") / "tiny"
    for (name, number), (world, asked) in PROBLEMS.items():
        inside = folder / "problems" / name
        inside.mkdir(parents=True, exist_ok=True)
        # JSON is YAML.
        (inside / f"scene{number:04}.yaml").write_text(json.dumps(world))
        (inside / f"request{number:04}.yaml").write_text(json.dumps(asked))
    (folder / "tiny_spherized.urdf").write_text(URDF)
    (folder / "tiny.srdf").write_text(SRDF)
    return folder
