"""Models without visual geoms: the same motion, and no such model if the motion would differ."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target


def states(model: mujoco.MjModel, q: np.ndarray, steps: int = 150) -> np.ndarray:
    """What the model does from ``qpos`` on with controls that push it about, and the forces of contacts and limits."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    data.qpos[:], rows = q, []
    for _ in range(steps):
        data.ctrl[:] = rng.normal(size=model.nu)
        mujoco.mj_step(model, data)
        rows.append(np.concatenate([data.qpos, data.qvel, data.qfrc_constraint, [data.ncon]]))
    return np.array(rows)


@pytest.mark.parametrize(
    ("name", "scene"), [("telescopic_pr", "shelf"), ("telescopic_compound", "free"), ("telescopic_rrp", "poles")]
)
def test_an_arm_moves_to_the_last_bit_as_without_its_visual_geoms(name, scene):
    arm = Arm.load(name, scene)
    bare = arm.without_visuals
    assert bare.model.ngeom < 0.25 * arm.model.ngeom
    q = arm.qpos(draw_target(Arm.load(name), 1))
    np.testing.assert_array_equal(states(arm.model, q), states(bare.model, q))
    assert arm.without_visuals is bare


@pytest.mark.parametrize(
    "change",
    [
        lambda model: model.dof_damping.__iadd__(1.0),
        lambda model: model.geom_friction.__imul__(2.0),
        lambda model: setattr(model.opt, "timestep", 1e-3),
        lambda model: model.geom_contype.fill(0),
    ],
)
def test_a_model_that_was_changed_is_left_as_it_is(change):
    arm = Arm.load("telescopic_pr")
    changed = replace(arm, model=copy.deepcopy(arm.model))
    assert changed.without_visuals is not changed
    change(changed.model)
    assert changed.without_visuals is changed


def test_what_sees_visual_geoms_keeps_them(gantry):
    assert gantry.without_visuals.model.ngeom < gantry.model.ngeom
    spec = gantry.spec.copy()
    kind = {"type": mujoco.mjtSensor.mjSENS_RANGEFINDER, "objtype": mujoco.mjtObj.mjOBJ_SITE, "intprm": [1, 0, 0]}
    spec.add_sensor(objname="base_frame", **kind)
    arm = Arm.from_spec(spec, gantry.source, "seeing")
    assert arm.without_visuals is arm
