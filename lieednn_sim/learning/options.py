"""Options of learning, with named settings."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_choice, as_count, as_positive
from lieednn_sim.values import check_fields


@dataclass(frozen=True)
class LearningOptions:
    """Options of all algorithms.

    Attributes:
        direction: ``"gradient"`` of the loss, or ``"gauss-newton"``, the smallest change of the weights that reaches
            the target to first order.
        initial_rate: first learning rate of each start.
        min_rate: rate below which a start is given up; with ``"adaptive"`` steps, the least rate.
        max_rate: the largest rate.
        grow: factor of the rate after a good step.
        shrink: factor after a bad one.
        max_jump: largest change of a coordinate of the equilibrium in one step that is accepted [rad, m].
        tolerance: tau, the bound on the largest coordinate of xi* - xi_d [rad, m].
        restarts: how many new initial weights to draw after starts that are given up.
        max_start_epochs: largest number of epochs of a start.
        stability_interval: epochs between checks of the equilibrium's stability, which take as long as some epochs; the
            final one is always checked.
    """

    direction: str = "gauss-newton"
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
        # Checked values are stored as plain numbers, which JSON can hold.
        as_choice("direction", self.direction, ("gradient", "gauss-newton"))
        check_fields(self, as_count, "max_start_epochs", "stability_interval")
        check_fields(self, as_count, "restarts", least=0)
        check_fields(self, as_positive, "initial_rate", "min_rate", "max_rate")
        check_fields(self, as_positive, "grow", "shrink", "max_jump", "tolerance")
        least, rate, largest = self.min_rate, self.initial_rate, self.max_rate
        if not least <= rate <= largest:
            raise InputError(f"initial_rate must be from min_rate {least:g} to max_rate {largest:g}, got {rate:g}")
        if self.shrink >= 1.0 or self.grow < 1.0:
            raise InputError(f"shrink must be below 1 and grow at least 1, got {self.shrink:g} and {self.grow:g}")

    @property
    def most_epochs(self) -> int:
        """Largest number of epochs over all starts."""
        return self.max_start_epochs * (self.restarts + 1)

    def end(self, start: int, epoch: int) -> int:
        """The epoch at which a start that begins at ``epoch`` is given up."""
        return epoch + self.max_start_epochs


@dataclass(frozen=True)
class TrainingOptions(LearningOptions):
    """Options of projective learning, besides `LearningOptions`; the defaults are the paper's Algorithm 1, repaired.

    Attributes:
        loss: ``"squared"``, E^2/2, or ``"norm"``, the printed E; the Gauss-Newton direction is the same for both.
        equilibrium: ``"newton"``, damped Newton steps from the last one, or ``"rk45"``, integrating the network.
        projection: ``"block-wise"`` (paper, App. F), ``"exact"`` (Frobenius-nearest), ``"scaled"`` (alpha and block
            together, alpha of either sign), or ``"none"`` (ablation).
        period: epochs between projections.
        learn_alpha: step in alpha by dE/dalpha; otherwise alpha stays 1/(3N). The scaled projection sets alpha itself.
        step_control: ``"adaptive"``: every step is taken, and the rate follows the loss. ``"tracked"``: the steps from
            one projection to the next are a trial, repeated at a smaller rate if the equilibrium is lost or jumps.
        max_epochs: largest number of epochs over all starts; only this number limits the last start.
        verified_stop: test the tolerance after step and projection; the printed algorithm tests before.
    """

    direction: str = "gradient"
    loss: str = "squared"
    equilibrium: str = "newton"
    projection: str = "block-wise"
    period: int = 10
    learn_alpha: bool = True
    initial_rate: float = 0.02
    min_rate: float = 0.002
    max_rate: float = 0.2
    grow: float = 1.02
    shrink: float = 0.9
    step_control: str = "adaptive"
    max_jump: float = 0.1
    max_epochs: int = 25_000
    restarts: int = 0
    max_start_epochs: int = 25_000
    verified_stop: bool = True
    stability_interval: int = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        as_choice("loss", self.loss, ("squared", "norm"))
        as_choice("equilibrium", self.equilibrium, ("newton", "rk45"))
        as_choice("projection", self.projection, ("block-wise", "exact", "scaled", "none"))
        as_choice("step control", self.step_control, ("adaptive", "tracked"))
        check_fields(self, as_count, "period", "max_epochs")
        check_fields(self, lambda _, flag: bool(flag), "learn_alpha", "verified_stop")

    @property
    def most_epochs(self) -> int:
        """As in `LearningOptions`."""
        return self.max_epochs

    def end(self, start: int, epoch: int) -> int:
        """As in `LearningOptions`; the last start may have all epochs that are left."""
        return self.max_epochs if start == self.restarts else min(self.max_epochs, super().end(start, epoch))

    @classmethod
    def literal(cls, **changes: Any) -> TrainingOptions:
        """Algorithm 1 as printed: RK45 equilibrium, loss E, fixed alpha, stop test before the last step."""
        return cls(**{"loss": "norm", "equilibrium": "rk45", "learn_alpha": False, "verified_stop": False, **changes})

    @classmethod
    def tracked(cls, **changes: Any) -> TrainingOptions:
        """Projective learning that nearly always reaches the target.

        Rates and starts are those of `LearningOptions`; each projection is a trial that must keep the equilibrium.
        """
        usual = {entry.name: entry.default for entry in fields(LearningOptions)} | {"min_rate": 1e-3, "max_jump": 0.1}
        return cls(**{**usual, "projection": "scaled", "period": 1, "step_control": "tracked", **changes})


@dataclass(frozen=True)
class RiemannianOptions(LearningOptions):
    """Options of learning on the manifold, besides `LearningOptions`.

    A step is rejected, and the rate shrinks, where the equilibrium is lost, jumps or is unstable; with the gradient,
    also where E does not fall. A rate of 1 is the full Gauss-Newton step.

    Attributes:
        certified: learn a certificate of global stability along with the weights, and give up a start that ends
            without one; Gauss-Newton only.
    """

    certified: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fields(self, lambda _, flag: bool(flag), "certified")
        largest = 1.0 if self.direction == "gauss-newton" else 1e6  # larger gradient steps could overflow
        if self.max_rate > largest:
            raise InputError(f"max_rate must be at most {largest:g} for {self.direction}, got {self.max_rate:g}")
        if self.certified and self.direction != "gauss-newton":
            raise InputError(f"certified training needs the direction 'gauss-newton', got {self.direction!r}")

    @classmethod
    def stability_aware(cls, **changes: Any) -> RiemannianOptions:
        """A certificate of global stability is learned along with the weights."""
        return cls(**{"certified": True, **changes})
