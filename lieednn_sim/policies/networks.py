"""The policies that run a network made for the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lieednn_sim.network import LieEDNN
from lieednn_sim.planning import ShapedOptions, plan
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.options import NetworkOptions
from lieednn_sim.planning.shaped import lever_units
from lieednn_sim.policies.network_policy import NetworkPolicy
from lieednn_sim.policies.task import PolicyTask
from lieednn_sim.synthesis import ShapingOptions, shape, synthesize


@dataclass(frozen=True)
class CertifiedPolicyOptions(NetworkOptions):
    """Options of the policy ``lieednn-certified``.

    Attributes:
        bias_magnitude: magnitude of the network's bias [gamma/mu].

    Raises:
        InputError: a value is out of range.
    """

    bias_magnitude: float = 0.25


def shaped(task: PolicyTask, options: ShapedOptions) -> NetworkPolicy:
    """A network along the motion of the planner ``lieednn-shaped``."""
    result = plan(task.arm, task.target, planner="lieednn-shaped", start=task.start, options=options, seed=task.seed)
    network, motion = result.network, result.motion
    assert isinstance(network, LieEDNN)
    if options.rate == 1.0 and network.n_hidden:
        # A tenth of the universal network's neurons: its steps take less time, and so does the bound on a push.
        shaping = ShapingOptions(options.rate, options.neurons, options.activation)
        units = lever_units(task.arm, motion.q)
        network = shape(motion.xi[::2], 0.2 * options.deviation, units=units, options=shaping).network
    # Its clock is the slowest.
    return _policy(task, network, task.convergence_rate / options.rate)


def certified(task: PolicyTask, options: CertifiedPolicyOptions) -> NetworkPolicy:
    """A certified network for the target."""
    xi = task.arm.encode(task.target)
    network = synthesize(
        xi,
        bias="sign-matched",
        bias_magnitude=options.bias_magnitude,
        activation=options.activation,
        seed=task.seed,
    ).unwrap()
    slowest = -float(np.linalg.eigvals(network.jacobian(xi)).real.max())
    return _policy(task, network, task.convergence_rate / slowest)


def linear(task: PolicyTask) -> NetworkPolicy:
    """A network without weights: xi' = -(xi - xi_d)."""
    return _policy(task, without_weights(task.arm.encode(task.target)), task.convergence_rate)


def _policy(task: PolicyTask, network: LieEDNN, speed: float) -> NetworkPolicy:
    return NetworkPolicy(task.arm, network, task.rate, speed=speed, feedforward=False, feedback=task.feedback)
