"""Joints that others move: by hand, against MuJoCo's own residuals and Jacobians, and by finite differences."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from arm.loops import PALLETISER, SCISSOR_LIFT
from hypothesis import given, settings
from hypothesis import strategies as st
from mechanisms import CRANE, body, compiled, connect, four_bar, hinge, site, slide, tied
from scipy.spatial.transform import RigidTransform, Rotation

import lieednn_sim as ls
from lieednn_sim._mujoco import kinematics_at, mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.dependents import Dependents
from lieednn_sim.arm.equalities import tendon_joints
from lieednn_sim.errors import InputError, NoSolutionError


def make(bodies, equalities, independent, jacobian="dense", **state):
    """Model, state and dependents; ``state`` are positions of joints."""
    return read(compiled(bodies, equalities, jacobian), independent, **state)


def read(model, independent, **state):
    """The same of a compiled model."""
    data = mujoco.MjData(model)
    for name, value in state.items():
        data.joint(name).qpos[:] = value
    return model, data, Dependents(model, data, [model.joint(name).id for name in independent.split()])


def rows_at(model, **positions):
    """Rows in which all joints but the named ones are at -9."""
    count = max(np.size(value) for value in positions.values())
    rows = np.full((count, model.nq), -9.0)
    for name, value in positions.items():
        rows[:, model.joint(name).qposadr[0]] = value
    return rows


def column(model, rows, name):
    return rows[:, model.joint(name).qposadr[0]]


def equality_rows(model, data, qpos):
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    if not mujoco.mj_isSparse(model):
        return data.efc_pos[: data.ne].copy(), data.efc_J.reshape(-1, model.nv)[: data.ne].copy()
    jacobian = np.zeros((data.nefc, model.nv))
    mujoco.mju_sparse2dense(jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    return data.efc_pos[: data.ne].copy(), jacobian[: data.ne]


def check(model, data, dependents, rows, accuracy=1e-10):
    """Solved rows meet MuJoCo's equalities, and velocities agree with its Jacobian and with finite differences."""
    rows = dependents.to_qpos(rows)
    for row, basis in zip(rows, dependents.basis(rows), strict=True):
        residual, jacobian = equality_rows(model, data, row)
        assert np.abs(residual).max() < accuracy
        assert np.abs(jacobian @ basis).max() < 1e-8
        for dof, rates in zip(dependents.dofs, basis.T, strict=True):
            ends, difference = [], np.empty(model.nv)
            for step in (-1e-5, 1e-5):
                end, motion = row.copy(), np.zeros(model.nv)
                motion[dof] = step
                mujoco.mj_integratePos(model, end, motion, 1.0)
                ends.append(dependents.to_qpos(end))
            mujoco.mj_differentiatePos(model, difference, 2e-5, *ends)
            assert difference == pytest.approx(rates, abs=1e-5 * max(1.0, np.abs(rates).max()))
    return rows


def stroke(luff):
    """The law of cosines: both lugs seen from the boom's hinge, and the angle between them."""
    a, b = np.hypot(1.5, 0.1), np.hypot(0.3, 1.2)
    angle = luff + np.arctan2(-0.1, 1.5) - np.arctan2(-1.2, 0.3)
    return np.sqrt(a * a + b * b - 2 * a * b * np.cos(angle)) - 1.3


@pytest.mark.parametrize("jacobian", ["dense", "sparse"])
def test_the_cylinder_of_a_crane_takes_three_iterations(monkeypatch, jacobian):
    model, data, dependents = make(*CRANE, "slew luff extend", jacobian)
    assert [model.joint(j).name for j in dependents.moved] == ["swivel", "stroke"]
    luff, calls, real = np.linspace(-0.3, 1.2, 500), [], mujoco.mj_makeConstraint
    rows = rows_at(model, luff=luff, slew=luff, extend=0.3)
    monkeypatch.setattr(mujoco, "mj_makeConstraint", lambda *a: calls.append(real(*a)))
    solved = dependents.to_qpos(rows.reshape(2, 250, -1)).reshape(rows.shape)
    assert len(calls) <= 2.5 * len(rows)  # for the way from the state to the first row
    assert column(model, solved, "stroke") == pytest.approx(stroke(luff), abs=1e-10)
    others = [model.joint(name).qposadr[0] for name in ("slew", "luff", "extend", "g1", "g2")]
    assert np.array_equal(solved[:, others], rows[:, others])
    data.eq_active[1] = 0
    check(model, data, dependents, rows[::50])


def test_a_jump_is_a_path_and_does_not_depend_on_earlier_calls():
    model, _, dependents = make(*CRANE, "slew luff extend")
    luff = np.random.default_rng(0).uniform(-0.9, 1.6, 200)
    once = dependents.to_qpos(rows_at(model, luff=luff, slew=8 * luff, extend=0))
    assert column(model, once, "stroke") == pytest.approx(stroke(luff), abs=1e-10)
    assert dependents.to_qpos(once[-1]) == pytest.approx(once[-1], abs=1e-10)
    assert np.array_equal(make(*CRANE, "slew luff extend")[2].to_qpos(once[-1]), dependents.to_qpos(once[-1]))


