"""An attractor and repelling geoms, as a policy: Riemannian motion policies in joint space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.collision import Collisions
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.policies.feedback import FEEDBACK, Feedback, JointPolicy
from lieednn_sim.policies.making import PolicyTask
from lieednn_sim.values import Floats


@dataclass(frozen=True)
class FabricOptions(PlannerOptions):
    """Options of the policy ``fabric``.

    Attributes:
        stiffness: k of the equations in `Fabric` [1/s^2].
        damping: c [1/s].
        near: d_0, distance within which geoms repel [m].
        margin: distance to keep where start and target allow it [m].
        strength: r, strength of the repulsion.
    """

    stiffness: float = 16.0
    damping: float = 8.0
    near: float = 0.15
    margin: float = 0.01
    strength: float = 0.3


class Fabric(JointPolicy):
    """A policy that combines an attractor and repelling geoms by their metrics, as Riemannian motion policies do.

    With joints in units of their range, M a = k (g - y) - c v + sum_i w_i n_i (r / d_i - c n_i . v) and
    M = I + sum_i w_i n_i n_i', with n_i the gradient of the distance of a pair, d_i this distance above its margin, and
    w_i = (d_0 / d_i - 1)^2 within d_0 (Ratliff et al., arXiv 1801.02854). A pair repels only within d_0, and within 0.9
    of its distance at the start and at the target.

    Args:
        arm, rate, feedback: as for `JointPolicy`; the arm is in its scene.
    """

    def __init__(
        self, arm: Arm, rate: float = 100, *, options: FabricOptions | None = None, feedback: Feedback | None = FEEDBACK
    ) -> None:
        super().__init__(arm, rate, feedback=feedback)
        self._options, self._collisions = options or FabricOptions(), Collisions(arm)

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self._collisions.move({})
        # Pairs that are close by design, or at the target, repel only when closer still, or the arm would not arrive.
        self._design, self._goal = self._near(q), np.full_like(q, np.nan)
        self._there: dict[tuple[int, int], float] = {}
        self._v = np.zeros_like(q)

    def see(self, places: Mapping[str, Floats]) -> None:
        """See `Policy`; raises `InputError` for names of no obstacles."""
        super().see(places)
        self._collisions.move(places)

    def velocity(self, target: Floats, waiting: float) -> Floats:
        """See `JointPolicy`; unchecked."""
        options = self._options
        if (target != self._goal).any():
            self._goal, self._there = target.copy(), self._near(target)
        near = self._collisions.distances(self.y, options.near)
        known = [min(self._design.get((a, b), np.inf), self._there.get((a, b), np.inf)) for a, b in near.pairs.tolist()]
        onset = np.minimum(options.near, 0.9 * np.array(known))
        kept = np.minimum(options.margin, 0.5 * onset)
        gap = np.maximum(near.distance - kept, 1e-3)
        weight = np.maximum((onset - kept) / gap - 1.0, 0.0) ** 2
        slopes, v = near.jacobian * self.range, self._v
        force = options.stiffness * (target - self.y) / self.range - options.damping * v
        force = force + (weight * (options.strength / gap - options.damping * (slopes @ v))) @ slopes
        metric = np.eye(len(v)) + (slopes.T * weight) @ slopes
        self._v = v + waiting * self.period * np.linalg.solve(metric, force)
        fastest = np.abs(self._v * self.range / self.arm.velocity_limits).max()
        self._v = self._v / max(1.0, float(fastest))
        return np.asarray(self._v * self.range)

    def _near(self, q: Floats) -> dict[tuple[int, int], float]:
        """Distances of pairs that are near [m]."""
        near = self._collisions.distances(q, self._options.near)
        return {(a, b): float(d) for (a, b), d in zip(near.pairs.tolist(), near.distance, strict=True)}


def fabric(task: PolicyTask, options: FabricOptions) -> Fabric:
    """The fabric of a task, which needs no motion."""
    return Fabric(task.arm, task.rate, options=options, feedback=task.feedback)
