"""Statements of the paper against numbers: each check draws random cases and returns what it measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from paper.checks import formulas, learning, theorems

CHECKS: dict[str, Callable[[int], dict[str, Any]]] = {
    "automorphism": theorems.automorphism,
    "closed group": theorems.closed_group,
    "representation": theorems.representation,
    "quotient": theorems.quotient,
    "rotation lemma": theorems.rotation_lemma,
    "decoding": theorems.decoding,
    "projection": formulas.projection,
    "weight gradient": learning.weight_gradient,
    "strength gradient": learning.strength_gradient,
    "riemannian": learning.riemannian,
    "norm conditions": formulas.norm_conditions,
    "single norms": formulas.single_norms,
    "algebras": formulas.algebras,
    "activation": formulas.activation,
    "equivariance": formulas.equivariance,
}
