"""Numerical checks of the paper's statements: each draws random cases and returns what it measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from paper.checks import formulas, learning, theorems

CHECKS: dict[str, Callable[[int], dict[str, Any]]] = {
    check.__name__.replace("_", " "): check
    for check in (
        *(theorems.automorphism, theorems.closed_group, theorems.representation, theorems.quotient),
        *(theorems.rotation_lemma, theorems.decoding, formulas.projection, learning.weight_gradient),
        *(learning.strength_gradient, learning.riemannian, formulas.norm_conditions, formulas.single_norms),
        *(formulas.algebras, formulas.activation, formulas.equivariance),
    )
}
