"""Any input at all: a finite result or an error of the package, never a traceback from the depths, NaN or a hang.

Bounded here; open-ended by ``pytest tests/test_fuzz.py --hypothesis-profile=fuzz`` (see conftest).
"""

from __future__ import annotations

import dataclasses
import functools
import json

import fuzz_public
import fuzz_things
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lieednn_sim import lie, stability, theory
from lieednn_sim.arm import Arm
from lieednn_sim.cli import main
from lieednn_sim.cli.task import Task
from lieednn_sim.errors import FileError, LieEDNNError
from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.network import LieEDNN
from lieednn_sim.policies import SafetyFilter
from lieednn_sim.registry import BIAS_RULES
from lieednn_sim.synthesis.bias import bias_for
from lieednn_sim.theory import EquivariantLieEDNN, GroupLieEDNN, groups
from lieednn_sim.validation import as_choice, as_count, as_floats, as_seed, as_shape


def bounded(examples, **more):
    """So many examples in the suite, and as many as the profile says in a campaign."""
    most = settings.default.max_examples
    return settings(max_examples=examples if most <= 100 else most, **more)


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
                (group.adjoint, g),
                (group.contains, g),
                (group.ad, x),
                (group.vee, g),
            ]
        )
    )
    element = check(function, argument)
    if function == group.exp and element is not None:
        check(group.adjoint, element)


@bounded(40)
@given(st.data())
def test_rigid_motions(data):
    function, shape = data.draw(
        st.sampled_from(
            [
                (lie.project_to_rotation, (3, 3)),
                (lie.project_to_adjoint, (6, 6)),
                (lie.project_to_adjoint_exact, (6, 6)),
                (lie.project_to_scaled_adjoint, (6, 6)),
                (lie.left_jacobian_so3, (3,)),
                (lie.left_jacobian_se3, (6,)),
                (lie.hat, (3,)),
                (lie.vee, (3, 3)),
            ]
        )
    )
    check(function, data.draw(arrays(*shape)))
    check(lie.adjoint, data.draw(rotations()), data.draw(arrays(3)))
    pose = check(lie.exp, data.draw(arrays(6)))
    if pose is not None:
        assert np.isfinite(pose.as_matrix()).all()
        check(lie.log, pose)


@bounded(40)
@given(st.data())
def test_stability(data):
    n = data.draw(st.integers(1, 3))
    weight = data.draw(arrays(n, n))
    rates = {"gamma": data.draw(positive), "mu": data.draw(positive)}
    call = data.draw(
        st.sampled_from(
            [
                lambda: check(stability.verify, np.abs(data.draw(arrays(n))), weight, **rates),
                lambda: check(stability.find_certificate, weight, **rates),
                lambda: check(stability.log_norms, weight),
                lambda: check(stability.weighted_norm, weight),
                # Infinite beside an output that vanishes, as documented.
                lambda: check(stability.smallest_one_norm, weight, data.draw(arrays(n, n)), infinite=(0,)),
                lambda: check(stability.assess, weight, jacobian=data.draw(arrays(n, n)), **rates),
                lambda: check(theory.smoothness_bounds, weight, data.draw(arrays(n)), data.draw(positive), **rates),
                lambda: check(theory.curvature, data.draw(arrays(n)), data.draw(arrays(n))),
            ]
        )
    )
    call()


@bounded(12)
@given(st.data(), st.sampled_from([LieEDNN, EquivariantLieEDNN, GroupLieEDNN]))
def test_networks(data, kind):
    n, gamma, mu = 2, data.draw(positive), data.draw(positive)
    alpha, bias, state = (data.draw(arrays(*shape)) for shape in ((n, n), (n, 6), (n, 6)))
    if kind is GroupLieEDNN:
        group = groups.group("SE(3)")
        theta = check(group.project_to_adjoint, data.draw(arrays(n, n, 6, 6)))
        network = check(kind, group, alpha, np.eye(4) if theta is None else theta, bias, gamma)
    else:
        hidden = {"hidden_start": data.draw(arrays(data.draw(st.integers(0, 1)), 6))} if kind is LieEDNN else {}
        network = check(kind, alpha, data.draw(rotations(n, n)), data.draw(arrays(n, n, 3)), bias, gamma, mu, **hidden)
    if network is None:
        return
    check(network.vector_field, state)
    check(network.jacobian, state)
    check(network.equilibrium, state)
    visible = check(network.visible, state)
    check(network.retarget, state if visible is None else visible)
    check(network.start, state)
    # What is too large to be reached in some thousand steps is for the test of stiff networks.
    if gamma < 100.0 and np.abs(network.blocks).max() * mu < 100.0:
        trajectory = check(network.trajectory, state, 1.0 / gamma, rtol=1e-3, atol=1e-6)
        assert trajectory is None or np.isfinite(trajectory(trajectory.t[-1])).all()


@bounded(40)
@given(st.sampled_from(list(BIAS_RULES)), arrays(2, 6), positive, numbers)
def test_biases(rule, xi, bound, magnitude):
    with np.errstate(all="ignore"):
        outputs = np.tanh(xi)
    check(bias_for, rule, xi, outputs, bound, magnitude)


