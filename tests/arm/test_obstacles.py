"""Obstacles of one's own: what a file says stands there, for every arm, and what it says wrongly is named."""

from __future__ import annotations

import dataclasses
import json
import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.obstacles import describe, load_obstacles
from lieednn_sim.arm.targets import TARGET_CLEARANCE, draw_target
from lieednn_sim.errors import FileError, InputError

DOCUMENT = Path(__file__).parents[2] / "docs" / "howto" / "own_scene.md"
BOX = {"shape": "box", "size": [0.2, 0.4, 0.6], "position": [1.5, 0.0, 0.0]}
POLE = {"shape": "cylinder", "name": "pole", "radius": 0.1, "length": 2.0, "position": [0.0, 1.5, 0.0]}
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MJCF = """
<mujoco>
  <compiler angle="degree" meshdir="meshes"/>
  <default><default class="post"><geom type="cylinder" size="0.1 1"/></default></default>
  <asset><mesh name="wedge" file="wedge.obj"/></asset>
  <worldbody>
    <geom class="post" pos="1.5 0 0" euler="90 0 0"/>
    <body name="wedge" pos="-1 0 -0.5"><geom name="wedge" type="mesh" mesh="wedge"/></body>
    <geom name="picture" size="5" contype="0" conaffinity="0"/>
    {more}
  </worldbody>
  <keyframe><key name="home"/></keyframe>
</mujoco>"""


def write(folder, name, text):
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(text if isinstance(text, str) else json.dumps(text))
    return path


def clearance(arm, *q):
    return Collisions(arm).clearance(np.array(q, dtype=float))


def test_shapes_stand_where_the_list_says(gantry, tmp_path):
    # The ball of radius 0.1 is 1 m beside (x, y, z).
    write(tmp_path, "wedge.obj", TETRAHEDRON)
    turned = {**POLE, "name": "rail", "position": [0.0, -1.5, 0.5], "rpy": [0.0, np.pi / 2, np.pi / 2]}
    ball = {"shape": "sphere", "radius": 0.2, "position": [1.0, 0.0, 2.0]}
    wedge = {"shape": "mesh", "file": "wedge.obj", "scale": 0.5, "position": [-0.5, 0.0, 1.2]}
    path = write(tmp_path, "own.json", {"obstacles": [BOX, POLE, turned, ball, wedge]})
    arm = gantry.with_scene(path, seed=3)
    assert (arm.scene, arm.scene_seed) == ("own", 0)
    assert clearance(arm, 0, 0, 0, 0) == pytest.approx(0.5 - 0.1 - 0.1)  # the box's face at x = 1.4
    assert clearance(arm, -1, 1, 0, 0) == pytest.approx(0.5 - 0.1 - 0.1)  # the pole
    assert clearance(arm, -1, 0, 0.5, 0) == pytest.approx(0.5 - 0.1, abs=1e-6)  # the rail along y ends at y = -0.5
    assert clearance(arm, -1, -1.5, 0.8, 0) == pytest.approx(0.3 - 0.1 - 0.1)  # and above it
    assert clearance(arm, 0, 0, 1.5, 0) == pytest.approx(0.5 - 0.2 - 0.1)
    # The mesh's slanted face is 0.5 / sqrt(3) from its corner, the ball 1.5 / sqrt(3).
    assert clearance(arm, -1, 0.5, 1.7, 0) == pytest.approx(1.0 / np.sqrt(3.0) - 0.1, abs=1e-6)


def test_a_quaternion_turns_as_the_angles_do(gantry, tmp_path):
    turns = {"rpy": [np.pi / 2, 0.0, np.pi / 2]}, {"quaternion": [0.5, 0.5, 0.5, 0.5]}
    one, other = (
        gantry.with_scene(write(tmp_path, f"turned{i}.json", {"obstacles": [BOX | turn]})).fingerprint
        for i, turn in enumerate(turns)
    )
    # Roll, then yaw: x to y to z to x.
    assert one == other != gantry.with_scene(write(tmp_path, "as_is.json", {"obstacles": [BOX]})).fingerprint


