"""Planners that run a network through the safety filter: alone, and guided along a path.

Alone, certified networks are made for the target, and those whose own motion is most free of obstacles run through the
filter. The filter looks one step ahead; if it blocks them all, RRT-Connect searches for a path (`sampling`), and the
network is retargeted along it: its bias attracts it to one corner of the path after another and then to the target,
with the same weights and the same certificate.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import interp1d

from lieednn_sim.budget import check_time
from lieednn_sim.errors import InputError, NotCertifiedError, PlanError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.baselines import sampling
from lieednn_sim.planning.baselines.sampling import SearchOptions
from lieednn_sim.planning.certified import CandidateOptions, rough_trajectories
from lieednn_sim.planning.joint_space import Workspace, joint_scale
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.problem import Plan, PlanningProblem
from lieednn_sim.planning.safety_filter import FilteredRun, FilterOptions, run_filtered
from lieednn_sim.planning.time_laws import minimum_jerk_law
from lieednn_sim.registry import optional_module
from lieednn_sim.synthesis import synthesize
from lieednn_sim.values import Floats

_FILTER = FilterOptions()
# Time in which the remaining distance to the target is closed [s].
_CLOSING_TIME = 0.1
# More clearance than the filter keeps, so that it does not impede a network that follows the path.
_SEARCH = SearchOptions(margin=0.02)


@dataclass(frozen=True)
class FilteredOptions(CandidateOptions):
    """Options of the planner ``lieednn-filtered``, besides those of `CandidateOptions`.

    Attributes:
        attempts: starts of `synthesize` for each network.
        tried: number of networks run although their own path is not free; if one is blocked, the others usually are.
        n_checked: number of configurations on a network's own path checked before the filter runs, up to 10 000.
        control_step: control period of the filter, up to 0.1 s, rounded to a whole number of the model's time steps.
        filter: options of the filter.
    """

    n_networks: int = 12
    attempts: int = 3
    tried: int = 1
    n_checked: int = field(default=40, metadata={"range": (1, 10_000)})
    control_step: float = field(default=0.01, metadata={"range": (0.0, 0.1)})
    filter: FilterOptions = _FILTER


@dataclass(frozen=True)
class GuidedOptions(FilteredOptions):
    """Options of the planner ``lieednn-guided``, besides those of `FilteredOptions`.

    Attributes:
        paths: number of paths to search for.
        followers: number of networks that follow each path.
        halvings: how often an edge is halved, up to 16, while the network's own path along it is not free; the network
            is retargeted to the ends of the halves.
        search: options of the path search; by default paths keep 0.02 m of clearance.
        own_margin: clearance that paths keep between parts of the arm [m].
    """

    paths: int = 2
    followers: int = 2
    halvings: int = field(default=4, metadata={"range": (1, 16)})
    search: SearchOptions = _SEARCH
    own_margin: float = 0.004


def filtered(problem: PlanningProblem, options: FilteredOptions) -> Plan:
    """The first motion of a certified network through the filter that arrives in the time allowed.

    Raises:
        NotCertifiedError: no network could be certified.
        PlanError: no run arrived; the message says what blocked the most promising one.
    """
    search = _Search(problem, options)
    return search.alone() or search.refuse()


def guided(problem: PlanningProblem, options: GuidedOptions) -> Plan:
    """As `filtered`; if no motion arrives, the network is retargeted along a path of RRT-Connect.

    Raises:
        LieEDNNError: OMPL is not installed.
        NotCertifiedError: no network could be certified.
        PlanError: no run arrived; the message says what blocked the most promising one.
    """
    optional_module("ompl")
    search = _Search(problem, options)
    return search.alone() or search.guided(options) or search.refuse()


class _Search:
    """Runs through the filter for one problem.

    Attributes:
        networks: networks drawn by `alone`, the most promising first.
        refusals: reasons of the runs that did not arrive.
    """

    def __init__(self, problem: PlanningProblem, options: FilteredOptions) -> None:
        self.problem, self.options = problem, options
        self.networks: list[LieEDNN] = []
        self.refusals: list[str] = []
        self._clear = Workspace(problem, options.filter.margin, options.filter.own_margin).clear
        self._scale = joint_scale(problem.arm)
        self._ratio = max(round(options.control_step / problem.timestep), 1)

    def alone(self) -> Plan | None:
        """Run certified networks whose own path is free as they are made, then the most promising others."""
        drawn: list[tuple[float, LieEDNN]] = []
        for network, unsafe in self._candidates():
            drawn.append((unsafe, network))
            if unsafe == 0.0 and (made := self._run(network)) is not None:
                return made
        if not drawn:
            raise NotCertifiedError(
                f"none of {self.options.n_networks} candidates for the target could be certified and followed"
            )
        drawn.sort(key=lambda candidate: candidate[0])
        self.networks = [network for _, network in drawn]
        for unsafe, network in drawn[: self.options.tried]:
            if unsafe > 0.0 and (made := self._run(network)) is not None:
                return made
        return None

    def guided(self, options: GuidedOptions) -> Plan | None:
        """The most promising networks, retargeted along paths."""
        workspace = Workspace(self.problem, options.search.margin, options.own_margin)
        search = sampling.ompl_search("rrt-connect")
        for attempt in range(options.paths):
            corners = sampling.connecting_path(self.problem, workspace, options.search, search, attempt)
            if corners is None:
                continue
            for network in self.networks[: options.followers]:
                made = self._run(network, self._via(network, corners, options.halvings))
                if made is not None:
                    return made
        return None

    def refuse(self) -> Plan:
        """Raise `PlanError`: nothing arrived."""
        first = self.refusals[0] if self.refusals else "none could be tried"
        raise PlanError(f"no run through the filter arrived; the most promising: {first}")

    def _candidates(self) -> Iterator[tuple[LieEDNN, float]]:
        """Certified networks for the target, each with the fraction of its own motion that is not free."""
        problem, arm = self.problem, self.problem.arm
        xi, rng = arm.encode(problem.target), np.random.default_rng(problem.seed)
        for magnitude in self.options.magnitudes():
            network = synthesize(
                xi,
                bias="sign-matched",
                bias_magnitude=magnitude,
                activation=self.options.activation,
                seed=rng,
                max_attempts=self.options.attempts,
            ).network
            if network is None:
                continue
            yield network, self._unsafe(network, problem.start)

    def _unsafe(self, network: LieEDNN, start: Floats) -> float:
        """The fraction of a network's own path from a start that is not free."""
        check_time()
        arm = self.problem.arm
        # The path is nearly straight between decoded states, so that few of them suffice.
        q = arm.decode(rough_trajectories([network], arm.encode(start))[0], start=start).q
        # A little more than the length, so that it increases even where nothing moves.
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q / self._scale, axis=0), axis=1) + 1e-9))
        path = interp1d(length, q, axis=0)(np.linspace(0.0, length[-1], self.options.n_checked + 2)[1:-1])
        inside = arm.limit_excess(path).max(axis=1) <= 0.0
        return 1.0 - float(np.mean(inside & [self._clear(position) for position in path]))

    def _run(self, network: LieEDNN, via: Floats | tuple[()] = ()) -> Plan | None:
        """The motion through the filter, with its run, or None with the reason added to the refusals."""
        problem, arm = self.problem, self.problem.arm
        try:
            run = run_filtered(
                arm,
                network,
                problem.start,
                problem.duration,
                via=via,
                timestep=self._ratio * problem.timestep,
                max_time_scale=problem.max_time_scale - _CLOSING_TIME / problem.duration,
                options=self.options.filter,
            )
            if not run.success:
                raise PlanError(run.message)
            motion = motion_of(run, problem.target, arm.encode(problem.target), self._ratio)
            check_motion(arm, motion)
        except (PlanError, InputError) as error:
            self.refusals.append(str(error))
            return None
        return Plan(motion, network, run)

    def _via(self, network: LieEDNN, corners: Floats, halvings: int) -> Floats:
        """Joint positions ``(V, n)`` to pass: the inner corners, and points where the network leaves an edge."""
        parts = [self._between(network, *edge, halvings) for edge in itertools.pairwise(corners)]
        return np.array([q for part in parts for q in part][:-1])

    def _between(self, network: LieEDNN, first: Floats, second: Floats, halvings: int) -> list[Floats]:
        """Joint positions from ``first``, without it, to ``second``, between which the network's own motion is free."""
        if halvings == 0 or self._unsafe(network.retarget(self.problem.arm.encode(second)), first) == 0.0:
            return [second]
        middle = 0.5 * (first + second)
        return [
            *self._between(network, first, middle, halvings - 1),
            *self._between(network, middle, second, halvings - 1),
        ]


