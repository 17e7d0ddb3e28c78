"""The tube of a plan: the deviations of its network's state that provably end at the target without contact.

Let d be a deviation of the visible neurons at one instant, while the hidden ones are as planned. In a cascade it decays
by d' = -gamma d; in any other network |d| stays below |d(0)| times the gain of `stability.Robustness.push_gain`.
`arm.deviations` bounds how far the joints then are from the plan, and `arm.clearance_bounds` how far what they move is
from contact, on intervals of time that are halved until the bound is sharp. `docs/mathematics/tube.md` proves each step
and says what is assumed, and what is not covered: the error of a controller that tracks the deviated motion is covered
only if it is given as ``tracking``.
"""

from __future__ import annotations

import heapq
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim.arm import Arm
from lieednn_sim.arm.clearance_bounds import ClearanceBounds
from lieednn_sim.arm.deviations import Deviations
from lieednn_sim.budget import check_time
from lieednn_sim.errors import InputError, NotCertifiedError, PlanError
from lieednn_sim.network import ComponentwiseNetwork
from lieednn_sim.planning.clearance import Cubics
from lieednn_sim.planning.motion import Motion
from lieednn_sim.planning.problem import Plan
from lieednn_sim.planning.shaped import lever_units
from lieednn_sim.validation import as_floats
from lieednn_sim.values import Floats, frozen

_SMALLEST = 1e-4  # smallest size at which the projection is bounded [m]
# Differences of a motion's states and joints from those computed again [rad, m]: what integration leaves in any case,
# and the largest for which the motion still counts as its network's path. The tube allows for them.
_INTEGRATED, _SAME = 1e-6, 5e-5


@frozen
class Tube:
    """The deviations of a network's visible state from its path that provably end at the target without contact.

    They may occur anywhere on the path.

    All links may deviate at once: link i by any turn up to `rotation` and any shift up to `translation`, in the
    coordinates omega and v of its twist. The module says what is proved and what is assumed.

    Attributes:
        size: s, the shift of every link [m]. Each link may at the same time turn by s over its lever arm, the longest
            distance of the end effector from it on the way: as far as moves the end effector by s. At most 0.1.
        rotation: ``(N,)`` largest deviation |d omega| of each link [rad].
        translation: ``(N,)`` largest deviation |d v| of each link [network coordinates, `Arm.length_scale` m].
        push: largest Euclidean norm, over all visible coordinates, up to which a perturbation of the state is harmless
            in every direction [network coordinates].
        gain: largest growth of a deviation; 1 for a cascade.
        t: instant of the motion that limits the tube [s].
        pair: names of the two geoms whose contact limits the tube; empty if something else limits it.
    """

    size: float
    rotation: Floats
    translation: Floats
    push: float
    gain: float
    t: float
    pair: tuple[str, ...]

    def __repr__(self) -> str:
        by = f"limited by {' and '.join(map(repr, self.pair))} at {self.t:.2f} s"
        limit = by if self.pair else "not limited by contact"
        return (
            f"<Tube: {1e3 * self.size:.3g} mm for every link at once, pushes up to {self.push:.3g} [rad, m], {limit}>"
        )

    def holds(self, deviation: ArrayLike) -> bool:
        """Whether a deviation ``(N, 6)`` of the visible neurons, in network coordinates, is proved to be harmless."""
        off = as_floats("deviation", deviation, (len(self.rotation), 6))
        turns, shifts = np.linalg.norm(off.reshape(-1, 2, 3), axis=2).T
        inside = (turns <= self.rotation).all() and (shifts <= self.translation).all()
        return bool(inside or np.linalg.norm(off) <= self.push)


def find_tube(arm: Arm, plan: Plan, *, tracking: ArrayLike = 0.0, margin: float = 0.0) -> Tube:
    """Find the largest tube that can be proved for a plan whose motion is the path of its certified network.

    Args:
        arm: the arm that the plan is for, in its scene.
        plan: the plan.
        tracking: largest tracking errors ``(n,)`` of the joints that the tube allows for, or one for all [rad, m].
        margin: distance that everything keeps from contact [m].

    Raises:
        InputError: a value is malformed or negative, the plan has no network, its motion is not the network's path, or
            closed loops move geoms that could touch something (`ClearanceBounds`).
        NotCertifiedError: the network has no certificate, or nothing is proved about the growth of deviations.
        PlanError: the motion comes too close to contact for any tube.
    """
    given = as_floats("tracking", tracking, (), batched=True, largest=1e3)
    errors = np.broadcast_to(as_floats("tracking", given, (arm.n_joints,) if given.ndim else ()), arm.n_joints)
    keep = float(as_floats("margin", margin, (), largest=1e3))
    if (errors < 0.0).any() or keep < 0.0:
        raise InputError(f"tracking and margin must not be negative, got {errors.min():g} and {keep:g}")
    network, motion = plan.network, plan.motion
    if network is None:
        raise InputError(f"only plans with a network have a tube, the planner {plan.planner!r} makes none")
    if motion.q.shape[1] != arm.n_joints:
        raise InputError(f"the plan has {motion.q.shape[1]} joint coordinates, arm {arm.name!r} has {arm.n_joints}")
    if not network.certified:
        raise NotCertifiedError("only certified networks have a tube; see network.certify()")
    cascade = not network.coupled[:, : network.n_visible].any()
    gain = 1.0
    if not cascade:
        proved = network.robustness().contracting
        if proved is None:
            raise NotCertifiedError("nothing is proved about the growth of deviations, since contraction is not")
        gain = max(1.0, proved.push_gain())
    path = _Path(arm, motion, errors + 5.0 * _off_path(arm, network, motion), keep)
    units = np.stack([1.0 / lever_units(arm, motion.q)[:, 0], np.full(arm.n_links, 1.0)], axis=1)
    size, t, pair = path.largest(units)
    each = units / [1.0, arm.length_scale]
    push = size * float(each.min()) / gain
    if not cascade:
        # Only balls of the norm are proved to be invariant, so the deviations of all links together must be in one.
        size = push / float(np.linalg.norm(each))
    rotation, translation = size * each.T
    return Tube(size, rotation, translation, push, gain, t, path.bounds.names(pair) if pair[0] >= 0 else ())


