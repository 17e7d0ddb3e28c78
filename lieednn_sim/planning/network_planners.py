"""Planners whose network is certified once and retargeted, learned, or without weights."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import reference_configuration
from lieednn_sim.errors import PlanError
from lieednn_sim.learning import TrainingOptions, train
from lieednn_sim.network import ACTIVATIONS, DEFAULT_ACTIVATION, ComponentwiseNetwork, LieEDNN
from lieednn_sim.planning.certified import CandidateOptions
from lieednn_sim.planning.motion import LIMIT_TOLERANCE
from lieednn_sim.planning.network_path import NetworkPath, timed_motion
from lieednn_sim.planning.options import NetworkOptions
from lieednn_sim.planning.problem import Plan, PlanningProblem, in_time
from lieednn_sim.synthesis import bias_for, synthesize
from lieednn_sim.validation import as_positive
from lieednn_sim.values import Floats, weakly_cached


@dataclass(frozen=True)
class RetargetedOptions(NetworkOptions):
    """Options of the planner ``lieednn-retargeted``.

    Attributes:
        bias_magnitude: magnitude of the reference network's sign-matched bias [gamma/mu].
    """

    bias_magnitude: float = 0.25


@dataclass(frozen=True)
class TrainedOptions(CandidateOptions):
    """Options of the planner ``lieednn-trained``, besides those of `CandidateOptions`.

    Attributes:
        training: options of the training.
    """

    n_networks: int = 4
    # The motion ends at the learned network's equilibrium, which must be the target [rad, length_scale m].
    training: TrainingOptions = field(default=TrainingOptions.tracked(tolerance=1e-8))


def retargeted(problem: PlanningProblem, options: RetargetedOptions) -> Plan:
    """Retarget the network of `reference_network` by its bias alone.

    Raises:
        NotCertifiedError: the arm's reference network could not be certified.
        PlanError: the motion breaks a limit of the arm.
    """
    reference = reference_network(problem.arm, options.bias_magnitude, options.activation)
    network = reference.retarget(problem.arm.encode(problem.target))
    return Plan(in_time(timed_motion, problem, _path(problem, network)), network)


def reference_network(
    arm: Arm, bias_magnitude: float = RetargetedOptions.bias_magnitude, activation: str = DEFAULT_ACTIVATION
) -> LieEDNN:
    """The network of the planner ``lieednn-retargeted``, which is the same for every target and seed.

    It is certified for the arm's reference configuration; other targets change its bias only.

    Args:
        arm: the arm.
        bias_magnitude: magnitude of its sign-matched bias [gamma/mu].
        activation: a name of `network.ACTIVATIONS`.

    Raises:
        NotCertifiedError: it could not be certified.
    """
    return _reference_network(arm, as_positive("bias_magnitude", bias_magnitude), activation)


@weakly_cached
def _reference_network(arm: Arm, bias_magnitude: float, activation: str) -> LieEDNN:
    target = arm.encode(reference_configuration(arm))
    return synthesize(target, bias="sign-matched", bias_magnitude=bias_magnitude, activation=activation).unwrap()


def trained(problem: PlanningProblem, options: TrainedOptions) -> Plan:
    """The first of a few learned networks with a feasible motion; certified if a certificate is found.

    The weights are learned by tracked projective learning (`learning.train`) under the sign-matched bias.

    Raises:
        PlanError: no network was learned, or every motion breaks a limit of the arm.
    """
    xi, activation = problem.arm.encode(problem.target), options.activation
    refusal = ""
    for candidate, magnitude in enumerate(options.magnitudes()):
        bias = bias_for("sign-matched", xi, ACTIVATIONS[activation].phi(xi), 1.0, magnitude)
        result = train(xi, options.training, bias=bias, activation=activation, seed=problem.seed + candidate)
        if result.network is None or not result.success:
            # The reason of a refused motion is more informative than that of a failed training.
            refusal = refusal or result.message
            continue
        try:
            return Plan(timed_motion(problem, _path(problem, result.network)), result.network.try_certify())
        except PlanError as error:
            refusal = str(error)
    raise PlanError(f"no learned network of {options.n_networks} can be used: {refusal}")


def linear_attractor(problem: PlanningProblem) -> Plan:
    """The linear attractor xi' = -k (xi - xi_d), which is the LieEDNN without weights and with bias xi_d.

    It is timed like any network (`network_path.NetworkPath`), so only the path matters, not k: a straight line in the
    network's coordinates. Its certificate is trivial.

    Raises:
        PlanError: the motion breaks a limit of the arm.
    """
    network = without_weights(problem.arm.encode(problem.target))
    return Plan(in_time(timed_motion, problem, _path(problem, network)), network)


def without_weights(target: Floats) -> LieEDNN:
    """The certified network whose visible neurons go straight to ``target`` ``(N, 6)``, independently."""
    n = len(target)
    unturned = np.broadcast_to(np.eye(3), (n, n, 3, 3))
    return LieEDNN(alpha=np.zeros((n, n)), rotation=unturned, translation=np.zeros((n, n, 3)), bias=target).certify()


def _path(problem: PlanningProblem, network: ComponentwiseNetwork) -> NetworkPath:
    """The path of a network, checked to end at the problem's target."""
    path = NetworkPath.integrate(problem.arm, network, problem.start)
    # The end may be elsewhere: an uncertified network may have several equilibria, and learning has a tolerance.
    distance = float(np.abs(network.visible(path.target) - problem.arm.encode(problem.target)).max())
    if distance > LIMIT_TOLERANCE:
        raise PlanError(f"it ends at another equilibrium, {distance:.2g} from the target; use a certified network")
    return path