def test_a_four_bar_stays_on_its_branch_through_a_turn():
    model, data, dependents = make(*four_bar(0.3, 0.9, 0.7), "crank", rocker=1.5)
    angle = np.linspace(0.0, 2 * np.pi, 60)
    solved = check(model, data, dependents, rows_at(model, crank=angle))
    x, z = 0.3 * np.cos(angle) - 1.0, 0.3 * np.sin(angle)
    d = np.hypot(x, z)
    by_hand = np.arctan2(z, x) - np.arccos((d**2 + 0.7**2 - 0.9**2) / (2 * d * 0.7))
    assert np.exp(1j * column(model, solved, "rocker")) == pytest.approx(np.exp(1j * by_hand), abs=1e-10)
    assert dependents.to_qpos(rows_at(model, crank=angle[-1])) == pytest.approx(solved[-1:], abs=1e-9)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=8)
def test_a_jump_ends_where_a_fine_path_does(seed):
    rng = np.random.default_rng(seed)
    try:
        dependents = make(*four_bar(*rng.uniform(0.2, 1.2, 3)), "crank", crank=0.3, coupler=1, rocker=2)[2]
        rows = np.linspace([0.3, 0, 0], [0.3 + rng.uniform(-2, 2), 0, 0], 300)
        path = dependents.to_qpos(rows)
    except NoSolutionError:
        return
    # Rows of a long path are solved otherwise than those of short ones.
    assert np.concatenate([dependents.to_qpos(part) for part in np.split(rows, 6)]) == pytest.approx(path, abs=1e-8)
    assert dependents.to_qpos(path[-1]) == pytest.approx(path[-1], abs=1e-8)


def test_what_is_too_short_or_at_a_dead_centre_is_said():
    crank = body("crank", hinge("crank"), body("strut", hinge("strut"), site("tip", ".5 0 0"), ".3 0 0"))
    crank += body("piston", slide("push"), site("pin", "0 0 0"))
    model, _, dependents = make(crank, connect("tip", "pin"), "push", crank=1, push=0.6)
    with pytest.raises(NoSolutionError, match=r"connect .* open by 0\.1 .*last solution is where 'push' = 0\.7"):
        dependents.to_qpos(rows_at(model, push=0.9))
    with pytest.raises(NoSolutionError, match=r"dead centre.*where 'push' = 0.8"):
        dependents.basis(rows_at(model, push=0.8, crank=0, strut=0))
    with pytest.raises(NoSolutionError, match="state is a dead centre"):
        make(*four_bar(0.3, 1.0, 0.3), "crank")
    with pytest.raises(NoSolutionError, match=r"in the given state .*'tip' and 'end'.* stays open"):
        make(*four_bar(0.3, 0.1, 0.3), "crank")


def test_the_wrist_of_a_palletiser_stays_level():
    compiled_model = mujoco.MjModel.from_xml_string(PALLETISER)
    model, data, dependents = read(compiled_model, "turn lower upper flange")
    a, b = np.random.default_rng(1).uniform([-0.7, -0.4], [0.7, 0.4], (30, 2)).T
    solved = check(model, data, dependents, rows_at(model, turn=b, lower=a, upper=b, flange=a))
    for name, angle in {
        "level1": a,
        "plate": -a,
        "level2": a + b,
        "crank": a + b,
        "drive": -b,
        "wrist": -a - b,
    }.items():
        assert column(model, solved, name) == pytest.approx(angle, abs=1e-9)
    with pytest.raises(InputError, match=r"'upper'.* not determined by .* add 1 of these .*for example"):
        read(compiled_model, "turn lower flange")
    with pytest.raises(InputError, match=r"cannot move independently.* because of .*; leave 1 of them"):
        read(compiled_model, "turn lower upper wrist flange")


def test_the_platform_of_a_scissor_lift_rises_by_pythagoras():
    model, data, dependents = read(mujoco.MjModel.from_xml_string(SCISSOR_LIFT), "stroke")
    solved = check(model, data, dependents, rows_at(model, stroke=np.linspace(-0.04, 0.14, 10)))
    for data.qpos[:] in solved:
        mujoco.mj_kinematics(model, data)
        width = 0.8 + data.joint("foot").qpos[0]
        assert data.body("platform").xpos[2] == pytest.approx(2.0 * np.sqrt(1.0 - width**2), abs=1e-9)


