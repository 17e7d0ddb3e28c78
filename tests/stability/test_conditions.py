"""The hierarchy of conditions: implications, and the text that people read."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim.errors import InputError
from lieednn_sim.lie import adjoint
from lieednn_sim.stability import CONDITIONS, assess, find_certificate, verify, weighted_norm

seeds = st.integers(0, 2**32 - 1)

IMPLICATIONS = [
    ("1-norm", "log norm 1"),
    ("infinity norm", "log norm infinity"),
    ("norm sum", "log norm 2"),
    ("log norm 1", "weighted log norm"),
    ("log norm infinity", "weighted log norm"),
    ("weighted log norm", "diagonal Lyapunov"),
    ("log norm 2", "diagonal Lyapunov"),
    ("contraction", "diagonal Lyapunov"),
]


def se3_weight(rng, n, size):
    """W and W_R of n random SE(3) neurons with strengths of about `size`."""
    rotation = Rotation.random(n * n, rng=rng).as_matrix().reshape(n, n, 3, 3)
    blocks = rng.normal(size=(n, n, 1, 1)) * size * adjoint(rotation, rng.normal(size=(n, n, 3)))
    whole = blocks.transpose(0, 2, 1, 3).reshape(6 * n, 6 * n)
    return whole, blocks[..., :3, :3].transpose(0, 2, 1, 3).reshape(3 * n, 3 * n)


@settings(max_examples=14)
@given(seeds, st.booleans(), st.sampled_from([(1.0, 1.0), (2.0, 0.5), (0.3, 4.0)]))
def test_each_rung_implies_the_later_ones(seed, with_rotations, rates):
    rng, (gamma, mu) = np.random.default_rng(seed), rates
    if with_rotations:
        weight, core = se3_weight(rng, 2, rng.uniform(0.05, 0.5) * gamma / mu)
    else:
        core = None
        weight = rng.normal(size=(5, 5)) * 10.0 ** rng.uniform(-1, 1, (5, 1)) - np.diag(rng.uniform(0, 2, 5))
        weight *= rng.uniform(0.05, 1.0) * gamma / mu
    verdict = assess(weight, gamma=gamma, mu=mu, rotational_weight=core)
    for weaker, stronger in IMPLICATIONS:
        first, second = verdict[weaker], verdict[stronger]
        # As numbers: what proves more has the smaller left side against the same bound.
        slack = 1e-6 * max(1.0, np.abs(weight).max())
        assert max(second.value, 0.0) / second.bound <= max(first.value, 0.0) / first.bound + slack, (weaker, stronger)
        assert second.holds or not first.holds or first.value > first.bound * (1.0 - 1e-6)
    assert [condition.name for condition in verdict.conditions] == [name for name in CONDITIONS if name != "local"]
    for condition in verdict.conditions:
        assert condition.holds == (condition.value < condition.bound)
        assert condition.rate == pytest.approx(
            gamma * (1.0 - max(condition.value, 0.0) / condition.bound) if condition.holds else 0.0
        )
    assert verdict.globally_stable == any(condition.holds for condition in verdict.conditions)
    best = max(condition.rate for condition in verdict.conditions)
    assert (verdict.strongest.rate if verdict.globally_stable else 0.0) == best


@pytest.mark.parametrize(
    ("weight", "level"),
    [
        ([[0.5, 0.4], [0.4, 0.5]], "1-norm"),
        ([[0.5, 0.4], [0.9, 0.0]], "infinity norm"),
        # A row and a column are too large, but not those of one neuron.
        ([[0.0, 0.6, 0.6, 0.0], [0.0, 0.0, 0.0, 0.6], [0.0, 0.0, 0.0, 0.6], [0.0] * 4], "norm sum"),
        ([[-4.0, 0.5], [0.5, -4.0]], "log norm 1"),
        ([[-4.0, 0.9, 0.0], [0.5, 0.0, 0.4], [0.0, 0.9, 0.0]], "log norm infinity"),
        ([[-2.0, 0.3], [9.0, 0.0]], "weighted log norm"),
        ([[0.5, 3.0], [-3.0, 0.5]], "log norm 2"),
        ([[0.5, 3.0], [-0.3, 0.5]], "contraction"),
        ([[0.5, 30.0], [-3.0, 0.5]], "diagonal Lyapunov"),
        ([[0.5, 3.0], [3.0, 0.5]], "none"),
    ],
)
def test_level_is_the_first_rung_that_holds(weight, level):
    assert assess(weight, gamma=1.0, mu=1.0).level == level


def test_no_global_proof_leaves_the_local_one():
    weight = np.diag([2.0, 0.0])
    # phi' at the saturated equilibria of x' = -x + 2 tanh(x): both are stable, so no global proof can exist.
    equilibrium = 1.9150080481545375
    jacobian = np.diag([-1.0 + 2.0 / np.cosh(equilibrium) ** 2, -1.0])
    verdict = assess(weight, gamma=1.0, mu=1.0).locally(jacobian)
    assert (verdict.level, verdict.globally_stable) == ("local", False)
    assert verdict.strongest.scope == "local"
    assert verdict.strongest.rate == pytest.approx(1.0 - 2.0 / np.cosh(equilibrium) ** 2)
    assert str(verdict).startswith("locally stable only")
    # A faster local rate never hides a global proof.
    assert assess([[0.5]], gamma=1.0, mu=1.0).locally([[-0.9]]).strongest.scope == "global"
    unstable = assess(weight, gamma=1.0, mu=1.0).locally(np.eye(2))
    assert (unstable.level, unstable.strongest) == ("none", None)
    assert str(unstable).startswith("no proof of stability")


@settings(max_examples=4)
@given(seeds)
def test_translations_matter_to_unweighted_norms_alone(seed):
    rng = np.random.default_rng(seed)
    weight, core = se3_weight(rng, 2, 0.15)
    moved = weight.reshape(2, 6, 2, 6).copy()
    moved[:, 3:, :, :3] *= 50.0
    near = assess(weight, gamma=1.0, mu=1.0, rotational_weight=core)
    far = assess(moved.reshape(12, 12), gamma=1.0, mu=1.0, rotational_weight=core)
    for name in CONDITIONS[5:9]:
        assert far[name] == near[name]
    assert not far["1-norm"].holds
    # On the whole W, without being told of its structure, the weighted norm comes to the same.
    assert assess(weight, gamma=1.0, mu=1.0)["weighted log norm"].value == pytest.approx(
        near["weighted log norm"].value, rel=1e-3
    )


def test_a_given_diagonal_is_used_when_it_proves_and_replaced_when_it_does_not():
    weight = np.array([[0.0, 30.0], [0.0, 0.0]])
    good = np.array([1.0, 1e4])
    assert assess(weight, gamma=1.0, mu=1.0, lyapunov_diagonal=good).certificate.lambda_max == pytest.approx(0.15)
    replaced = assess(weight, gamma=1.0, mu=1.0, lyapunov_diagonal=[1.0, 1.0])
    assert replaced.certificate.valid
    assert not verify([1.0, 1.0], weight).valid
    assert replaced.certificate.lambda_max == find_certificate(weight).lambda_max


def test_report_has_one_aligned_line_for_each_rung():
    lines = str(assess([[0.5, 30.0], [-3.0, 0.5]], gamma=2.0, mu=2.0).locally(-np.eye(2))).splitlines()
    assert lines[0] == "globally stable by the diagonal Lyapunov, at a rate of at least 1"
    assert len(lines) == 1 + len(CONDITIONS)
    assert len({line.index("<") for line in lines[1:]}) == 1
    assert lines[1].split() == ["1-norm", "30.5", "<", "1", "fails"]
    # The best norm, scaled, turns by sqrt(90): 5 solves 4 v (v - 0.5) = 90.
    assert lines[8].split() == ["contraction", "5", "<", "1", "fails"]
    assert lines[9].split() == ["diagonal", "Lyapunov", "0.5", "<", "1", "global", "rate", "1"]
    assert lines[10].split() == ["local", "-1", "<", "0", "local", "rate", "1"]


def test_the_verdict_quotes_each_rungs_own_rate():
    """Of the rates of all conditions the fastest need not be that of the first one that holds."""
    verdict = assess([[0.3, 0.9], [-0.2, 0.3]], gamma=1.0, mu=1.0)
    first, fastest = verdict[verdict.level], verdict.strongest
    assert fastest.name != first.name
    assert fastest.rate > 1.05 * first.rate
    summary = str(verdict).splitlines()[0]
    assert summary == (
        f"globally stable by the {first.name}, at a rate of at least {first.rate:.4g}; "
        f"the {fastest.name} proves {fastest.rate:.4g}"
    )


def test_wrong_input_is_named():
    rng = np.random.default_rng(0)
    weight, core = se3_weight(rng, 2, 0.1)
    both_ways = weight.copy()
    both_ways[0, 4] = 1e-9
    cases = [
        (lambda: assess(np.ones((2, 3)), gamma=1.0, mu=1.0), "weight must have shape"),
        (lambda: assess(weight, gamma=0.0, mu=1.0), "gamma must be positive"),
        (lambda: assess(weight, gamma=1.0, mu=1.0).locally(np.ones((2, 3))), r"jacobian must have shape \(n, n\)"),
        (lambda: assess(weight, gamma=1.0, mu=1.0, rotational_weight=np.eye(3)), r"\(3N, 3N\) for a weight \(6N, 6N\)"),
        (lambda: assess(weight, gamma=1.0, mu=1.0, rotational_weight=1.1 * core), "must be the rotational blocks"),
        (lambda: assess(both_ways, gamma=1.0, mu=1.0, rotational_weight=core), "v drives omega"),
        (lambda: assess(weight, gamma=1.0, mu=1.0)["log norm 3"], "no condition 'log norm 3'; allowed: 1-norm"),
    ]
    for call, words in cases:
        with pytest.raises(InputError, match=words):
            call()


def test_stiff_networks_are_warned_of():
    """alpha is told from the entries of alpha R: a rotation by 45 degrees has none above 0.71."""
    whole, core = se3_weight(np.random.default_rng(3), 1, 1.0)
    strength = np.linalg.norm(core, 2)
    for factor, stiff in ((99.9, False), (100.1, True)):
        size = factor * 2.0 / 0.5 / strength
        verdict = assess(size * whole, gamma=2.0, mu=0.5, rotational_weight=size * core)
        assert verdict.stiffness == pytest.approx(factor)
        assert (verdict.warning is not None) == stiff
        assert ("warning: stiff: the strongest coupling is 100 gamma/mu" in str(verdict)) == stiff
    # Without neurons to tell apart the largest entry counts.
    assert assess([[0.0, -300.0], [0.0, 0.0]], gamma=1.0, mu=1.0).stiffness == 300.0


def test_many_coordinates_without_inputs_change_no_weighted_condition():
    """What they send can be scaled away, here by hand."""
    weight = np.zeros((9, 9))
    weight[:2] = 30.0 * np.random.default_rng(2).normal(size=(2, 9))
    weight[:2, :2] = [[0.3, 0.4], [-0.2, 0.1]]
    verdict, inner = assess(weight, gamma=1.0, mu=1.0), assess(weight[:2, :2], gamma=1.0, mu=1.0)
    for name in ("weighted log norm", "contraction"):
        assert verdict[name].value == pytest.approx(inner[name].value, rel=1e-6)
        assert verdict[name].holds
    assert verdict["diagonal Lyapunov"].holds
    assert not verdict["log norm 2"].holds
    # Their columns small beside the others.
    scaled = weight * np.where(np.arange(9) < 2, 1.0, 1e-9)
    assert weighted_norm(scaled).value == pytest.approx(verdict["weighted log norm"].value, rel=1e-5)
