"""Transitions by hand, and their codes: velocity and acceleration go on, and the network's own motion is the curve."""

import itertools

import numpy as np
import pytest
from scipy.interpolate import BPoly

from lieednn_sim.arm import Arm
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.network.stepping import UndrivenState
from lieednn_sim.planning import plan
from lieednn_sim.planning.timed_path import Clock, TimedPath
from lieednn_sim.planning.transition import along, straight, transition
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder

TARGET = np.array([0.3, -0.4, 0.5, 0.6])


def moving(speed=1.0):
    return np.stack([np.zeros(4), speed * np.array([0.2, 0.1, -0.3, 0.4]), speed * np.array([0.5, -1.0, 0.2, 0.1])])


def test_to_a_target_it_is_the_quintic_between_both_states(gantry):
    now = moving()
    made = transition(gantry, now, straight(gantry, now[0], TARGET, 2.0))
    assert (made.duration, made.fade) == (2.0, 2.0)
    ends = [[*now], [TARGET, np.zeros(4), np.zeros(4)]]
    quintic, t = BPoly.from_derivatives([0.0, 2.0], ends), np.linspace(0.0, 2.0, 9)
    for order, found in enumerate(made(t)):
        np.testing.assert_allclose(found, quintic(t, nu=order), atol=1e-12)
    np.testing.assert_allclose(made(np.array([9.0]))[0][0], TARGET, atol=1e-12)


def test_a_motion_is_slowed_down_and_joined(gantry):
    motion = plan(gantry, TARGET, planner="minimum-jerk", duration=(0.4, 3.6)).motion
    base = along(gantry, motion)
    # It takes 0.675 of the y joint's limit of 2 m/s and more of others': at most half of all is left.
    slower = base.x[-1] / motion.t[-1]
    assert (np.abs(motion.qd) / slower / gantry.velocity_limits).max() <= 0.5 + 1e-9
    made = transition(gantry, moving(), base)
    t = np.linspace(0.0, made.duration, 400)
    q, qd, qdd = made(t)
    np.testing.assert_allclose(qd[0], moving()[1], atol=1e-9)
    np.testing.assert_allclose(q[-1], TARGET, atol=1e-9)
    assert (np.abs(qd) <= 0.8 * gantry.velocity_limits).all()
    assert (np.abs(qdd) <= 0.81 * gantry.acceleration_limits).all()
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[1:-1], qd[1:-1], atol=2e-3)


def test_limits_are_kept_also_where_the_first_transition_tried_breaks_them(gantry):
    """0.5 of the limits for a short motion from rest; then begun against the motion, and towards a joint's limit."""
    start, short, t = np.zeros(4), 0.03 * TARGET, np.linspace(0.0, 1.0, 500)
    base = straight(gantry, start, short, 1e-3)
    limits = gantry.velocity_limits, gantry.acceleration_limits
    taken = [np.abs(base(t * base.x[-1], nu=nu) / most).max() for nu, most in enumerate(limits, 1)]
    assert max(taken) == pytest.approx(0.5, rel=1e-3)
    low, high = gantry.position_limits.T
    against = np.stack([start, -0.3 * np.sign(TARGET) * limits[0], start])
    towards = np.stack([high * [0.0, 0.0, 0.0, 1.0] - 0.1, limits[0] * [0.0, 0.0, 0.0, 0.2], start])
    for now, target, least in ((against, short, 1e-3), (towards, TARGET, 5.0)):
        made = transition(gantry, now, straight(gantry, now[0], target, least))
        q, qd, qdd = made(made.duration * t)
        assert (np.abs(qd) <= 0.81 * limits[0]).all()
        assert (np.abs(qdd) <= 0.82 * limits[1]).all()
        assert ((q >= low - 1e-6) & (q <= high + 1e-6)).all()


