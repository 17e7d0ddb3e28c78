"""Options of learning, with named settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.learning.sensitivity import LOSSES
from lieednn_sim.validation import as_choice, as_count, as_positive
from lieednn_sim.values import check_fields

DIRECTIONS = ("gradient", "gauss-newton")
EQUILIBRIA = ("newton", "rk45")
PROJECTIONS = ("block-wise", "exact", "scaled", "none")
STEP_CONTROLS = ("adaptive", "tracked")
METHODS = ("gradient", "gauss-newton")
# Options of the learning rate, common to both kinds of learning.
_RATES = ("initial_rate", "min_rate", "max_rate", "grow", "shrink", "max_jump")


def check_rates(initial: float, bounds: tuple[float, float], *, grow: float, shrink: float) -> None:
    """Raise `InputError` unless a learning rate begins within its bounds and its factors grow and shrink it."""
    least, largest = bounds
    if not least <= initial <= largest:
        raise InputError(f"initial_rate must lie between min_rate {least:g} and max_rate {largest:g}, got {initial:g}")
    if shrink >= 1.0 or grow < 1.0:
        raise InputError(f"shrink must be below 1 and grow at least 1, got {shrink:g} and {grow:g}")


@dataclass(frozen=True)
class TrainingOptions:
    """Options of `train`. The defaults are the paper's Algorithm 1, repaired.

    Attributes:
        direction: ``"gradient"`` of the loss, or ``"gauss-newton"``, the smallest change of W that reaches the target
            to first order.
        loss: ``"squared"``, E^2/2, or ``"norm"``, the printed E; the Gauss-Newton direction is the same for both.
        equilibrium: ``"newton"``, damped Newton steps from the last one, or ``"rk45"``, running the network.
        projection: ``"block-wise"`` (paper, App. F), ``"exact"`` (Frobenius-nearest), ``"scaled"`` (alpha and block
            together, alpha of either sign), or ``"none"`` (ablation).
        period: epochs between projections.
        learn_alpha: step in alpha by dE/dalpha; otherwise alpha is fixed. The scaled projection sets alpha itself.
        initial_alpha: initial alpha of all blocks; None for 1/(3N).
        initial_rate: first learning rate.
        min_rate: with ``"adaptive"``, the least rate; with ``"tracked"``, the rate at which a start is given up.
        max_rate: the largest rate.
        grow: factor of the rate after a good epoch.
        shrink: factor after a bad one.
        step_control: ``"adaptive"``: every step is taken, and the rate follows the loss. ``"tracked"``: the steps from
            one projection to the next are a trial, repeated at a smaller rate when the equilibrium is lost or jumps by
            more than ``max_jump``.
        max_jump: largest change of a coordinate of the equilibrium in one trial [rad, m].
        tolerance: tau on the largest coordinate of xi* - xi_d [rad, m].
        max_epochs: largest number of epochs over all starts.
        restarts: how many new initial weights to draw after starts that are given up.
        max_start_epochs: largest number of epochs of a start while restarts are left.
        verified_stop: test the tolerance with the weights after step and projection; the printed algorithm tests
            before.
        stability_interval: epochs between checks of the equilibrium's stability; a check takes as long as some epochs.
    """

    direction: str = "gradient"
    loss: str = "squared"
    equilibrium: str = "newton"
    projection: str = "block-wise"
    period: int = 10
    learn_alpha: bool = True
    initial_alpha: float | None = None
    initial_rate: float = 0.02
    min_rate: float = 0.002
    max_rate: float = 0.2
    grow: float = 1.02
    shrink: float = 0.9
    step_control: str = "adaptive"
    max_jump: float = 0.1
    tolerance: float = 1e-5
    max_epochs: int = 25_000
    restarts: int = 0
    max_start_epochs: int = 25_000
    verified_stop: bool = True
    stability_interval: int = 100

    def __post_init__(self) -> None:
        # Checked values are stored as plain numbers, which JSON can hold.
        as_choice("direction", self.direction, DIRECTIONS)
        as_choice("loss", self.loss, LOSSES)
        as_choice("equilibrium", self.equilibrium, EQUILIBRIA)
        as_choice("projection", self.projection, PROJECTIONS)
        as_choice("step control", self.step_control, STEP_CONTROLS)
        check_fields(self, as_count, "period", "max_epochs", "max_start_epochs", "stability_interval")
        check_fields(self, as_count, "restarts", least=0)
        check_fields(self, lambda _, flag: bool(flag), "learn_alpha", "verified_stop")
        check_fields(self, as_positive, *_RATES, "tolerance")
        if self.initial_alpha is not None:
            check_fields(self, as_positive, "initial_alpha")
        check_rates(self.initial_rate, (self.min_rate, self.max_rate), grow=self.grow, shrink=self.shrink)

    @classmethod
    def literal(cls, **changes: Any) -> TrainingOptions:
        """Algorithm 1 as printed: RK45 equilibrium, E itself, alpha fixed, tested before the last step."""
        return cls(**{"loss": "norm", "equilibrium": "rk45", "learn_alpha": False, "verified_stop": False, **changes})

    @classmethod
    def repaired(cls, **changes: Any) -> TrainingOptions:
        """Algorithm 1 repaired so that it can converge: Newton equilibrium, E^2/2, alpha learned with W."""
        return cls(**changes)

    @classmethod
    def tracked(cls, **changes: Any) -> TrainingOptions:
        """Projective learning that nearly always reaches the target.

        Gauss-Newton direction, alpha projected with its block, and each projection a trial that must keep the
        equilibrium.
        """
        return cls(
            **{
                "direction": "gauss-newton",
                "projection": "scaled",
                "period": 1,
                "step_control": "tracked",
                "initial_rate": 1.0,
                "min_rate": 1e-3,
                "max_rate": 1.0,
                "grow": 1.3,
                "shrink": 0.5,
                "restarts": 4,
                "max_start_epochs": 1000,
                "stability_interval": 25,
                **changes,
            }
        )


# Largest rate of gradient steps, which could overflow beyond it.
_LARGEST_RATE = 1e6


@dataclass(frozen=True)
class RiemannianOptions:
    """Options of `train_riemannian`.

    Attributes:
        method: ``"gradient"``, each step lowers E, or ``"gauss-newton"``, each step aims straight at the target.
        certified: learn a certificate of global stability along with the weights, and give up a start that ends
            without one; Gauss-Newton only.
        barrier: fraction of gamma/mu, below 1, at which the certificate starts to push back.
        damping: Levenberg damping of the Gauss-Newton equations.
        initial_rate: first learning rate of each start.
        min_rate: rate below which a start is given up.
        max_rate: the largest rate; 1 is the full Gauss-Newton step.
        grow: factor of the rate after an accepted step.
        shrink: factor after a rejected step: the equilibrium was lost, jumped or was unstable; or, with the gradient,
            E did not fall.
        max_jump: largest change of a coordinate of the equilibrium in one step [rad, m].
        tolerance: tau on the largest coordinate of xi* - xi_d [rad, m].
        restarts: how many new initial weights to draw after starts that are given up.
        max_start_epochs: largest number of epochs of a start.
        stability_interval: epochs between checks of the equilibrium's stability; the final one is always checked.
    """

    method: str = "gauss-newton"
    certified: bool = False
    barrier: float = 0.8
    damping: float = 1e-6
    initial_rate: float = 1.0
    min_rate: float = 1e-4
    max_rate: float = 1.0
    grow: float = 1.3
    shrink: float = 0.5
    max_jump: float = 0.05
    tolerance: float = 1e-5
    restarts: int = 4
    max_start_epochs: int = 1000
    stability_interval: int = 25

    def __post_init__(self) -> None:
        as_choice("method", self.method, METHODS)
        check_fields(self, as_count, "max_start_epochs", "stability_interval")
        check_fields(self, as_count, "restarts", least=0)
        check_fields(self, lambda _, flag: bool(flag), "certified")
        check_fields(self, as_positive, "barrier", "damping", *_RATES, "tolerance")
        largest = 1.0 if self.method == "gauss-newton" else _LARGEST_RATE
        if self.max_rate > largest:
            raise InputError(f"max_rate must be at most {largest:g} for {self.method}, got {self.max_rate:g}")
        if self.certified and self.method != "gauss-newton":
            raise InputError(f"certified training needs the method 'gauss-newton', got {self.method!r}")
        if self.barrier >= 1.0:
            raise InputError(f"barrier must lie below 1, where the certificate ends, got {self.barrier:g}")
        check_rates(self.initial_rate, (self.min_rate, self.max_rate), grow=self.grow, shrink=self.shrink)

    @classmethod
    def stability_aware(cls, **changes: Any) -> RiemannianOptions:
        """A certificate of global stability is learned along with the weights."""
        return cls(**{"certified": True, **changes})
