"""Arguments checked against annotations: what passes, what is refused, and the one line that says so."""

from __future__ import annotations

import functools
import inspect
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np
import pytest
from numpy.typing import ArrayLike

import lieednn_sim as ls
from lieednn_sim import learning, lie, simulation, stability, synthesis
from lieednn_sim.arm import Arm
from lieednn_sim.environments import tasks
from lieednn_sim.environments.gymnasium import VectorEnvironment
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import Demonstration, align
from lieednn_sim.network import BlockNetwork
from lieednn_sim.stability import certificate
from lieednn_sim.typecheck import typechecked
from lieednn_sim.values import Floats, frozen

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


class Options(TypedDict, total=False):
    flag: bool


class Scalar:
    """As the arrays without axes of other libraries than NumPy."""

    ndim = 0

    def __len__(self):
        raise TypeError("len() of unsized object")

    __iter__ = __contains__ = __len__

    def __repr__(self):
        return "Scalar(\n1.0)"


def every_kind(
    number: float = 0.0,
    count: int | None = None,
    flag: bool = False,
    names: Sequence[str] = (),
    files: Iterable[str] = (),
    sizes: tuple[int, ...] = (),
    pair: tuple[float, float] = (0.0, 0.0),
    table: Mapping[str, float] | None = None,
    call: Callable[[float], ArrayLike] | ArrayLike = 0.0,
    array: Floats | None = None,
    rotation: Rotation | None = None,
    text: str | ArrayLike = "",
) -> str:
    return "done"


CHECKED = typechecked(every_kind)


@pytest.mark.parametrize(
    "given",
    [
        *({"number": value} for value in (1, 1.0, np.float32(1.0), np.int64(1), np.array(1.0), Fraction(1, 2))),
        *({"count": value} for value in (None, 3, np.int8(3), np.array(3))),
        *({"flag": value} for value in (True, np.True_)),
        *({"files": value} for value in ([], ("a",), iter("ab"))),
        *({"names": value} for value in ([], ("a", "b"), np.array(["a"]), {"a": 1}.keys())),
        *({"sizes": value} for value in ([1, 2], np.arange(3), range(10**12))),
        *({"pair": value} for value in ([1, 2.0], np.zeros(2))),
        *({"table": value} for value in ({}, {"a": 1})),
        *({"call": value} for value in (abs, [1.0, 2.0], 3, np.zeros(2))),
        *({"array": value} for value in ([[1, 2]], (1,), 2.0, np.zeros(3, dtype=int), None)),
        *({"text": value} for value in ("uniform", [0.0], np.zeros(2))),
    ],
)
def test_what_works_without_the_check_works_with_it(given):
    assert CHECKED(**given) == "done"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"number": "1"}, "number must be a number, got '1'"),
        ({"number": np.zeros(1)}, "number must be a number, got an array of shape (1,)"),
        ({"count": True}, "count must be a whole number, got True"),
        ({"flag": 1}, "flag must be True or False, got 1"),
        ({"files": b"ab"}, "files must be a list, got b'ab'"),
        ({"names": "ab"}, "names must be a list, each item a string, got 'ab'"),
        ({"names": ["a"] * 9 + [3]}, "names[9] must be a string, got 3"),
        ({"sizes": [1, 2.5]}, "sizes[1] must be a whole number, got 2.5"),
        ({"pair": (1.0,)}, "pair must be a tuple of 2, each item a number, got a tuple of 1"),
        ({"pair": Scalar()}, "pair must be a tuple of 2, each item a number, got Scalar( 1.0)"),
        ({"table": {"a": "b"}}, "table['a'] must be a number, got 'b'"),
        ({"table": {3: 1.0}}, "table: its keys must be a string, got 3"),
        ({"table": [1]}, "table must be a dictionary, got a list of 1"),
        ({"call": None}, "call must be a function or an array of numbers, got None"),
        ({"array": {1: 2}}, "array must be an array of numbers, got a dict of 1"),
        ({"rotation": object()}, "rotation must be a Rotation of scipy, got an object"),
        ({"text": b"1"}, "text must be a string or an array of numbers, got b'1'"),
    ],
)
def test_the_refusal_is_one_line(given, message):
    with pytest.raises(InputError) as failed:
        CHECKED(**given)
    assert str(failed.value) == message
    with pytest.raises(InputError):
        CHECKED(*(given.get(name, one.default) for name, one in inspect.signature(every_kind).parameters.items()))