def _off_path(arm: Arm, network: ComponentwiseNetwork, motion: Motion) -> float:
    """Largest difference of a motion's states and joints from those computed from its network [rad, m].

    `InputError` if it is so large that the motion is not the network's path.
    """
    off = np.inf if motion.xi.shape[1] != network.n_visible else _INTEGRATED
    if np.isfinite(off) and motion.tau[-1] > 0.0:
        states = network.trajectory(network.start(motion.xi[0]), motion.tau[-1])(motion.tau)
        off = max(off, float(np.abs(network.visible(states) - motion.xi).max()))
    if off <= _SAME:
        off = max(off, float(np.abs(arm.decode(motion.xi, start=motion.q[0]).q - motion.q).max()))
    if off > _SAME:
        raise InputError("the motion is not the path of its network, so there is no tube")
    return off


class _Path:
    """A motion as a continuous path, and its clearance."""

    def __init__(self, arm: Arm, motion: Motion, tracking: Floats, margin: float) -> None:
        self._arm, self._motion, self._rest = arm, motion, tracking
        self._cubics = Cubics(motion.timestep, motion.q, motion.qd)
        self.bounds = ClearanceBounds(arm.without_visuals, arm.retractor.groups, margin)
        twist = motion.xi * arm.twist_units
        steps = np.linalg.norm(np.diff(twist, axis=0).reshape(len(twist) - 1, -1, 2, 3), axis=-1)
        slack = np.zeros((*twist.shape[:2], 2))
        slack[1:] = steps
        slack[:-1] = np.maximum(slack[:-1], steps)
        self._states = Deviations(twist, motion.q, np.zeros((arm.n_links, 2)), slack)

    def largest(self, sizes: Floats) -> tuple[float, float, tuple[int, int]]:
        """The largest scale of ``sizes`` ``(N, 2)`` [rad, m] without contact, and the instant and geoms that limit it.

        `PlanError` if there is none.
        """
        last = len(self._motion.t) - 1
        # A first estimate from a few instants, at most 0.1 m; then the projection must be bounded at this size.
        spread, best, t, pair = self._spread(_SMALLEST, sizes), 0.1, 0.0, (-1, -1)
        for k in np.linspace(0, last, 16) if np.isfinite(spread).all() else ():
            _, there, geoms = self._scales(k, k, spread, best)
            if there < best:
                best, t, pair = there, k * self._motion.timestep, geoms
        while best >= _SMALLEST and not np.isfinite(spread := self._spread(best, sizes)).all():
            best, pair = 0.85 * best, (-1, -1)
        if best < _SMALLEST:
            raise PlanError(
                f"there is no tube of {1e3 * _SMALLEST:g} mm: the motion comes too close to contact, or the joints "
                "nearest to the network's state may jump"
            )
        edges = np.linspace(0.0, last, min(48, last) + 1)
        heap: list[tuple[float, float, float]] = [(-1.0, a, b) for a, b in pairwise(edges)]
        # Halve intervals until the bound for all instants is near the least one at single instants, at most 4000 times.
        for _ in range(4000):
            check_time()
            scale, a, b = heapq.heappop(heap)
            if scale >= 0.95 * best:
                heapq.heappush(heap, (scale, a, b))
                break
            middle = 0.5 * (a + b)
            parts = ((a, b),) if scale < 0.0 else ((a, middle), (middle, b))
            for begin, end in parts:
                result, there, geoms = self._scales(begin, end, spread, best)
                if there < best:
                    best, t, pair = there, 0.5 * (begin + end) * self._motion.timestep, geoms
                heapq.heappush(heap, (result, begin, end))
        size = max(heap[0][0], 0.0)
        if size == 0.0:
            raise PlanError(f"there is no tube: the motion comes too close to contact at t = {t:.2f} s")
        return size, t, pair

    def _spread(self, radius: float, sizes: Floats) -> Floats:
        """Largest changes ``(K, G)`` of the joints for a scale of 1, proved for scales up to ``radius``."""
        return self._arm.retractor.spread(replace(self._states, size=radius * sizes)) / radius

    def _scales(self, a: float, b: float, spread: Floats, most: float) -> tuple[float, float, tuple[int, int]]:
        """The scales of `ClearanceBounds` in an interval of samples, at all its instants and at its middle alone."""
        middle, path, rest = self._cubics.around([a], [b])
        first = min(int(a), len(spread) - 2)
        widest = spread[first : max(int(np.ceil(b)), first + 1) + 1].max(axis=0)
        whole, there, pairs = self.bounds(middle, path, rest + self._rest, widest[None], most)
        return float(whole[0]), float(there[0]), (int(pairs[0, 0]), int(pairs[0, 1]))
