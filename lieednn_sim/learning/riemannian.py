"""Learning on the weight manifold itself: every iterate has blocks alpha_ij Ad(theta_ij), so nothing is projected.

A step has the coordinates (d_alpha, omega, d_t) at block (i, j), shape ``(N, N, 7)``. It is taken by the retraction of
the product R x SO(3) x R^3, alpha + d_alpha, Exp(hat(omega)) R and t + d_t, not by the exponential of SE(3). The metric
is Euclidean in these coordinates, so a Riemannian gradient is the list of plain derivatives in them. Row i of W y,
y = phi(x), depends on the blocks (i, j) only: equations on W y are N systems with 6 rows, 7N unknowns.

With delta = xi* - xi_d, S = I - (mu/gamma) W diag(phi'(xi*)) and B the derivative of W y in the coordinates, a step p
of the weights moves the equilibrium by S^-1 (mu/gamma) B p to first order. Hence two methods:

- gradient: p = -rate (mu/gamma) B^T S^-T delta, the Riemannian gradient of E^2/2, with Armijo backtracking;
- gauss-newton: the shortest p with (mu/gamma) B p = -rate S delta, which needs no inverse of S.

The second leaves 7 N^2 - 6 N directions along which the equilibrium does not move to first order. Certified training
uses them: it learns log S_P of a Lyapunov diagonal P = S_P^2 along with the weights, and whenever the smoothed largest
eigenvalue of (mu/gamma) sym(S_P W_R S_P^-1) nears 1, log S_P and the neutral part of the weights descend its gradient.
Below 1 the network has only one equilibrium, globally stable, which can neither be lost nor jump.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from lieednn_sim.learning.manifold import Network, SE3Weights, WeightPoint, block_view
from lieednn_sim.learning.options import RiemannianOptions
from lieednn_sim.learning.sensitivity import SensitivityMatrix
from lieednn_sim.learning.training import Iterate, StopReason, Training
from lieednn_sim.lie import hat, vee
from lieednn_sim.network.base import flatten_blocks
from lieednn_sim.stability import Certificate, find_certificate, verify
from lieednn_sim.stability.certificate import log_scale_gradient, smooth_largest
from lieednn_sim.stability.norms import scale
from lieednn_sim.values import Floats

_BARRIER = 0.8  # fraction of gamma/mu at which the certificate starts to push back


def retract(point: WeightPoint, step: Floats) -> WeightPoint:
    """The point a step ``(N, N, 7)`` away; on the manifold, up to rounding, for a step of any length."""
    turn = Rotation.from_rotvec(step[..., 1:4]).as_matrix()
    rotation, translation = turn @ point.elements["rotation"], point.elements["translation"] + step[..., 4:]
    return SE3Weights().point(point.alpha + step[..., 0], {"rotation": rotation, "translation": translation})


def differential(point: WeightPoint, output: Floats) -> Floats:
    """Derivative of row block i of W y, y ``(6N,)``, in the coordinates of the blocks (i, j), ``(N, 6, 7N)``.

    With (u, v) = Ad(theta_ij) y_j, block (i, j) alone gives alpha_ij (u, v), whose derivative is

        (u, v) d_alpha - alpha_ij [[hat(u), 0], [hat(v) + hat(u) hat(t), hat(u)]] (omega, d_t):

    turning R while t stays is to move theta from the left by the twist (omega, t x omega), shifting t by (0, d_t).
    """
    n = len(point.alpha)
    images = np.einsum("ijab,jb->ija", point.adjoints, output.reshape(n, 6))
    u, v, t = hat(np.stack([images[..., :3], images[..., 3:], point.elements["translation"]]))
    alpha = point.alpha[:, :, None, None]
    blocks = np.zeros((n, n, 6, 7))
    blocks[..., 0] = images
    blocks[..., :3, 1:4] = blocks[..., 3:, 4:] = -alpha * u
    blocks[..., 3:, 1:4] = -alpha * (v + u @ t)
    return blocks.transpose(0, 2, 1, 3).reshape(n, 6, 7 * n)


def loss_gradient(rows: Floats, nearby: SensitivityMatrix, delta: Floats, ratio: float) -> Floats:
    """Riemannian gradient (mu/gamma) B^T S^-T delta of E^2/2, ``(N, N, 7)``, from B ``(N, 6, 7N)``, S and mu/gamma."""
    n = len(rows)
    multiplier = nearby.solve_transposed(ratio * delta).reshape(n, 1, 6)
    return (multiplier @ rows).reshape(n, n, 7)


def rotational_weight(point: WeightPoint) -> Floats:
    """W_R = [alpha_ij R_ij], ``(3N, 3N)``."""
    return flatten_blocks(point.alpha[:, :, None, None] * point.elements["rotation"])


def smoothed_eigenvalue(
    point: WeightPoint, log_scale: Floats, ratio: float, sharpness: float
) -> tuple[float, Floats, Floats]:
    """Log-sum-exp bound on the largest eigenvalue of sym(M), M = (mu/gamma) S W_R S^-1, and its gradients.

    These are the Riemannian one ``(N, N, 7)`` and that in log S ``(3N,)``. With G the gradient in W_R, that in block
    (i, j) is <G, d_alpha R + hat(omega) alpha R> = d_alpha <G, R> + omega . 2 vee(alpha G R^T); it does not depend on
    translations.
    """
    scaled = ratio * scale(rotational_weight(point), log_scale)
    value, in_scaled = smooth_largest(*np.linalg.eigh(0.5 * (scaled + scaled.T)), sharpness)
    # <H, S dW S^-1> = <S H S^-1, dW>: the scaling is symmetric.
    in_weight, rotation = block_view(ratio * scale(in_scaled, log_scale), 3), point.elements["rotation"]
    gradient = np.zeros((*point.alpha.shape, 7))
    gradient[..., 0] = np.einsum("ijab,ijab->ij", in_weight, rotation)
    gradient[..., 1:4] = 2.0 * point.alpha[..., None] * vee(in_weight @ rotation.swapaxes(-1, -2))
    return value, gradient, log_scale_gradient(in_scaled, scaled)


class RowEquations:
    """The N linear systems B_i p_i = r_i on a step's rows p_i, each with fewer equations than unknowns.

    Solved by (B_i B_i^T + damping I) z_i = r_i and p_i = B_i^T z_i (Levenberg): the shortest solution when the damping
    is small against the squared singular values of B_i, and still a short one where these vanish.
    """

    def __init__(self, rows: Floats, damping: float) -> None:
        self._rows = rows
        self._gram = rows @ rows.swapaxes(1, 2) + damping * np.eye(rows.shape[1])

    def shortest(self, right: Floats) -> Floats:
        """The step ``(N, N, 7)`` for right-hand sides ``(6N,)``."""
        n = len(self._rows)
        multiplier = np.linalg.solve(self._gram, right.reshape(n, -1, 1))
        return (self._rows.swapaxes(1, 2) @ multiplier).reshape(n, n, 7)

    def neutral(self, step: Floats) -> Floats:
        """The part of a step that changes no left-hand side: its orthogonal projection onto the null space."""
        n = len(self._rows)
        return step - self.shortest(self._rows @ step.reshape(n, -1, 1))


class RiemannianTraining(Training[RiemannianOptions]):
    """Steps along the manifold, each taken only if the equilibrium follows it."""

    _checked_at = 0  # epoch of the last check of stability

    def initial(self, weight: Floats) -> Iterate:
        """See `Training`."""
        n = len(self.problem.target)
        point = self.manifold.project(weight, np.ones((n, n)), "scaled")
        weight, self._checked_at = point.weight, self.epoch
        rate = self.options.initial_rate
        return Iterate(weight, point.alpha, point, self.solver.first(weight), np.zeros(3 * n), rate)

    def network(self, last: Iterate) -> Network:
        """See `Training`; with a certificate if one was to be learned."""
        parameters = self.problem.rates
        if self.options.certified and (proof := self._certificate(last)).valid:
            parameters["lyapunov_diagonal"] = proof.lyapunov_diagonal
        return self.manifold.network(last.point, self.problem.bias, parameters)

    def accepts(self, network: Network | None) -> bool:
        """See `Training`."""
        return not self.options.certified or (network is not None and network.certified)

    def advance(self, before: Iterate, end: int) -> tuple[Iterate, StopReason | None]:
        """One step, or none where it is rejected."""
        options = self.options
        due = self.epoch - self._checked_at >= options.stability_interval
        proofs = (self._learned_certificate, self._certificate)[: 1 + due]
        if self.arrived(before) and (not options.certified or any(proof(before).valid for proof in proofs)):
            return before, StopReason.CONVERGED
        if self.epoch >= end:
            return before, StopReason.EPOCHS_SPENT
        nearby = self.solver.sensitivity(before.weight, before.equilibrium)
        if nearby.singular:
            return before, StopReason.LOST_EQUILIBRIUM
        if options.direction == "gradient":
            trial, decrease = self._gradient_step(before, nearby)
        else:
            trial, decrease = self._gauss_newton_step(before, nearby), -np.inf
        row = self.epoch
        self.epoch += 1
        if self._followed(before, trial, decrease) and (not due or self.stable(trial)):
            self.record(row, before, before.rate)
            if due:
                self._checked_at = self.epoch
            return trial._replace(rate=min(options.max_rate, before.rate * options.grow)), None
        rate = before.rate * options.shrink
        return before._replace(rate=rate), StopReason.STEP_VANISHED if rate < options.min_rate else None

    def _moved(self, before: Iterate, step: Floats, log_scale: Floats, nearby: SensitivityMatrix) -> Iterate:
        """The iterate a step away, with the equilibrium near that of before."""
        point = retract(before.point, step)
        weight = point.weight
        equilibrium = self.solver.newton(weight, before.equilibrium.x, nearby)
        return Iterate(weight, point.alpha, point, equilibrium, log_scale, before.rate)

    def _followed(self, now: Iterate, trial: Iterate, decrease: float) -> bool:
        """Whether the trial has the same equilibrium, slightly moved, and the loss fell by at least ``decrease``."""
        before, after = now.equilibrium.x, trial.equilibrium.x
        if not trial.equilibrium.success or np.abs(after - before).max() > self.options.max_jump:
            return False
        loss, lost = (0.5 * float((x - self.goal) @ (x - self.goal)) for x in (before, after))
        if not lost <= loss - decrease:
            return False
        return not self.arrived(trial) or self.stable(trial)

    def _gradient_step(self, now: Iterate, nearby: SensitivityMatrix) -> tuple[Iterate, float]:
        """The trial against the gradient, and how much E^2/2 must fall."""
        delta = now.equilibrium.x - self.goal
        gradient = loss_gradient(differential(now.point, now.equilibrium.output), nearby, delta, self.ratio)
        trial = self._moved(now, -now.rate * gradient, now.log_scale, nearby)
        # Armijo's condition: the loss must fall by at least a ten thousandth of what its slope predicts.
        return trial, 1e-4 * now.rate * float(np.vdot(gradient, gradient))

    def _gauss_newton_step(self, now: Iterate, nearby: SensitivityMatrix) -> Iterate:
        """The trial with the shortest step towards the target, plus the certificate's neutral step."""
        delta = now.equilibrium.x - self.goal
        longest = 0.4 * self.options.max_jump  # leaves room for second-order terms
        aim = delta * (longest / max(longest, np.abs(delta).max()))
        equations = RowEquations(differential(now.point, now.equilibrium.output), damping=1e-6)
        step = equations.shortest(nearby.matrix @ (-now.rate / self.ratio * aim))
        log_scale = now.log_scale
        sharpness = 16.0  # the smoothed eigenvalue lies above the largest by at most log(3N) / sharpness
        if self.options.certified:
            value, in_point, in_log_scale = smoothed_eigenvalue(now.point, log_scale, self.ratio, sharpness)
            if value > _BARRIER:
                # Not scaled by the rate: the certificate takes precedence over the target.
                neutral = equations.neutral(in_point)
                slope = float(np.vdot(neutral, neutral) + in_log_scale @ in_log_scale)
                # Shorter steps where the slope is small, so that the weights come to rest at a minimum.
                length = min(0.3 * (value - _BARRIER), 0.1) / max(slope, 0.3)
                step, log_scale = step - length * neutral, log_scale - length * in_log_scale
        return self._moved(now, step, log_scale, nearby)

    def _learned_certificate(self, now: Iterate) -> Certificate:
        weight, rates = rotational_weight(now.point), {"gamma": self.problem.gamma, "mu": self.problem.mu}
        return verify(np.exp(2.0 * now.log_scale), weight, **rates)

    def _certificate(self, now: Iterate) -> Certificate:
        """The better one of the learned certificate and the best that can be found."""
        certificate = find_certificate(rotational_weight(now.point), gamma=self.problem.gamma, mu=self.problem.mu)
        return min(self._learned_certificate(now), certificate, key=lambda proof: proof.lambda_max + proof.rounding)