def test_yaml_says_the_same(gantry, tmp_path):
    pytest.importorskip("yaml")
    text = "# a box\nobstacles:\n  - shape: box\n    size: [0.2, 0.4, 6e-1]\n    position: [1.5, 0, 0]\n"
    arms = [
        gantry.with_scene(write(tmp_path, "own.yaml", text)),
        gantry.with_scene(write(tmp_path, "o.json", {"obstacles": [BOX]})),
    ]
    assert arms[0].fingerprint == arms[1].fingerprint
    with pytest.raises(FileError, match=r"bad.yml is not a valid scene \(ValueError: while parsing"):
        gantry.with_scene(write(tmp_path, "bad.yml", "obstacles: [1, 2"))


def test_the_example_of_the_documentation_is_a_scene_of_an_arm(tmp_path):
    pytest.importorskip("yaml")
    text = re.search(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)[1]
    path = write(tmp_path, "table.yaml", text)
    assert describe(load_obstacles(path))[0] == "1 box, 1 cylinder, 1 capsule, 1 sphere; targets in 1 goal"
    draw_target(Arm.load("telescopic_pr", scene=path), 0)


@pytest.mark.parametrize("bits", [(1, 1), (2, 0), (0, 4)])
def test_an_mjcf_file_is_an_obstacle_for_every_arm(gantry, tmp_path, bits):
    write(tmp_path, "meshes/wedge.obj", TETRAHEDRON)
    # Mocap bodies stand where the file has them.
    more = '<body name="far" mocap="true" pos="0 0 40"><geom size=".01"/></body>'
    path = write(tmp_path, "own.xml", MJCF.format(more=more))
    # An arm whose geoms collide by other bits than those of the file.
    spec = gantry.spec.copy()
    ball = spec.geom("ball")
    ball.contype, ball.conaffinity = bits
    arm = Arm.from_spec(spec, gantry.source, "gantry").with_scene(path)
    assert clearance(arm, 0, 0, 0, 0) == pytest.approx(0.5 - 0.1 - 0.1)
    assert set(*arm.near_contacts([0.35, 0, 0, 0])) == {"obstacle_own", "wrist"}
    assert describe(load_obstacles(path))[0] == "1 cylinder, 1 mesh, 1 sphere; targets anywhere"
    assert arm.model.body("obstacle_far").pos == pytest.approx([0, 0, 40])
    # The plant of a controller that adds bodies is compiled from the spec again.
    assert arm.spec.copy().compile().ngeom == arm.model.ngeom
    assert [arm.model.key(k).name for k in range(arm.model.nkey)] == [
        gantry.model.key(k).name for k in range(gantry.model.nkey)
    ]


def test_targets_of_a_robot_whose_first_link_turns_close_over_the_floor(tmp_path):
    """As that of a UR5e by 12 mm, wherever it goes: none kept 20 mm."""
    turning = '<joint name="turn" axis="0 0 1" range="-170 170"/><geom type="cylinder" size=".06 .05" pos="0 0 .06"/>'
    link = '<joint name="lift" axis="0 1 0" range="-60 60"/><geom type="capsule" size=".02" fromto="0 0 .1 .3 0 .1"/>'
    file = tmp_path / "turner.xml"
    file.write_text(
        '<mujoco><worldbody><geom name="floor" type="plane" size="2 2 1"/>'
        f'<body>{turning}<body pos="0 0 .1">{link}</body></body></worldbody></mujoco>'
    )
    box = {**BOX, "name": "box", "size": [0.1, 0.1, 0.1], "position": [0.0, 0.4, 0.2]}
    arm = Arm.load(file, scene=write(tmp_path, "own.json", {"obstacles": [box]}))
    near = [Collisions(arm).distances(draw_target(arm, seed), TARGET_CLEARANCE) for seed in range(5)]
    assert all("floor" in Collisions(arm).names(pair) for found in near for pair in found.pairs)
    assert all(found.distance == pytest.approx([0.01]) for found in near)