@functools.cache
def safety_filter():
    return SafetyFilter(Arm.load("telescopic_pr", "poles"), 0.01)


@bounded(30)
@given(st.data())
def test_arm_and_filter(data):
    safety = safety_filter()
    arm = safety.arm
    q = data.draw(arrays(arm.n_joints))
    check(arm.limit_excess, q)
    check(arm.check_position, q)
    check(arm.encode, q)
    check(arm.link_poses, q)
    check(arm.decode, data.draw(arrays(arm.n_links, 6)))
    check(safety.step, q, data.draw(arrays(arm.n_joints)), data.draw(arrays(arm.n_joints)))


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


# What JSON can hold; of a whole number Python writes at most 4300 digits.
scalars = st.one_of(
    WORDS, st.integers(), st.sampled_from([10**400, 10**4000, -1]), st.floats(), st.none(), st.booleans()
)
values = st.one_of(scalars, st.lists(scalars, max_size=3), st.dictionaries(WORDS, scalars, max_size=2))
TASK = dataclasses.asdict(Task("telescopic_pr", (0.0,) * 8, (0.1,) * 8, 4.0))


@bounded(60)
@given(
    st.dictionaries(st.sampled_from([*TASK, "more"]), values, max_size=3), st.sets(st.sampled_from([*TASK]), max_size=1)
)
def test_task_files(tmp_path_factory, changed, removed):
    content = {name: value for name, value in {**TASK, **changed}.items() if name not in removed}
    path = tmp_path_factory.getbasetemp() / "fuzz.json"
    path.write_text(json.dumps(content))
    try:
        task = Task.load(path)
    except FileError:
        return
    assert not removed
    task.save(path)
    assert Task.load(path) == task
    # The arm as it was takes a while to compile, and is good.
    if changed.keys() & {"arm", "scene", "imported"}:
        check(task.load_arm)


@bounded(40)
@given(st.data(), st.sampled_from([2, 3, 7]))
def test_demonstrations(data, columns):
    samples = data.draw(arrays(5, columns))
    if columns == 7 and samples.shape == (5, 7) and data.draw(st.booleans()):
        samples[:, 3:] = [[1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], *np.eye(4)[1:]]
    t = data.draw(st.one_of(st.none(), arrays(5), st.just(np.arange(5.0))))
    length = data.draw(st.sampled_from([1.0, 0.001]))
    one = check(Demonstration.from_samples, samples, t, length)
    if one is not None:
        shown = check(align, [one, one], samples=7, phase=data.draw(st.sampled_from(["length", "time"])))
        if shown is not None:
            check(shown.to_world, shown.mean)
            assert np.isfinite(shown.displaced).all()


@pytest.mark.parametrize("part", range(4))
def test_everything_public(part, tmp_path, monkeypatch):
    """Each name once, whoever added it; but no rendering, which takes too long, and no live pages, which go on."""
    monkeypatch.chdir(tmp_path)
    fuzz_things.furnish()
    known = fuzz_public.targets()
    assert {"plan", "stability.verify", "arm.Arm.keyframe", "environments.gymnasium.VectorEnvironment.step"} <= {
        target.name.removeprefix("planning.") for target in known
    }
    left_out = ("rendering.", "live.")
    most = settings.default.max_examples
    numbers = range(part, len(known) if most <= 100 else most, 4)
    calls = (number for number in numbers if not known[number % len(known)].name.startswith(left_out))
    assert [wrong for wrong in map(fuzz_public.attempt, calls) if wrong] == []


NUMBERS = ("nan", "inf", "1e308", "-1e308", "0", "-1", "1e-320", "5", "1e9", "1,2", "1e308,0,0", "random:-1", "3" * 400)
OPTIONS = ("arm", "option", "duration", "links", "output", "planner", "position", "scene")
OPTIONS += (
    "scene-seed",
    "seed",
    "servos",
    "start",
    "target",
    "time-budget",
    "base",
    "preset",
    "plots",
    "nonsense",
    "keyframe",
    "home",
)


@bounded(60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.one_of(
        st.lists(WORDS, max_size=3),
        st.tuples(st.sampled_from(("simulate", "render", "evaluate")), WORDS),
        st.tuples(st.just("arms"), WORDS),
        st.tuples(
            st.just("learn"), WORDS, st.sampled_from(("--starts=0", "--unit=inch", "--clock-rate=0", "--seed=0"))
        ),
        # Whatever else is asked for, the last option is bad, and found to be before the work.
        st.builds(
            lambda options, bad: ("demo", *(f"--{name}={value}" for name, value in options), bad),
            st.lists(st.tuples(st.sampled_from(OPTIONS), st.one_of(WORDS, st.sampled_from(NUMBERS))), max_size=2),
            st.sampled_from(("--hold=-1", "--fps=0", "--payload=-1", "--controller=none", "--push=hand", "--size=0x9")),
        ),
    )
)
def test_command_lines(tmp_path, monkeypatch, capsys, words):
    monkeypatch.chdir(tmp_path)
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code
    assert code == 2
    assert "error: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
