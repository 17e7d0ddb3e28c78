"""Views of compiled models against MuJoCo: poses, places of dependent joints, limits, contacts, slopes, messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm.loops import PALLETISER, SCISSOR_LIFT
from hypothesis import given, settings
from hypothesis import strategies as st

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.clearance_bounds import ClearanceBounds
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.contact_slopes import ContactSlopes
from lieednn_sim.errors import InputError, NoSolutionError

CRANE = str(Path(__file__).parents[2] / "assets/mjcf/telescopic_crane/scene.xml")
EQUALITY, JOINT, TENDON = (
    int(getattr(mujoco.mjtConstraint, f"mjCNSTR_{kind}")) for kind in ("EQUALITY", "LIMIT_JOINT", "LIMIT_TENDON")
)


def random_world(rng):
    """A chain that carries a hand and branches of followers, on a base that has a joint, with a drum, among things."""
    numbers = lambda *v: " ".join(f"{x:.4f}" for x in v)  # noqa: E731

    def geom(name):
        margin, gap = rng.choice([0.0, 0.02, 0.05], 2)
        return f'<geom name="{name}" size="{rng.uniform(0.03, 0.12):.4f}" margin="{margin}" gap="{gap}"/>'

    def body(name, kind, inside="", wide=1.0):
        where, axis = numbers(*rng.uniform(-0.25, 0.25, 3)), numbers(*rng.normal(size=3))
        bounds = "" if kind == "ball" else f'range="{numbers(-wide * rng.uniform(0.3, 1), wide * rng.uniform(0.3, 1))}"'
        joint = f'<joint name="{name}" type="{kind}" axis="{axis}" {bounds}/>' if kind else ""
        return f'<body name="b{name}" pos="{where}">{joint}{geom("g" + name)}{inside}</body>'

    kinds = list(rng.choice(["hinge", "slide"], 3)) + ["ball"] * (rng.random() < 0.3)
    scalars, ties = ["j0", "j1", "j2"], '<joint joint1="drum" joint2="j1" polycoef=".1 2 0 0 0"/>'
    tree = body("palm", "", body("finger1", "hinge") + body("finger2", "slide"))
    for k in reversed(range(len(kinds))):
        kind, leader = rng.choice(["hinge", "slide"]), rng.choice([*scalars, "drum"])
        curved = rng.normal(size=3) * (rng.random() < 0.3)
        ties += (
            f'<joint joint1="f{k}" joint2="{leader}" polycoef="{numbers(*rng.normal(scale=0.3, size=2), *curved)}"/>'
        )
        tree = body(f"j{k}", kinds[k], tree + body(f"f{k}", kind, body(f"e{k}", ""), wide=3.0))
    things = "".join(f'<geom name="t{k}" pos="{numbers(*rng.uniform(-0.6, 0.6, 3))}" size=".08"/>' for k in range(4))
    things += f'<body name="thing" pos=".3 .3 0"><freejoint/>{geom("thing")}</body>'
    pairs = "".join(
        f'<pair geom1="{a}" geom2="{b}" margin="{m}" gap=".01"/>'
        for a, b, m in (("gj0", "gj1", 0.1), ("gpalm", "t0", 0.3), ("gfinger1", "gj2", 0.0), ("gbase", "gj0", 0.02))
        if rng.random() < 0.3
    )
    rope = '<fixed name="rope" range="-.9 .9"><joint joint="j0" coef=".7"/><joint joint="j2" coef="-1"/></fixed>'
    return f"""<mujoco><compiler angle="radian" autolimits="true"/><worldbody>{things}{body("drum", "hinge", wide=9.0)}
      {body("base", "slide", tree)}</worldbody><contact>{pairs}<exclude body1="bj0" body2="bpalm"/></contact>
      <tendon>{rope if rng.random() < 0.5 else ""}</tendon><equality>{ties}</equality></mujoco>"""


def pushing(arm, model, data):
    """Pairs of bodies that push each other in MuJoCo, of those that the arm moves against each other."""
    contact = data.contact
    pairs = {tuple(map(int, model.geom_bodyid[geoms])) for geoms in contact.geom[contact.exclude == 0]}
    moves = {body: arm.moved_by(body)[arm.dofs].tolist() for pair in pairs for body in pair}
    return {frozenset(model.body(b).name for b in pair) for pair in pairs if moves[pair[0]] != moves[pair[1]]}


def compare(arm, model, data, q):
    """Everything at a configuration, against MuJoCo's own answers."""
    data.qpos[:] = arm.qpos(q)
    mujoco.mj_forward(model, data)
    rows = np.abs(data.efc_pos[data.efc_type == EQUALITY])
    assert rows.max(initial=0.0) < 1e-9
    assert arm.coordinates(data.qpos) == pytest.approx(q, abs=1e-9)
    place, turn = arm.frames.poses(data.xpos, data.xmat)
    pose = arm.link_poses(q)
    assert pose.translation == pytest.approx(place, abs=1e-9)
    assert pose.rotation.as_matrix() == pytest.approx(turn, abs=1e-9)
    moved = set(model.dof_jntid[arm.dofs])
    ids = zip(data.efc_type, data.efc_id, data.efc_pos, strict=True)
    beyond = [-pos for kind, i, pos in ids if kind == TENDON or (kind == JOINT and i in moved)]
    if abs(max(beyond, default=1.0)) > 2e-6:
        assert (arm.limit_excess(q).max() > 0.0) == bool(beyond)
    assert {frozenset(pair) for pair in arm.contacts(q)} == pushing(arm, model, data)