def test_targets_are_in_the_goals_of_a_file_or_anywhere_free(gantry, tmp_path):
    arm = Arm.load("telescopic_pr")
    tip = arm.link_poses(arm.keyframe("extended")).translation[-1]
    x, y, z = map(float, tip)
    goal = {"size": [0.2, 0.2, 0.2], "position": [x, y, z]}
    shelf = {**BOX, "position": [x, y, z - 0.6]}
    inside = arm.with_scene(write(tmp_path, "goal.json", {"obstacles": [shelf], "goals": [goal]}))
    for seed in range(3):
        reached = inside.link_poses(draw_target(inside, seed)).translation[-1]
        assert np.abs(reached - tip).max() < 0.1 + 2e-3
    # Slots in which the ball has 15 mm on both sides, too few for a target, and room beyond the last plate.
    plates = [{**BOX, "size": [0.1, 9.0, 9.0], "position": [1.165 - 0.33 * k, 0.0, 0.0]} for k in range(4)]
    anywhere = gantry.with_scene(write(tmp_path, "anywhere.json", {"obstacles": plates}))
    collisions = Collisions(anywhere)
    assert all(collisions.is_free(draw_target(anywhere, seed), TARGET_CLEARANCE) for seed in range(8))


@pytest.mark.parametrize(
    ("content", "error", "message"),
    [
        ({"obstacle": []}, InputError, "unknown entries obstacle; allowed: floor, goals, obstacles"),
        ({"obstacles": BOX}, InputError, "obstacles must be a list, got dict"),
        ({"obstacles": []}, InputError, "holds no obstacle"),
        ({"obstacles": [3]}, InputError, "entry 1 of obstacles must be a mapping, got int"),
        ({"obstacles": [BOX, {}]}, InputError, "entry 2 of obstacles: it needs a shape: box, sphere"),
        ({"obstacles": [{**BOX, "shape": "cone"}]}, InputError, "entry 1 .*no shape 'cone'; allowed: box, capsule"),
        ({"obstacles": [{**BOX, "radius": 1}]}, InputError, "unknown entries radius; allowed: name, position"),
        ({"obstacles": [{"shape": "sphere"}]}, InputError, "it has no position, radius"),
        ({"obstacles": [{**BOX, "size": [1, 0, 1]}]}, InputError, "each size must be positive, got 0"),
        ({"obstacles": [{**BOX, "quaternion": [0, 0, 0, 0]}]}, InputError, "quaternion must have length 1, got 0"),
        ({"obstacles": [{**BOX, "quaternion": [1, 0, 0, 0], "rpy": [0, 0, 0]}]}, InputError, "both rpy and quat"),
        ({"obstacles": [{**BOX, "rpy": [0, 0, 90]}]}, InputError, "rpy, in radians, must not exceed 6.3 .* got 90"),
        ({"obstacles": [POLE, POLE]}, InputError, "entry 2 .*name must be a printable text that no other"),
        (
            {"obstacles": [{"shape": "mesh", "file": "gone.stl", "position": [0, 0, 0]}]},
            FileError,
            "entry 1 of obstacles: no such file: .*gone.stl",
        ),
        ({"obstacles": [BOX], "goals": [{"size": [1, 1, 1]}]}, InputError, "entry 1 of goals: it has no position"),
        (
            {"obstacles": [{**POLE, "position": [1.0, 0.0, 0.0]}]},
            InputError,
            "obstacle 'pole' of scene 'own' is within 2 mm of 'ball' of arm 'gantry' at home; move it.* another home$",
        ),
        (
            {"obstacles": [{**BOX, "size": [400.0, 600.0, 400.0]}]},
            InputError,
            r"give the arm another home \(are its lengths, or its mesh's, in millimetres\?\)",
        ),
        (
            {"obstacles": [{**POLE, "position": [600.0, 0.0, 450.0]}]},
            InputError,
            "'pole' is 750 m away; lengths are in metres, not millimetres",
        ),
        (MJCF.format(more=""), FileError, "files of the model are missing: .*wedge.obj"),
        ("<mujoco/>", InputError, "holds no obstacle"),
        (
            '<mujoco><worldbody><body><joint name="door"/><geom size="1"/></body></worldbody></mujoco>',
            InputError,
            "obstacles must not move, but it has joints: door",
        ),
        (
            '<mujoco><worldbody><geom size="1"/><site name="goal"/></worldbody></mujoco>',
            InputError,
            "goals must be boxes, which these are not: goal",
        ),
    ],
)
def test_what_a_file_says_wrongly_is_named(gantry, tmp_path, content, error, message):
    path = write(tmp_path, "own.xml" if isinstance(content, str) else "own.json", content)
    with pytest.raises(error, match=message) as caught:
        gantry.with_scene(path)
    assert len(str(caught.value)) < 500


