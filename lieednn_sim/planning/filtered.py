"""The LieEDNN with limits and clearance enforced while it runs, for scenes with obstacles: alone, and guided.

Alone, certified networks are drawn for the target, and those whose own motion stays clearest of obstacles run through
the filter. The filter sees no further than the next step; where it blocks them all, a path helps: RRT-Connect finds one
(`sampling`), and the network is retargeted on the way. Its bias draws it to one corner of the path after another and
then to the target, with the same weights and the same certificate.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import interp1d

from lieednn_sim.budget import check_time
from lieednn_sim.errors import InputError, NotCertifiedError, PlanError
from lieednn_sim.network import LieEDNN
from lieednn_sim.planning.baselines import sampling
from lieednn_sim.planning.baselines.joint_space import Workspace, joint_scale
from lieednn_sim.planning.certified import BIAS_MAGNITUDES, rough_way
from lieednn_sim.planning.extras import optional_module
from lieednn_sim.planning.filtering import FilterOptions, run_filtered
from lieednn_sim.planning.motion import Motion, check_motion
from lieednn_sim.planning.problem import Plan, PlanningProblem
from lieednn_sim.planning.segments import CLOSING, motion_of
from lieednn_sim.synthesis import synthesize

Floats = NDArray[np.float64]


# Networks drawn, starts of `synthesize` for each, and how many of those whose own way is not free are run all the same:
# where one is blocked the others mostly are.
_CANDIDATES, _ATTEMPTS, _TRIED = 12, 3, 1
# A network's way is looked at before the filter runs, at so many postures.
_LOOKS = 40
# A control step is the whole number of the model's steps next to this [s].
_CONTROL_STEP = 0.01
# Paths for guiding keep this from obstacles, more than the filter does, and from other parts of the arm [m].
_PATH_MARGIN, _PATH_OWN_MARGIN = 0.02, 0.004
# Paths are searched for this often, and followed by so many networks each; on edges where the network's own way is not
# free there are more postures, at the ends of this many halvings.
_PATHS, _GUIDED, _HALVINGS = 2, 2, 4


def filtered(problem: PlanningProblem) -> Plan:
    """The first motion of a certified network through the filter that arrives.

    It takes what time it needs, up to ``problem.longest`` durations.

    Raises:
        NotCertifiedError: no network could be certified.
        PlanError: no run arrived; the message says what blocked the most promising one.
    """
    search = _Search(problem)
    return search.alone() or search.refuse()


def guided(problem: PlanningProblem) -> Plan:
    """As `filtered`; where that does not arrive, the network is retargeted along a path of RRT-Connect.

    Raises:
        LieEDNNError: OMPL is not installed.
        NotCertifiedError: no network could be certified.
        PlanError: no run arrived; the message says what blocked the most promising one.
    """
    optional_module("ompl")
    search = _Search(problem)
    return search.alone() or search.guided() or search.refuse()


class _Search:
    """Runs through the filter for one problem.

    Attributes:
        networks: drawn so far, once `alone` is through the most promising first.
        refusals: of the runs that did not arrive.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        self.problem = problem
        self.networks: list[LieEDNN] = []
        self.refusals: list[str] = []
        margins = FilterOptions()
        self._clear = Workspace(problem, margins.margin, margins.own_margin).clear
        self._scale = joint_scale(problem.arm)
        self._ratio = max(round(_CONTROL_STEP / problem.timestep), 1)

    def alone(self) -> Plan | None:
        """Certified networks whose own way is free as soon as they are drawn, then the most promising other one."""
        drawn: list[tuple[float, LieEDNN]] = []
        for network, unsafe in self._candidates():
            drawn.append((unsafe, network))
            if unsafe == 0.0 and (motion := self._run(network)) is not None:
                return Plan(motion, network)
        if not drawn:
            raise NotCertifiedError(f"none of {_CANDIDATES} candidates for the target could be certified and followed")
        drawn.sort(key=lambda candidate: candidate[0])
        self.networks = [network for _, network in drawn]
        for unsafe, network in drawn[:_TRIED]:
            if unsafe > 0.0 and (motion := self._run(network)) is not None:
                return Plan(motion, network)
        return None

    def guided(self) -> Plan | None:
        """The most promising networks, retargeted along paths."""
        workspace = Workspace(self.problem, _PATH_MARGIN, _PATH_OWN_MARGIN)
        for attempt in range(_PATHS):
            corners = sampling.connecting_path(self.problem, workspace, attempt)
            if corners is None:
                continue
            for network in self.networks[:_GUIDED]:
                motion = self._run(network, self._postures(network, corners))
                if motion is not None:
                    return Plan(motion, network)
        return None

    def refuse(self) -> Plan:
        """Raise `PlanError`: nothing arrived."""
        first = self.refusals[0] if self.refusals else "none could be tried"
        raise PlanError(f"no run through the filter arrived; the most promising: {first}")

    def _candidates(self) -> Iterator[tuple[LieEDNN, float]]:
        """Certified networks for the target, with the share of their own motion that is not free."""
        problem, arm = self.problem, self.problem.arm
        xi, rng = arm.encode(problem.target), np.random.default_rng(problem.seed)
        for index in range(_CANDIDATES):
            magnitude = BIAS_MAGNITUDES[index % len(BIAS_MAGNITUDES)]
            network = synthesize(
                xi, bias="sign-matched", bias_magnitude=magnitude, seed=rng, max_attempts=_ATTEMPTS
            ).network
            if network is None:
                continue
            yield network, self._unsafe(network, problem.start)

    def _unsafe(self, network: LieEDNN, start: Floats) -> float:
        """The share of a network's own way from a start that is not free."""
        check_time()
        arm = self.problem.arm
        # From one decoded state to the next the way is nearly straight, and few states are decoded quickly.
        q = arm.decode(rough_way(network, arm.encode(start))).q
        # A little more than the length, so that it increases where nothing moves.
        length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(q / self._scale, axis=0), axis=1) + 1e-9))
        way = interp1d(length, q, axis=0)(np.linspace(0.0, length[-1], _LOOKS + 2)[1:-1])
        inside = arm.limit_excess(way).max(axis=1) <= 0.0
        return 1.0 - float(np.mean(inside & [self._clear(position) for position in way]))

    def _run(self, network: LieEDNN, via: Floats | tuple[()] = ()) -> Motion | None:
        """The motion through the filter, or None and the reason among the refusals."""
        problem, arm = self.problem, self.problem.arm
        try:
            run = run_filtered(
                arm,
                network,
                problem.start,
                problem.duration,
                via=via,
                timestep=self._ratio * problem.timestep,
                longest=problem.longest - CLOSING / problem.duration,
            )
            if not run.success:
                raise PlanError(run.message)
            motion = motion_of(run, problem.target, arm.encode(problem.target), self._ratio)
            check_motion(arm, motion)
        except (PlanError, InputError) as error:
            self.refusals.append(str(error))
            return None
        return motion

    def _postures(self, network: LieEDNN, corners: Floats) -> Floats:
        """Postures to pass ``(V, n)``: the inner corners, and others between where the network leaves the edges."""
        parts = [self._between(network, *edge, _HALVINGS) for edge in itertools.pairwise(corners)]
        return np.array([posture for part in parts for posture in part][:-1])

    def _between(self, network: LieEDNN, first: Floats, second: Floats, halvings: int) -> list[Floats]:
        """Postures from ``first``, without it, to ``second``, between which the network's own motion is free."""
        if halvings == 0 or self._unsafe(network.retarget(self.problem.arm.encode(second)), first) == 0.0:
            return [second]
        middle = 0.5 * (first + second)
        return [
            *self._between(network, first, middle, halvings - 1),
            *self._between(network, middle, second, halvings - 1),
        ]
