"""A certified network as a policy: its bias moves with the target, and measured joints may pull its state.

The certificate of a network does not depend on its bias, so the bias b(x) = (gamma/mu) x - W phi(x) makes any target x
the global attractor, at any moment. With the network's speed c [1/s], and the factors s, k and d of `feedback` (s = 1
and k = 0 without it), the state x = (visible, hidden and clock) obeys

    x_v' = l (s c F_v(x) + x'_ff + k d (xi(q) - xi(q_r))),    x_h' = l s c F_h(x),

where F is the field of the network retargeted to the present target, xi the arm's encoding, q the measured joints, q_r
the reference of the same instant, x'_ff the target's velocity in the network's coordinates, and l <= 1 keeps the joints
within their limits of velocity and, while speeding up, of acceleration. Behind a target that moves with velocity v a
state near it lags by (-c J)^-1 v, with the field's Jacobian J at the target; the feedforward x'_ff = v removes that.

The proof is kept. Without the coupling (k d = 0) and behind a target at rest x' = r(t) F(x) with a factor
r = l s c > 0: in the time integral of r it is the network itself, so x runs along the same orbits, and the network's
Lyapunov function V decreases, dV/dt = r grad V . F < 0, until the target is reached, since s and l never vanish for
good. The whole field must be scaled: slowing the hidden neurons or the clock alone would give another system, which no
certificate covers. The coupling is an input of the visible neurons, not of a cascade's hidden ones. It vanishes when
the arm comes within the tolerance of its reference; then the certified network runs from wherever it was pulled to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg.blas import idamax

from lieednn_sim.arm import Arm
from lieednn_sim.arm.local_retraction import LocalRetraction
from lieednn_sim.errors import InputError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.stepping import RungeKuttaStepper
from lieednn_sim.planning import ShapedOptions, plan
from lieednn_sim.planning.network_path import require_fit
from lieednn_sim.planning.network_planners import without_weights
from lieednn_sim.planning.options import NetworkOptions
from lieednn_sim.planning.shaped import lever_units
from lieednn_sim.policies.exporting import write_policy
from lieednn_sim.policies.feedback import FEEDBACK, Feedback, FeedbackPolicy
from lieednn_sim.policies.making import PolicyTask
from lieednn_sim.synthesis import ShapingOptions, shape, synthesize
from lieednn_sim.validation import as_positive
from lieednn_sim.values import Floats, StrPath

# Largest |l s c| T in the certificate's norm, and largest change of a switch's argument, in a Runge-Kutta step.
_MAX_STEP = 0.5
_MAX_STEPS = 100  # of these in a period, at most


class NetworkPolicy(FeedbackPolicy):
    """A certified network that leads an arm to a target, which may move.

    Its state follows the network's own dynamics from one `reset` to the next.

    Args:
        arm: the arm, which encodes targets; `LocalRetraction` decodes states.
        network: certified, with as many visible neurons as the arm has links; its own bias does not matter.
        rate: control rate [Hz].
        speed: the network's speed c, its own time per second [1/s].
        feedforward: whether to add the target's velocity, the difference of its last two samples over the period.
        feedback: settings of the feedback from the measured joints; None for no feedback.

    Attributes:
        network, speed: as given.
        xi: ``(N, 6)`` state of all neurons.
        pulled: whether measured joints pulled the state in the last period, which is then no orbit of the network.
        gap: ``(N, 2)`` mechanism gap of each link in the last period: angle [rad] and distance [m].

    Raises:
        InputError: network and arm differ in size, the network is not certified, or the speed is too high for the rate.
    """

    certified = True

    def __init__(
        self,
        arm: Arm,
        network: LieEDNN,
        rate: float = 100.0,
        *,
        speed: float = 5.0,
        feedforward: bool = True,
        feedback: Feedback | None = FEEDBACK,
    ) -> None:
        super().__init__(arm, rate, feedback=feedback)
        require_fit(arm, network, certified=True)
        self.network = network
        self.speed, self._feedforward = as_positive("speed", speed), feedforward
        self._stepping, self._visible = RungeKuttaStepper(network), 6 * network.n_visible
        self._stiffness = network.gamma + network.mu * _certified_norm(network)
        fastest = _MAX_STEPS * _MAX_STEP * self.rate / self._stiffness
        if self.speed > fastest:
            raise InputError(
                f"speed must be at most {fastest:.3g} per second for this network at {self.rate:g} Hz, got {speed:g}"
            )

    def begin(self, q: Floats) -> None:
        """See `Policy`; unchecked."""
        super().begin(q)
        self.xi = self.network.start(self.arm.encode(q))
        self._retraction = LocalRetraction(self.arm, q)
        # The last target and its goal, and whether the field belongs to this goal, not to one ahead of it.
        self._aimed: tuple[Floats, Floats] | None = None
        self._still = np.zeros(self.xi.size), np.zeros(self.arm.n_joints)
        self._settled = False
        # The network's state, its drive and its field; then the state and the field in joint coordinates.
        self._x = self.xi.ravel()
        self._drive, self._flow = self._stepping.drive(self._x), np.zeros(self.xi.size)
        self._drawn, self._flow_rate = q, self.qd
        # The pull towards the network's rest state.
        self._pull = np.zeros(self.xi.size)
        self.pulled, self.gap = False, np.zeros((self.arm.n_links, 2))

    @property
    def state(self) -> Floats:
        """``(N, 6)``, as `xi`."""
        return self.xi

    def to_c(self, folder: StrPath) -> Path:
        """Write the policy as C99 for a robot's controller, without allocation: ``policy.h``, ``policy.c`` and numbers.

        One call a period takes measured joints and a target, and gives the reference that `step` gives, up to rounding.
        It also reports faults of measurements and targets by a status, and brakes if they last; ``policy.h`` has the
        rules. The network's files, see `LieEDNN.to_c`, are written beside them. The C policy begins where it is told
        to, as after `reset`; it does not go on from the present state.

        Args:
            folder: where to write them, made if it is missing, and returned. Files of these names are replaced.

        Raises:
            InputError: the arm's joints move others that have ranges of their own; or as for `LieEDNN.to_c`.
            FileError: the files cannot be written.
        """
        settings = {
            "RATE": (self.rate, "control rate [Hz]"),
            "PERIOD": (self.period, "control period [s]"),
            "SPEED": (self.speed, "the network's own time per second"),
            "FEEDFORWARD": (int(self._feedforward), "whether the velocity of a target that moves is added"),
            "STIFFNESS": (self._stiffness, "bound on the network's rates, per unit of its time"),
            "MAX_STEP": (_MAX_STEP, "largest product of that and a Runge-Kutta step"),
            "MAX_STEPS": (_MAX_STEPS, "largest number of such steps in a period"),
        }
        write_policy(self.arm, settings, self._feedback, folder)
        return self.network.to_c(folder)

    def act(self, measured: Floats | None, target: Floats) -> tuple[Floats, Floats]:
        """See `Policy`; unchecked."""
        period = self.period
        drift, rate = self._aim(target)
        waiting, pull = self._listen(measured, self._drawn)
        scale, self.pulled = waiting * self.speed, pull is not None
        if pull is not None:
            drift, rate = drift.copy(), rate + pull[1]
            drift[: self._visible] += pull[0]
        allowed = self.allowed()
        desired = scale * self._flow_rate + rate
        fraction = 1.0 / max(1.0, _max_abs(desired / allowed))
        # Run again if velocities at the end exceed their limits.
        for _ in range(4):
            x, drive, flow = self._integrate(fraction * scale, drift / scale)
            drawn, flow_rate = self._decode(x, flow, self._drawn + fraction * period * desired)
            qd = fraction * (scale * flow_rate + rate)
            excess = _max_abs(qd / allowed)
            if excess <= 1.001:
                break
            fraction /= excess
        self._x, self._drive, self._flow, self._flow_rate = x, drive, flow, flow_rate
        self.xi, self.pace, self._limited = x.reshape(self.xi.shape), fraction * waiting, fraction < 1.0
        self.gap = self._retraction.gap
        self._drawn = inside = self._within_limits(drawn)
        return inside, np.where(inside == drawn, qd, 0.0)

    def _aim(self, target: Floats) -> tuple[Floats, Floats]:
        """Set the goal of all neurons in the middle of the period; returns its velocity, flat, and the joints'."""
        before, jumped = self._aimed, False
        moving = self._still
        if before is not None and self._settled and target is before[0]:
            return moving
        goal = self.network.goal(self.arm.encode(target)).ravel()
        self._aimed, aim = (target, goal), goal
        if before is not None:
            rate = (target - before[0]) * self.rate
            jumped = bool((np.abs(rate) > self.arm.jump_speeds).any())
            if self._feedforward and not jumped and rate.any():
                moving = (goal - before[1]) * self.rate, rate
                aim = goal + 0.5 * self.period * moving[0]
        self._settled = aim is goal
        self._pull = aim - self._stepping.drive(aim)
        self._flow = self._field(self._x, self._drive)
        if before is None or jumped:
            _, self._flow_rate = self._decode(self._x, self._flow, self._drawn)
        return moving

    def _field(self, x: Floats, drive: Floats) -> Floats:
        """Flat field F at a state with its drive."""
        return self.network.gamma * (self._pull + drive - x)

    def _integrate(self, scale: float, drift: Floats) -> tuple[Floats, Floats, Floats]:
        """The state after a period of x' = scale (F(x) + drift), by RK4, and its drive and F there."""
        x, drive, gamma = self._x, self._drive, self.network.gamma
        switching = _max_abs(self._flow[self._visible :])
        extent = scale * self.period * max(self._stiffness, switching) / _MAX_STEP
        count = min(math.ceil(extent), _MAX_STEPS) or 1
        pull, z = self._pull + drift / gamma, gamma * scale * self.period / count
        for _ in range(count):
            x, drive = self._stepping.step(x, drive, pull, z)
        return x, drive, self._field(x, drive)

    def _decode(self, x: Floats, flow: Floats, near: Floats) -> tuple[Floats, Floats]:
        """Configuration of a flat state, near another one, and its rates along a field, both ``(n,)``."""
        self._retraction.q, seen = near, slice(self._visible)
        return self._retraction(x[seen].reshape(-1, 6), flow[seen].reshape(-1, 6))


