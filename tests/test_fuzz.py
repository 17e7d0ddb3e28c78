"""Any input at all: a finite result or an error of the package, never a traceback from the depths, NaN or a hang.

Bounded here; open-ended by ``pytest tests/test_fuzz.py --hypothesis-profile=fuzz`` (see conftest).
"""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lieednn_sim import lie
from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, LieEDNNError
from lieednn_sim.lie import groups
from lieednn_sim.motion import Motion
from lieednn_sim.network import EquivariantLieEDNN, GroupLieEDNN, LieEDNN
from lieednn_sim.synthesis.bias import BIAS_RULES, bias_for
from lieednn_sim.validation import as_choice, as_count, as_floats, as_seed, as_shape


def bounded(examples):
    """So many examples in the suite, and as many as the profile says in a campaign."""
    most = settings.default.max_examples
    return settings(max_examples=examples if most <= 100 else most)


SIZES = (0.0, 5e-324, 1e-308, 1e-160, 1e-99, 1e-8, 1.0, np.pi, 1e3, 1e8, 1e50, 9e99, 1e101, 1.7e308, np.inf, np.nan)
numbers = st.one_of(st.sampled_from(SIZES + tuple(-x for x in SIZES)), st.floats(-10.0, 10.0))
positive = st.one_of(st.sampled_from(SIZES), st.floats(0.1, 10.0))


@st.composite
def arrays(draw, *shape):
    """One size for most entries, and some of any size; now and then of another shape."""
    if draw(st.integers(0, 30)) == 0:
        shape = draw(st.sampled_from([(), (0,), (3,), (2, 6), (1, 2, 6), (6, 6), (4, 4)]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    with np.errstate(all="ignore"):
        array = np.asarray(draw(numbers) * rng.normal(size=shape))
    for _ in range(draw(st.integers(0, 2)) if array.size else 0):
        array.flat[draw(st.integers(0, array.size - 1))] = draw(numbers)
    return array


@st.composite
def rotations(draw, *shape):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rotation = lie.project_to_rotation(rng.normal(size=(*shape, 3, 3)))
    return rotation if draw(st.integers(0, 9)) else draw(arrays(*shape, 3, 3))


def leaves(value):
    """All numbers of a result."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if not field.name.startswith("_"):
                yield from leaves(getattr(value, field.name))
    elif isinstance(value, tuple | list):
        for item in value:
            yield from leaves(item)
    elif isinstance(value, float | np.floating | np.ndarray) and np.asarray(value).dtype.kind in "fc":
        yield value


def check(function, *arguments, infinite=(), **named):
    """Finite result, or an error of the package; a warning is an error (pytest's setting)."""
    try:
        result = function(*arguments, **named)
    except LieEDNNError:
        return None
    for name, leaf in enumerate(leaves(result)):
        assert np.isfinite(leaf).all() or name in infinite, (function, leaf)
    return result


GROUPS = ("SO(2)", "SO(3)", "SE(2)", "SE(3)", "SU(2)", "SU(3)", "C^x", "H^x", "Sim(3)", "GL(2)", "affine(C^x)")


@bounded(60)
@given(st.data(), st.sampled_from(GROUPS))
def test_lie_groups(data, name):
    group = groups.group(name)
    d, m = group.dimension, group.size
    x, g = data.draw(arrays(d)), data.draw(arrays(m, m))
    function, argument = data.draw(
        st.sampled_from(
            [
                (group.exp, x),
                (group.log, g),
                (group.adjoint, g),
                (group.contains, g),
                (group.in_kernel, g),
                (group.ad, x),
                (group.vee, g),
            ]
        )
    )
    element = check(function, argument)
    if function == group.exp and element is not None:
        check(group.log, element)
        check(group.adjoint, element)


@bounded(12)
@given(st.data(), st.sampled_from([LieEDNN, EquivariantLieEDNN, GroupLieEDNN]))
def test_networks(data, kind):
    n, gamma, mu = 2, data.draw(positive), data.draw(positive)
    alpha, bias, state = (data.draw(arrays(*shape)) for shape in ((n, n), (n, 6), (n, 6)))
    if kind is GroupLieEDNN:
        network = check(
            kind.from_blocks, groups.group("SE(3)"), alpha, data.draw(arrays(n, n, 6, 6)), bias, gamma=gamma
        )
    else:
        network = check(kind, alpha, data.draw(rotations(n, n)), data.draw(arrays(n, n, 3)), bias, gamma, mu)
    if network is None:
        return
    check(network.vector_field, state)
    check(network.jacobian, state)
    check(network.equilibrium, state)
    check(network.retarget, state)
    # What is too large to be reached in some thousand steps is for the test of stiff networks.
    if gamma < 100.0 and np.abs(network.blocks).max() * mu < 100.0:
        trajectory = check(network.trajectory, state, 1.0 / gamma, rtol=1e-3, atol=1e-6)
        assert trajectory is None or np.isfinite(trajectory(trajectory.t[-1])).all()


@bounded(40)
@given(st.sampled_from(BIAS_RULES), arrays(2, 6), positive, numbers)
def test_biases(rule, xi, bound, magnitude):
    with np.errstate(all="ignore"):
        outputs = np.tanh(xi)
    check(bias_for, rule, xi, outputs, bound, magnitude)


WORDS = st.one_of(
    st.text(max_size=12),
    st.sampled_from(["a\0b", "x" * 5000, "", "1e308", "nan", "-inf", "1_000", "٣", "../../..", "None", "[bold]", "-"]),
)
junk = st.one_of(
    WORDS,
    st.integers(),
    st.floats(),
    st.none(),
    st.booleans(),
    st.binary(max_size=20),
    st.just(10**5000),
    st.just(np.broadcast_to(np.int8(0), (2**40,))),
    st.just(np.broadcast_to(0.0, (2**20, 2**20))),
    st.just(range(10**12)),
    st.just(object()),
    st.just(1j),
    st.lists(st.integers(), max_size=3),
)


@bounded(60)
@given(junk)
def test_checks_of_input_refuse_without_taking_memory_or_time(value):
    for function in (
        lambda: as_floats("x", value, ("n",)),
        lambda: as_floats("x", value, (3,), batched=True),
        lambda: as_count("n", value),
        lambda: as_seed("seed", value),
        lambda: as_shape("shape", value),
        lambda: as_choice("thing", value, ("one", "two")),
        lambda: groups.group(value),
        lambda: groups.so3().random(0, value),
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


@bounded(40)
@given(st.data())
def test_damaged_files(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "fuzz.npz"
    LieEDNN(0.1 * np.eye(2), np.tile(np.eye(3), (2, 2, 1, 1)), np.zeros((2, 2, 3)), np.zeros((2, 6))).save(path)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(content[: data.draw(st.integers(0, len(content)))] if data.draw(st.booleans()) else content))
    for kind in (LieEDNN, Motion):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                kind.load(path)
        except FileError:
            pass
