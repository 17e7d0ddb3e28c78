"""The words of a command: what is read from them, what is refused and how, and the help, without heavy imports."""

from __future__ import annotations

import math
import subprocess
import sys
from argparse import ArgumentTypeError
from dataclasses import make_dataclass
from importlib import metadata

import pytest
from hypothesis import given
from hypothesis import strategies as st

import lieednn_sim
from lieednn_sim import registry
from lieednn_sim.arm import Arm, arm_names
from lieednn_sim.cli import COMMANDS, main, parser
from lieednn_sim.cli.arguments import Planning, Simulating, joint_position, option_names, read_options
from lieednn_sim.cli.kinds import KINDS, decimal, decimal_or_inf, force, named_numbers, names, numbers, size, whole
from lieednn_sim.errors import InputError
from lieednn_sim.planning.shaped import ShapedOptions
from lieednn_sim.simulation.disturbances import Disturbances

ALL = {command: module for members in COMMANDS.values() for command, module in members.items()}
# Underscores, other scripts' digits (Arabic-Indic 12, full-width 1), blanks, infinities, other bases.
ODD = ["1_000", "\u0661\u0662", "\uff11", " 1", "1 ", "", "-inf", "nan", "1e999", "1e1000", "0x10", "1,0", "+-1", "e3"]
# Signs of numbers and of other scripts' numbers, superscripts, Roman numerals, blanks.
LETTERS = "0123456789+-.eE_xaninfj, \t\n\u00a0\u00b2\u0661\u0663\u09ea\u2167\u2212\u3007\uff11\U0001d7d9"


def given_to(monkeypatch, command: str, *words: str):
    """What a command's function is called with."""
    seen = {}
    module = __import__(f"lieednn_sim.cli.{ALL[command]}", fromlist=[command])
    monkeypatch.setattr(module, command, lambda **values: seen.update(values))
    assert main([command, *words]) == 0
    return seen


def help_of(command: str) -> str:
    """The help of a command, in one line."""
    return " ".join(parser.make_parser(parser.definition(ALL[command], command)).format_help().split())


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
    except ArgumentTypeError:
        return
    assert math.isfinite(value)
    assert set(text) <= set("0123456789+-.eE")


@pytest.mark.parametrize("text", ODD)
def test_what_only_python_reads_is_refused(text):
    for read in (decimal, whole, decimal_or_inf):
        with pytest.raises(ArgumentTypeError, match="must be a"):
            read(text)
    # Between commas there may be blanks.
    if text.strip(" ") == text:
        for read, about in (
            (lambda one: numbers(f"1,{one},3", 3), "3 comma"),
            (lambda one: force(f"a,{one},0,0,0,1"), "BODY"),
        ):
            with pytest.raises(ArgumentTypeError, match=about):
                read(text)


def test_texts_with_several_parts_are_read():
    assert numbers("1, -2.5,.5e1", 3) == (1.0, -2.5, 5.0)
    assert size("1280x720") == (1280, 720)
    assert force("link 2,0,50,0,1.5,0.2") == ("link 2", (0.0, 50.0, 0.0, 1.5, 0.2))
    assert named_numbers("a=1, b.c=-.5") == {"a": 1.0, "b.c": -0.5}
    assert names("one,arm.xml:link,tool") == ["one", "arm.xml:link,tool"]
    assert names("a.py:one,two,b.py:three") == ["a.py:one", "two", "b.py:three"]
    floor = KINDS["float | str"].read
    assert [floor(text) for text in ("-1.", "0.5", "none")] == [-1.0, 0.5, "none"]
    assert decimal_or_inf("inf") == math.inf
    arm = Arm.load("telescopic_pr")
    for call in (
        lambda: joint_position(arm, "random:\u0661", "target"),
        lambda: size("\uff11\uff12x10"),
        lambda: named_numbers("a"),
    ):
        with pytest.raises((InputError, ArgumentTypeError), match="must look like"):
            call()


