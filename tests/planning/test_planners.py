"""Rival planners: one contract for all, and what each is known for."""

from __future__ import annotations

import dataclasses
import inspect

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from lieednn_sim.errors import InputError, NoSolutionError, PlanError, TooFastError
from lieednn_sim.lie import exp, log
from lieednn_sim.planning import (
    PLANNERS,
    CertifiedOptions,
    OptimisationOptions,
    Plan,
    PlanningProblem,
    RrtConnectOptions,
    ShapedOptions,
    TrainedOptions,
    network_planners,
    plan,
    planners,
    reference_network,
)
from lieednn_sim.planning.baselines import smoothing
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.time_laws import minimum_jerk_law

from .arms import coarse

ARM = coarse()
LOW, HIGH = ARM.position_limits.T
MISSING = PLANNERS.missing()
# These spend what work they are given on shortening the path that they found: a tenth of that here.
LITTLE_WORK = {
    name: PLANNERS[name].options(max_collision_checks=tuple(2_000 * 2**k for k in range(7)))
    for name in ("rrt-star", "informed-rrt-star", "bit-star", "aorrtc")
}
# A planner that is not installed is seen to be skipped, with what it needs.
EACH = [
    pytest.param(name, marks=pytest.mark.skipif(name in MISSING, reason=f"{name} needs {MISSING.get(name)}"))
    for name in sorted(PLANNERS)
]


def problem(seed: int, margin: float = 0.35, **changes: object) -> PlanningProblem:
    """From home to a drawn target, which keeps this share of the range from its limits."""
    rng = np.random.default_rng(seed)
    while True:
        target = rng.uniform(LOW + margin * (HIGH - LOW), HIGH - margin * (HIGH - LOW))
        if not ARM.near_contacts(target):
            break
    values = {"start": ARM.keyframe("home"), "target": target, "seed": seed, **changes}
    return PlanningProblem(ARM, **values)


def planned(name: str, task: PlanningProblem, **more: object) -> Plan:
    """The plan of a planner for a problem."""
    given = {"start": task.start, "duration": (task.duration, task.longest), "seed": task.seed}
    return plan(task.arm, task.target, planner=name, **given, **more)


def plan_with(name: str, task: PlanningProblem, **more: object) -> Motion:
    """Its motion."""
    return planned(name, task, **more).motion


@pytest.mark.parametrize("name", EACH)
def test_every_planner_goes_from_rest_to_rest_within_the_limits_and_does_so_again(name):
    task, step = problem(0), ARM.model.opt.timestep
    made, again = (planned(name, task, options=LITTLE_WORK.get(name)) for _ in range(2))
    motion = made.motion
    assert (made.network is not None) == PLANNERS[name].network
    np.testing.assert_array_equal(again.motion.q, motion.q)
    np.testing.assert_array_equal(again.motion.qd, motion.qd)
    np.testing.assert_allclose(motion.t, step * np.arange(len(motion.t)), atol=1e-12)
    assert motion.t[-1] == pytest.approx(task.duration, abs=1e-9)
    np.testing.assert_allclose(motion.q[0], task.start, atol=1e-6)
    np.testing.assert_allclose(motion.q[-1], task.target, atol=1e-6)
    np.testing.assert_array_equal(motion.qd[[0, -1]], 0.0)
    np.testing.assert_allclose(motion.xi_target, ARM.encode(task.target), atol=1e-6)
    check_motion(ARM, motion)
    # The states are those that the joints follow: decoded anew they give positions and gap.
    decoded = ARM.decode(motion.xi)
    # Both are interpolated.
    np.testing.assert_allclose(decoded.q, motion.q, atol=1e-7)
    np.testing.assert_allclose(decoded.gap_translation, motion.gap_translation, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(decoded.gap_rotation, motion.gap_rotation, rtol=1e-3, atol=1e-6)
    # Velocities are the derivatives, of fourth order, since the steps are coarse.
    q = motion.q
    numeric = (8.0 * (q[3:-1] - q[1:-3]) - (q[4:] - q[:-4])) / (12.0 * step)
    np.testing.assert_allclose(motion.qd[2:-2], numeric, atol=2e-4 * np.abs(motion.qd).max())


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=10)
def test_minimum_jerk_has_no_gap_and_is_straight_in_joint_space(seed):
    task = problem(seed, margin=0.1, duration=8.0)
    try:
        motion = plan_with("minimum-jerk", task)
    except PlanError:
        reject()  # something is in the way
    np.testing.assert_array_equal(motion.gap_translation, 0.0)
    np.testing.assert_array_equal(motion.gap_rotation, 0.0)
    way = task.target - task.start
    middle = len(motion.t) // 2
    np.testing.assert_allclose(motion.q[middle], task.start + 0.5 * way, atol=1e-12)
    # sigma' = 30 s^2 (1 - s)^2 peaks at 15/8.
    np.testing.assert_allclose(motion.qd[middle], 1.875 * way / 8.0, atol=1e-12)


