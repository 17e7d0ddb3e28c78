"""The clearance of motions at every instant: against MuJoCo's distances at random instants, and by hand."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import lieednn_sim as ls
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.errors import PlanError
from lieednn_sim.planning import clearance
from lieednn_sim.planning.clearance import Cubics, check_clearance, proved_clearance

# A thin rod of two links, and a wire of a tenth of a millimetre.
SWING = """<mujoco><option timestep="{step}"/><worldbody>
  <geom name="wire" type="box" size="{width} .3 .00005" pos="{x} 0 {z}" euler="{tilt} 0 0"/>
  <body pos="0 0 .5"><joint name="j" axis="0 1 0" range="-3 3"/>
    <geom type="capsule" fromto="0 0 0 .4 0 0" size=".0002"/>
    <body pos=".4 0 0"><joint name="k" axis="0 1 0" range="-3 3"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".0002"/></body></body>
</worldbody></mujoco>"""


def swing(seed):
    """A fast motion in long steps, most of which step over the wire."""
    rng = np.random.default_rng(seed)
    step = rng.choice([0.002, 0.01, 0.03])
    where = {"x": rng.uniform(0.3, 0.7), "z": rng.uniform(0.2, 0.8), "tilt": rng.uniform(-60.0, 60.0)}
    model = mujoco.MjModel.from_xml_string(SWING.format(step=step, width=rng.choice([5e-5, 0.05]), **where))
    arm = ls.Arm.of(model, mujoco.MjData(model), ["j", "k"], clearance=0.0)
    t = step * np.arange(round(1.0 / step) + 1)
    start, target = rng.uniform(-1.5, 1.5, (2, 2))
    s = (t / t[-1])[:, None]
    law, rate = s**3 * (10.0 - 15.0 * s + 6.0 * s**2), 30.0 * s**2 * (1.0 - s) ** 2 / t[-1]
    return arm, t, start + law * (target - start), rate * (target - start), rng


def least_distance(arm, q):
    """The least distance from the wire, as MuJoCo measures it."""
    data, result = mujoco.MjData(arm.model), []
    for data.qpos[:] in q:
        mujoco.mj_kinematics(arm.model, data)
        result.append(min(mujoco.mj_geomDistance(arm.model, data, 0, geom, 1.0, None) for geom in (1, 2)))
    return np.array(result)


def test_a_wire_between_samples_is_found_or_proved_to_be_clear():
    found, proved = 0, 0
    for seed in range(28):
        arm, t, q, qd, rng = swing(seed)
        if any(arm.near_contacts_along(q)):
            continue
        result = proved_clearance(arm, t, q, qd)
        instants = rng.uniform(0.0, t[-1], 400)
        distances = least_distance(arm, CubicHermiteSpline(t, q, qd)(instants))
        if result.proved:
            proved += 1
            check_clearance(arm, t, q, qd)
            assert 0.0 < result.bound <= distances.min() + 1e-9
        else:
            found += 1
            with pytest.raises(PlanError, match="would touch"):
                check_clearance(arm, t, q, qd)
            inside = ((instants[:, None] > result.unproved[:, 0]) & (instants[:, None] < result.unproved[:, 1])).any(
                axis=1
            )
            assert distances[~inside].min() >= result.bound - 1e-9
            # While the rod's axis is in the wire, which may be 0.1 m wide, MuJoCo may measure up to 20 mm.
            assert result.proved_fraction > (0.7 if arm.model.geom_size[0, 0] > 1e-3 else 0.99)
    assert found > 5
    assert proved > 5


@pytest.mark.parametrize(
    ("name", "scene", "planner"),
    [
        ("telescopic_pr", "window", "lieednn-shaped"),
        ("telescopic_rrp", "poles", "rrt-connect"),
        ("telescopic_compound", "shelf", "lieednn-shaped"),
        ("telescopic_pr", "free", "lieednn-certified"),
    ],
)
def test_every_instant_of_a_plan_is_as_clear_as_is_proved(name, scene, planner):
    arm = ls.Arm.load(name, scene, 1)
    plan = ls.plan(arm, ls.draw_target(arm, 1), planner=planner)
    found = plan.clearance
    assert plan.proved
    assert found.bound >= arm.clearance
    instants = np.random.default_rng(0).uniform(0.0, plan.t[-1], 100)
    spline = CubicHermiteSpline(plan.t, plan.motion.q, plan.motion.qd)
    collisions = clearance.bounds_of(arm, own=True)._collisions
    measured = collisions.clearance(spline(np.sort(instants)))
    assert found.bound <= measured + 1e-9
    if found.pair:
        there = collisions.distances(spline(found.t), 0.2)
        assert set(collisions.names(there.pairs[0])) == set(found.pair)
        # Sharp to a twentieth, and to how far the geoms move within an interval.
        assert found.bound > 0.8 * there.distance[0]
        assert str(found).startswith(
            f"at least {1e3 * found.bound:.3g} mm, '{found.pair[0]}' from '{found.pair[1]}' at "
        )


def test_pieces_hold_the_cubic():
    rng = np.random.default_rng(0)
    q, qd, step = rng.normal(size=(9, 3)), rng.normal(size=(9, 3)), 0.1
    spline, largest = CubicHermiteSpline(step * np.arange(9), q, qd), 0.0
    for begin, end in ((0.0, 8.0), (1.0, 3.0), (2.25, 2.5), (3.5, 5.25), (8.0, 8.0), (7.5, 8.0)):
        at, way, (rest, _) = (value[0] for value in Cubics(step, q, qd).around([begin], [end]))
        c = np.linspace(-1.0, 1.0, 201)[:, None]
        off = np.abs(spline(step * (0.5 * (begin + end) + 0.5 * (end - begin) * c[:, 0])) - at - c * way)
        assert (off <= rest + 1e-12).all()
        largest = max(largest, (off / np.maximum(rest, 1e-300)).max() if end > begin else 0.0)
    assert largest > 0.5


def test_where_nothing_can_be_proved_samples_are_tested(monkeypatch):
    arm, t, q, qd, _ = swing(0)
    monkeypatch.setattr(clearance, "bounds_of", lambda *_, **__: "no proof of clearance: here")
    touching = [k for k, near in enumerate(arm.near_contacts_along(q)) if near]
    assert not touching
    check_clearance(arm, t, q, qd)
    result = proved_clearance(arm, t, q, qd)
    assert not result.proved
    assert str(result) == "no proof of clearance: here"
    np.testing.assert_array_equal(result.unproved, [[0.0, t[-1]]])
    wide = replace(arm, clearance=0.5)
    with pytest.raises(PlanError, match="would come within 500 mm of"):
        check_clearance(wide, t, q, qd)


SDF = """<mujoco>
  <extension><plugin plugin="mujoco.sdf.torus"><instance name="t"/></plugin></extension>
  <asset><mesh name="ring"><plugin instance="t"/></mesh></asset>
  <worldbody><geom name="ring" type="sdf" mesh="ring" pos="1 0 0"><plugin instance="t"/></geom>
    <body><joint name="j" axis="0 0 1" range="-3 3"/><geom type="capsule" fromto="0 0 0 .7 0 0" size=".02"/></body>
  </worldbody></mujoco>"""


def test_of_geoms_seen_in_contact_alone_nothing_is_proved():
    model = mujoco.MjModel.from_xml_string(SDF)
    with pytest.warns(UserWarning, match="sdf"):
        arm = ls.Arm.of(model, mujoco.MjData(model), ["j"])
    t = 0.002 * np.arange(501)
    q = np.linspace(-1.0, 1.0, 501)[:, None]
    qd = np.full_like(q, 2.0)
    assert any(arm.near_contacts_along(q))
    result = proved_clearance(arm, t, q, qd)
    assert not result.proved
    assert result.bound == -np.inf
    assert "geoms of the type sdf" in str(result)
    with pytest.raises(PlanError, match="would come within"):
        check_clearance(arm, t, q, qd)


CLOTH = """<mujoco><worldbody>
  <flexcomp name="cloth" type="grid" count="6 6 1" spacing=".2 .2 .1" pos="0 0 .5" euler="0 90 0" rigid="true" dim="2"
    radius=".01"><contact selfcollide="none"/></flexcomp>
  <body name="hand" pos="-1 0 .5"><joint name="x" type="slide" range="-3 3" axis="1 0 0"/><geom size=".1"/></body>