def test_options_go_to_the_parameters_that_they_are_of(monkeypatch):
    words = ["--target", "-.9,1", "--pose", "1,2,3,0,0,0", "--pose=-1,2,3,0,0,0", "--links", "a,b", "--floor", "-1"]
    words += ["--payload", "2", "--noise-seed", "7", "--push", "hand,0,0,1,0.5,1", "--size", "64x32", "--no-page"]
    words += ["--option", "rate=0.5", "--time-budget", "inf"]
    seen = given_to(monkeypatch, "demo", *words)
    pose = ((1.0, 2.0, 3.0, 0.0, 0.0, 0.0), (-1.0, 2.0, 3.0, 0.0, 0.0, 0.0))
    assert seen["planning"] == Planning(
        target="-.9,1",
        pose=pose,
        option=("rate=0.5",),
        time_budget=math.inf,
        imported={"links": ["a", "b"], "floor": -1.0},
    )
    disturbed = Disturbances(payload=2.0, seed=7)
    assert seen["simulating"] == Simulating(push=(("hand", (0.0, 0.0, 1.0, 0.5, 1.0)),), disturbances=disturbed)
    # What is not given is left to the function's own defaults.
    assert {name: value for name, value in seen.items() if name not in ("planning", "simulating")} == {
        "look": {"size": (64, 32)},
        "page": False,
    }
    words = "--planners dmp,stomp --planners own --arms a.xml:one,two --date 2030-01-02 --merge x y"
    seen = given_to(monkeypatch, "compare", *words.split())
    assert seen["cases"]["planners"] == ["dmp", "stomp", "own"]
    assert seen["cases"]["arms"] == ["a.xml:one,two"]
    assert (seen["date"], seen["merge"]) == ("2030-01-02", ["x", "y"])
    assert seen["line"] == f"lieednn-sim compare {words}"
    assert given_to(monkeypatch, "view")["imported"] == {}
    assert given_to(monkeypatch, "export", "a", "b", "--format", "csv")["runs"] == ["a", "b"]


def test_the_options_of_a_planner_are_those_of_its_class(capsys):
    options = read_options(
        ShapedOptions(), ["rate=0.5", "guide.search.spacings=0.1,0.05", "neurons=8", "guide.optimised=false"]
    )
    assert (options.rate, options.neurons, options.guide.optimised) == (0.5, (8,), False)
    assert options.guide.search.spacings == (0.1, 0.05)
    assert options.guide.searches == ShapedOptions().guide.searches
    assert "guide.search.spacings" in option_names(options)
    for text in ("guide=1", "rate.x=1", "guide.speed=1", "guide.optimised=yes"):
        with pytest.raises(InputError, match=r"NAME=VALUE with a name of|option optimised must be true or false"):
            read_options(ShapedOptions(), [text])
    # Of another package, where annotations may be the types themselves.
    own = make_dataclass("Own", [("gain", float, 1.0), ("sizes", tuple[int, ...], (1,)), ("call", object, None)])
    assert read_options(own(), ["gain=2", "sizes=3,4"]) == own(2.0, (3, 4))
    with pytest.raises(InputError, match="option call cannot be read from a text"):
        read_options(own(), ["call=1"])
    # The help of a planner says so without loading it, and tells every option that there is.
    for planner, entry in registry.PLANNERS.entries.items():
        with pytest.raises(SystemExit):
            main(["plan", "--planner", planner, "--help"])
        printed = capsys.readouterr().out
        for name in option_names(entry.options()) if entry.options else ():
            assert f"\n{name}=" in printed, (planner, name)


def test_the_help_lists_what_there_is(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert list(registry.ARMS) == arm_names()
    for command in ("demo", "plan"):
        text = help_of(command)
        assert text.index("one of these (default: lieednn-certified;") < text.index("minimum-jerk: straight")
        assert all(name in text for name in (*registry.ARMS, *registry.SCENES))
    for command, listed in (
        *(("plan", registry.PLANNERS), ("simulate", registry.CONTROLLERS), ("view", registry.POLICIES)),
        *(("export", registry.FORMATS), ("train", registry.ALGORITHMS)),
    ):
        assert all(f"{name}: {entry.help}" in help_of(command) for name, entry in listed.entries.items())
    assert all(name in help_of("compare") for name in registry.PLANNERS.entries)
    assert "--duration X duration of the motion [s] (default: 4; plans of slow arms get up to 60)" in help_of("plan")
    assert "--size WxH (width, height) in pixels (default: 1280x720)" in help_of("render")
    assert "--time-budget X largest CPU time for planning [s]; inf for no limit (default: 60)" in help_of("plan")
    assert main(["--help"]) == main([]) == 0
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 78
    assert len(ALL) == 12
    for command, module in ALL.items():
        assert f"\n  {command} " in printed
        assert parser.definition(module, command).docstring.split("\n\n")[0].endswith(".")


@pytest.mark.parametrize("command", ALL)
def test_every_option_says_what_it_is(command):
    described = parser.make_parser(parser.definition(ALL[command], command))._actions
    assert [action.option_strings or action.dest for action in described if not action.help] == []


def test_the_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"lieednn-sim {metadata.version('lieednn_sim')}\n"
    assert lieednn_sim.__version__ == metadata.version("lieednn_sim")
    with pytest.raises(AttributeError, match="no attribute 'version'"):
        lieednn_sim.version  # noqa: B018


def test_the_help_imports_nothing_heavy():
    code = (
        "import sys\n"
        "from lieednn_sim.cli import main\n"
        "for words in ('--help', 'demo --help', 'compare --help', 'plan --planner dmp --help'):\n"
        "    try: main(words.split())\n"
        "    except SystemExit: pass\n"
        "assert not {'numpy', 'mujoco', 'scipy', 'rich'} & set(sys.modules), 'heavy import'"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "usage: lieednn-sim compare [OPTIONS]" in done.stdout