def test_the_screw_is_the_geodesic_of_every_joint():
    task = problem(0)
    motion = plan_with("se3-geodesic", task)
    origin, goal = ARM.joint_poses(task.start), ARM.joint_poses(task.target)
    way = log(origin.inv() * goal)
    units = np.repeat([1.0, ARM.length_scale], 3)
    np.testing.assert_allclose(motion.tau, minimum_jerk_law(motion.t / task.duration)[0], atol=1e-12)
    for k in (0, 140, 300, len(motion.t) - 1):
        done = log(origin.inv() * exp(motion.xi[k] * units))
        np.testing.assert_allclose(done, motion.tau[k] * way, atol=1e-9)
    assert motion.gap_translation.max() > 1e-3, "turning and sliding at once is no screw of the joint"


def test_the_screw_takes_the_shorter_turn_and_is_refused_where_a_stop_is_in_between():
    start, target = ARM.keyframe("home").copy(), ARM.keyframe("home").copy()
    base = ARM.joint_names.index("turn")
    start[base], target[base] = -2.5, 2.5
    task = problem(0, start=start, target=target, duration=8.0)
    plan_with("minimum-jerk", task)
    with pytest.raises(PlanError, match=rf"{ARM.joint_names[base]!r} would be at -?3\.1"):
        plan_with("se3-geodesic", task)


def test_the_linear_attractor_is_a_straight_line_in_network_coordinates():
    motion = plan_with("linear-attractor", problem(0))
    way = motion.xi_target - motion.xi[0]
    share = ((motion.xi - motion.xi[0]) * way).sum(axis=(1, 2)) / (way**2).sum()
    np.testing.assert_allclose(motion.xi, motion.xi[0] + share[:, None, None] * way, atol=1e-6)
    # xi' = -(xi - xi_d) in the network's own time.
    np.testing.assert_allclose(1.0 - share[:-1], np.exp(-motion.tau[:-1]), atol=1e-6)


def test_networks_come_with_their_motions():
    task = problem(0)
    assert planned("minimum-jerk", task).network is None
    made = planned("lieednn-retargeted", task)
    network, motion = made.network, made.motion
    reference = reference_network(ARM)
    # An array of one number is that number, also where results are kept by it.
    assert reference_network(ARM, np.array(0.25)) is reference
    np.testing.assert_array_equal(network.weight, reference.weight)
    assert network.certified
    assert not np.array_equal(network.bias, reference.bias)
    np.testing.assert_allclose(network.vector_field(motion.xi_target), 0.0, atol=1e-10)
    for name in ("linear-attractor", "lieednn-certified"):
        assert planned(name, task).network.certified


def test_refusals_say_why():
    hurried = problem(0, duration=0.05)
    for name in ("minimum-jerk", "se3-geodesic", "linear-attractor", "lieednn-certified", "lieednn-retargeted"):
        with pytest.raises(PlanError, match=r"would (move|accelerate) at .*its limit is|would be at"):
            plan_with(name, hurried)
    with pytest.raises(PlanError, match=r"no learned network of 1 can be used: joint .* would (move|accelerate) at"):
        plan_with("lieednn-trained", hurried, options=TrainedOptions(n_networks=1))


