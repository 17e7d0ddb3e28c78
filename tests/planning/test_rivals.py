"""Sampling, optimisation and primitives: what each promises beyond the contract of all planners."""

from __future__ import annotations

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.arm import PLANNED_CLEARANCE, Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.targets import draw_target, reference_configuration
from lieednn_sim.errors import InputError, LieEDNNError, PlanError
from lieednn_sim.network.componentwise import HopfieldNetwork
from lieednn_sim.planning import (
    PLANNERS,
    OptimisationOptions,
    PlanningProblem,
    RrtConnectOptions,
    RrtStarOptions,
    plan,
    reference_network,
)
from lieednn_sim.planning.baselines import sampling
from lieednn_sim.planning.baselines.optimisation import _Descent
from lieednn_sim.planning.baselines.smoothing import SmoothingOptions, motion_along, smoothed, stopping
from lieednn_sim.planning.joint_space import ClearanceTest, sweeps
from lieednn_sim.planning.motion import joint_scale
from lieednn_sim.planning.time_laws import minimum_jerk_law

from .arms import posted
from .test_planners import LITTLE_WORK, plan_with

ARM = Arm.load("telescopic_pr")
LOW, HIGH = ARM.position_limits.T
POSTED = posted(0.5 * np.pi, 0.06)
SMOOTHING = SmoothingOptions()
IMPROVING = tuple(LITTLE_WORK)
DETOUR = ("rrt-connect", "mjpl", "sscbirrt", *IMPROVING, "trajectory-optimisation", "stomp")
seeds = st.integers(0, 2**32 - 1)


def needs(name: str) -> None:
    if name in PLANNERS.missing():
        pytest.skip(f"{name} needs {PLANNERS.missing()[name]}")


def blocked(seed: int = 0, duration: float = 8.0) -> PlanningProblem:
    """Half a turn, with a post in the way."""
    start, target = ARM.keyframe("extended").copy(), ARM.keyframe("extended").copy()
    turn = ARM.joint_names.index("turn")
    start[turn], target[turn] = 0.5, 2.6
    return PlanningProblem(POSTED, start, target, duration, seed)


# RRT* comes near the straight way, and spends what it may.
@pytest.mark.parametrize("name", ["informed-rrt-star", "bit-star", "aorrtc"])
def test_who_finds_the_straight_way_looks_no_further(monkeypatch, name):
    """Nothing is shorter: samples that would make it so are drawn in vain, a hundred for each look at what is left."""
    needs(name)
    tested = []
    first_blocked = ClearanceTest.first_blocked
    monkeypatch.setattr(ClearanceTest, "first_blocked", lambda self, q: tested.append(len(q)) or first_blocked(self, q))
    target = draw_target(ARM, 1)
    motion = plan(ARM, target, planner=name, duration=1.5).motion
    straight = np.linalg.norm((target - ARM.keyframe("home")) / joint_scale(ARM))
    length = np.linalg.norm(np.diff(motion.q / joint_scale(ARM), axis=0), axis=1).sum()
    assert length == pytest.approx(straight, rel=1e-6)
    assert sum(tested) < 40_000


@pytest.mark.parametrize("name", ["rrt-connect", *IMPROVING])
def test_where_the_target_is_the_start_the_arm_stays(name):
    needs(name)
    home = ARM.keyframe("home")
    motion = plan(ARM, home, planner=name, duration=1.0).motion
    np.testing.assert_allclose(motion.q, np.broadcast_to(home, motion.q.shape), rtol=0.0, atol=1e-12)


def corners(seed: int, count: int = 5) -> np.ndarray:
    drawn = np.random.default_rng(seed).uniform(LOW, HIGH, (count, len(LOW)))
    drawn[0], drawn[-1] = ARM.keyframe("home"), ARM.keyframe("extended")
    return drawn


def test_a_path_is_searched_for_once_however_long_the_motion_takes(monkeypatch):
    start, target = ARM.keyframe("home"), ARM.keyframe("extended")
    attempts = []

    def straight(_problem, _clear, _options, _planner, attempt):
        attempts.append(attempt)
        return np.array([start, target])

    monkeypatch.setattr(sampling, "connecting_path", straight)
    motion = plan_with("rrt-connect", PlanningProblem(ARM, start, target, 0.5))
    assert motion.t[-1] > 0.5, "the time asked for is too short"
    assert attempts == [0]