def test_a_short_fade_is_looked_at_by_itself(gantry):
    """A detour of 0.6 s in a motion of 10 s is between two of its samples; the rest of the way is looked at once."""
    base, looked = straight(gantry, np.zeros(4), TARGET, 10.0), []

    def clear(q):
        looked.append(len(q))
        # A wall behind the arm, and one that the motion with the longest fade goes through.
        return "a chair" if q[:, 0].min() < -1e-3 or len(looked) == 1 else None

    with pytest.raises(PlanError, match="keeps clear of a chair"):
        transition(gantry, -moving(0.05), base, clear)
    # The first transition, the base after half of it, and the fade with what is within it; and so on.
    assert looked[1:5] == [24, 16 + 25, 12, 16 + 13]
    # Then only fades are left.
    assert len(looked) == 5 * 5 + 4


def test_it_is_looked_at_evenly_along_its_way(gantry):
    """No further apart than 49 even times, in about half as many places, and on it."""
    looked = []
    for now in (np.zeros((3, 4)), moving(0.05), -moving(0.05)):
        made = transition(gantry, now, straight(gantry, np.zeros(4), TARGET, 1.0), looked.append)
        timed, q = made(np.linspace(0.0, made.duration, 49))[0], looked.pop()
        gaps, most = (np.linalg.norm(np.diff(part, axis=0), axis=1) for part in (q, timed))
        assert gaps.max() <= 1.01 * most.max()
        assert len(q) < 33
        np.testing.assert_array_equal(q[[0, -1]], timed[[0, -1]])
        dense = made(np.linspace(0.0, made.duration, 2000))[0]
        off = np.linalg.norm(q[:, None] - dense, axis=2).min(axis=1)
        assert off.max() < 0.02 * gaps.max()
        assert np.ptp(gaps) < 0.05 * gaps.max()


def test_what_is_in_the_way_of_the_base_is_in_the_way_of_all_that_end_on_it(gantry):
    """Each transition that does not is tried: of the five at different speeds none is clear."""
    base, looked = straight(gantry, np.zeros(4), TARGET, 10.0), []

    def clear(q):
        looked.append(len(q))
        return "a chair" if q[:, 0].max() > 0.9 * TARGET[0] else None

    for now, tests in ((moving(0.05), 5 + 1), (np.zeros((3, 4)), 1)):
        looked.clear()
        with pytest.raises(PlanError, match="keeps clear of a chair"):
            transition(gantry, now, base, clear)
        assert len(looked) == tests


def test_what_the_state_lacks_of_a_configuration_fades(gantry):
    made = transition(gantry, moving(), straight(gantry, np.zeros(4), TARGET, 2.0))
    gap = 1e-3 * np.random.default_rng(0).normal(size=(2, 6))
    course = TimedPath(gantry, CurveEncoder(2), made, gantry.encode(np.zeros(4)) + gap)
    last = 0.0
    for time, left in ((0.02, 1.0), (1.0, 0.5), (2.0, 0.0)):
        z, _ = course.clock(time)
        course.state.advance(z - last)
        last = z
        off = course.state.x.reshape(2, 6) - gantry.encode(made(np.array([time]))[0][0])
        np.testing.assert_allclose(off, left * gap, atol=2e-4)


def test_it_says_what_is_in_the_way(gantry):
    base = straight(gantry, np.zeros(4), TARGET, 1.0)
    with pytest.raises(PlanError, match="no transition keeps clear of a chair"):
        transition(gantry, moving(), base, lambda q: "a chair")
    fast = np.stack([np.zeros(4), gantry.velocity_limits, np.zeros(4)])
    with pytest.raises(PlanError, match="no transition keeps the limits of the joints"):
        transition(gantry, fast, base)


