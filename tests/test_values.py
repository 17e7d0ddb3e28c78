"""Values: of every frozen dataclass with arrays these are read-only, and equal is what holds the same."""

import copy
import dataclasses
import importlib
import pickle
import pkgutil
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import lieednn_sim as ls
from lieednn_sim.values import frozen

# Parts of an arm and of a group, inputs and what is computed from them on the way: each is made once, and is itself.
IDENTITIES = {
    *("Chain", "Coordinates", "Factor", "CompoundJoint", "CompoundJoints", "MovingPoses", "MatrixLieGroup"),
    *("PlanningProblem", "PolicyTask", "NetworkPath", "SerialArm", "ModelArm", "Arm", "Frame", "Joint"),
    *("Transition", "ChunkMotion", "Deviations", "BodyFrames"),
}


def dataclasses_of_the_package():
    for module in pkgutil.walk_packages(ls.__path__, "lieednn_sim."):
        # These two are dm_control's, which is not everywhere; they have no dataclasses.
        if not module.name.endswith(("__main__", "environments.suite")):
            with warnings.catch_warnings(action="ignore"):
                found = vars(importlib.import_module(module.name)).values()
            yield from (
                cls
                for cls in found
                if isinstance(cls, type)
                and dataclasses.is_dataclass(cls)
                and getattr(cls, "__module__", "") == module.name
            )


def is_value(cls):
    return getattr(cls.__eq__, "__module__", "") == "lieednn_sim.values"


@pytest.fixture(scope="module")
def classes():
    """All of them, which takes every module and what it imports: not while tests are collected, by every worker."""
    return sorted(dataclasses_of_the_package(), key=lambda cls: cls.__qualname__)


@pytest.fixture(scope="module")
def values(classes):
    return [cls for cls in classes if is_value(cls)]


def test_every_frozen_dataclass_with_arrays_is_a_value(classes, values):
    with_arrays = {
        cls.__name__
        for cls in classes
        if cls.__dataclass_params__.frozen
        and not cls.__name__.startswith("_")
        and any("Floats" in str(item.type) or "NDArray" in str(item.type) for item in dataclasses.fields(cls))
    }
    assert {cls.__name__ for cls in values} >= with_arrays - IDENTITIES
    assert {"Motion", "Rollout", "Plan", "Certificate", "Synthesis", "Following", "LieEDNN"} <= {
        cls.__name__ for cls in values
    }


CONTENT = arrays(np.float64, (2, 3), elements=st.floats(allow_nan=True))


def test_arrays_are_read_only_and_equality_is_of_content(values):
    for cls in values:
        check_value(cls)


@settings(max_examples=3)
@given(content=CONTENT, data=st.data())
def check_value(cls, content, data):
    names = [item.name for item in dataclasses.fields(cls)]
    public = [item for item in dataclasses.fields(cls) if item.compare or not item.name.startswith("_")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cls, "__post_init__", lambda _: None, raising=False)
        if hasattr(cls.__init__, "__typechecked__"):
            patch.setattr(cls, "__init__", cls.__init__.__wrapped__)
        wrap = {0: lambda x: x, 1: lambda x: (x, 1.0), 2: lambda x: {"x": [x]}}
        made = wrap[data.draw(st.integers(0, 2))]
        one, other = (cls(**{name: made(content.copy()) for name in names}) for _ in range(2))
        assert one == other
        assert hash(one) == hash(other)
        for item in public:
            kept = getattr(one, item.name)
            array = kept if isinstance(kept, np.ndarray) else kept[0] if isinstance(kept, tuple) else kept["x"][0]
            with pytest.raises(ValueError, match="read-only"):
                array[0, 0] = 1.0
            changed = content.copy()
            changed[1, 2] = 0.0 if changed[1, 2] != 0.0 else 1.0
            assert (dataclasses.replace(one, **{item.name: made(changed)}) != one) == item.compare
            assert (dataclasses.replace(one, **{item.name: made(content[:1])}) != one) == item.compare


def test_values_by_hand():
    @frozen
    class Result:
        x: np.ndarray
        note: str = ""
        error: float = 0.0

    given_array = np.zeros(3)
    result = Result(given_array)
    # What was handed over is still the caller's.
    given_array[0] = 0.0
    assert repr(result).endswith("Result(x=array([0., 0., 0.]), note='', error=0.0)")
    assert repr(Result(np.zeros((50, 3)))).endswith("Result(x=<ndarray (50, 3)>, note='', error=0.0)")
    assert result == Result(np.zeros(3))
    assert result != Result(np.zeros(3), "other")
    assert result != "a string"
    assert Result(np.zeros(3), error=float("nan")) == Result(np.zeros(3), error=float("nan"))
    with pytest.raises(dataclasses.FrozenInstanceError):
        result.note = "changed"


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))])
def test_copies_are_equal_and_read_only(cascade, copied):
    """Otherwise weights could be changed under a certificate that is cached."""
    network = cascade(np.full((2, 6), 0.3))
    assert network.weight.shape == (30, 30)
    again = copied(network)
    assert again == network
    for value in (again.alpha, again.bias, again.weight):
        with pytest.raises(ValueError, match="read-only"):
            value[0, 0] = 1.0