def motion_of(run: FilteredRun, target: Floats, xi_target: Floats, ratio: int) -> Motion:
    """The motion of a run that arrived, extended to the target itself.

    Args:
        run: a run with control steps of equal length.
        target: ``(n,)`` joint position to end at, near the run's last.
        xi_target: ``(N, 6)`` network state of the target.
        ratio: samples of the motion per control step.
    """
    h = float(run.t[1] - run.t[0])
    step = h / ratio
    fraction = (np.arange(ratio) / ratio)[:, None]
    change = np.diff(run.qd, axis=0)[:, None]
    # Between control steps the acceleration is constant.
    qd = (run.qd[:-1, None] + fraction * change).reshape(-1, run.q.shape[1])
    q = (run.q[:-1, None] + h * fraction * run.qd[:-1, None] + 0.5 * h * fraction**2 * change).reshape(qd.shape)
    closing_q, closing_qd = _closing(run.q[-1], run.qd[-1], target, step)
    q, qd = np.concatenate([q, closing_q]), np.concatenate([qd, closing_qd])
    t = step * np.arange(len(q), dtype=np.float64)
    reference = run.reference
    clock = np.interp(t, run.t, run.clock)
    position = np.clip(np.searchsorted(reference.t, clock, side="right") - 1, 0, len(reference.t) - 2)
    weights = (clock - reference.t[position]) / np.diff(reference.t)[position]

    def along(values: Floats) -> Floats:
        weight = weights.reshape(-1, *(1,) * (values.ndim - 1))
        return np.asarray((1.0 - weight) * values[position] + weight * values[position + 1])

    names = ("tau", "xi", "gap_translation", "gap_rotation")
    tau, xi, *gaps = (along(getattr(reference, name)) for name in names)
    return Motion(t, tau, xi, xi_target, q, qd, *gaps)


def _closing(q: Floats, qd: Floats, goal: Floats, step: float) -> tuple[Floats, Floats]:
    """From nearly at rest near the goal to rest at the goal, by the quintic without acceleration at both ends."""
    count = max(round(_CLOSING_TIME / step), 2)
    s = (np.arange(count + 1) / count)[:, None]
    length = count * step
    ease, slope = minimum_jerk_law(s)
    # The quintic with unit slope at s = 0 whose other boundary values are zero, and its slope.
    start, start_slope = s * (1.0 - s) ** 3 * (1.0 + 3.0 * s), (1.0 - s) ** 2 * (1.0 + 2.0 * s - 15.0 * s**2)
    change = goal - q
    positions = q + ease * change + length * start * qd
    rates = slope * change / length + start_slope * qd
    positions[-1], rates[-1] = goal, 0.0
    return positions, rates
