"""The statements of the paper on groups, projections, learning and stability, on random cases of the reproduction."""

from __future__ import annotations

from functools import cache

import pytest
from paper.checks import CHECKS
from paper.claims import CHECKED
from paper.measures import HOLDS, PART

# What holds only in part, by the numbers of the report; all else holds.
IN_PART = {
    *("definition", "telescopic", "strength gradient", "riemannian", "one norm for both", "algebras", "projection"),
    "activation",
}


@cache
def measured(check: str):
    return CHECKS[check](40)


@pytest.mark.parametrize("name", CHECKED)
def test_a_statement_holds_as_far_as_we_found(name):
    check, _, verdict = CHECKED[name]
    assert verdict(measured(check)) == (PART if name in IN_PART else HOLDS)


def test_what_fails_of_the_statements_that_hold_in_part():
    assert measured("closed group")["reflections_apart"] > 1.0
    assert measured("quotient")["unbounded"] > 1e3
    algebras = measured("algebras")
    assert algebras["complex_identity"] < 1e-12
    assert min(algebras["complex_apart"], algebras["quaternion_apart"]) == 1.0
    activation = measured("activation")
    assert activation["printed_pure_translation"] == 0.0
    assert activation["corrected_pure_translation"] == 1.0
    assert activation["negative_trace"] == 1.0
    equivariance = measured("equivariance")
    assert equivariance["tanh"] > 1e-2
    assert equivariance["own"] > 1e-3