def test_a_plan_says_what_it_was_made_of(monkeypatch):
    task = problem(0)
    monkeypatch.setattr(planners, "cpu_time", iter([3.0, 5.5, 6.0, 7.0]).__next__)
    made = plan(ARM, list(task.target), planner="minimum-jerk")
    assert (made.planner, made.network, made.details) == ("minimum-jerk", None, None)
    np.testing.assert_array_equal(made.target, task.target)
    assert made.cpu_time == 2.5
    np.testing.assert_array_equal(made.motion.q[0], ARM.keyframe("home"))
    assert made.motion.t[-1] == 4.0
    made = planned("lieednn-certified", task, options=CertifiedOptions(n_first=2))
    assert (made.planner, made.details.n_networks) == ("lieednn-certified", 2)
    assert 1 <= made.details.within_limits <= 2


def test_options_of_another_planner_are_refused_with_the_name_of_the_right_ones():
    with pytest.raises(InputError, match="options must be PlannerOptions, got a dict of 1; see"):
        plan(ARM, problem(0).target, options={"candidates": 8})
    with pytest.raises(InputError, match="'se3-geodesic' has no options, got CertifiedOptions"):
        plan(ARM, problem(0).target, planner="se3-geodesic", options=CertifiedOptions())
    with pytest.raises(InputError, match="'rrt-star' takes options of class RrtStarOptions, got RrtConnectOptions"):
        plan(ARM, problem(0).target, planner="rrt-star", options=RrtConnectOptions())


KINDS = sorted({planner.options for planner in PLANNERS.values() if planner.options}, key=lambda kind: kind.__name__)


@pytest.mark.parametrize("kind", KINDS)
def test_options_are_documented_and_checked(kind):
    documented = "\n".join(inspect.cleandoc(one.__doc__) for one in kind.__mro__)
    for field in dataclasses.fields(kind):
        assert f"\n    {field.name}: " in documented
        for bad in (-1, 0, float("nan"), "many", None, [], object()):
            with pytest.raises(InputError, match=field.name.replace("_", ".") if field.name != "bias" else "bias"):
                kind(**{field.name: bad})
    whole = [field.name for field in dataclasses.fields(kind) if type(field.default) is int]
    for name in whole:
        with pytest.raises(InputError, match=f"{name} must be a whole number, got 2.5"):
            kind(**{name: 2.5})
    assert kind() == kind(**{field.name: field.default for field in dataclasses.fields(kind)})
    assert hash(kind()) == hash(kind())


def test_what_would_be_no_spline_or_no_end_is_refused():
    with pytest.raises(InputError, match="intervals must be from 2 to 1000, got 1"):
        OptimisationOptions(intervals=1)
    with pytest.raises(InputError, match=r"spacings must be from 0\.001 to 1, got 1e-09"):
        RrtConnectOptions(spacings=(0.04, 1e-9))
    for bad in ({"rate": 1.5}, {"rate": 0.001}, {"neurons": (257,)}):
        with pytest.raises(InputError, match=rf"{next(iter(bad))} must be from"):
            ShapedOptions(**bad)
    made = planned("trajectory-optimisation", problem(0), options=OptimisationOptions(intervals=2, guesses=1))
    check_motion(ARM, made.motion)


def test_lists_will_do_for_tuples():
    assert CertifiedOptions(bias_magnitudes=[0.25, 1]).bias_magnitudes == (0.25, 1.0)


