"""Options of projective manifold learning, with the settings that are worth a name."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from lieednn_sim.errors import InputError
from lieednn_sim.learning.sensitivity import LOSSES
from lieednn_sim.validation import as_choice, as_count, as_positive

DIRECTIONS = ("gradient", "gauss-newton")
EQUILIBRIA = ("newton", "rk45")
PROJECTIONS = ("block-wise", "exact", "scaled", "none")
BLOCK_SCALE = "block-scale"
STEP_CONTROLS = ("adaptive", "tracked")


def check_rates(initial: float, bounds: tuple[float, float], *, grow: float, shrink: float) -> None:
    """Raise `InputError` unless a learning rate begins within its bounds and its factors grow and shrink it."""
    least, largest = bounds
    if not least <= initial <= largest:
        raise InputError(f"initial_rate must lie between min_rate {least:g} and max_rate {largest:g}, got {initial:g}")
    if shrink >= 1.0 or grow < 1.0:
        raise InputError(f"shrink must be below 1 and grow at least 1, got {shrink:g} and {grow:g}")


@dataclass(frozen=True)
class TrainingOptions:
    """How `train` learns. The defaults are the paper's Algorithm 1, repaired.

    Attributes:
        direction: ``"gradient"`` of the loss, or ``"gauss-newton"``, the smallest change of W that reaches the target
            to first order.
        loss: ``"squared"``, E^2/2, or ``"norm"``, the printed E; the Gauss-Newton direction is the same for both.
        equilibrium: ``"newton"``, damped Newton steps from the last one, or ``"rk45"``, running the network.
        projection: ``"block-wise"`` (paper, App. F), ``"exact"`` (Frobenius-nearest), ``"scaled"`` (alpha and block
            together, alpha of either sign), or ``"none"`` (the ablation).
        period: epochs from one projection to the next.
        learn_alpha: step in alpha with dE/dalpha; without, alpha stays. The scaled projection sets alpha itself.
        initial_alpha: constant start of alpha, None for 1/(3N), or ``"block-scale"``, the least-squares scale of each
            block of the first weights onto its rotation.
        initial_rate: first learning rate.
        min_rate: adaptive: the rate never falls below; tracked: the start is given up there.
        max_rate: the rate never rises above.
        grow: factor of the rate after a good epoch.
        shrink: factor after a bad one.
        step_control: ``"adaptive"``: every step is taken, the rate follows the loss. ``"tracked"``: the steps from one
            projection to the next are a trial, taken back at a smaller rate when the equilibrium is lost or jumps
            by more than ``max_jump``.
        max_jump: largest change of a coordinate of the equilibrium in one trial [rad, m].
        tolerance: tau on the largest coordinate of xi* - xi_d [rad, m].
        max_epochs: of all starts together.
        restarts: new initial weights to draw when a start is given up.
        max_start_epochs: a start that takes longer is given up while there are restarts left.
        verified_stop: test the weights after step and projection; the printed algorithm tests those before.
        stability_interval: epochs from one check of the equilibrium's stability to the next; it costs several epochs.
    """

    direction: str = "gradient"
    loss: str = "squared"
    equilibrium: str = "newton"
    projection: str = "block-wise"
    period: int = 10
    learn_alpha: bool = True
    initial_alpha: float | str | None = None
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
        # What is stored is what was checked: plain numbers, which JSON can hold.
        def store(name: str, value: float) -> None:
            object.__setattr__(self, name, value)

        as_choice("direction", self.direction, DIRECTIONS)
        as_choice("loss", self.loss, LOSSES)
        as_choice("equilibrium", self.equilibrium, EQUILIBRIA)
        as_choice("projection", self.projection, PROJECTIONS)
        as_choice("step control", self.step_control, STEP_CONTROLS)
        for name in ("period", "max_epochs", "max_start_epochs", "stability_interval"):
            store(name, as_count(name, getattr(self, name)))
        store("restarts", as_count("restarts", self.restarts, least=0))
        for name in ("learn_alpha", "verified_stop"):
            store(name, bool(getattr(self, name)))
        for name in ("initial_rate", "min_rate", "max_rate", "grow", "shrink", "max_jump", "tolerance"):
            store(name, as_positive(name, getattr(self, name)))
        if isinstance(self.initial_alpha, str):
            as_choice("initial alpha", self.initial_alpha, (BLOCK_SCALE,))
        elif self.initial_alpha is not None:
            store("initial_alpha", as_positive("initial_alpha", self.initial_alpha))
        check_rates(self.initial_rate, (self.min_rate, self.max_rate), grow=self.grow, shrink=self.shrink)

    @classmethod
    def literal(cls, **changes: Any) -> TrainingOptions:
        """Algorithm 1 as printed: RK45 equilibrium, E itself, alpha fixed, tested before the last step."""
        return cls(**{"loss": "norm", "equilibrium": "rk45", "learn_alpha": False, "verified_stop": False, **changes})

    @classmethod
    def repaired(cls, **changes: Any) -> TrainingOptions:
        """Algorithm 1 that can converge: Newton equilibrium, E^2/2, alpha learned with W."""
        return cls(**changes)

    @classmethod
    def tracked(cls, **changes: Any) -> TrainingOptions:
        """Projective learning that nearly always arrives.

        Gauss-Newton direction, alpha projected with its block, each projection a trial that must keep the equilibrium.
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

    def as_dict(self) -> dict[str, Any]:
        """Values by name, as JSON can hold them."""
        return asdict(self)


# The named settings, for command lines.
ALGORITHMS = {
    "literal": TrainingOptions.literal,
    "repaired": TrainingOptions.repaired,
    "tracked": TrainingOptions.tracked,
}
