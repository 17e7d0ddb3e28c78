"""Numbers on the command line: what a person writes, not all that Python reads as a number."""

from __future__ import annotations

import argparse
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lieednn_sim.arm import Arm
from lieednn_sim.cli import main
from lieednn_sim.cli.arguments import joint_position, numbers, push, size
from lieednn_sim.cli.options import decimal, decimal_or_inf, whole
from lieednn_sim.errors import InputError
from lieednn_sim.studies import Case

# Underscores, other scripts' digits (Arabic-Indic 12, full-width 1), blanks, infinities, other bases.
ODD = [
    "1_000",
    "\u0661\u0662",
    "\uff11",
    " 1",
    "1 ",
    "",
    "inf",
    "-inf",
    "nan",
    "1e999",
    "1e1000",
    "0x10",
    "1,0",
    "+-1",
    "e3",
    ".",
]

# Signs of numbers and of other scripts' numbers, superscripts, Roman numerals, blanks.
LETTERS = "0123456789+-.eE_xaninfj, \t\n\u00a0\u00b2\u0661\u0663\u09ea\u2167\u2212\u3007\uff11\U0001d7d9"


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_number_is_read_back(value):
    assert decimal(repr(value)) == decimal_or_inf(repr(value)) == value


@given(st.integers(-(10**18) + 1, 10**18 - 1))
def test_every_whole_number_is_read_back(value):
    assert whole(str(value)) == value
    assert decimal(str(value)) == float(value)


@given(st.text(LETTERS, max_size=6))
def test_what_is_read_is_ascii_without_underscores(text):
    try:
        value = decimal(text)
    except argparse.ArgumentTypeError:
        return
    assert math.isfinite(value)
    assert set(text) <= set("0123456789+-.eE")


@pytest.mark.parametrize("text", ODD)
def test_what_only_python_reads_is_refused(text):
    for read in (decimal, whole):
        with pytest.raises(argparse.ArgumentTypeError, match="must be a"):
            read(text)
    assert decimal_or_inf("inf") == math.inf


@pytest.mark.parametrize("option", ["--duration", "--seed", "--payload", "--n-networks"])
def test_options_say_what_they_take(option, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["demo", option, "1_000"])
    assert f"argument {option}: must be a" in capsys.readouterr().err


def test_numbers_within_texts_are_as_strict():
    arm = Arm.load("telescopic_pr")
    assert numbers("1, -2.5,.5e1", "position", 3).tolist() == [1.0, -2.5, 5.0]
    assert size("1280x720") == (1280, 720)
    for bad in ("1_0", "\u0661", "nan", "inf"):
        with pytest.raises(InputError, match="must be 3 comma-separated numbers"):
            numbers(f"1,{bad},3", "position", 3)
        with pytest.raises(InputError, match="a push must look like"):
            push(f"link 1,{bad},0,0,0,1")
    for call in (
        lambda: joint_position(arm, "random:\u0661", "target"),
        lambda: size("\uff11\uff12x10"),
        lambda: Case.parse("a:b:c:\u0661"),
    ):
        with pytest.raises(InputError, match="must look like"):
            call()