def _max_abs(values: Floats) -> float:
    """The largest magnitude among values, 0 if there are none; for a few numbers in a tenth of NumPy's time."""
    return float(abs(values[idamax(values)])) if len(values) else 0.0


def _certified_norm(network: LieEDNN) -> float:
    """||S W_R S^-1||_2 with the certificate's P = S^2: the norm of W if translations have no weight."""
    scale = np.sqrt(np.asarray(network.lyapunov_diagonal))
    weight = scale[:, None] * network.certifiable_weight / scale
    # Rows and columns of zeros, which are most of a cascade's, would take most of the time and change nothing.
    acting = weight[weight.any(axis=1)][:, weight.any(axis=0)]
    return float(np.linalg.norm(acting, 2)) if acting.size else 0.0


@dataclass(frozen=True)
class CertifiedPolicyOptions(NetworkOptions):
    """Options of the policy ``lieednn-certified``.

    Attributes:
        bias_magnitude: magnitude of the network's bias [gamma/mu].
    """

    bias_magnitude: float = 0.25


def shaped(task: PolicyTask, options: ShapedOptions) -> NetworkPolicy:
    """A network along the motion of the planner ``lieednn-shaped``."""
    result = plan(task.arm, task.target, planner="lieednn-shaped", start=task.start, options=options, seed=task.seed)
    network, motion = result.network, result.motion
    assert isinstance(network, LieEDNN)
    if options.rate == 1.0 and network.n_hidden:
        # It has a tenth of the universal network's neurons: its steps take less time, and so does the bound on a push.
        shaping = ShapingOptions(options.rate, options.neurons, options.activation)
        units = lever_units(task.arm, motion.q)
        network = shape(motion.xi[::2], 0.2 * options.deviation, units=units, options=shaping).network
    # The clock is the network's slowest part.
    return _policy(task, network, task.convergence_rate / options.rate)


def certified(task: PolicyTask, options: CertifiedPolicyOptions) -> NetworkPolicy:
    """A certified network for the target."""
    xi = task.arm.encode(task.target)
    network = synthesize(
        xi, bias="sign-matched", bias_magnitude=options.bias_magnitude, activation=options.activation, seed=task.seed
    ).unwrap()
    slowest = -float(np.linalg.eigvals(network.jacobian(xi)).real.max())
    return _policy(task, network, task.convergence_rate / slowest)


def linear(task: PolicyTask) -> NetworkPolicy:
    """A network without weights: xi' = -(xi - xi_d)."""
    return _policy(task, without_weights(task.arm.encode(task.target)), task.convergence_rate)


def _policy(task: PolicyTask, network: LieEDNN, speed: float) -> NetworkPolicy:
    return NetworkPolicy(task.arm, network, task.rate, speed=speed, feedforward=False, feedback=task.feedback)
