"""Views of compiled models against MuJoCo: poses, places of dependent joints, limits, contacts, slopes, messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arm.loops import PALLETISER, SCISSOR_LIFT
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanisms import MODEL, TOOL, body, compiled, connect, hinge, random_world, site, slide, tied, with_cylinder

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.clearance_bounds import ClearanceBounds
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.contact_slopes import ContactSlopes
from lieednn_sim.arm.importer import remarks
from lieednn_sim.errors import InputError, NoSolutionError

CRANE = str(Path(__file__).parents[2] / "assets/mjcf/telescopic_crane/scene.xml")
CURVED = body("a", hinge("x"), body("b", hinge("y")))
EQUALITY, JOINT, TENDON = (
    int(getattr(mujoco.mjtConstraint, f"mjCNSTR_{kind}")) for kind in ("EQUALITY", "LIMIT_JOINT", "LIMIT_TENDON")
)


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
    assert np.abs(data.efc_pos[data.efc_type == EQUALITY]).max(initial=0.0) < 1e-9
    assert arm.coordinates(data.qpos) == pytest.approx(q, abs=1e-9)
    (place, turn), pose = arm.frames.poses(data.xpos, data.xmat), arm.link_poses(q)
    assert pose.translation == pytest.approx(place, abs=1e-9)
    assert pose.rotation.as_matrix() == pytest.approx(turn, abs=1e-9)
    moved = set(model.dof_jntid[arm.dofs])
    ids = zip(data.efc_type, data.efc_id, data.efc_pos - data.efc_margin, strict=True)
    beyond = [-pos for kind, i, pos in ids if kind == TENDON or (kind == JOINT and i in moved)]
    if abs(max(beyond, default=1.0)) > 2e-6:
        assert (arm.limit_excess(q).max() > 0.0) == bool(beyond)
    assert {frozenset(pair) for pair in arm.contacts(q)} == pushing(arm, model, data)


def check_slopes(arm, q):
    """Velocities and derivatives of distances by finite differences."""
    qd, step = np.random.default_rng(0).normal(size=arm.n_joints), 1e-6
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


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_trees_are_as_mujoco_says(seed):
    rng = np.random.default_rng(seed)
    xml = random_world(rng)
    model, data = made(with_cylinder(xml, rng) if rng.random() < 0.3 else xml, base=0.1)
    arm = ls.Arm.of(model, data, [name for name in ("j0", "j1", "j2", "j3") if f'name="{name}"' in xml])
    assert (arm.dependents is None) == (model.nsite == 0 and not model.eq_data[:, 2:5].any())
    low, high = arm.position_limits.T
    for q in rng.uniform(low - 0.1 * arm.ranges, high + 0.1 * arm.ranges, (8, arm.n_joints)):
        q[arm.space.balls] *= 0.4  # a turn of less than pi
        if not np.isnan(arm.qpos(q, strict=False)).any():  # beyond a dead centre of the loop
            compare(arm, model, data, q)
    if not np.isnan(arm.qpos(q := rng.uniform(low, high), strict=False)).any():
        check_slopes(arm, q)
    if arm.dependents is None:
        bounds = ClearanceBounds(arm, [(np.array([k]), np.ones(1)) for k in range(arm.n_joints)])
        q, spread, none = rng.uniform(low, high), rng.uniform(0.2, 1.0, arm.n_joints), np.zeros((2, arm.n_joints))
        scale = bounds(q[None], none[:1], none[None], spread[None], 0.8)[0][0]
        corners = q + scale * spread * rng.choice([-1.0, 1.0], (10 * (scale > 0.0), arm.n_joints))
        assert Collisions(arm).clearance(corners) > -1e-9


@pytest.mark.parametrize(("height", "contact"), [(0.119, True), (0.121, False), (0.139, False)])
def test_in_a_gap_there_is_no_force(height, contact):
    arm = '<body><joint name="z" type="slide" axis="0 0 1" range="0 1"/><geom size=".1" margin=".02" gap=".02"/></body>'
    model, data = made(f'<mujoco><worldbody><geom type="plane" size="1 1 1"/>{arm}</worldbody></mujoco>', z=height)
    view = ls.Arm.of(model, data, ["z"])
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    assert bool(view.contacts([height])) == contact == bool(data.efc_force[: data.nefc].any())


@pytest.mark.parametrize("pair", ["", '<contact><pair geom1="floor" geom2="ball" margin=".5"/></contact>'])
@pytest.mark.parametrize(("height", "contact"), [(0.119, True), (0.121, False)])
def test_margins_that_an_option_overrides(height, contact, pair):
    slide = '<joint name="z" type="slide" axis="0 0 1" range="0 1"/>'
    ball = f'<body>{slide}<geom name="ball" size=".1" margin=".5"/></body>'
    option = '<option o_margin=".02"><flag override="enable"/></option>'
    floor = '<geom name="floor" type="plane" size="1 1 1"/>'
    model, data = made(f"<mujoco>{option}<worldbody>{floor}{ball}</worldbody>{pair}</mujoco>", z=height)
    view = ls.Arm.of(model, data, ["z"])
    mujoco.mj_forward(model, data)
    assert bool(view.contacts([height])) == contact == bool(data.efc_force[: data.nefc].any())
    assert Collisions(view).clearance([height]) == pytest.approx(height - 0.12)


def made(model, **state):
    if isinstance(model, str):
        read = mujoco.MjModel.from_xml_path if model.endswith(".xml") else mujoco.MjModel.from_xml_string
        model = read(model)
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
        (PALLETISER, ["turn", "lower", "upper", "flange"], "tool", 10),
        (SCISSOR_LIFT, ["rise1"], "platform", 9),
    ],
)
def test_loops_are_closed_and_their_ranges_kept(xml, joints, tip, moved):
    model, data = made(xml)
    arm = ls.Arm.of(model, data, joints, tip=tip)
    assert (len(arm.dofs), arm.dependents is None) == (moved, xml == PALLETISER)
    (low, high), rng = arm.position_limits.T, np.random.default_rng(0)
    for q in rng.uniform(low - 0.05 * arm.ranges, high + 0.05 * arm.ranges, (20, arm.n_joints)):
        if arm.limit_excess(q).max() < np.inf:
            compare(arm, model, data, q)
    check_slopes(arm, rng.uniform(low, high))


def test_targets_of_a_crane_may_be_strokes_of_its_cylinder():
    arm = ls.Arm.load(CRANE)
    q = arm.coordinates_at({"stroke": 0.4, "slew": 0.5})
    assert q[[0, 2]] == pytest.approx([0.5, arm.keyframe("home")[2]])
    data = mujoco.MjData(arm.model)
    data.qpos[:] = arm.qpos(q)
    mujoco.mj_kinematics(arm.model, data)
    eyes = data.site("barrel_eye").xpos - data.site("rod_eye").xpos
    assert data.joint("stroke").qpos == pytest.approx(0.4, abs=1e-9)
    home = arm.qpos(arm.keyframe("home"))
    data.qpos[:] = home
    mujoco.mj_kinematics(arm.model, data)
    longer = np.linalg.norm(data.site("barrel_eye").xpos - data.site("rod_eye").xpos) - np.linalg.norm(eyes)
    assert longer == pytest.approx(home[arm.model.joint("stroke").qposadr[0]] - 0.4, abs=1e-9)
    with pytest.raises(InputError, match="one of the joints that move with 'luff', not 'luff' as well"):
        arm.coordinates_at({"stroke": 0.4, "luff": 0.3})
    with pytest.raises(InputError, match="no joint that the arm moves 'swing_along'; allowed: extend, extend2, luff"):
        arm.coordinates_at({"swing_along": 0.1})
    with pytest.raises(NoSolutionError, match="'stroke' = 9: equality 'cylinder'"):
        arm.coordinates_at({"stroke": 9.0})


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
    model, data = made(spec.compile())
    arm = ls.Arm.of(model, data, joints, tip="end_effector")
    assert ("world", "rod") in arm.near_contacts(q)
    check_slopes(arm, q - [0.05, 0.0, 0.0])
    with pytest.raises(InputError, match=r"no proof of clearance: body '(rod|barrel)' is moved by a closed loop"):
        ClearanceBounds(arm, arm.retractor.groups)
    data.qpos[:] = arm.qpos(np.array([0.0, 0.05, 0.5]))
    found = ls.plan(arm, [-0.7, 0.1, 1.0], duration=(6, 30))
    for data.qpos[:] in found.qpos[::50]:
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[data.efc_type == EQUALITY]).max() < 1e-9
        assert not pushing(arm, model, data)


def test_where_a_loop_cannot_close_nothing_is_free():
    bodies = body("crank", hinge("crank"), body("strut", hinge("strut"), site("tip", ".5 0 0"), ".3 0 0"))
    bodies += body("piston", slide("push", more='range=".4 1" limited="true"'), site("pin", "0 0 0"))
    arm = ls.Arm.of(*made(compiled(bodies, connect("tip", "pin")), crank=1, strut=-2, push=0.6), ["push"])
    assert np.isnan(arm.qpos(np.array([[0.9], [0.5]]), strict=False)).any(axis=1).tolist() == [True, False]
    assert arm.limit_excess(np.array([0.9])).max() == np.inf
    assert list(arm.near_contacts_along(np.array([[0.5], [0.9]])))[1] == [("crank", "strut")]
    with pytest.raises(InputError, match=r"target is out of reach: no solution .* stays open by 0\.1"):
        ls.plan(arm, [0.9], start=[0.6], planner="minimum-jerk")
    with pytest.raises(NoSolutionError, match=r"'push' = 0\.9"):
        arm.qpos([0.9])


BLOCK = """<mujoco><asset><mesh name="block" vertex="-.25 -.2 -.2 .25 -.2 -.2 -.25 .2 -.2 .25 .2 -.2 -.25 -.2 .2
.25 -.2 .2 -.25 .2 .2 .25 .2 .2"/></asset><worldbody>
<geom name="block" pos="1 0 0" type="sdf" mesh="block"{}/>
<body name="a"><joint name="out" type="slide" axis="1 0 0" range="0 1"/><geom size=".1"/></body></worldbody></mujoco>"""


def test_geoms_of_which_no_clearance_can_be_kept_are_named():
    told = r"keep no clearance of 'block'"
    model = mujoco.MjModel.from_xml_string(BLOCK.format(""))
    with pytest.warns(UserWarning, match=told) as seen:
        arm = ls.Arm.of(model, mujoco.MjData(model), ["out"], clearance=0.02)
    assert seen[0].filename == __file__
    # MuJoCo sees it no sooner: the ball of 0.1 m comes to the block, which begins at 0.75 m, at 0.65 m.
    assert arm.near_contacts([0.645]) == []
    assert arm.near_contacts([0.66])
    # The notes of a view are part of an import's report.
    assert any(told.removeprefix("keep no ") in note for note in arm.notes)
    drawn = mujoco.MjModel.from_xml_string(BLOCK.format(' contype="0" conaffinity="0"'))
    assert ls.Arm.of(drawn, mujoco.MjData(drawn), ["out"]).notes == ()


def test_open_loops_are_no_contacts_in_a_report(monkeypatch):
    """Crank and strut, 0.3 and 0.5 m, push the piston out to 0.8 m; its range, 0.4 to 1 m, is a third longer."""
    bodies = body("crank", hinge("crank"), body("strut", hinge("strut"), site("tip", ".5 0 0"), ".3 0 0"))
    bodies += body("piston", slide("push", more='range=".4 1" limited="true"'), site("pin", "0 0 0"))
    spec = mujoco.MjSpec.from_string(MODEL.format(bodies, connect("tip", "pin"), "dense"))
    monkeypatch.setattr(remarks, "_PATHS", 64)
    arm = ls.Arm.from_spec(spec, joints=["push"], home={"crank": 1, "strut": -2, "push": 0.6}, floor="none")
    (told,) = (note for note in arm.import_report.notes if "64 random configurations" in note)
    assert told.endswith(" of 64 random configurations are where closed loops stay open: these cannot be targets")
    assert int(told.split()[0]) == pytest.approx(64 / 3, abs=10)


PLANAR = """<mujoco><compiler angle="radian"/><worldbody><body name="mocap" mocap="true" pos="{}"/>
<body name="a"><joint name="j1"/><geom size=".03"/><body name="b" pos=".4 0 0"><joint name="j2"/><geom size=".02"/>
<body name="c" pos=".3 0 0"><joint name="j3"/><geom size=".02"/></body></body></body></worldbody>
<equality><weld name="w" body1="mocap" body2="c" relpose="0 0 0 1 0 0 0"/></equality>
<keyframe><key qpos="{}"/></keyframe></mujoco>"""


@pytest.mark.parametrize(("place", "q"), [(".7 0 0", "0 0 0"), (".4 .3 0", "0 1.5707963267948966 -1.5707963267948966")])
def test_a_weld_that_leaves_no_joint_free_is_named_with_what_to_do(place, q):
    """Stretched, joints have a first-order freedom, but no motion; bent, not even that."""
    spec = mujoco.MjSpec.from_string(PLANAR.format(place, q))
    model, data = made(spec.compile())
    data.qpos[:] = model.key_qpos[0]
    told = r"cannot move independently, because of equality 'w' \(weld\); deactivate .*: active=\"false\" in a file"
    for make in (lambda: ls.Arm.of(model, data, ["j1"]), lambda: ls.Arm.from_spec(spec)):
        with pytest.raises(InputError, match=told):
            make()
    data.eq_active[0] = 0
    assert ls.Arm.of(model, data, ["j1", "j2", "j3"]).n_joints == 3


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
        (compiled(CURVED, tied("y", "x", "0 1 2 0 0")), ["x"], "b", "'y', on the way .* by 'x' through .* a curve"),
    ],
)
def test_joints_that_are_no_arm_are_named(xml, joints, tip, message):
    with pytest.raises(InputError, match=message):
        ls.Arm.of(*made(xml), joints, tip=tip)


def test_bodies_without_names_are_told_apart_by_their_numbers():
    ball = '<geom size=".1" mass="1"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>{ball}
        <body pos=".201 0 0"><freejoint/>{ball}<body name="post" pos="-.6 0 0">{ball}</worldbody></mujoco>"""
    )
    arm = ls.Arm.of(model, mujoco.MjData(model), ["x"])
    assert arm.near_contacts([0.0]) == [("body 1", "body 2")]
    with pytest.raises(InputError, match=r"'body 1' would touch 'body 2' there, 9 mm deep$"):
        arm.check_reachable([0.01])
    with pytest.raises(InputError, match="'body 1' would touch 'post'"):
        arm.check_reachable([-0.5])


