"""The tube of a plan: deviations that are proved to end at the target without contact, attacked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.arm.contacts import ContactFinder
from lieednn_sim.arm.deviations import Deviations
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, NotCertifiedError, PlanError
from lieednn_sim.planning import CertifiedOptions, find_tube, plan, tube
from lieednn_sim.planning.time_laws import retime

from .arms import coarse

# Scenes whose targets minimum jerk reaches, which the shaped network follows; and how far at most a deviation in the
# worst direction may exceed the tube before it touches.
CASES = {
    "telescopic_pr": ("window", 1, 1.5),
    "telescopic_rrp": ("window", 3, 2.2),
    "telescopic_compound": ("poles", 2, 1.5),
}


@cache
def tubed(name):
    """An arm among obstacles, a plan of its shaped network, and the tube."""
    scene, seed, _ = CASES[name]
    arm = coarse(name, scene, seed)
    made = plan(arm, draw_target(arm, seed), planner="lieednn-shaped", seed=seed)
    return arm, made, find_tube(arm, made)


@pytest.fixture(params=CASES)
def case(request):
    return tubed(request.param)


def deviated(arm, made, deviations, k, stride):
    """Joints ``(K, B, n)`` of the motion from sample k on with the state off by ``deviations`` ``(B, N, 6)`` there."""
    motion, gamma = made.motion, made.network.gamma
    left = np.exp(-gamma * (motion.tau[k::stride] - motion.tau[k]))[:, None, None, None]
    q = arm.decode(motion.xi[k::stride, None] + left * deviations, start=motion.q[k]).q
    return np.clip(arm.within_angles(q), *arm.position_limits.T)


def corner(rng, tube):
    """A deviation ``(N, 6)`` of full size in a random direction for each link."""
    parts = rng.standard_normal((len(tube.rotation), 2, 3))
    parts /= np.linalg.norm(parts, axis=2, keepdims=True)
    return (parts * np.stack([tube.rotation, tube.translation], axis=1)[..., None]).reshape(-1, 6)


def contacts(arm, made, tube, count, seed, stride=1, batch=10):
    """How many of random deviations of full size touch on their way to the target; ``batch`` at each random instant."""
    rng, finder = np.random.default_rng(seed), ContactFinder(arm.without_visuals.model)
    touched = 0
    for _ in range(count // batch):
        offs = np.stack([corner(rng, tube) for _ in range(batch)])
        q = deviated(arm, made, offs, int(rng.integers(len(made.motion.t))), stride)
        touched += sum(finder.first(arm.qpos(path)) < len(path) for path in np.swapaxes(q, 0, 1))
    return touched


def worst(arm, made, tube, rounds=2):
    """By which factor a deviation in the worst direction found, at the limiting instant, may exceed the tube."""
    collisions, finder = Collisions(arm.without_visuals), ContactFinder(arm.without_visuals.model)
    sizes = np.repeat(np.stack([tube.rotation, tube.translation], axis=1), 3, axis=1)
    low, high = arm.position_limits.T

    def decoded(xi, q):
        return np.clip(arm.within_angles(arm.decode(xi[None], start=q).q[0]), low, high)

    def touches(xi, q, deviation, factor):
        return finder.first(arm.qpos(decoded(xi + factor * deviation, q))[None]) < 1

    def directions(xi, q, near, found):
        """For the pairs near by, the corner that brings them together fastest, with the factor at first order."""
        base, step = arm.decode(xi[None], start=q).q[0], 1e-5
        slopes = np.array(
            [
                (arm.decode((xi + step * unit.reshape(-1, 6))[None], start=q).q[0] - base) / step
                for unit in np.eye(sizes.size)
            ]
        )
        gaps = collisions.distances(found, near)
        for distance, gradient in zip(gaps.distance, gaps.jacobian @ slopes.T, strict=True):
            parts = gradient.reshape(-1, 2, 3)
            lengths = np.linalg.norm(parts, axis=2, keepdims=True)
            way = -(parts / np.maximum(lengths, 1e-12)).reshape(-1, 6) * sizes
            yield distance / max(-float((gradient * way.ravel()).sum()), 1e-12), way

    k = round(tube.t / made.motion.timestep)
    xi, q = made.motion.xi[k], made.motion.q[k]
    factor, way = min(directions(xi, q, 0.3, q), key=lambda case: case[0])
    best = np.inf
    for _ in range(rounds):
        scales = np.linspace(1.0, 2.0 * factor, 100)
        best = min(best, next((scale for scale in scales if touches(xi, q, way, scale)), np.inf))
        reached = decoded(xi + 0.9 * min(best, factor) * way, q)
        _, way = min(directions(xi, q, 0.3, reached), key=lambda case: case[0])
    return best


def test_no_deviation_inside_touches_and_one_just_outside_does(case):
    """The proof is not far from sharp: not much more in the worst direction is too much."""
    arm, made, tube = case
    assert contacts(arm, made, tube, count=40, seed=0, stride=3) == 0
    assert 1.0 < worst(arm, made, tube) < CASES[arm.name][2]
    assert tube.pair[0].startswith("obstacle")


def test_the_deviation_decays_as_the_proof_says(case):
    """The deviated network, integrated by itself from some instant on."""
    arm, made, tube = case
    motion, network, k = made.motion, made.network, len(made.motion.t) // 3
    off = corner(np.random.default_rng(1), tube)
    state = network.trajectory(network.start(motion.xi[0]), motion.tau[-1])(motion.tau[k]).copy()
    state[: arm.n_links] += off
    run = network.trajectory(state, motion.tau[-1] - motion.tau[k])(motion.tau[k:] - motion.tau[k])
    left = np.exp(-network.gamma * (motion.tau[k:] - motion.tau[k]))[:, None, None]
    # The motion is interpolated between points of the network's path.
    np.testing.assert_allclose(network.visible(run) - motion.xi[k:], left * off, atol=1e-6)
    assert tube.holds(off * (1.0 - 1e-12))
    assert tube.push == pytest.approx(min(tube.rotation.min(), tube.translation.min()))
    assert not tube.holds(1.01 * off)
    assert tube.gain == 1.0


def test_joints_move_no_further_than_their_bounds(case):
    """The bounds of the projection, also far from the joints' own set; and they are not much too large."""
    arm, made, _ = case
    rng, size = np.random.default_rng(2), np.array([0.02, 0.01])
    sizes = np.tile(size, (arm.n_links, 1))
    largest = 0.0
    for gap in (0.0, 0.03):
        xi = made.motion.xi[::40] + gap * rng.uniform(-1.0, 1.0, made.motion.xi[::40].shape)
        q = arm.decode(xi).q
        twist = xi * arm.twist_units
        bounds = arm.retractor.spread(Deviations(twist, q, sizes, np.zeros((*twist.shape[:2], 2))))
        assert np.isfinite(bounds).all()
        for _ in range(60):
            parts = rng.standard_normal((*xi.shape[:2], 2, 3))
            parts *= size[:, None] / np.linalg.norm(parts, axis=-1, keepdims=True)
            moved = arm.decode((twist + parts.reshape(twist.shape)) / arm.twist_units).q - q
            found = np.stack([np.linalg.norm(w * moved[:, i], axis=1) for i, w in arm.retractor.groups], axis=1)
            assert (found <= bounds * (1.0 + 1e-9)).all()
            largest = max(largest, (found / bounds).max())
    assert largest > 0.8


