"""From a network to a joint trajectory that starts and ends at rest and takes a stated duration.

In its own time tau, a network starts with a step of velocity, and converges exponentially without arriving in finite
time. A robot can do neither. So only the path q(tau) of the network is kept. The motion follows it by a minimum-jerk
law of its length l, l(t) = L sigma(t / T) with sigma = 10 s^3 - 15 s^4 + 6 s^5, and more slowly where it turns sharply.
The length combines joint velocities, in units of their limits, with the rate of convergence: where joints reverse,
their velocity passes through zero, so with a length of the joints alone they would reverse abruptly. The path ends
where the network is within `RESIDUAL` of its equilibrium. The path of a universal network has a closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, PchipInterpolator, make_interp_spline

from lieednn_sim.arm import Arm
from lieednn_sim.arm.projection import Retraction
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.network import BlockNetwork, ComponentwiseNetwork, LieEDNN
from lieednn_sim.planning.motion import (
    JUMP,
    Motion,
    check_motion,
    count_steps,
    interpolation,
    joint_scale,
    travelled,
    unexplained_steps,
)
from lieednn_sim.planning.problem import PlanningProblem
from lieednn_sim.planning.time_laws import Law, eased_law, minimum_jerk_law
from lieednn_sim.synthesis import CurveEncoder
from lieednn_sim.values import Floats

_LATE, _SWING = 25, 1e-4  # number of last samples between which the spline of no joint may swing by more [rad, m]
RESIDUAL = 1e-8  # distance to the equilibrium at which the path is cut [network coordinates: rad, length_scale m]


@dataclass(frozen=True, eq=False)
class NetworkPath:
    """The path of an arm that follows a network; `timed` makes motions along it.

    Positions on the path are the network's own time tau or, for a universal network, w = 1 - e^-tau, in which it is
    smooth to the end. The joints are decoded at some positions; a spline through them is good to a micrometre.

    Attributes:
        arm: decodes states to joint positions.
        network: a network with as many visible neurons as the arm has links.
        target: ``(N, 6)`` the visible neurons' equilibrium.
        states: maps positions ``(K,)`` to the states of all neurons or, if the path is universal, of the visible ones.
        speed: the speed along the path as a function of position up to its end, either of the joints in units of their
            limits, combined with the rate of convergence, or of the network's states. None if nothing moves.
        joints: joints ``(n,)``, then mechanism gaps ``(N,)`` [m] and ``(N,)`` [rad], as functions of position.
        universal: whether the network is universal and positions are w.
    """

    arm: Arm
    network: ComponentwiseNetwork
    target: Floats
    states: Callable[[Floats], Floats]
    speed: PchipInterpolator | None
    joints: BSpline | PchipInterpolator
    universal: bool = False

    @classmethod
    def integrate(
        cls, arm: Arm, network: ComponentwiseNetwork, start: ArrayLike, units: Floats | None = None
    ) -> NetworkPath:
        """Integrate the network from joint position ``start`` ``(n,)``.

        If ``units`` ``(N, 6)`` of the visible neurons' coordinates are given, the path's length is that of the states
        in these units, as in `law_of`.

        Raises:
            InputError: the start is out of limits, or network and arm differ in size.
            PlanError: the network has no equilibrium or does not arrive there.
        """
        require_fit(arm, network)
        begin = arm.check_position(start, "start")
        origin = network.start(arm.encode(begin))
        equilibrium = network.equilibrium(origin)
        if not equilibrium.success:
            raise PlanError(f"the network cannot be used for a motion: {equilibrium.message}")
        target = equilibrium.xi
        if np.abs(origin - target).max() <= RESIDUAL:
            still = make_interp_spline([0, 1], [np.append(begin, np.zeros(2 * arm.n_links))] * 2, 1)
            return cls(arm, network, network.visible(target), lambda at: np.stack([origin] * len(at)), None, still)
        # Far from the equilibrium gamma determines the pace, close to it the slowest eigenvalue.
        pace = max(-equilibrium.spectral_abscissa, 1e-3 * network.gamma)
        longest = 100.0 / network.gamma + 40.0 / pace
        # A slow clock makes the speed low at the end of the path, and the integrator's error must be small beside it.
        # The error may also keep it from arriving at a target with large entries; then a smaller tolerance is tried.
        usual = max(1e-8 * min(1.0, pace / network.gamma) ** 4, 1e-12)
        # Nothing is integrated towards an equilibrium that does not attract.
        for rtol in (usual, 1e-2 * usual) if equilibrium.spectral_abscissa < 0.0 else ():
            trajectory = network.trajectory(
                origin, longest, until=target, distance=RESIDUAL, method="DOP853", rtol=rtol, atol=1e-2 * rtol
            )
            if np.abs(network.visible(trajectory.xi[-1] - target)).max() <= 2.0 * RESIDUAL:
                break
        else:
            raise PlanError(
                "the network does not arrive at its equilibrium from this start, or too slowly (spectral abscissa "
                f"{equilibrium.spectral_abscissa:.2g}); use another network"
            )
        # A grid finer than the integrator's steps, since the speed is interpolated with a lower order than the states.
        between = trajectory.t[:-1, None] + np.diff(trajectory.t)[:, None] * (np.arange(24) / 24)
        grid = np.append(between, trajectory.t[-1])
        states = trajectory(grid)
        some = np.append(np.arange(0, len(grid) - 1, 4), len(grid) - 1)
        known, field = grid[some], network.visible(network.vector_field(states[some]))
        decoded = arm.decode(network.visible(states[some]), field, begin)
        # The rates of a link's joints are unbounded where they are exactly singular.
        if not (np.abs(decoded.qd) < 1e100).all() or unexplained_steps(known, decoded.q, decoded.qd)[1].max() > JUMP:
            raise PlanError("the joint positions nearest to the network's path jump; use another network")
        joints = _through(known, decoded)
        if units is None:
            weights = np.where(np.isfinite(arm.velocity_limits), arm.velocity_limits, 1.0)
            rates = np.linalg.norm(joints(grid, 1)[:, : arm.n_joints] / weights, axis=-1)
            rates = np.hypot(rates, pace * np.linalg.norm(network.visible(states - target), axis=(-2, -1)))
        else:
            rates = np.linalg.norm(network.visible(network.vector_field(states)) * units, axis=(-2, -1))
        # Shape-preserving, so that the speed stays positive between its samples.
        speed = PchipInterpolator(grid, rates)
        return cls(arm, network, network.visible(target), trajectory, speed, joints)

    @classmethod
    def encoded(cls, arm: Arm, network: LieEDNN, given: Motion, units: Floats) -> NetworkPath:
        """The path of a universal network from the start of a motion that it follows, in closed form.

        Args:
            arm: decodes states to joint positions.
            network: the universal network (`synthesis.CurveEncoder`) with the code of a curve.
            given: the motion, whose joint positions are the guesses from which the path is decoded.
            units: as for `integrate`.

        Raises:
            InputError: the network is another one.
        """
        strength = float(network.alpha[0].max())
        visible = CurveEncoder(network.n_visible, network.activation, strength).path(network, given.xi[0])
        w = visible.x
        slope = np.concatenate([visible.c[2], visible(w[-1:], 1)]) * units
        speed = PchipInterpolator(w, np.sqrt(np.einsum("kij,kij->k", slope, slope)))
        # Joints are decoded at every third instant, or every sixth of a smooth path, and at all instants near the end.
        bends = np.abs(np.diff(visible.c[3, : np.count_nonzero(w < 0.95) : 6], n=6, axis=0)).max()
        some = w[(np.arange(len(w)) % (6 if bends < 5e-5 else 3) == 0) | ((w > 0.95) & (w < 0.9999)) | (w == w[-1])]
        # Both paths have about the same length, so guesses are taken from samples of the motion at the same length.
        known = given.ends(500)
        passed, length = travelled(given.xi[known] * units), speed.antiderivative()(some)
        near = np.stack([np.interp(length, passed, joint) for joint in given.q[known].T], axis=1)
        joints = _through(some, arm.decode(visible(some), start=near))
        return cls(arm, network, network.bias[: network.n_visible], visible, speed, joints, universal=True)

    def timed(self, duration: float, timestep: float, law: Law | None = None) -> Motion:
        """The motion along the path in ``duration``, sampled every ``timestep`` [s].

        The law maps fractions of the duration to fractions of the path's length. By default it is minimum jerk, slowed
        down where the path turns sharply.
        """
        motion = self._timed(duration, timestep, minimum_jerk_law if law is None else law)
        eased = eased_law(motion, joint_scale(self.arm)) if law is None else None
        return motion if eased is None else self._timed(duration, timestep, eased)

    def _timed(self, duration: float, timestep: float, law: Law) -> Motion:
        t = timestep * np.arange(count_steps(duration, timestep) + 1, dtype=np.float64)
        known, all_of = interpolation(len(t), 500)
        position, rate = np.zeros_like(t), np.zeros(len(known))
        if (speed := self.speed) is not None:
            length = speed.antiderivative()
            total = float(length(speed.x[-1]))
            progress, progress_rate = law(t[known] / t[-1])
            position = _invert(length, speed, speed.x, total * np.clip(all_of @ progress, 0.0, 1.0))
            rate = total * progress_rate / (t[-1] * np.maximum(speed(position[known]), 1e-300))
        states = self.states(position)
        tau, xi = (-np.log1p(-position), states) if self.universal else (position, self.network.visible(states))
        n, values, slopes = self.arm.n_joints, self.joints(position[known]), self.joints(position[known], 1)
        q, qd = all_of @ values[:, :n], all_of @ (slopes[:, :n] * rate[:, None])
        qd[[0, -1]] = 0.0
        gaps = np.maximum(all_of @ values[:, n:], 0.0)
        return Motion(t, tau, xi, self.target, q, qd, *np.split(gaps, 2, axis=1))


def require_fit(arm: Arm, network: BlockNetwork, *, certified: bool = False) -> None:
    """Raise `InputError` unless the network has a visible neuron for each link, and, if asked for, a certificate."""
    if network.n_visible != arm.n_links:
        raise InputError(f"the network has {network.n_visible} visible neurons, arm {arm.name!r} {arm.n_links} links")
    if certified and not network.certified:
        raise InputError("only a certified network follows every target; see network.certify()")


def timed_motion(problem: PlanningProblem, path: NetworkPath, *law: Law) -> Motion:
    """The checked motion along a path in the problem's duration, by a given time law or that of `NetworkPath.timed`.

    Raises:
        PlanError: the motion breaks a limit of the arm, or ends at another configuration with the target's poses.
    """
    arm, motion = problem.arm, path.timed(problem.duration, problem.timestep, *law)
    check_motion(arm, motion)
    away = np.abs(motion.q[-1] - problem.target)
    joint = int(away.argmax())
    # Different configurations with the same poses differ by more than this [rad, m].
    if away[joint] > 1e-3:
        raise PlanError(
            f"the path ends at another configuration with the target's poses: joint {arm.joint_names[joint]!r} at "
            f"{motion.q[-1, joint]:.3g} {arm.unit(joint)} in place of {problem.target[joint]:.3g}; name more links, or "
            "take a target on this side of the configurations at which a link's pose does not tell its joints apart"
        )
    return motion


def _through(position: Floats, decoded: Retraction) -> BSpline | PchipInterpolator:
    """The joints and gaps of `NetworkPath` through those decoded at some positions ``(K,)``."""
    values = np.concatenate([decoded.q, decoded.gap_translation, decoded.gap_rotation], axis=1)
    smooth = make_interp_spline(position, values, 5)
    # If poses near the end hardly determine the joints, these settle later than the poses, and a spline would swing.
    late, known = position[-_LATE:], values[-_LATE:]
    swing = np.abs(smooth(0.5 * (late[1:] + late[:-1])) - known[1:]) - 2.0 * np.abs(np.diff(known, axis=0))
    return PchipInterpolator(position, values) if swing.max() > _SWING else smooth


def _invert(length: PchipInterpolator, speed: PchipInterpolator, grid: Floats, wanted: Floats) -> Floats:
    """Solutions tau of length(tau) = wanted, by Newton steps safeguarded by bisection, for all samples at once."""
    known = length(grid)
    index = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(grid) - 2)
    low, high = grid[index].copy(), grid[index + 1].copy()
    tau = np.interp(wanted, known, grid)
    for _ in range(60):
        error = length(tau) - wanted
        # Solved samples are kept: rounding could move them out of their brackets, and bisection then far away.
        off = np.abs(error) > 1e-14 * known[-1]
        if not off.any():
            break
        low, high = np.where(error < 0.0, tau, low), np.where(error >= 0.0, tau, high)
        newton = tau - error / np.maximum(speed(tau), 1e-300)
        trial = np.where((newton > low) & (newton < high), newton, 0.5 * (low + high))
        tau = np.where(off, trial, tau)
    return tau
