"""Recordings for Rerun, read again by its own reader."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from rollouts import make_rollout
from scipy.spatial.transform import Rotation

from lieednn_sim._mujoco import kinematics_at
from lieednn_sim.arm import Arm
from lieednn_sim.exports import export


@pytest.fixture(autouse=True)
def installed():
    pytest.importorskip("rerun")


def reader(path):
    from rerun.chunk import RrdReader  # by the worker that needs it, not by all that collect the tests

    return RrdReader(path)


def read(path):
    """The columns of each entity by name, with the unnecessary lists around single values removed."""
    found = {}
    for part in reader(path).stream():
        entity = found.setdefault(str(part.entity_path), {})
        batch = part.to_record_batch()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            entity.setdefault(name, []).extend(column.to_pylist())
    return found


def test_the_arm_moves_and_curves_run_as_they_were_simulated(rollout, tmp_path):
    (path,) = export({"reach": rollout}, tmp_path, format="rerun", rate=20.0)
    assert path.name == "reach.rrd"
    assert [store.recording_id for store in reader(path).recordings()] == ["reach"]
    found, rows, arm = read(path), slice(None, None, 5), rollout.arm
    curve = found["/joints/lift/measured"]
    np.testing.assert_array_equal(np.ravel(curve["Scalars:scalars"]), rollout.q[rows, 1])
    np.testing.assert_array_equal(np.ravel(found["/joints/lift/planned"]["Scalars:scalars"]), rollout.q_ref[rows, 1])
    np.testing.assert_allclose([time.total_seconds() for time in curve["time"]], rollout.t[rows], atol=1e-9)
    planned, measured = arm.tip(rollout.q_ref[rows]), arm.tip(rollout.q[rows])
    away = np.linalg.norm(planned - measured, axis=1)
    np.testing.assert_allclose(np.ravel(found["/tracking_error"]["Scalars:scalars"]), away, atol=1e-12)
    np.testing.assert_allclose(
        found["/planned_path"]["LineStrips3D:strips"][0][0], arm.tip(rollout.q_ref[rows]), atol=1e-6
    )
    moved = found["/scene/link4"]
    for row in (0, -1):
        data = kinematics_at(arm.model, arm.qpos(rollout.q[rows][row]))
        body = arm.model.body("link4").id
        np.testing.assert_allclose(moved["Transform3D:translation"][row][0], data.xpos[body], atol=1e-6)
        np.testing.assert_allclose(moved["Transform3D:quaternion"][row][0], data.xquat[body][[1, 2, 3, 0]], atol=1e-6)
    # What does not move is there once, without the floor.
    assert len(found["/scene/base"]["Transform3D:translation"]) == 1
    assert "/scene/world/plane" not in found


def test_quaternions_do_not_jump_where_the_hand_turns_nearly_all_the_way(tmp_path):
    """What a hand carries is where its matrix says: the sign of the quaternion that is made of it would jump."""
    body = '<body name="{0}" pos=".3 0 0"><joint name="{0}" axis="0 0 1" range="-170 170"/><geom size=".05"/>{1}</body>'
    arms = body.format("a", body.format("b", ""))
    cup = '<body name="cup" pos="0.72 0 0"><freejoint/><geom size=".06"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{arms}{cup}</worldbody></mujoco>")
    arm = Arm.of(model, mujoco.MjData(model), ["a", "b"], tip="b").holding("cup")
    q = np.linspace([0.4, 0.2], [2.9, 2.9], 50)
    (path,) = export(make_rollout(arm, q), tmp_path, format="rerun")
    quaternion = np.array(read(path)["/scene/cup"]["Transform3D:quaternion"])[:, 0]
    assert np.vecdot(quaternion[1:], quaternion[:-1]).min() > 0.9
    turns = Rotation.from_quat(quaternion).as_rotvec()[:, 2] % (2.0 * np.pi)
    np.testing.assert_allclose(turns, q.sum(axis=1), atol=1e-5)


SHAPES = """
<mujoco>
  <asset><mesh name="tetrahedron" vertex="0 0 0 1 0 0 0 1 0 0 0 1" scale="0.3 0.3 0.3"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="one"><joint name="a" range="-90 90"/><geom type="capsule" size="0.02" fromto="0.1 0 0 0.3 0 0"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0 0 1" rgba="1 0 0 1"/><geom type="sphere" size="0.25"/>
      <geom type="mesh" mesh="tetrahedron" pos="0 0 2" euler="90 0 0"/><geom type="box" size="1 1 1" group="3"/>
      <body name="two" pos="0.3 0 0"><joint name="b" axis="0 1 0" range="-90 90"/>
        <geom type="cylinder" size="0.1 0.3"/><site name="tool" pos="0.3 0 0"/>
      </body></body>
  </worldbody>
  <contact><exclude body1="one" body2="two"/></contact>
</mujoco>
"""


def test_each_shape_has_its_place_and_size(tmp_path):
    (tmp_path / "shapes.xml").write_text(SHAPES)
    arm = Arm.load(tmp_path / "shapes.xml")
    (path,) = export(make_rollout(arm), tmp_path / "out", format="rerun")
    found = read(path)
    capsule, (mesh,) = found["/scene/one/capsule"], (entity for name, entity in found.items() if "mesh" in name)
    # Along z from its translation on, as Rerun has it.
    begin, length, quaternion = (
        capsule[f"Capsules3D:{what}"][0][0] for what in ("translations", "lengths", "quaternions")
    )
    end = begin + length * Rotation.from_quat(quaternion).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(sorted([begin, end.tolist()]), [[0.1, 0.0, 0.0], [0.3, 0.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(found["/scene/one/box"]["Boxes3D:half_sizes"][0], [[0.1, 0.2, 0.3]], atol=1e-6)
    assert found["/scene/one/box"]["Boxes3D:colors"][0] == [0xFF0000FF]
    np.testing.assert_allclose(found["/scene/one/sphere"]["Ellipsoids3D:half_sizes"][0], [[0.25] * 3], atol=1e-6)
    np.testing.assert_allclose(found["/scene/two/cylinder"]["Cylinders3D:lengths"][0], [0.6], atol=1e-6)
    corners = np.array(sorted(np.round(mesh["Mesh3D:vertex_positions"][0], 4).tolist()))
    np.testing.assert_allclose(corners, [[0, -0.3, 2], [0, 0, 2], [0, 0, 2.3], [0.3, 0, 2]], atol=1e-6)