def test_followers_in_closed_form_and_polynomials_backwards():
    chain = body("b1", slide("x", more='ref=".2"'), body("b2", slide("y"), body("b3", slide("z", more='ref="-.1"'))))
    ties = tied("z", "y", "0 -2 0 0 0") + tied("y", "x", ".1 1 .5 -.2 .1") + '<joint joint1="w" polycoef=".3 0 0 0 0"/>'
    model, data, dependents = make(chain + body("b4", slide("w") + slide("v")), ties + tied("v", "w", "0 2 0 0 0"), "x")
    x = np.linspace(-1, 1, 7)
    u = x - 0.2
    y = 0.1 + u + 0.5 * u**2 - 0.2 * u**3 + 0.1 * u**4
    solved = check(model, data, dependents, rows_at(model, x=x), 1e-14)
    assert solved == pytest.approx(np.stack([x, y, -0.1 - 2 * y, 0 * x + 0.3, 0 * x + 0.6], axis=1), abs=1e-14)
    model, data, backwards = make(chain, tied("z", "y", "0 -2 0 0 0") + tied("x", "y", "0 1 0 2 0"), "x")
    solved = check(model, data, backwards, rows_at(model, x=x))
    assert 0.2 + solved[:, 1] + 2 * solved[:, 1] ** 3 == pytest.approx(x, abs=1e-10)


def test_of_two_joints_that_follow_each_other_the_first_leads():
    x, y, z = (slide(name, axis, 'range="-1 1"') for name, axis in (("x", "1 0 0"), ("y", "1 0 0"), ("z", "0 0 1")))
    chain = body("b1", x, body("b2", y, body("b3", z)))
    model = compiled(chain, tied("x", "y", "0 1 0 0 0") + tied("y", "x", "0 1 0 0 0"))
    arm = Arm.of(model, mujoco.MjData(model), ["x", "y", "z"])
    assert arm.joint_names == ("x", "z")
    np.testing.assert_allclose(arm.qpos([0.2, 0.3]), [0.2, 0.2, 0.3])


def test_lengths_of_tendons_tie_joints():
    bodies = body("b1", slide("x"), body("b2", slide("y") + slide("z")))
    rope = '<fixed name="rope"><joint joint="x" coef="1"/><joint joint="y" coef="-2"/></fixed>'
    reel = f'</equality><tendon>{rope}<fixed name="reel"><joint joint="z" coef="1"/></fixed></tendon><equality>'
    ties = '<tendon tendon1="rope" polycoef=".1 0 0 0 0"/><tendon tendon1="reel" tendon2="rope" polycoef="0 2 0 0 0"/>'
    model, data, dependents = make(bodies, reel + ties, "x")
    assert check(model, data, dependents, rows_at(model, x=0.4)) == pytest.approx(np.array([[0.4, 0.15, 0.2]]))


def test_a_drum_leads_two_stages_backwards():
    stages = body("s1", slide("out1"), body("s2", slide("out2", more='range="-1 .4"'), body("s3", slide("out3"))))
    ties = tied("out1", "drum", ".01 .05 0 0 0") + tied("out2", "drum", "0 .1 0 0 0")
    ties += tied("out3", "out2", "0 -1 0 0 0")
    bodies = body("drum", '<joint name="drum" range="-1 3"/>')
    bodies += body("ball", '<joint name="ball" type="ball"/>', stages)
    model, data, dependents = make(bodies, ties, "out1 ball")
    rows = rows_at(model, out1=[0.01, 0.06])
    rows[:, 1:5] = 1, 0, 0, 0
    solved = check(model, data, dependents, rows, 1e-14)
    assert solved[:, [0, 6, 7]] == pytest.approx(np.array([[0, 0, 0], [1, 0.1, -0.1]]), abs=1e-14)
    assert dependents.basis(solved)[1][[0, 4, 5, 6], 3] == pytest.approx([20.0, 1.0, 2.0, -2.0])
    assert dependents.follower_limits()[-1] == pytest.approx([-0.04, 0.16])
    assert np.isinf(dependents.follower_limits()[:3]).all()
    with pytest.raises(InputError, match="'out1', 'out2' cannot move independently"):
        make(bodies, ties, "out1 out2")


def test_a_free_tool_goes_with_the_hand_that_it_is_welded_to():
    arm = body("arm", '<joint name="ball" type="ball"/>', body("hand", slide("out"), pos=".3 0 0"))
    arm += body("tool", '<freejoint name="free"/>', pos=".45 0 .1") + body("can", '<freejoint name="loose"/>')
    weld = '<weld body1="hand" body2="tool"/>'
    model, data, dependents = make(arm, weld, "ball out")
    rows = np.tile(model.qpos0, (20, 1))
    rows[:, :4], rows[:, 4] = Rotation.random(20, rng=0).as_quat(scalar_first=True), np.linspace(-1, 1, 20)
    solved = check(model, data, dependents, rows)
    turn = RigidTransform.from_rotation(Rotation.from_quat(solved[:, :4], scalar_first=True))
    by_hand = turn.apply(np.stack([solved[:, 4] + 0.45, *np.tile([[0.0], [0.1]], 20)], axis=1))
    assert solved[:, 5:8] == pytest.approx(by_hand, abs=1e-9)
    assert np.array_equal(solved[:, 12:], rows[:, 12:])
    data.eq_active[0] = 0
    assert Dependents(model, data, dependents.independent).moved == ()


