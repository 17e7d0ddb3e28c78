"""Options of learning on the weight manifold."""

from __future__ import annotations

from dataclasses import dataclass

from lieednn_sim.errors import InputError
from lieednn_sim.learning.options import check_rates
from lieednn_sim.validation import as_choice, as_count, as_positive

METHODS = ("gradient", "gauss-newton")
# A gradient step beyond it leaves the range of floating point before it is taken back.
_LARGEST_RATE = 1e6
_COUNTS = ("max_start_epochs", "stability_interval")
_POSITIVE = ("barrier", "damping", "initial_rate", "min_rate", "max_rate", "grow", "shrink", "max_jump", "tolerance")


@dataclass(frozen=True)
class RiemannianOptions:
    """How `train_riemannian` learns.

    Attributes:
        method: ``"gradient"``, each step lowers E, or ``"gauss-newton"``, each step aims straight at the target.
        certified: learn a certificate of global stability with the weights, and give up a start that ends without;
            Gauss-Newton only.
        barrier: where the certificate pushes back: this part of gamma/mu, below 1.
        damping: Levenberg damping of the Gauss-Newton equations.
        initial_rate: first learning rate of each start.
        min_rate: a start is given up below.
        max_rate: the rate never rises above; 1 is the full Gauss-Newton step.
        grow: factor of the rate after a step that was taken.
        shrink: factor after one taken back: the equilibrium was lost, jumped or was unstable; or, with the gradient, E
            did not fall.
        max_jump: largest change of a coordinate of the equilibrium in one step [rad, m].
        tolerance: tau on the largest coordinate of xi* - xi_d [rad, m].
        restarts: new initial weights to draw when a start is given up.
        max_start_epochs: a start that takes longer is given up.
        stability_interval: epochs from one check of the equilibrium's stability to the next; the last is checked too.
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
        for name in _COUNTS:
            object.__setattr__(self, name, as_count(name, getattr(self, name)))
        object.__setattr__(self, "restarts", as_count("restarts", self.restarts, least=0))
        object.__setattr__(self, "certified", bool(self.certified))
        for name in _POSITIVE:
            object.__setattr__(self, name, as_positive(name, getattr(self, name)))
        largest = 1.0 if self.method == "gauss-newton" else _LARGEST_RATE
        if self.max_rate > largest:
            raise InputError(f"max_rate must be at most {largest:g} for {self.method}, got {self.max_rate:g}")
        if self.certified and self.method != "gauss-newton":
            raise InputError(f"certified training needs the method 'gauss-newton', got {self.method!r}")
        if self.barrier >= 1.0:
            raise InputError(f"barrier must lie below 1, where the certificate ends, got {self.barrier:g}")
        check_rates(self.initial_rate, (self.min_rate, self.max_rate), grow=self.grow, shrink=self.shrink)