def test_less_is_left_with_a_margin_and_with_errors_of_tracking():
    arm, made, tube = tubed("telescopic_pr")
    less = [find_tube(arm, made, **more).size for more in ({"margin": 0.004}, {"tracking": 5e-4})]
    assert 0.0 < min(less) <= max(less) < 0.9 * tube.size
    clearance = Collisions(arm).clearance(made.motion.q)
    assert clearance > 0.004
    with pytest.raises(PlanError, match=r"there is no tube.*: the motion comes too close to contact"):
        find_tube(arm, made, margin=clearance)


def test_between_samples_the_motion_is_covered(monkeypatch):
    """What the proof allows for within an interval bounds how far the spline is from its tangent in the middle."""
    arm, made, _ = tubed("telescopic_pr")
    path = tube._Path(arm, made.motion, np.zeros(arm.n_joints), 0.0)
    spread, given = path._spread(1e-3, np.ones((arm.n_links, 2))), []
    monkeypatch.setattr(
        path, "bounds", lambda *arguments: given.append(arguments) or (np.zeros(1), np.zeros(1), -np.ones((1, 2)))
    )
    motion, spline = made.motion, CubicHermiteSpline(made.motion.t, made.motion.q, made.motion.qd)
    last, largest = len(motion.t) - 1, 0.0
    for a, b in ((0.0, last / 4), (last / 4, last / 2), (last / 2 + 0.2, last / 2 + 0.7), (0.7 * last, last)):
        path._scales(a, b, spread, 1.0)
        q, way, rest = (value[0] for value in given[-1][:3])
        c = np.linspace(-1.0, 1.0, 101)[:, None]
        off = np.abs(spline(motion.timestep * (0.5 * (a + b) + 0.5 * (b - a) * c[:, 0])) - q - c * way)
        assert (off <= rest[0]).all()
        largest = max(largest, (off / rest[0]).max())
    assert largest > 0.3
    # The state may be as far from its nearest sample as the next one is.
    steps = np.linalg.norm(np.diff(motion.xi * arm.twist_units, axis=0).reshape(last, -1, 2, 3), axis=-1)
    assert (path._states.slack[:-1] >= steps).all()
    assert (path._states.slack[1:] >= steps).all()


