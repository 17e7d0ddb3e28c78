"""Planners that run a network: certified once and retargeted, learned, and without weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import reference_posture
from lieednn_sim.errors import PlanError
from lieednn_sim.learning import TrainingOptions, TrainingResult, train
from lieednn_sim.network import ComponentwiseNetwork, LieEDNN
from lieednn_sim.network.hopfield import HopfieldNetwork
from lieednn_sim.planning.certified import CandidateOptions
from lieednn_sim.planning.network_path import NetworkPath, timed_motion
from lieednn_sim.planning.options import PlannerOptions
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.synthesis import bias_for, synthesize
from lieednn_sim.values import Floats

# Where a learned network has its equilibrium the motion ends, and it shall end at the target [rad, length_scale m].
_LEARNED_TOLERANCE = 1e-8
_TRACKED = TrainingOptions.tracked(tolerance=_LEARNED_TOLERANCE)
_PLAIN = TrainingOptions.repaired(projection="none", tolerance=_LEARNED_TOLERANCE, max_epochs=20_000, restarts=1)
# A network's equilibrium further away than this is not the target [rad, length_scale m]: a hundred times what learning
# leaves, and as much as a position may exceed a limit.
_ARRIVAL = 1e-6


@dataclass(frozen=True)
class RetargetedOptions(PlannerOptions):
    """Options of the planner ``lieednn-retargeted``.

    Attributes:
        bias_magnitude: of the sign-matched bias under which the reference network is certified [gamma/mu].
    """

    bias_magnitude: float = 0.25


@dataclass(frozen=True)
class TrainedOptions(CandidateOptions):
    """Options of the planner ``lieednn-trained``, beside what `CandidateOptions` say.

    Attributes:
        training: how each is learned.
    """

    candidates: int = 4
    training: TrainingOptions = _TRACKED


@dataclass(frozen=True)
class UnprojectedOptions(TrainedOptions):
    """Options of the planner ``lieednn-unprojected``: `TrainedOptions` with gradient steps, never projected."""

    training: TrainingOptions = _PLAIN


def retargeted(problem: PlanningProblem, options: RetargetedOptions) -> Plan:
    """The one network of `reference_network`, made to end at the target by its bias alone.

    Raises:
        NotCertifiedError: the arm's reference network could not be certified.
        PlanError: the motion breaks a limit of the arm.
    """
    network = reference_network(problem.arm, options.bias_magnitude).retarget(problem.arm.encode(problem.target))
    return Plan(in_time(timed_motion, problem, _path(problem, network)), network)


def reference_network(arm: Arm, bias_magnitude: float = RetargetedOptions.bias_magnitude) -> LieEDNN:
    """The network certified once for the arm's `reference_posture`, for every target and seed the same.

    Args:
        arm: the arm.
        bias_magnitude: of its sign-matched bias [gamma/mu].

    Raises:
        NotCertifiedError: it could not be certified.
    """
    return _reference_network(arm, bias_magnitude)


@lru_cache(maxsize=8)
def _reference_network(arm: Arm, bias_magnitude: float) -> LieEDNN:
    target = arm.encode(reference_posture(arm))
    return synthesize(target, bias="sign-matched", bias_magnitude=bias_magnitude).unwrap()


def trained(problem: PlanningProblem, options: TrainedOptions) -> Plan:
    """The first of a few learned networks whose motion the arm can make; with a certificate where there is one.

    The weights are learned by tracked projective learning (`learning.train`) under the sign-matched bias.

    Raises:
        PlanError: no network was learned, or every motion breaks a limit of the arm.
    """
    return _learned(problem, options, lambda result, _: result.network)


def unprojected(problem: PlanningProblem, options: UnprojectedOptions) -> Plan:
    """As `trained`, by the gradient steps of Algorithm 1 alone: weights that never return to the adjoint matrices.

    What is left is a plain network of 6N neurons (`HopfieldNetwork`), the ablation that shows what the structure is
    good for. It gets a certificate where there is one.

    Raises:
        PlanError: no network was learned, or every motion breaks a limit of the arm.
    """
    return _learned(problem, options, lambda result, bias: HopfieldNetwork(result.weight, bias))


def _learned(
    problem: PlanningProblem,
    options: TrainedOptions,
    network_of: Callable[[TrainingResult, Floats], ComponentwiseNetwork | None],
) -> Plan:
    xi = problem.arm.encode(problem.target)
    refusal = ""
    for candidate, magnitude in enumerate(options.magnitudes()):
        bias = bias_for("sign-matched", xi, np.tanh(xi), 1.0, magnitude)
        result = train(xi, options.training, bias=bias, seed=problem.seed + candidate)
        network = network_of(result, bias) if result.success else None
        if network is None:
            # A refused motion tells more than a failed training.
            refusal = refusal or result.message
            continue
        try:
            motion = timed_motion(problem, _path(problem, network))
        except PlanError as error:
            refusal = str(error)
            continue
        return Plan(motion, network.try_certify())
    raise PlanError(f"no learned network of {options.candidates} can be used: {refusal}")


def linear_attractor(problem: PlanningProblem) -> Plan:
    """The linear attractor xi' = -k (xi - xi_d), which is the LieEDNN without weights and with bias xi_d.

    So it shares the network's way through time (`network_path.NetworkPath`), where k has no part: only the path counts,
    a straight line in the network's coordinates. Its certificate is trivial.

    Raises:
        PlanError: the motion breaks a limit of the arm.
    """
    network = without_weights(problem.arm.encode(problem.target))
    return Plan(in_time(timed_motion, problem, _path(problem, network)), network)


def without_weights(target: Floats) -> LieEDNN:
    """The certified network whose visible neurons go straight to ``target`` ``(N, 6)``, each on its own."""
    n = len(target)
    return LieEDNN(
        alpha=np.zeros((n, n)),
        rotation=np.broadcast_to(np.eye(3), (n, n, 3, 3)),
        translation=np.zeros((n, n, 3)),
        bias=target,
    ).certify()


def _path(problem: PlanningProblem, network: ComponentwiseNetwork) -> NetworkPath:
    """The path of a network, when it ends at the problem's target."""
    path = NetworkPath.drawn(problem.arm, network, problem.start)
    # An uncertified network may have more equilibria than the one it was made for.
    distance = float(np.abs(network.visible(path.target) - problem.arm.encode(problem.target)).max())
    if distance > _ARRIVAL:
        raise PlanError(
            f"the network ends at another equilibrium, {distance:.2g} from the target; use a certified network"
        )
    return path