def test_arguments_of_any_form_are_checked():
    @typechecked
    def function(first: int, *more: object, last: int = 0, **options: Unpack[Options]) -> None:
        pass

    function(1, 2, 3, last=4, flag=True)
    for call in (
        functools.partial(function, "1"),
        functools.partial(function, 1, last="4"),
        functools.partial(function, 1, flag="no"),
    ):
        with pytest.raises(InputError, match=r"^(first|last|flag) must be "):
            call()
    with pytest.raises(TypeError, match="missing 1 required"):
        function()


def test_what_is_refused_is_never_quoted_at_length():
    for huge in ("x" * 10**6, [0] * 10**6, 10**5000, np.broadcast_to(0.0, (2**20, 2**20)), {"x" * 10**6: 1}):
        with pytest.raises(InputError) as failed:
            CHECKED(flag=huge)
        assert len(str(failed.value)) < 200


def test_functions_and_classes_stay_what_they_were():
    """Pickle finds them, signatures are theirs, and the ways within the package go past the check."""
    for value in (ls.plan, stability.verify, Arm, Arm.keyframe):
        assert pickle.loads(pickle.dumps(value)) is value
    assert list(inspect.signature(ls.plan).parameters)[:3] == ["arm", "target", "planner"]
    assert stability.verify.__wrapped__ is certificate.verify
    assert not hasattr(ls.LieEDNN.vector_field, "__typechecked__")  # `as_floats` looks at its only argument

    @frozen
    class Inherited(stability.LogNorms):
        more: Any = None

    assert Inherited(1.0, 1.0, 1.0, 1.0, 1.0).more is None


def test_a_name_is_checked_before_mujoco_reads_it():
    """This was a segmentation fault."""
    with pytest.raises(InputError, match="name must be a string, got None"):
        Arm.load("telescopic_pr").keyframe(None)


def test_what_dm_control_wraps_is_told():
    wrapper = type("MjModel", (), {"ptr": property(lambda _: Arm.load("telescopic_pr").model)})()
    with pytest.raises(InputError, match=r"model must be a MjModel of mujoco, got a MjModel; give its \.ptr"):
        Arm.of(wrapper, None, ["a"])


ARM = Arm.load("telescopic_pr")
HOME = ARM.keyframe("home")
XI = ARM.encode(0.9 * HOME)
RAGGED = [[1.0], [1.0, 2.0]]
FAR = 10**9


@functools.cache
def network():
    return ls.synthesize(XI).unwrap()


@functools.cache
def shown():
    s = np.linspace(0.0, 1.0, 5)
    return align([Demonstration.from_samples(np.stack([s, s], axis=1))], samples=9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: simulation.Simulation(ARM, disturbances=5), "disturbances must be Disturbances"),
        (lambda: ls.simulate_many(ARM, np.array(1.0)), "motions must be a list"),
        (lambda: synthesis.shape(np.array(1.0)), "curve must have shape"),
        (lambda: lie.hat(RAGGED), "vector must be an array of numbers"),
        (lambda: network().robustness(range(10**12)), "pushed must name coordinates"),
        (lambda: network().assess()["x" * 10**6], "no condition 'x+' ... \\(1000000 characters\\)"),
        (lambda: ARM.unit(8), "joint must be at most 7"),
        (lambda: ls.Disturbances.from_json({}), "these are no disturbances: KeyError: 'pushes'"),
        (lambda: tasks.make_task("reach").target(0.0), "no episode has begun: reset first"),
        (lambda: BlockNetwork.load("network.npz"), "a BlockNetwork is read by its own class"),
        (lambda: VectorEnvironment(2, threads=FAR), "threads must be at most 1024"),
        (lambda: VectorEnvironment(FAR), "num_envs must be at most 65536"),
        (lambda: align([Demonstration.from_samples(np.eye(3))], samples=FAR), "samples must be at most 100000"),
        (lambda: ls.synthesize(XI, max_attempts=FAR), "max_attempts must be at most 10000"),
        (lambda: simulation.Simulation(ARM).advance(FAR), "steps must be at most 10000000"),
        (lambda: simulation.Simulation(ARM).advance(2, HOME), r"controls must have shape \(2, 8\)"),
    ],
)
def test_what_was_a_foreign_traceback_or_a_hang_is_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_a_network_far_faster_than_its_decay_is_given_up():
    """The search for its equilibrium ran for hours."""
    assert ls.train(XI[:1], mu=2**64 - 1).reason is learning.StopReason.LOST_EQUILIBRIUM