@pytest.mark.parametrize("name", DETOUR)
def test_they_go_around_what_is_in_the_way_with_clearance(name):
    needs(name)
    task = blocked(3)
    with pytest.raises(PlanError, match=r"would come within .* of .post. at"):
        plan_with("minimum-jerk", task)
    motion = plan_with(name, task, options=LITTLE_WORK.get(name))
    collisions = Collisions(POSTED)
    assert min(collisions.clearance(q) for q in motion.q[::4]) > PLANNED_CLEARANCE - 1e-6
    assert (POSTED.limit_excess(motion.q) <= 1e-9).all()
    np.testing.assert_array_equal(motion.q[[0, -1]], [task.start, task.target])
    # Accelerations stay finite: no velocity jumps from one sample to the next.
    acceleration = np.abs(np.diff(motion.qd, axis=0)) / motion.timestep / joint_scale(POSTED)
    assert acceleration.max() < 10.0


@pytest.mark.parametrize(
    ("name", "tests"), [("rrt-star", 16_000), ("informed-rrt-star", 16_000), ("bit-star", 4_000), ("aorrtc", 6_000)]
)
def test_they_improve_on_what_is_found_first(name, tests):
    """The straight way is blocked: a shortest way bends around the post, by less than what RRT-Connect finds."""
    needs(name)
    task, options = blocked(7), RrtStarOptions(max_collision_checks=(tests,), shortcuts=1, longest_edge=0.2)

    def length(by):
        clear = sampling.ProblemClearance(task, options.margin)
        corners = sampling.connecting_path(task, clear, options, sampling.ompl_search(by), 0)
        return np.linalg.norm(np.diff(corners / joint_scale(POSTED), axis=0), axis=1).sum()

    straight = np.linalg.norm((task.target - task.start) / joint_scale(POSTED))
    assert straight < length(name) < 0.8 * length("rrt-connect")


def test_sampling_is_the_same_whatever_ran_before_and_silent(capfd):
    needs("rrt-connect")
    first = plan_with("rrt-connect", blocked(3)).q
    pytest.importorskip("ompl.util").RNG().uniform01()
    other = plan_with("rrt-connect", blocked(4)).q
    np.testing.assert_array_equal(plan_with("rrt-connect", blocked(3)).q, first)
    assert not np.array_equal(other, first), "the seed is of no effect"
    assert capfd.readouterr() == ("", "")


@given(seed=seeds)
@settings(max_examples=10)
def test_the_fast_test_of_clearance_agrees_with_measured_distances(seed):
    rng = np.random.default_rng(seed)
    collisions, margin = Collisions(POSTED), 0.03
    clear = ClearanceTest(POSTED, margin)
    q = rng.uniform(LOW, HIGH, (20, len(LOW)))
    distance = np.array([collisions.clearance(position) for position in q])
    for position, value in zip(q, distance, strict=True):
        # Between the two, contacts are found more roughly than distances are measured.
        if abs(value - margin) > 2e-3:
            assert clear(position) == (value > margin)
    assert clear.first_blocked(q[distance > margin + 2e-3]) is None
    assert not POSTED.model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE, "the arm's own model was changed"


@given(seed=seeds, count=st.sampled_from([6, 15, 80]))
@settings(max_examples=10)
def test_rounded_paths_stay_within_limits_and_come_close_to_the_polyline(seed, count):
    polyline = corners(seed)
    task = PlanningProblem(ARM, polyline[0], polyline[-1], 8.0)
    scale, times = joint_scale(ARM), task.times()
    q, qd, progress = smoothed(task, polyline, count, SMOOTHING.bend)
    np.testing.assert_allclose(q[[0, -1]], polyline[[0, -1]], atol=1e-9)
    np.testing.assert_array_equal(qd[[0, -1]], 0.0)
    assert (ARM.limit_excess(q) <= 1e-9).all()
    assert (np.diff(progress) >= 0.0).all()
    numeric = (q[2:] - q[:-2]) / (times[2:] - times[:-2])[:, None]
    np.testing.assert_allclose(qd[1:-1], numeric, atol=1e-3 * np.abs(qd).max())
    length = np.linalg.norm(np.diff(polyline / scale, axis=0), axis=1).sum()
    assert np.linalg.norm(np.diff(q / scale, axis=0), axis=1).sum() <= length + 1e-9
    along = stopping(task, polyline)[0] / scale
    far = np.linalg.norm(q[::80, None] / scale - along[None, ::4], axis=2).min(axis=1).max()
    # Six control points span each piece of the curve, and they are a share of the length apart.
    assert far <= 3.0 * length / count + 0.02 * length