def test_geoms_changed_since_the_model_was_compiled_are_where_they_are():
    others = "".join(f'<geom type="box" size=".04 .04 .2" pos="{3 + k} 0 .4"/>' for k in range(20))
    wall = '<geom name="wall" type="box" size="{}" pos="{} 0 .4"/>'
    unseen = wall.format(".04 .04 .2", 0.7).replace("/>", ' contype="0" conaffinity="0"/>')
    xml = """<mujoco><worldbody><body pos="0 0 .4"><joint name="turn" axis="0 0 1" range="-150 150"/>
    <geom type="capsule" size=".03" fromto=".1 0 0 .6 0 0"/></body><body name="rack">{}</body></worldbody></mujoco>"""
    known = mujoco.MjModel.from_xml_string(xml.format(wall.format(".04 .04 .2", 0.7) + others))
    enlarged = mujoco.MjModel.from_xml_string(xml.format(wall.format(".01 .01 .01", 0.7)))
    enlarged.geom("wall").size[:] = 0.04, 0.04, 0.2
    moved = mujoco.MjModel.from_xml_string(xml.format(wall.format(".04 .04 .2", 2.0) + others))
    moved.geom("wall").pos[0] = 0.7
    heavier = mujoco.MjModel.from_xml_string(xml.format(wall.format(".04 .04 .2", 0.7) + others))
    heavier.body("rack").ipos[2] += 5.0
    touchable = [mujoco.MjModel.from_xml_string(xml.format(unseen + more)) for more in ("", others)]
    for model in touchable:
        model.geom("wall").contype = model.geom("wall").conaffinity = 1
    for model in (known, enlarged, moved, heavier, *touchable):
        arm, q = ls.Arm.of(model, mujoco.MjData(model), ["turn"]), np.array([0.15])
        corner = np.hypot(0.66 - 0.6 * np.cos(q[0]), 0.6 * np.sin(q[0]) - 0.04)
        distances, _ = arm.contact_finder(0.2).geoms(arm.qpos(q))
        assert [distances.min(), Collisions(arm).clearance(q)] == pytest.approx([corner - 0.03] * 2, abs=1e-6)


