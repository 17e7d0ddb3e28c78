"""Any input at all: a finite result or an error of the package, never a traceback from the depths, NaN or a hang.

Bounded here; open-ended by ``pytest tests/test_fuzz.py --hypothesis-profile=fuzz`` (see conftest).
"""

from __future__ import annotations

from functools import partial

import fuzz_public
import fuzz_things
import numpy as np
import pytest
from hypothesis import settings

from lieednn_sim import lie, stability, theory
from lieednn_sim.arm import Arm
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.learning.demonstrations.alignment import in_world
from lieednn_sim.network import LieEDNN
from lieednn_sim.policies import SafetyFilter
from lieednn_sim.registry import BIAS_RULES
from lieednn_sim.synthesis.bias import bias_for
from lieednn_sim.theory import EquivariantLieEDNN, GroupLieEDNN, groups
from lieednn_sim.validation import as_choice, as_count, as_floats, as_seed

MOST = settings.default.max_examples


def rounds(examples):
    """So many examples in the suite, and as many as the profile says in a campaign."""
    return examples if MOST <= 100 else MOST


def check(function, *arguments, **named):
    """The result of a call; None where the package refuses. Its numbers are finite, and a warning is an error."""
    try:
        result = function(*arguments, **named)
    except LieEDNNError:
        return None
    # Infinite beside an output that vanishes, as documented.
    infinite = getattr(function, "__name__", "") == "smallest_one_norm"
    for leaf in fuzz_public.leaves(result, fields=True):
        assert not np.isnan(leaf).any() if infinite else np.isfinite(leaf).all(), (function, arguments, named)
    return result


def lie_groups():
    for name in ("SO(2)", "SO(3)", "SE(2)", "SE(3)", "SU(2)", "SU(3)", "C^x", "H^x", "Sim(3)", "GL(2)", "affine(C^x)"):
        group = groups.group(name)
        d, square = (group.dimension,), (group.size, group.size)
        yield from ((group.exp, d), (group.ad, d))
        yield lambda x, group=group: check(group.adjoint, group.exp(x)), d
        yield from ((of, square) for of in (group.adjoint, group.contains, group.vee))


def rigid_motions():
    yield lie.project_to_rotation, (3, 3)
    yield from ((of, (6, 6)) for of in (lie.project_to_adjoint, lie.project_to_adjoint_exact))
    yield lie.project_to_scaled_adjoint, (6, 6)
    yield from ((lie.left_jacobian_so3, (3,)), (lie.left_jacobian_se3, (6,)), (lie.hat, (3,)), (lie.vee, (3, 3)))
    yield lambda matrix, vector: lie.adjoint(lie.project_to_rotation(matrix), vector), (3, 3), (3,)
    yield lambda twist: [lie.exp(twist).as_matrix(), check(lie.log, lie.exp(twist))], (6,)


def conditions():
    for n in (1, 2, 3):
        vector, square, rates = (n,), (n, n), (float, float)
        yield lambda d, w, g, m: stability.verify(np.abs(d), w, gamma=g, mu=m), vector, square, *rates
        yield lambda w, g, m: stability.find_certificate(w, gamma=g, mu=m), square, *rates
        yield from ((of, square) for of in (stability.log_norms, stability.weighted_norm))
        yield stability.smallest_one_norm, square, square
        yield lambda w, jacobian, g, m: stability.assess(w, gamma=g, mu=m).locally(jacobian), square, square, *rates
        yield lambda w, x, s, g, m: theory.smoothness_bounds(w, x, s, gamma=g, mu=m), square, vector, float, *rates
        yield theory.curvature, vector, vector
    for rule in BIAS_RULES:
        yield lambda xi, *bounds, rule=rule: bias_for(rule, xi, np.tanh(xi), *bounds), (2, 6), float, float


def networks():
    at, pairs = (2, 6), (2, 2, 3)
    yield partial(check_network, LieEDNN), (2, 2), (*pairs, 3), pairs, at, at, (1, 6), float, float
    yield partial(check_network, EquivariantLieEDNN), (2, 2), (*pairs, 3), pairs, at, at, (1, 6), float, float
    yield partial(check_network, GroupLieEDNN), (2, 2), (2, 2, 6), pairs, at, at, (1, 6), float, float