@given(seed=seeds)
@settings(max_examples=5)
def test_the_polyline_itself_is_followed_with_a_stop_at_every_corner(seed):
    polyline = corners(seed)
    task = PlanningProblem(ARM, polyline[0], polyline[-1], 8.0)
    q, qd, _ = stopping(task, polyline)
    scale = joint_scale(ARM)
    for corner in polyline:
        nearest = np.linalg.norm((q - corner) / scale, axis=1).argmin()
        np.testing.assert_allclose(q[nearest], corner, atol=1e-4)
        assert np.abs(qd[nearest] / scale).max() < 1e-2
    numeric = (q[2:] - q[:-2]) / (2.0 * task.timestep)
    np.testing.assert_allclose(qd[1:-1], numeric, atol=1e-3 * np.abs(qd).max())


def test_a_straight_polyline_is_run_through_by_minimum_jerk():
    task = PlanningProblem(ARM, ARM.keyframe("home"), ARM.keyframe("extended"), 4.0)
    middle = 0.3 * task.start + 0.7 * task.target
    motion = motion_along(task, np.array([task.start, middle, middle, task.target]), SMOOTHING, {})
    np.testing.assert_allclose(motion.q, plan_with("minimum-jerk", task).q, atol=1e-9)
    still = PlanningProblem(ARM, task.start, task.start, 1.0)
    np.testing.assert_array_equal(motion_along(still, np.array([task.start] * 2), SMOOTHING, {}).qd, 0.0)


def test_sweeps_bound_the_motion_of_the_link_frames():
    slide = [ARM.joint_names.index(name) for name in ("lift", "extend1")]
    np.testing.assert_allclose(sweeps(ARM)[slide], 1.0, rtol=1e-6)
    radius = np.linalg.norm(np.asarray(ARM.link_poses(ARM.keyframe("extended")).translation)[-1, :2])
    assert sweeps(ARM)[ARM.joint_names.index("turn")] > 0.9 * radius


@pytest.mark.parametrize(("name", "off"), [("trajectory-optimisation", 1e-6), ("stomp", 1e-12)])
def test_optimisation_finds_minimum_jerk_where_nothing_is_in_the_way(name, off):
    task = PlanningProblem(ARM, ARM.keyframe("home"), ARM.keyframe("extended"), 4.0)
    motion, known = plan_with(name, task), plan_with("minimum-jerk", task)
    np.testing.assert_allclose(motion.q, known.q, atol=off)
    np.testing.assert_allclose(motion.qd, known.qd, atol=10.0 * off)


@given(seed=seeds)
@settings(max_examples=5)
def test_the_optimiser_descends_along_its_true_derivatives(seed):
    descent = _Descent(blocked(seed % 1000, duration=2.5), OptimisationOptions())
    rng = np.random.default_rng(seed)
    x = next(descent.guesses())
    x = np.clip(x + 0.05 * rng.normal(size=x.shape), descent.low, descent.high)
    way = rng.normal(size=x.shape)
    _, jacobian = descent.terms(x, 8.0)
    step = 1e-6
    ahead, behind = (descent.terms(x + side * step * way, 8.0)[0] for side in (1.0, -1.0))
    numeric = (ahead - behind) / (2.0 * step)
    wrong = np.abs(jacobian @ way - numeric) > 1e-3 * np.abs(numeric).max()
    # Where the nearest features of two boxes change, and in penetration, distances have kinks.
    assert wrong.sum() <= 3


@pytest.mark.parametrize("name", ["lieednn-retargeted", "dmp"])
def test_an_arm_needs_no_keyframe_extended(gantry, name):
    # Ranges [-1, 1], [-2, 2], [-2, 3] and [-3, 3] about home at 0.
    np.testing.assert_allclose(reference_configuration(gantry), [0.5, 1.0, 1.5, 1.5])
    np.testing.assert_array_equal(reference_configuration(ARM), ARM.keyframe("extended"))
    target = np.array([-0.3, 0.4, 0.5, -0.6])
    motion = plan_with(name, PlanningProblem(gantry, np.zeros(4), target, 4.0))
    np.testing.assert_allclose(motion.q[-1], target, atol=1e-3)