def test_a_scene_is_a_file_that_is_there_and_no_name_of_the_packages(gantry, tmp_path):
    with pytest.raises(FileError, match=r"no such file: .*gone.yaml"):
        gantry.with_scene(tmp_path / "gone.yaml")
    with pytest.raises(InputError, match=r"window.json has the name of the package's scene 'window'"):
        gantry.with_scene(write(tmp_path, "window.json", {"obstacles": [BOX]}))
    around = gantry.with_scene(write(tmp_path, "own.json", {"obstacles": [BOX]}))
    with pytest.raises(InputError, match="already has the obstacles of scene 'own'"):
        around.with_scene("poles")


def test_of_an_obstacle_far_beyond_reach_it_is_asked_whether_that_is_millimetres(gantry, tmp_path):
    far = 20.0 * gantry.reach + 0.2 * np.sqrt(14.0) / 2.0  # and half of the box's diagonal
    for more, warns in ((-0.05, False), (0.05, True)):
        place = np.add(gantry.base.translation, [far + more, 0.0, 0.0])
        path = write(tmp_path, "apart.json", {"obstacles": [BOX | {"position": place.tolist()}]})
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            gantry.with_scene(path)
        assert [str(each.message).count("'obstacle_box0' is") for each in told] == [1] * warns


def test_thousands_of_obstacles_are_a_scene_and_the_nearest_of_them_is_found(tmp_path):
    """MuJoCo's broad phase needs more memory than the arms ask for; many configurations at once are sorted out."""
    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0.0, 2.0 * np.pi, 1600), rng.uniform(0.0, 3.0, 1600)
    places = np.stack([3.5 * np.cos(angle), 3.5 * np.sin(angle), height], axis=1).tolist()
    balls = [{"shape": "sphere", "radius": 0.01, "position": place} for place in places]
    arm = Arm.load("telescopic_pr", write(tmp_path, "balls.json", {"obstacles": balls}))
    collisions, random = Collisions(arm), rng.uniform(*arm.position_limits.T, (12, arm.n_joints))
    assert collisions.clearance(random) == pytest.approx(min(map(collisions.clearance, random)), abs=2e-6)
    data, places, turns = mujoco.MjData(arm.geometry), [], []
    for data.qpos[:] in arm.qpos(random):
        mujoco.mj_kinematics(arm.geometry, data)
        places.append(data.geom_xpos.copy())
        turns.append(data.geom_xmat.reshape(-1, 3, 3).copy())
    together = collisions.separations(np.array(places), np.array(turns), 1.5)
    each = [collisions.separations(one[None], turn[None], 1.5) for one, turn in zip(places, turns, strict=True)]
    assert len(together[0]) > 100
    np.testing.assert_array_equal(together[1], np.concatenate([index for _, index, _, _ in each]))


def test_in_a_model_without_a_spec_obstacles_move_and_grow_as_in_one(gantry):
    arm, rng = Arm.load("telescopic_pr", scene="poles", seed=3), np.random.default_rng(0)
    names = [name for k in range(arm.model.nbody) if (name := arm.model.body(k).name).startswith("obstacle")]
    places = {name: arm.model.body(name).pos + np.array([0.1, 0.05, 0.02]) for name in names}
    bare = dataclasses.replace(arm.without_visuals, spec=None)
    whole, light = (each.with_moved_bodies(places, 0.05).contact_finder(0.02) for each in (arm, bare))
    found_any = 0
    for qpos in arm.qpos(rng.uniform(*arm.position_limits.T, (300, 8))):
        distances = [np.sort(finder.geoms(qpos)[0]) for finder in (whole, light)]
        np.testing.assert_array_equal(*distances)
        found_any += len(distances[0])
    assert found_any > 100
    for each in (arm, bare):
        with pytest.raises(InputError, match="grown must not be negative, got -1"):
            each.with_moved_bodies(places, -1.0)