</worldbody></mujoco>"""


def test_of_flexes_nothing_is_proved_and_samples_are_tested():
    model = mujoco.MjModel.from_xml_string(CLOTH)
    with pytest.warns(UserWarning, match="no clearance of 'cloth', and avoid contact at samples"):
        arm = ls.Arm.of(model, mujoco.MjData(model), ["x"])
    t, q = 0.002 * np.arange(501), np.linspace(0.0, 2.0, 501)[:, None]
    assert arm.near_contacts([1.0]) == [("hand", "cloth")]
    assert "keep no clearance of 'cloth'" in str(proved_clearance(arm, t, q, np.full_like(q, 2.0)))
    with pytest.raises(PlanError, match="'hand' would come within 2 mm of 'cloth'"):
        check_clearance(arm, t, q, np.full_like(q, 2.0))


def test_where_nothing_is_proved_there_is_no_bound():
    arm, t, q, qd, _ = swing(0)
    result = proved_clearance(arm, t, q, qd, np.full_like(q, 3.0))
    assert (result.bound, result.proved_fraction, str(result)) == (-np.inf, 0.0, "not proved at any instant")


def test_what_is_near_is_told_beside_parts_of_the_arm_that_are_nearer_to_each_other():
    arm = ls.Arm.load("telescopic_rrp", scene="poles", seed=6)
    planned = ls.plan(arm, ls.draw_target(arm, seed=6), seed=6)
    own, others = planned.clearance, planned.clearance.others
    collisions, measured = Collisions(arm), []
    for q in planned.motion.q[::10]:
        near = collisions.distances(q, 0.1)
        names = [collisions.names(pair) for pair in near.pairs]
        foreign = [any(not name.startswith(("link", "base")) for name in pair) for pair in names]
        measured.append(near.distance[foreign].min(initial=0.1))
    assert 0.0 < own.bound < others.bound <= min(measured) < 1.1 * others.bound
    assert all(name.startswith("link") for name in own.pair)
    assert others.pair[0].startswith("obstacle")
    assert others.others is None
    told = (f"{1e3 * own.bound:.3g} mm between parts of the arm, ", f"; {1e3 * others.bound:.3g} mm from all else, ")
    assert all(words in str(own) for words in told)


@pytest.mark.parametrize("kind", ["<freejoint/>", "<joint/>", ""])
def test_a_cup_or_another_robot_is_no_part_of_the_arm(kind):
    mocap = "" if kind else ' mocap="true"'
    cup = f'<body{mocap} pos=".35 0 .2">{kind}<geom name="cup" type="sphere" size=".02"/></body></worldbody>'
    swing = SWING.format(step=0.002, width=0.05, x=0.6, z=0.9, tilt=0.0)
    model = mujoco.MjModel.from_xml_string(swing.replace("</worldbody>", cup).replace('"-3 3"', '"-90 90"'))
    arm = ls.Arm.of(model, mujoco.MjData(model), ["j", "k"], clearance=0.0)
    nearest = ls.plan(arm, [0.5, 0.2], duration=1.0).clearance
    assert "cup" in nearest.pair
    # Else all but the cup would be said to be further away.
    assert nearest.others is None