def test_a_primitive_keeps_its_shape_at_every_amplitude():
    home, extended = ARM.keyframe("home"), ARM.keyframe("extended")
    task = PlanningProblem(ARM, home, extended, 4.0)
    motion = plan_with("dmp", task)
    sigma, _ = minimum_jerk_law(task.times() / 4.0)
    shown = home + sigma[:, None] * (extended - home)
    # It imitates what it was shown, up to the basis functions of its forces.
    np.testing.assert_allclose(motion.q, shown, atol=0.012 * np.abs(extended - home).max())
    half = PlanningProblem(ARM, home, home + 0.5 * (extended - home), 4.0)
    np.testing.assert_allclose(plan_with("dmp", half).q - home, 0.5 * (motion.q - home), atol=1e-9)
    turned = extended.copy()
    turn = ARM.joint_names.index("turn")
    assert extended[turn] == home[turn]
    turned[turn] = 1.0
    way = plan_with("dmp", PlanningProblem(ARM, home, turned, 4.0)).q[:, turn]
    # Never shown: spring and damper, critically damped, do not overshoot.
    assert (np.diff(way) >= -1e-6).all()
    assert way.max() <= 1.0 + 1e-9


@pytest.mark.parametrize("name", [name for name, entry in PLANNERS.items() if entry.library])
def test_who_lacks_a_library_says_what_to_install(monkeypatch, name):
    library = PLANNERS[name].library
    for loaded in [module for module in sys.modules if module.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, library, None)
    assert name in PLANNERS.missing()
    with pytest.raises(LieEDNNError, match=rf"planners? .*{name}.* pip install 'lieednn_sim\[\w+\]'") as caught:
        plan_with(name, blocked())
    assert not isinstance(caught.value, PlanError | InputError), "a missing library is no failed plan"


@pytest.mark.parametrize("name", ["mjpl", "sscbirrt"])
def test_paths_of_other_libraries_are_shortened_and_end_with_the_tests_allowed(name):
    needs(name)
    task, options = blocked(3), PLANNERS[name].options(control_points=(24,))

    def length(**changed):
        motion = plan_with(name, task, options=replace(options, **changed))
        return np.linalg.norm(np.diff(motion.q / joint_scale(POSTED), axis=0), axis=1).sum()

    assert length() < 0.95 * length(shortcuts=1)
    with pytest.raises(PlanError, match=f"^{name} found no path free of contact"):
        length(max_collision_checks=(5,))
    # What is clear all along is gone straight, at either library's first look.
    free = PlanningProblem(ARM, ARM.keyframe("home"), ARM.keyframe("extended"), 4.0)
    motion = plan_with(name, free)
    way = np.diff(motion.q, axis=0).sum(axis=0)
    assert np.linalg.norm(np.diff(motion.q, axis=0), axis=1).sum() == pytest.approx(np.linalg.norm(way), rel=1e-6)


def test_refusals_say_what_was_tried():
    few = OptimisationOptions(guesses=2, drawn=2, evaluations=3)
    with pytest.raises(PlanError, match=r"no local optimum of 2 first guesses can be followed: joint .* its limit is"):
        plan_with("trajectory-optimisation", PlanningProblem(ARM, LOW, HIGH, 0.3), options=few)
    needs("rrt-connect")
    with pytest.raises(PlanError, match="rrt-connect found no path free of contact; try another seed or target"):
        plan_with("rrt-connect", blocked(), options=RrtConnectOptions(max_collision_checks=(1,)))


@given(seed=seeds)
@settings(max_examples=5)
def test_a_plain_network_is_the_structured_one_when_its_weights_are(seed):
    rng = np.random.default_rng(seed)
    twin = reference_network(ARM).retarget(rng.uniform(-0.8, 0.8, (ARM.n_links, 6)))
    plain = HopfieldNetwork(twin.weight, twin.bias)
    xi = rng.normal(size=(3, *twin.bias.shape))
    np.testing.assert_allclose(plain.vector_field(xi), twin.vector_field(xi), atol=1e-12)
    np.testing.assert_allclose(plain.jacobian(xi), twin.jacobian(xi), atol=1e-12)
    np.testing.assert_array_equal(plain.weight, twin.weight)


def test_plain_networks_are_checked_stored_and_certified(tmp_path):
    network = HopfieldNetwork(0.5 * np.eye(12), np.full((2, 6), 0.1)).try_certify()
    assert network.certified
    network.save(tmp_path / "plain.npz")
    again = HopfieldNetwork.load(tmp_path / "plain.npz")
    np.testing.assert_array_equal(again.weight, network.weight)
    assert again.certified
    assert not HopfieldNetwork(3.0 * np.eye(12), np.full((2, 6), 0.1)).try_certify().certified
    with pytest.raises(InputError, match=r"matrix must have shape \(12, 12\), got \(6, 6\)"):
        HopfieldNetwork(np.eye(6), np.zeros((2, 6)))