def test_flags_that_disable_contacts_do_not_hide_obstacles():
    xml = """<mujoco><option><flag {}="disable"/></option><worldbody><body name="rod" pos="0 0 .4">
    <joint name="turn" axis="0 0 1" range="-150 150"/><geom type="capsule" size=".03" fromto=".1 0 0 .6 0 0"/></body>
    <body name="wall" pos=".7 0 .4"><geom type="box" size=".2 .04 .2"/></body></worldbody></mujoco>"""
    for flag in ("contact", "constraint"):
        model = mujoco.MjModel.from_xml_string(xml.format(flag))
        arm = ls.Arm.of(model, mujoco.MjData(model), ["turn"])
        assert arm.contacts([0.1]) == [("rod", "wall")]
        with pytest.raises(ls.errors.PlanError, match="'rod' would come within 2 mm of 'wall'"):
            ls.plan(arm, [1.0], start=[-1.0], planner="minimum-jerk")
        assert not ls.simulate(arm, ls.plan(arm, [1.4], start=[0.9])).contacts.any()


def test_disabled_equalities_hold_nothing():
    chain = body("a", hinge("x"), body("b", hinge("y"), site("tip", "0 0 1")))
    free = '<body name="tool" pos="0 0 3"><freejoint/><geom/></body>'
    held = '<equality><joint joint1="y" joint2="x"/><weld body1="b" body2="tool"/></equality>'
    for flag, names in (("", ("x",)), ("constraint", ("x", "y")), ("equality", ("x", "y"))):
        option = flag and f'<option><flag {flag}="disable"/></option>'
        xml = (
            f'<mujoco>{option}<default><geom size=".01"/></default><worldbody>{chain}{free}</worldbody>{held}</mujoco>'
        )
        model = mujoco.MjModel.from_xml_string(xml)
        arm = ls.Arm.of(model, mujoco.MjData(model), ["x", "y"], tip="tip")
        of_file = ls.Arm.from_spec(mujoco.MjSpec.from_string(xml), joints=["x", "y"], tip="tip")
        assert arm.joint_names == of_file.joint_names == names
        assert (arm.grasp is None) == bool(flag)