def test_other_plans_have_none_and_the_reason_is_told():
    arm, shaped, _ = tubed("telescopic_pr")
    target = shaped.target
    with pytest.raises(InputError, match="only plans with a network have a tube, the planner 'minimum-jerk'"):
        find_tube(arm, plan(arm, target, planner="minimum-jerk"))
    made = plan(arm, target, planner="linear-attractor")
    elsewhere = replace(made, motion=replace(made.motion, q=made.motion.q + 1e-4))
    late = replace(made, motion=replace(made.motion, tau=0.9 * made.motion.tau))
    # What integration leaves on seven joints is no other path, but makes the tube smaller.
    nearly = replace(made, motion=replace(made.motion, q=made.motion.q + 1e-5))
    assert 0.8 * find_tube(arm, made).size < find_tube(arm, nearly).size < find_tube(arm, made).size
    for other in (elsewhere, late):
        with pytest.raises(InputError, match="not the path of its network, so there is no tube"):
            find_tube(arm, other)
    with pytest.raises(InputError, match="the plan has 8 joint coordinates, arm 'telescopic_rrp' has 12"):
        find_tube(Arm.load("telescopic_rrp"), made)
    for wrong in ({"margin": -0.01}, {"tracking": -1e-3}):
        with pytest.raises(InputError, match="tracking and margin must not be negative"):
            find_tube(arm, made, **wrong)
    with pytest.raises(NotCertifiedError):
        find_tube(arm, replace(made, network=replace(made.network, lyapunov_diagonal=None)))


def test_where_visible_neurons_hear_each_other_only_a_ball_is_proved():
    """Deviations may grow by the gain of `robustness()`, so all links at once may deviate by less."""
    arm, shaped, _ = tubed("telescopic_pr")
    made = plan(arm, shaped.target, planner="lieednn-certified", options=CertifiedOptions(n_networks=1))
    tube = find_tube(arm, made)
    assert tube.gain == pytest.approx(made.network.robustness().contracting.push_gain())
    assert tube.gain > 1.0
    whole = np.linalg.norm([tube.rotation, tube.translation])
    assert tube.push == pytest.approx(whole)
    off = np.zeros((4, 6))
    off[2, 4] = 0.999 * tube.push
    assert tube.holds(off)
    assert not tube.holds(1.01 * off)


def test_the_fastest_motion_on_a_path_has_the_tube_of_the_path():
    """Before, times of the network were linear along the path, and the states off its own by 3e-4, or 2e-5 here."""
    pytest.importorskip("toppra")
    arm, made, slow = tubed("telescopic_pr")
    motion = retime(arm, made.motion)
    states = made.network.trajectory(made.network.start(motion.xi[0]), motion.tau[-1])(motion.tau)
    np.testing.assert_allclose(made.network.visible(states), motion.xi, rtol=0.0, atol=1e-6)
    assert find_tube(arm, replace(made, motion=motion)).push == pytest.approx(slow.push, rel=0.05)