def test_the_joints_of_a_tendon_change_its_length():
    """Cables around a ball on the second link, to the third and back to the first; a sum of the first and the last."""
    xml = """<mujoco><default><geom size="0.05"/><joint axis="0 1 0"/></default><worldbody><site/>
    <body><joint name="a"/><geom/><site name="begin" pos="0 0 0.3"/><site name="back" pos="2 0 0.3"/>
      <body pos="1 0 0"><joint name="b"/><geom/><geom name="drum" pos="0 0 0.3"/><site name="side" pos="0 0 0.5"/>
        <body pos="1 0 0"><joint name="c"/><geom/><site name="end" pos="0 0 0.3"/>
          <body pos="1 0 0"><joint name="d"/><geom/></body></body></body></body></worldbody><tendon>
    <spatial><site site="begin"/><geom geom="drum" sidesite="side"/><site site="end"/></spatial>
    <spatial><site site="begin"/><geom geom="drum" sidesite="side"/><site site="back"/></spatial>
    <fixed><joint joint="d" coef="2"/><joint joint="a" coef="1"/></fixed></tendon></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    lengths = []
    for q in 0.3 + np.vstack([np.zeros(4), np.eye(4)]):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        lengths.append(data.ten_length.copy())
    for tendon, moved in enumerate((np.abs(lengths[1:] - lengths[0]) > 1e-6).T):
        assert tendon_joints(model, tendon) == set(np.flatnonzero(moved).tolist())


def test_what_cannot_be_independent_is_said():
    with pytest.raises(InputError, match="'x' is fixed"):
        make(body("a", slide("x")), '<joint joint1="x"/>', "x")
    with pytest.raises(InputError, match="got shape"):
        make(*CRANE, "slew luff extend")[2].to_qpos(np.zeros(3))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_followers_in_random_trees_meet_the_equalities(seed):
    rng = np.random.default_rng(seed)
    bodies, ties, independent, scalars = [], "", [], []
    for k, kind in enumerate(rng.choice(["hinge", "slide", "ball"], 8, p=[0.4, 0.4, 0.2])):
        more = f'ref="{rng.normal():.3f}"' if kind != "ball" else ""
        bodies.append(f'<joint name="j{k}" type="{kind}" axis="{" ".join(map(str, rng.normal(size=3)))}" {more}/>')
        if kind == "ball" or not scalars or rng.random() < 0.4:
            independent.append(f"j{k}")
        else:
            slopes = rng.normal(size=4) * (rng.random(4) < [1, 0.3, 0.3, 0.3])
            pair = f"j{k}", rng.choice(scalars)
            ties += tied(*pair, " ".join(map(str, [rng.normal(), *slopes])))
        scalars += [f"j{k}"] * (kind != "ball")
    tree = ""
    for k, joint in reversed(list(enumerate(bodies))):
        tree = body(f"b{k}", joint, tree) if rng.random() < 0.6 else body(f"b{k}", joint) + tree
    model, data, dependents = make(tree, ties, " ".join(independent))
    for row in dependents.to_qpos(0.5 * rng.normal(size=(5, model.nq))):
        residual, jacobian = equality_rows(model, data, row)
        assert np.abs(residual).max(initial=0.0) < 1e-9 * max(1.0, np.abs(row).max())
        product = jacobian @ dependents.basis(row)
        assert np.abs(product).max(initial=0.0) < 1e-9 * max(1.0, np.abs(jacobian).max(initial=0.0))


def test_threads_that_use_one_arm_do_not_disturb_each_others_loops(monkeypatch):
    """As in the live view, where a loop, workers and the page use the same arm."""
    arm = ls.Arm.load("telescopic_crane")
    home, extended = (arm.qpos(arm.keyframe(name)) for name in ("home", "extended"))
    alone, measured, inside, done = arm.moving(home), [], threading.Event(), threading.Event()

    def interrupted(*args):
        result = kinematics_at(*args)
        if threading.current_thread() is not threading.main_thread():
            inside.set()
            done.wait()
        return result

    monkeypatch.setattr("lieednn_sim.arm.equalities.kinematics_at", interrupted)
    thread = threading.Thread(target=lambda: measured.append(arm.moving(home)))
    thread.start()
    inside.wait()
    arm.moving(extended)
    done.set()
    thread.join()
    np.testing.assert_array_equal(measured[0], alone)
