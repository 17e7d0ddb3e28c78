"""Input checks: what passes, what is refused, and the words of the refusal."""

from __future__ import annotations

import re

import numpy as np
import pytest

from lieednn_sim.errors import InputError
from lieednn_sim.validation import LARGEST, as_choice, as_count, as_floats, as_positive


def test_floats_accept_lists_integers_and_batches():
    array = as_floats("x", [[1, 2], [3, 4]], ("n", "n"))
    assert array.dtype == np.float64
    assert as_floats("x", np.zeros((7, 5, 4, 6)), ("N", 6), batched=True).shape == (7, 5, 4, 6)
    assert as_floats("x", np.zeros((4, 6)), ("N", 6), batched=True).shape == (4, 6)
    assert as_floats("x", np.zeros((0, 6)), ("N", 6)).shape == (0, 6)


@pytest.mark.parametrize(
    ("value", "shape", "batched", "words"),
    [
        (np.zeros((2, 6)), (4, 6), False, r"x must have shape \(4, 6\), got \(2, 6\)"),
        (np.zeros((2, 3)), ("n", "n"), False, r"\(n, n\), got \(2, 3\)"),
        (np.zeros((1, 4, 6)), ("N", 6), False, r"\(N, 6\), got \(1, 4, 6\)"),
        (np.zeros(6), ("N", 6), True, r"\(\.\.\., N, 6\), got \(6,\)"),
        (1.0, (3,), True, r"\(\.\.\., 3\), got \(\)"),
        ([1.0, np.nan, -np.inf], (3,), False, r"got 2 NaN or infinite entries, the first at \[1\]"),
        (float("nan"), (), False, "x must be finite, got nan$"),
        (None, (), False, "x must be finite, got None$"),
        ("abc", (1,), False, "x must be an array of numbers, got str"),
        ([[1.0], [1.0, 2.0]], ("n", "m"), False, "array of numbers, got list"),
        *((value, (1,), True, "array of numbers, got list") for value in ([object()], [True, 1.0], ["4.0"])),
        *((value, (), False, "x must be an array of numbers") for value in (True, np.array(True), b"4")),
        pytest.param(np.array([1.0 + 2.0j]), (1,), False, "x must", id="complex"),
        pytest.param(np.ma.masked_equal([1.0, 2.0], 2.0), (2,), False, "masked entries are not allowed", id="masked"),
        pytest.param(10**400, (), False, "x must", id="too large for a float"),
    ],
)
def test_floats_refuse_with_what_was_given_and_what_is_allowed(value, shape, batched, words):
    with pytest.raises(InputError, match=words):
        as_floats("x", value, shape, batched=batched)


@pytest.mark.parametrize("largest", [1e-200, 1.0, LARGEST, 1e152, 1e300])
def test_no_entry_may_be_larger_than_the_largest_and_many_may_be_as_large(largest):
    many = np.full((100, 3), -largest)
    assert as_floats("x", many, ("N", 3), largest=largest) is many
    many[70, 1] = np.nextafter(largest, np.inf)
    with pytest.raises(InputError, match=re.escape(f"x must not exceed {largest:g} in size")):
        as_floats("x", many, ("N", 3), largest=largest)
    for bad in (np.nan, np.inf, -np.inf):
        with pytest.raises(InputError, match="x must be finite, got 1 NaN or infinite"):
            as_floats("x", np.array([0.0, bad]), (2,), largest=largest)


@pytest.mark.parametrize(
    ("check", "value", "words"),
    [
        *((as_positive, value, f"x must be positive, got {value:g}") for value in (0.0, -2.5)),
        (as_positive, [1.0], r"\(\), got \(1,\)"),
        (as_count, 0, "x must be at least 1, got 0"),
        *((as_count, value, "whole number, got") for value in (2.0, True, "3")),
    ],
)
def test_positive_and_count_refuse(check, value, words):
    with pytest.raises(InputError, match=words):
        check("x", value)


def test_positive_and_count_give_python_numbers():
    assert type(as_positive("gamma", np.float32(0.5))) is float
    assert type(as_count("n", np.int64(3))) is int


def test_choice_lists_what_is_allowed():
    assert as_choice("colour", "red", ("red", "blue")) == "red"
    with pytest.raises(InputError, match="no colour 'green'; allowed: blue, red"):
        as_choice("colour", "green", ("red", "blue"))
    for elements, listed in ((["", "claw", ""], "claw"), (["", ""], "none")):  # some of a model have no names
        with pytest.raises(InputError, match=f"^no actuator 'gripper'; allowed: {listed}$"):
            as_choice("actuator", "gripper", elements)
