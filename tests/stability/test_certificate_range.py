"""No false proof: verdicts against exact rational arithmetic, and the range of numbers that a certificate accepts."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim.errors import InputError
from lieednn_sim.stability import assess, find_certificate, verify


def negative_definite(diagonal, weight, gamma, mu):
    """Whether P (mu W - gamma I) has a negative definite symmetric part: exact pivots of Gauss's elimination."""
    n = len(diagonal)
    p, rate, scale = [Fraction(float(x)) for x in diagonal], Fraction(float(gamma)), Fraction(float(mu))
    w = [[Fraction(float(x)) for x in row] for row in weight]
    rows = [
        [(2 * rate * p[i] if i == j else 0) - scale * (p[i] * w[i][j] + p[j] * w[j][i]) for j in range(n)]
        for i in range(n)
    ]
    for k in range(n):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return True


def powers(lowest, highest):
    return st.floats(lowest, highest).map(lambda x: 10.0**x)


@st.composite
def problems(draw):
    """Diagonals, weights and rates of any size, and weights drawn a few roundings from the boundary."""
    n = draw(st.integers(1, 4))
    span = draw(st.sampled_from([1.0, 5.0, 29.0, 308.0]))
    diagonal = np.array([draw(powers(-span, span)) for _ in range(n)])
    size = draw(st.sampled_from([0.5, 2.0, 99.0, 308.0]))
    entries = st.one_of(st.just(0.0), st.builds(lambda s, x: s * x, st.sampled_from([-1.0, 1.0]), powers(-size, size)))
    weight = np.array([[draw(entries) for _ in range(n)] for _ in range(n)])
    gamma, mu = draw(powers(-size, size)), draw(powers(-span, span))
    if draw(st.booleans()):
        # Put gamma at the boundary of this very diagonal, as far as floating point can.
        with np.errstate(all="ignore"):
            root = np.sqrt(diagonal)
            scaled = weight * (root[:, None] / root)
            if np.isfinite(doubled := scaled + scaled.T).all():
                largest = mu * np.linalg.eigvalsh(0.5 * doubled)[-1]
                gamma = float(abs(largest) * (1.0 + draw(st.integers(-6, 6)) * 2.0**-52))
    return diagonal, weight, gamma, mu


@settings(max_examples=60)
@given(problems())
def test_no_verdict_of_stable_is_false(problem):
    diagonal, weight, gamma, mu = problem
    try:
        certificate = verify(diagonal, weight, gamma=gamma, mu=mu)
    except InputError:
        return
    if certificate.valid:
        assert negative_definite(diagonal, weight, gamma, mu)
        # What is stored is a proof as well, with nothing but the rounding of its entries between them.
        again = verify(certificate.lyapunov_diagonal, weight, gamma=gamma, mu=mu)
        assert not again.valid or negative_definite(certificate.lyapunov_diagonal, weight, gamma, mu)


def test_what_underflows_is_no_proof():
    """The eigenvalue is 1e-200 and gamma ten times less; scaled the wrong way round every entry underflows."""
    weight = np.zeros((4, 4))
    weight[0, 1] = weight[1, 0] = 1e-200
    with pytest.raises(InputError, match="lyapunov_diagonal must not exceed"):
        verify([1e-308, 1e-308, 1e308, 1e308], weight, gamma=1e-201)
    with pytest.raises(InputError, match="lyapunov_diagonal must"):
        verify([1e-99, 1e-99, 1e99, 1e99], weight, gamma=1e-99)
    # Squares of these underflow in the Frobenius norm, by which rounding is bounded.
    weight = 1e-170 * np.array([[0.1, 0.7], [0.7, 0.1]])
    assert verify([1.0, 1.0], weight, gamma=1e-99).rounding > 1e-16 * 1e-170
    tiny = verify([1e-30, 1e30], [[0.0, 5e-324], [5e-324, 0.0]])
    assert tiny.rounding > 0.0
    assert tiny.valid


@pytest.mark.parametrize(
    ("diagonal", "weight", "rates", "words"),
    [
        ([1e-61, 1.0], np.zeros((2, 2)), {}, "none more than 1e.60 times another, got 1e-61 to 1"),
        ([5e-324, 5e-324], np.zeros((2, 2)), {}, "entries from 1e-100"),
        ([1.0, 1.7e308], np.zeros((2, 2)), {}, r"must not exceed 1e\+100 in size, got 1.7e\+308"),
        ([1.0], [[1e101]], {}, r"weight must not exceed 1e\+100"),
        ([1.0], [[0.0]], {"gamma": 1e-101}, "gamma must be at least 1e-100"),
        ([1.0], [[0.0]], {"gamma": 1e-99, "mu": 1e99}, "gamma/mu must be at least 1e-100"),
        ([1.0], [[0.0]], {"mu": 1e101}, r"mu must not exceed 1e\+100"),
    ],
)
def test_range_of_a_certificate(diagonal, weight, rates, words):
    with pytest.raises(InputError, match=words):
        verify(diagonal, weight, **rates)


def test_the_ends_of_the_range_are_accepted():
    certificate = verify([1e-30, 1e30], [[-1e100, 1e100], [1e100, 1e100]], gamma=1e-100, mu=1.0)
    assert np.isfinite([certificate.lambda_max, certificate.rounding, certificate.margin]).all()
    assert not certificate.valid
    assert verify(certificate.lyapunov_diagonal, np.zeros((2, 2))).valid
    assert find_certificate([[0.0, 1e-310], [1e-310, 0.0]]).valid
    assert find_certificate([[0.0, 1e100], [0.0, 0.0]], gamma=1e92).valid
    # No Jacobian so small that its rounding vanishes.
    slopes = 1e-170 * np.array([[-1e-17, 1.0], [0.0, -1e-17]])
    assert assess(np.full((2, 2), 1e100), gamma=1e-100, mu=1.0).locally(slopes).level == "none"