def test_the_clock_is_its_own_inverse_and_never_stops():
    t = np.linspace(0.0, 2.0, 129)
    clock = Clock(2.0, np.where(t < 1.0, 1.0, 0.0))
    levels = np.array([1.0, 0.9, 0.5, 0.1, 1e-3])
    back = np.exp([-clock(time)[0] for time in clock.times(levels)])
    np.testing.assert_allclose(back, levels, rtol=2e-3)
    for time in (0.0, 0.7, 1.5, 1.99, 2.0, 5.0):
        ahead, behind = clock(time + 1e-5)[0], clock(max(time - 1e-5, 0.0))[0]
        assert clock(time)[1] > 0.0
        assert (ahead - behind) / (2e-5 if time else 1e-5) == pytest.approx(clock(time)[1], rel=2e-3)


@pytest.mark.parametrize("name", ["gantry", "telescopic_rrp"])
def test_the_network_follows_the_transition_from_its_first_velocity_on(name, gantry):
    arm = gantry if name == "gantry" else Arm.load(name)
    home, rng = arm.keyframe("home"), np.random.default_rng(0)
    target = home + 0.15 * arm.ranges * rng.uniform(-1.0, 1.0, arm.n_joints)
    target = np.clip(target, *arm.position_limits.T)
    now = np.stack([home, 0.1 * arm.velocity_limits, -0.1 * arm.acceleration_limits])
    made = transition(arm, now, straight(arm, home, target, 2.0))
    encoder = CurveEncoder(arm.n_links)
    course = TimedPath(arm, encoder, made, arm.encode(home))
    assert course.network.certificate is encoder.network.certificate
    z, rate = course.clock(0.0)
    course.state.advance(z)
    h = 1e-4
    near = arm.encode(made(np.array([0.0, h, 2.0 * h]))[0]).reshape(3, -1)
    assert z == pytest.approx(0.0, abs=1e-12)
    velocity = (-1.5 * near[0] + 2.0 * near[1] - 0.5 * near[2]) / h
    np.testing.assert_allclose(rate * course.state.flow, velocity, atol=2e-4 * np.abs(velocity).max())
    # And from the first acceleration on.
    begun, ahead = course.state.flow, UndrivenState(course.network, arm.encode(home))
    after, rate_after = course.clock(h)
    ahead.advance(after)
    acceleration = (near[2] - 2.0 * near[1] + near[0]) / h**2
    found = (rate_after * ahead.flow - rate * begun) / h
    np.testing.assert_allclose(found, acceleration, atol=0.05 * np.abs(acceleration).max())
    for time in (0.1, 0.5, 1.0, 1.5, 2.0):
        there, _ = course.clock(time)
        course.state.advance(there - z)
        z = there
        wanted = arm.encode(made(np.array([time]))[0][0])
        np.testing.assert_allclose(course.state.x.reshape(-1, 6), wanted, atol=1e-3)


def test_steps_without_inputs_are_the_networks_own():
    rng = np.random.default_rng(1)
    curve = np.cumsum(0.02 * rng.normal(size=(30, 2, 6)), axis=0)
    network = CurveEncoder(2).encode(np.linspace(0.0, 1.0, 30)[:, None, None] * curve[-1] + 0.1 * curve)
    start = curve[0]
    trajectory = network.trajectory(network.start(start), 3.0, rtol=1e-10, atol=1e-12)
    # In the largest steps of this rough curve, and in small ones.
    for count, off in ((12, 1e-5), (2001, 1e-8)):
        state = UndrivenState(network, start)
        for before, after in itertools.pairwise(np.linspace(0.0, 3.0, count)):
            state.advance(after - before)
            if count == 12 or round(2000 * after / 3.0) % 400 == 0:
                own = trajectory(np.array([after]))[0]
                np.testing.assert_allclose(state.x, own[:2].ravel(), rtol=0.0, atol=off)
                np.testing.assert_allclose(state.flow, network.vector_field(own)[:2].ravel(), rtol=0.0, atol=10.0 * off)


def test_other_networks_are_refused(cascade):
    with pytest.raises(InputError, match="only visible neurons may have inputs, and only from hidden ones"):
        UndrivenState(cascade(np.zeros((2, 6))), np.zeros((2, 6)))