@pytest.mark.parametrize("name", ["minimum-jerk", "lieednn-certified", "lieednn-retargeted"])
def test_how_much_longer_a_motion_may_take_is_one_rule(name):
    """A motion is refused with the time that it needs, and made where that and the two percent of slack are allowed."""
    few = {"options": CertifiedOptions(n_networks=4)} if name == "lieednn-certified" else {}
    with pytest.raises(TooFastError) as refused:
        plan_with(name, problem(0, duration=0.5, longest=0.5), **few)
    assert isinstance(refused.value, NoSolutionError)
    share = 1.02 * refused.value.duration / 0.5
    with pytest.raises(TooFastError):
        plan_with(name, problem(0, duration=0.5, longest=0.999 * 0.5 * share), **few)
    motion = plan_with(name, problem(0, duration=0.5, longest=1.001 * 0.5 * share), **few)
    assert motion.t[-1] == pytest.approx(0.5 * share, abs=ARM.model.opt.timestep)
    # Hardly longer than it must: at the limit of a velocity or an acceleration, less the slack.
    acceleration = np.abs(np.diff(motion.qd, axis=0) / motion.timestep) / ARM.acceleration_limits
    assert max((np.abs(motion.qd) / ARM.velocity_limits).max(), acceleration.max()) > 0.93
    with pytest.raises(InputError, match="the longest duration must be at least the duration, 4 s, got 2"):
        plan(ARM, ARM.keyframe("extended"), duration=(4.0, 2.0))


def test_a_network_that_ends_elsewhere_is_refused(monkeypatch):
    task = problem(0)
    other = reference_network(ARM).retarget(ARM.encode(problem(1).target))
    monkeypatch.setattr(network_planners, "reference_network", lambda *_: other)
    monkeypatch.setattr(type(other), "retarget", lambda self, _: self)
    with pytest.raises(PlanError, match="ends at another equilibrium"):
        plan_with("lieednn-retargeted", task)


def test_problems_are_checked():
    task = problem(0)
    with pytest.raises(ValueError, match="read-only"):
        task.target[0] = 0.0
    beyond = ARM.keyframe("home").copy()
    beyond[3] = 3.0
    for name in ("start", "target"):
        with pytest.raises(InputError, match=f"{name} is out of reach: joint 'extend1' would be at 3 m"):
            problem(0, **{name: beyond})
    # Rounded to 32 bits, a limit may be beyond itself.
    rounded = np.where(np.arange(8) == 6, 1.745, ARM.keyframe("home")).astype(np.float32)
    assert float(rounded[6]) > 1.745 == problem(0, target=rounded).target[6]
    beyond = np.where(np.arange(8) == 6, 1.74502, ARM.keyframe("home"))
    with pytest.raises(InputError, match=r"would be at 1\.74502 rad, its range is \[-1\.745, 1\.745\]"):
        problem(0, target=beyond)
    folded = np.array([0.0, 0.0, -0.6, 0.45, 0.0, 0.4, -1.0, 0.3])
    assert ARM.contacts(folded)
    with pytest.raises(InputError, match=r"target is out of reach: '.*' would touch '.*' there, [0-9.]+ mm deep$"):
        problem(0, target=folded)
    with pytest.raises(InputError, match="seed must be a whole number"):
        PlanningProblem(ARM, task.start, task.target, seed=-1)


def test_of_refused_roundings_the_least_time_is_told(monkeypatch):
    times = [TooFastError(name, time) for name, time in (("five", 5.0), ("three", 3.0), ("four", 4.0))]
    refusals = iter([*times, PlanError("touches")])

    def refuse(*_):
        raise next(refusals, PlanError("the polyline"))

    monkeypatch.setattr(smoothing, "smoothed", lambda *_: (None, None, None))
    monkeypatch.setattr(smoothing, "stopping", lambda *_: (None, None, None))
    monkeypatch.setattr(smoothing, "joint_motion", refuse)
    with pytest.raises(TooFastError, match="three"):
        smoothing.motion_along(None, np.zeros((2, 1)), smoothing.SmoothingOptions(), {})
    with pytest.raises(PlanError, match="the polyline"):
        smoothing.motion_along(None, np.zeros((2, 1)), smoothing.SmoothingOptions(), {})