def check_slopes(arm, q):
    """Velocities and derivatives of distances by finite differences."""
    rng, step = np.random.default_rng(0), 1e-6
    qd = rng.normal(size=arm.n_joints)
    ends, motion = arm.qpos(q + step * np.array([[-1.0], [1.0]]) * qd), np.empty(arm.model.nv)
    mujoco.mj_differentiatePos(arm.model, motion, 2.0 * step, *ends)
    assert arm.qvel(q, qd) == pytest.approx(motion, abs=1e-5 * max(1.0, np.abs(motion).max()))
    collisions = Collisions(arm)
    near = collisions.distances(q, 0.3)
    there = [collisions.distances(q + side * step * qd, 0.4) for side in (-1.0, 1.0)]
    low, high = ({tuple(p): d for p, d in zip(each.pairs, each.distance, strict=True)} for each in there)
    for pair, slope, distance in zip(near.pairs, near.jacobian, near.distance, strict=True):
        offset = float(collisions.offsets(pair[None])[0])
        if distance + offset > 1e-4:  # MuJoCo's directions of separation in penetration are not always the shortest
            assert slope @ qd == pytest.approx((high[*pair] - low[*pair]) / (2 * step), abs=1e-4)
    slopes = ContactSlopes(arm, 0.05, own=True)
    index, distance, rates = slopes.along(q + step * np.array([[-1.0], [0.0], [1.0]]) * qd)
    if len(set(np.bincount(index, minlength=3))) == 1 and distance.min(initial=1.0) > 1e-3:
        sums = np.bincount(index, distance, 3)
        assert rates[index == 1].sum(axis=0) @ qd == pytest.approx((sums[2] - sums[0]) / (2 * step), abs=1e-3)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_random_trees_are_as_mujoco_says(seed):
    rng = np.random.default_rng(seed)
    xml = random_world(rng)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.joint("base").qpos = 0.1
    joints = [name for name in ("j0", "j1", "j2", "j3") if f'name="{name}"' in xml]
    arm = ls.Arm.of(model, data, joints)
    assert (arm.dependents is None) == all(not model.eq_data[e, 2:5].any() for e in range(model.neq))
    low, high = arm.position_limits.T
    for q in rng.uniform(low - 0.1 * arm.ranges, high + 0.1 * arm.ranges, (8, arm.n_joints)):
        q[arm.space.balls] *= 0.4  # a turn of less than pi
        compare(arm, model, data, q)
    check_slopes(arm, rng.uniform(low, high))


def made(xml, **state):
    model = mujoco.MjModel.from_xml_path(xml) if xml.endswith(".xml") else mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    for name, value in state.items():
        data.joint(name).qpos = value
    return model, data


@pytest.mark.parametrize(
    ("xml", "joints", "tip", "moved"),
    [
        (CRANE, ["slew", "luff", "extend"], "end_effector", 6),
        (PALLETISER, ["turn", "lower", "upper"], None, 9),
        (SCISSOR_LIFT, ["rise1"], None, 9),
    ],
)
def test_loops_are_closed_and_their_ranges_kept(xml, joints, tip, moved):
    model, data = made(xml)
    arm = ls.Arm.of(model, data, joints, tip=tip)
    assert len(arm.dofs) == moved
    low, high = arm.position_limits.T
    rng = np.random.default_rng(0)
    for q in rng.uniform(low - 0.05 * arm.ranges, high + 0.05 * arm.ranges, (20, arm.n_joints)):
        if np.isfinite(arm.limit_excess(q)).all():
            compare(arm, model, data, q)
    check_slopes(arm, rng.uniform(low, high))


