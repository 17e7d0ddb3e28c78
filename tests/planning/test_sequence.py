"""Picking and placing: what the hand holds on its way, gripper steps, and the whole in one simulation."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import lieednn_sim as ls
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.models import models_directory
from lieednn_sim.errors import InputError, PlanError, SimulationError

JOINTS = ["turn", "lift", "extend", "pitch", "yaw"]
SPEEDS = {"turn": 1.5, "lift": 1.0, "extend": 0.6, "pitch": 2.0, "yaw": 3.0}
LIMITS = {name: {"velocity": speed} for name, speed in SPEEDS.items()}
OPEN, CLOSED = {"gripper": 0.04}, {"gripper": 0.0}
# Where the box stands in the end: on the shelf, whose top is at 0.3 m.
PLACE = [0.62, 0.45, 0.32]


def down(x, y, z):
    """A pose of the hand that points down, with its fingers along y."""
    return RigidTransform.from_components([x, y, z], Rotation.from_euler("y", 90.0, degrees=True))


GRASP = [ls.Move(down(0.62, -0.45, 0.225), name="fetch"), ls.Actuate(CLOSED, 1.0, "settled", "grasp")]
CARRY = ls.Move(down(0.62, 0.45, 0.326), name="carry", holding="box", touching=["shelf"])
STEPS = [*GRASP, CARRY, ls.Actuate(OPEN), ls.Move("home")]


def cell():
    model = mujoco.MjModel.from_xml_path(str(models_directory() / "picking_cell" / "cell.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return model, data


def sequence(model, data, steps, **how):
    return ls.plan_sequence(ls.Arm.of(model, data, JOINTS, tip="grasp", limits=LIMITS), steps, **how)


def planned_in(model, data, goal, holding=None, **how):
    arm = ls.Arm.of(model, data, JOINTS, tip="grasp", limits=LIMITS)
    return ls.plan(arm if holding is None else arm.holding(holding), goal, **how)


@pytest.fixture(scope="module")
def planned():
    model, data = cell()
    return model, data, sequence(model, data, STEPS)


@pytest.fixture
def grasped(planned):
    """The model with the closed hand around the box."""
    model, data, found = planned
    state = mujoco.MjData(model)
    mujoco.mj_copyData(state, model, data)
    state.qpos[:] = found.qpos[found.parts[1].last]
    return model, state


def test_what_is_held_moves_with_the_hand_and_stays_where_it_is_put(planned):
    model, data, found = planned
    np.testing.assert_array_equal(data.qpos, cell()[1].qpos)
    assert [part.step.name for part in found.parts] == ["fetch", "grasp", "carry", "gripper 0.04", "home"]
    assert [part.plan is not None for part in found.parts] == [True, False, True, False, True]
    assert all(part.plan.network.certified for part in found.parts if part.plan)
    carry = found.parts[2]
    places, turns, shown = [], [], mujoco.MjData(model)
    for row in (carry.first, carry.first + 700, carry.first + 1300, carry.last):
        shown.qpos[:] = found.qpos[row]
        mujoco.mj_forward(model, shown)
        places.append(shown.site("grasp").xmat.reshape(3, 3).T @ (shown.body("box").xpos - shown.site("grasp").xpos))
        turns.append(shown.site("grasp").xmat.reshape(3, 3).T @ shown.body("box").xmat.reshape(3, 3))
        names = {model.geom(geom).name for geom in shown.contact.geom.flat}
        assert "wall" not in names
    # The box stood 5 mm below the middle of the fingers.
    np.testing.assert_allclose(places, [[0.005, 0.0, 0.0]] * 4, atol=3e-4)
    np.testing.assert_allclose(turns, [turns[0]] * 4, atol=1e-6)
    # In the world it is turned on the way.
    assert abs(shown.body("box").xquat @ found.qpos[carry.first + 1000, 3:7]) < 1.0 - 1e-4
    velocity = np.zeros(model.nv)
    k = carry.first + 900
    mujoco.mj_differentiatePos(model, velocity, 0.004, found.qpos[k - 1], found.qpos[k + 1])
    np.testing.assert_allclose(found.qvel[k], velocity, atol=2e-3)
    # It went over the wall, which is 48 cm high, and stands on the shelf afterwards.
    over = found.qpos[carry.first : carry.last, :3]
    assert over[np.abs(over[:, 1]).argmin(), 2] > 0.48 + 0.02
    np.testing.assert_allclose(found.qpos[-1, :3], PLACE, atol=1e-3)
    np.testing.assert_array_equal(found.qpos[found.parts[4].first :, 2], found.qpos[-1, 2])
    # The gripper closed until it met the box: its fingers are 1 mm inside their open position of 6 mm and more.
    assert found.qpos[carry.first, -1] == pytest.approx(0.02 - 0.001 - 0.001, abs=2e-3)
    # The step ended when they had been slower than 2 mm/s for 0.1 s, and were not before.
    grip, speed = found.parts[1], np.abs(found.qvel[:, -2:]).max(axis=1)
    quiet = round(0.1 / model.opt.timestep)
    assert (speed[grip.last - quiet + 1 : grip.last + 1] < 2e-3).all()
    assert speed[grip.last - quiet] >= 2e-3
    assert "carry         lieednn-shaped: globally stable for every bias" in str(found)
    clear = f"; at least {1e3 * carry.plan.clearance.bound:.3g} mm clear, proved"
    assert str(found).splitlines()[found.parts.index(carry)].endswith(clear)


def test_the_same_seed_gives_the_same_sequence(planned):
    again = sequence(*planned[:2], GRASP[:1])
    rows = len(again.t)
    np.testing.assert_array_equal(again.qpos, planned[2].qpos[:rows])


def test_in_the_simulation_friction_holds_the_box_and_it_is_put_where_planned(planned):
    model, _, found = planned
    run = ls.simulate(found.arm, found, hold=0.5)
    assert [name for _, name in run.steps] == [part.step.name for part in found.parts]
    assert run.step_at(run.steps[2][0] + 1.0) == "carry"
    assert np.abs(run.tracking_error).max() < 2e-3
    box = run.poses("box")
    assert box.translation[:, 2].max() > 0.45
    np.testing.assert_allclose(box[-1].translation, PLACE, atol=3e-3)
    assert run.t[-1] == pytest.approx(run.motion_end + 0.5)
    evaluation = ls.evaluate(run)
    assert 0.1 < evaluation.slip_mm < 20.0
    assert evaluation.shortfall == ""
    smooth, data = cell()
    smooth.geom_friction[:, 0] = 0.02
    lost = ls.evaluate(ls.simulate(ls.Arm.of(smooth, data, JOINTS, tip="grasp", limits=LIMITS), found))
    assert lost.arrival == f"fails: hold: what the hand should hold moves by {lost.slip_mm:.0f} mm in it"
    # Fingers that close later or sooner than planned only shift what follows.
    assert run.motion_end == pytest.approx(found.t[-1], abs=0.2)
    assert set(np.unique(run.ctrl[:, model.actuator("gripper").id])) == {0.0, 0.04}


def test_a_push_after_the_end_of_a_sequence_is_refused_before_the_run_or_told_after_it(planned, monkeypatch):
    def simulated(found, start):
        changes = ls.Disturbances(pushes=(ls.Push("box", (0.0, 0.0, 1.0), start, 1.0),))
        return ls.simulate(found.arm, found, hold=0.1, disturbances=changes)

    timed = sequence(*planned[:2], [ls.Actuate(CLOSED, 0.1)])
    # An event ends the second one, after about 0.18 s, and 1 s later at most.
    event = sequence(*planned[:2], [ls.Actuate(CLOSED, 1.0, until="settled")])
    simulated(timed, 0.2 - timed.arm.timestep)
    with pytest.warns(UserWarning, match=r"begin when the run is over, at 0\.\d+ s"):
        run = simulated(event, 1.0)
    assert run.t[-1] < 0.9
    assert "pushes after the end of the run, which did nothing: 1" in str(ls.evaluate(run))
    monkeypatch.setattr("lieednn_sim.simulation.tracking.Log", None)
    for found, start in ((timed, 0.2), (event, event.t[-1] + 1.1)):
        with pytest.raises(InputError, match=r"begin when the run is over, at \d"):
            simulated(found, start)


def test_an_event_that_does_not_come_ends_planning_and_run(planned):
    model, data, _ = planned
    touch = ls.Actuate(CLOSED, 0.3, until=("hand", "box"), name="touch")
    with pytest.raises(PlanError, match=r"step 1, 'touch': its event does not come: after 0\.3 s 'hand' and 'box'"):
        sequence(model, data, [touch])
    with pytest.raises(PlanError, match=r"step 1, .*have not settled, the fastest moves at 0\.\d+ rad/s or m/s"):
        sequence(model, data, [ls.Actuate(CLOSED, 0.05, until="settled")])
    found = sequence(model, data, [GRASP[0], touch])
    assert found.t[-1] - found.t[found.parts[1].first] < 0.2
    away = mujoco.MjData(model)
    mujoco.mj_copyData(away, model, data)
    away.joint("box").qpos[0] = 0.8
    with pytest.raises(
        SimulationError, match=r"step 2, 'touch', begun at 4\.00 s: its event does not come: after 0\.3"
    ) as failed:
        ls.simulate(found.arm.at(away), found)
    assert failed.value.rollout.t[-1] == pytest.approx(4.3, abs=0.01)
    assert failed.value.rollout.steps == ((0.0, "fetch"), (4.0, "touch"))


def test_a_held_box_is_kept_off_what_the_empty_hand_passes(grasped):
    """A block where the lower face of the box would sweep, below the fingers."""
    model, state = grasped
    how = {"planner": "minimum-jerk", "duration": 2.0}
    state.qpos[:] = planned_in(model, state, [-0.3, 0.1, 0.2, 1.4, 0.0], holding="box", **how).qpos[-1]
    goal = [-1.0, 0.1, 0.2, 1.4, 0.0]
    held = planned_in(model, state, goal, holding="box", **how)
    shown, changed = mujoco.MjData(model), cell()[0]
    shown.qpos[:] = held.qpos[2 * len(held.t) // 3]
    mujoco.mj_kinematics(model, shown)
    wall = model.body("wall").id
    changed.body_pos[wall], changed.geom_size[model.geom("wall").id] = shown.body("box").xpos - [0, 0, 0.02], 0.003
    with pytest.raises(PlanError, match="'wall' would come within 2 mm of 'box'"):
        planned_in(changed, state, goal, holding="box", **how)
    around = planned_in(changed, state, goal, holding="box", **{**how, "planner": "lieednn-shaped"})
    np.testing.assert_allclose(around.qpos[-1], held.qpos[-1], atol=1e-6)
    # The empty hand passes above the block.
    state.joint("box").qpos[:3] = [0.0, -2.0, 0.5]
    planned_in(changed, state, goal, **how)


def test_what_is_held_from_the_beginning_slips_from_where_it_is_then(grasped):
    model, state = grasped
    state.ctrl[model.actuator("gripper").id] = 0.0
    found = sequence(model, state, [CARRY])
    slip = ls.simulate(found.arm, found, hold=0.1).channels["slip in the hand"]
    assert slip[0] == 0.0
    assert slip[:100].max() < 1e-3


def test_what_it_stands_on_may_be_touched_but_not_entered_and_nothing_else(grasped):
    model, state = grasped
    how = {"duration": 1.5}
    aside = planned_in(model, state, down(0.62, -0.40, 0.225), holding="box", **how)
    assert aside.qpos[:, 2].min() > 0.22 - 1e-3
    assert aside.qpos[-1, 2] == pytest.approx(0.22, abs=2e-4)
    # What is said of distances is of what may not be touched: by MuJoCo, at some instants.
    assert aside.proved
    shown, far, may = mujoco.MjData(model), np.inf, {"table", "left", "right", "hand"}
    for shown.qpos[:] in aside.qpos[::50]:
        mujoco.mj_kinematics(model, shown)
        for pair in Collisions(ls.Arm.of(model, state, JOINTS, tip="grasp")).pairs:
            names = {model.body(model.geom_bodyid[geom]).name for geom in pair}
            if not ("box" in names and names & may):
                far = min(far, mujoco.mj_geomDistance(model, shown, *pair, 0.1, None))
    assert 0.9 * far < aside.clearance.bound <= far
    for goal, holding, message in (
        (down(0.62, -0.40, 0.222), "box", "'box'.*'table'|'table'.*'box'"),
        (CARRY.goal, "box", "'box'.*'shelf'|'shelf'.*'box'"),
        (
            down(0.62, -0.40, 0.3),
            None,
            r"from the start the motion must leave .* if the hand holds it, plan with arm.holding\('box'\)",
        ),
    ):
        with pytest.raises(ls.LieEDNNError, match=message):
            planned_in(model, state, goal, holding=holding, planner="minimum-jerk", **how)
    # It may also stand on what is fixed beside the arm's own base.
    own = cell()[0]
    own.body_rootid[own.body("table").id] = own.body("column").id
    held = ls.Arm.of(own, state, JOINTS, tip="grasp").holding("box")
    stood_on = {pair for pair, offset in held.offsets.items() if np.isfinite(offset)}
    assert stood_on == {(own.geom("box").id, own.geom("table").id)}


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ([], "at least one"),
        ([ls.Actuate({"claw": 1.0})], "no actuator 'claw'; allowed: extend, gripper"),
        ([ls.Actuate({"gripper": 255.0})], r"control of 'gripper' must be from 0 to 0\.04, got 255"),
        ([ls.Actuate({"turn": 0.0})], "actuator 'turn' moves the arm"),
        ([ls.Actuate({}, until="settled")], "its actuators move none"),
        ([ls.Actuate({}, until=("box", "cup"))], "no body 'cup'"),
        ([ls.Move("home", holding="cup")], "step 1, 'home': no body with a free joint 'cup'.*: box"),
        ([ls.Move("home", holding="box", touching=["cup"])], "no body 'cup'; allowed: boom, box"),
        ([ls.Move("home", holding="box")], r"step 1, 'home': 'box' is 0\.\d+ m or more from the hand, .* 0\.1"),
        ([ls.Move("nowhere")], "no keyframe 'nowhere'; keyframes of .*: home"),
        ([ls.Move([0.0])], "step 1, 'move': target of turn, lift"),
    ],
)
def test_bad_steps_are_named(planned, steps, message):
    with pytest.raises(InputError, match=message):
        sequence(*planned[:2], steps)


def test_bad_events_and_changes_are_refused():
    with pytest.raises(InputError, match="no event 'soon'; allowed: settled"):
        ls.Actuate(CLOSED, until="soon")
    with pytest.raises(InputError, match="seconds must be positive"):
        ls.Actuate(CLOSED, seconds=0.0)