def test_a_body_that_a_connect_ties_to_the_hand_is_named_with_what_to_do():
    free = '<body name="pail" pos="0 0 2"><freejoint/><geom/></body>'
    chain = body("a", hinge("x"), body("b", hinge("y"), site("tip", "0 0 1")))
    model = compiled(chain + free, '<connect body1="b" body2="pail" anchor="0 0 1"/>')
    told = r"number 2 of body 'pail' .* the connect equality of 'b' and 'pail', .* a weld in place .* data\.eq_active"
    with pytest.raises(InputError, match=told):
        ls.Arm.of(model, mujoco.MjData(model), ["x", "y"], tip="tip")


def test_what_hangs_on_a_held_body_moves_with_it():
    free = '<body name="{}" pos="{} 0 1"><freejoint/><geom size=".01" contype="{}"/></body>'
    welds = '<weld body1="b" body2="box"/><weld body1="box" body2="lamp"/>'
    chain = body("a", hinge("x"), body("b", hinge("y"), site("tip", "0 0 1")))
    model = compiled(chain + free.format("box", 0.5, 0) + free.format("lamp", 0.7, 1), welds)
    arm, data = ls.Arm.of(model, mujoco.MjData(model), ["x", "y"], tip="tip"), mujoco.MjData(model)
    data.qpos[:] = arm.qpos([0.4, 0.3])
    mujoco.mj_forward(model, data)
    assert np.abs(data.efc_pos[data.efc_type == EQUALITY]).max() < 1e-9
    assert data.body("lamp").xpos != pytest.approx([0.7, 0.0, 1.0], abs=0.1)
    data.eq_active[1] = 0
    assert ls.Arm.of(model, data, ["x", "y"], tip="tip").grasp.named[0] == "box"
    data.eq_active[:] = 0, 1
    loose = ls.Arm.of(model, data, ["x", "y"], tip="tip")
    with pytest.raises(InputError, match="'box' is held by the weld equality of 'box' and 'lamp'; deactivate it first"):
        loose.holding("box")