def test_a_crane_plans_around_what_is_in_the_way_of_its_cylinder():
    model, data = made(CRANE)
    joints = ["slew", "luff", "extend"]
    arm = ls.Arm.of(model, data, joints, tip="end_effector")
    q = np.array([0.0, 0.05, 0.5])
    data.qpos[:] = arm.qpos(q)
    mujoco.mj_kinematics(model, data)
    beside = 0.3 * data.site("barrel_eye").xpos + 0.7 * data.site("rod_eye").xpos + [0.0, 0.3, 0.0]
    spec = mujoco.MjSpec.from_file(CRANE)
    spec.worldbody.add_geom(name="post", pos=beside, size=[0.27, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    arm = ls.Arm.of(model, data, joints, tip="end_effector")
    assert ("world", "rod") in arm.near_contacts(q)
    check_slopes(arm, q - [0.05, 0.0, 0.0])
    with pytest.raises(InputError, match=r"no proof of clearance: body '(rod|barrel)' is moved by a closed loop"):
        ClearanceBounds(arm, arm.retractor.groups)
    found = ls.plan_in(model, data, joints, [-0.7, 0.1, 1.0], tip="end_effector", duration=6, max_time_scale=5)
    for data.qpos[:] in found.qpos[::50]:
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[data.efc_type == EQUALITY]).max() < 1e-9
        assert not pushing(found.arm, model, data)


def test_where_a_loop_cannot_close_nothing_is_free():
    crank = '<body><joint name="crank" axis="0 -1 0"/><geom size=".01"/><body name="strut" pos=".3 0 0"><joint '
    crank += (
        'name="strut" axis="0 -1 0" range="-179 179"/><geom size=".01"/><site name="tip" pos=".5 0 0"/></body></body>'
    )
    piston = '<body name="piston"><joint name="push" type="slide" axis="1 0 0" range=".3 1"/><geom size=".01"/>'
    world = f'<worldbody>{crank}{piston}<site name="pin"/></body></worldbody>'
    loop = '<equality><connect site1="tip" site2="pin"/></equality>'
    arm = ls.Arm.of(*made(f"<mujoco>{world}{loop}</mujoco>", crank=1, strut=-2, push=0.6), ["push"])
    assert np.isnan(arm.qpos(np.array([[0.9], [0.5]]), strict=False)).any(axis=1).tolist() == [True, False]
    assert arm.limit_excess(np.array([0.9])).max() == np.inf
    assert list(arm.near_contacts_along(np.array([[0.5], [0.9]])))[1] == [("", "strut")]
    with pytest.raises(InputError, match=r"target is out of reach: no solution .* stays open by 0\.1"):
        ls.plan(arm, [0.9], start=[0.6], planner="minimum-jerk")
    with pytest.raises(NoSolutionError, match=r"'push' = 0\.9"):
        arm.qpos([0.9])


TOOL = """<mujoco><worldbody><geom name="table" type="box" pos="0 .45 .44" size=".2 .2 .02"/>
<body name="a" pos="0 0 .5"><joint name="turn" axis="0 0 1" range="-90 90"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>
<body name="hand" pos=".3 0 0"><joint name="out" type="slide" axis="1 0 0" range="0 .3"/><geom size=".02"/>
<site name="tip" pos=".1 0 0"/></body></body><body name="tool" pos=".45 0 .5"><freejoint/>
<geom type="capsule" fromto="-.125 0 0 .1 0 0" size=".01"/><geom type="capsule" fromto="0 0 0 0 0 -.1" size=".01"/>
</body></worldbody><equality><weld body1="hand" body2="tool"/></equality></mujoco>"""


def test_a_welded_tool_is_held_and_one_that_is_not_lies_in_the_way():
    model, data = made(TOOL)
    arm = ls.Arm.of(model, data, ["turn", "out"], tip="tip")
    assert (arm.dependents, arm.grasp is None) == (None, False)
    q = np.random.default_rng(0).uniform(*arm.position_limits.T, (20, 2))
    for each in q:
        data.qpos[:] = arm.qpos(each)
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[data.efc_type == EQUALITY]).max() < 1e-9
        names = {frozenset(pair) for pair in arm.contacts(each)}
        assert names == pushing(arm, model, data) - {frozenset(["hand", "tool"])}
    assert any("tool" in pair for pairs in map(arm.contacts, q) for pair in pairs)
    check_slopes(arm, np.array([0.2, 0.1]))
    data = mujoco.MjData(model)
    data.eq_active[0] = 0
    assert ls.Arm.of(model, data, ["turn", "out"]).contacts([0.0, 0.0]) == [("hand", "tool")]


@pytest.mark.parametrize(
    ("xml", "joints", "tip", "message"),
    [
        (CRANE, ["slew", "stroke"], "end_effector", "'stroke' is not on the way to .* moves 'luff' there, so name"),
        (CRANE, ["luff", "stroke"], "end_effector", "'luff', 'stroke' cannot move .* equality 'cylinder'"),
        (PALLETISER, ["lower", "upper"], "tool", "'wrist', on the way .* by 'lower', 'upper' through a closed loop"),
    ],
)
def test_joints_that_are_no_arm_are_named(xml, joints, tip, message):
    with pytest.raises(InputError, match=message):
        ls.Arm.of(*made(xml), joints, tip=tip)