def check_network(kind, alpha, matrices, translation, bias, state, hidden, gamma, mu):
    if kind is GroupLieEDNN:
        group = groups.group("SE(3)")
        network = kind(group, alpha, group.exp(matrices), bias, gamma, mu)
    else:
        options = {"hidden_start": hidden[: int(gamma < 1.0)]} if kind is LieEDNN else {}
        network = kind(alpha, lie.project_to_rotation(matrices), translation, bias, gamma, mu, **options)
    for function in (network.vector_field, network.jacobian, network.equilibrium, network.start):
        check(function, state)
    visible = check(network.visible, state)
    check(network.retarget, state if visible is None else visible)
    # What takes more than some thousand steps is for the test of stiff networks.
    if 0.01 < gamma < 100.0 and np.abs(network.blocks).max() * network.mu < 100.0:
        trajectory = check(network.trajectory, state, 1.0 / gamma, rtol=1e-3, atol=1e-6)
        assert trajectory is None or np.isfinite(trajectory(trajectory.t[-1])).all()


def arms():
    arm = Arm.load("telescopic_pr", "poles")
    q = (arm.n_joints,)
    yield from ((of, q) for of in (arm.limit_excess, arm.check_position, arm.encode, arm.link_poses))
    yield arm.decode, (arm.n_links, 6)
    yield SafetyFilter(arm, 0.01).step, q, q, q


def demonstrations():
    for columns in (2, 3, 7):
        for phase in ("length", "time"):
            yield partial(check_demonstration, phase), (5, columns), (5,), float


def check_demonstration(phase, samples, t, length):
    if np.shape(samples) == (5, 7) and length < 1.0:
        samples = np.array(samples, dtype=float)
        samples[:, 3:] = [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], *np.eye(4)[1:]]
    times = t if length < 0.5 else np.arange(5.0) if length < 5.0 else None
    shown = align([check(Demonstration.from_samples, samples, times, length)] * 2, samples=7, phase=phase)
    check(in_world, shown.mean, shown.goal)
    assert np.isfinite(shown.displaced).all()


@pytest.mark.parametrize("area", [lie_groups, rigid_motions, conditions, networks, arms, demonstrations])
def test_numbers_of_any_size(area):
    with np.errstate(all="ignore"):
        calls = list(area())
    for number in range(rounds(max(45, 4 * len(calls)))):
        function, *kinds = calls[number % len(calls)]
        draw = fuzz_public.Draw(number, fuzz_things.fresh)
        check(function, *(abs(draw.number()) if kind is float else draw.array(kind) for kind in kinds))


@pytest.mark.parametrize("value", [*fuzz_public.junk(), *fuzz_public.WORDS], ids=lambda value: type(value).__name__)
def test_checks_of_input_refuse_without_taking_memory_or_time(value):
    for function in (
        lambda: as_floats("x", value, ("n",)),
        lambda: as_floats("x", value, (3,), batched=True),
        lambda: as_count("n", value),
        lambda: as_seed("seed", value),
        lambda: as_choice("thing", value, ("one", "two")),
        lambda: groups.group(value),
        # A list may be a good shape, of as many matrices as memory holds.
        lambda: None if isinstance(value, list) else groups.so3().random(0, value),
        lambda: Arm.load(value),
    ):
        try:
            function()
        except LieEDNNError as error:
            said = str(error)
        else:
            continue
        # A refusal quotes no million entries.
        assert len(said) < 3000


def test_everything_public(tmp_path, monkeypatch, two_hinges):
    """Each name once, whoever added it; but no rendering, which takes too long, and no live pages, which go on."""
    monkeypatch.chdir(tmp_path)
    fuzz_things.furnish(two_hinges)
    known = fuzz_public.targets()
    assert {"plan", "stability.verify", "arm.Arm.keyframe", "environments.gymnasium.VectorEnvironment.step"} <= {
        target.name.removeprefix("planning.") for target in known
    }
    left_out = ("rendering.", "live.")
    calls = (n for n in range(rounds(len(known))) if not known[n % len(known)].name.startswith(left_out))
    assert [wrong for wrong in map(fuzz_public.attempt, calls) if wrong] == []
