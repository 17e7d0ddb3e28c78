"""The parser of a command's line, made from the signature of its function (`signatures`): its help, and its call."""

from __future__ import annotations

import argparse
import difflib
import importlib
import re
import shlex
import shutil
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any, NoReturn

from lieednn_sim import registry
from lieednn_sim.cli.kinds import KINDS
from lieednn_sim.cli.signatures import Definition, Parameter, find, parameters
from lieednn_sim.errors import InputError

_PROGRAM = "lieednn-sim"


def definition(module: str, command: str) -> Definition:
    """The function of a command in a module of `lieednn_sim.cli`."""
    result = find(f"lieednn_sim.cli.{module}", command)
    assert result is not None
    return result


def overview(description: str, commands: Mapping[str, Mapping[str, str]]) -> str:
    """The help of the program: its commands by groups, with the first lines of their docstrings."""
    width = max(shutil.get_terminal_size().columns - 2, 24)  # like argparse
    lines = [f"usage: {_PROGRAM} COMMAND ...", "", *textwrap.wrap(description, width), ""]
    for group, members in commands.items():
        lines.append(f"{group}:")
        for command, module in members.items():
            summary = definition(module, command).docstring.partition("\n")[0].rstrip(".")
            text = f"  {command:<10}{summary[0].lower()}{summary[1:]}"
            lines += textwrap.wrap(text, width, subsequent_indent=12 * " ")
        lines.append("")
    last = f"{_PROGRAM} COMMAND --help explains the options of a command, --version prints the version"
    return "\n".join([*lines, *textwrap.wrap(last, width)])


def bind(source: Definition, words: Sequence[str]) -> Callable[[], Any]:
    """A call of a command's function with the arguments in the words; all others have the function's defaults.

    `InputError` if the words are wrong, `SystemExit` once the help is printed; nothing is imported for it.
    """
    taken = parameters(source)
    parser = make_parser(source)
    parser.epilog = _planner_help(words)
    space, unknown = parser.parse_known_args(words)
    line = shlex.join([_PROGRAM, source.node.name, *words])
    given = vars(space) | {each.option: line for each in taken if each.kind == "CommandLine"}
    if unknown:
        known = [name for action in parser._actions for name in action.option_strings]
        parser.error(f"{unknown[0]} is not understood{near(unknown[0].partition('=')[0], known)}")
    function = getattr(importlib.import_module(source.module), source.node.name)
    return partial(function, **_arguments(taken, given))


def _planner_help(words: Sequence[str]) -> str:
    """The values of ``--option`` for the planner that the words name, a line for each."""
    parts = [part for word in words for part in word.split("=", 1)]
    named = [after for part, after in pairwise(parts) if part == "--planner"]
    entry = next((registry.PLANNERS.entries[name] for name in named if name in registry.PLANNERS.entries), None)
    if entry is None or not isinstance(entry.takes, str) or not entry.takes:
        return ""
    options = find(f"lieednn_sim.{entry.place.partition(':')[0]}", entry.takes)
    assert options is not None
    return "\n".join(["options of this planner, for --option:", *_settings(parameters(options))])


def _settings(taken: Iterable[Parameter], within: str = "") -> Iterator[str]:
    for each in taken:
        if each.group:
            yield from _settings(each.group, f"{within}{each.name}.")
        else:
            yield f"{within}{each.name}={KINDS[each.kind].metavar}: {each.help}{_default(each)}"


def near(word: str, known: Iterable[str]) -> str:
    """A question that names the known word nearest to a word; empty if none is near."""
    close_matches = difflib.get_close_matches(word, list(known), 1)
    return f", did you mean {close_matches[0]}?" if close_matches else ""


def make_parser(source: Definition) -> argparse.ArgumentParser:
    """The parser of a command, with its function's parameters; each group has its own title."""
    taken = parameters(source)
    summary, _, more = source.docstring.partition("Args:")[0].partition("\n")
    words = [(each.option.upper(), each.required) for each in taken if each.positional]
    parser = _Parser(
        prog=f"{_PROGRAM} {source.node.name}",
        usage=" ".join(["%(prog)s [OPTIONS]", *(word if required else f"[{word}]" for word, required in words)]),
        description=" ".join([summary, *more.split()]),
        formatter_class=_Help,
        argument_default=argparse.SUPPRESS,
    )
    _add(parser, parser, taken)
    return parser


def _add(parser: argparse.ArgumentParser, group: Any, taken: Iterable[Parameter]) -> None:
    for each in taken:
        if not each.kind:
            _add(parser, parser.add_argument_group(each.help), each.group)
        elif each.kind != "CommandLine":
            _add_option(group, each)


def _add_option(group: Any, taken: Parameter) -> None:
    kind = KINDS[taken.kind]
    text = taken.help
    how: dict[str, Any] = {"dest": taken.option, "metavar": kind.metavar, "type": kind.read}
    if taken.positional:
        name, how["metavar"] = how.pop("dest"), taken.option.upper()
        several, single = ("+", None) if taken.required else ("*", "?")
        how["nargs"] = several if kind.words else single
    elif taken.kind == "bool":
        name = f"--no-{taken.option}" if taken.default else f"--{taken.option}"
        text = f"do not {text}" if taken.default else text
        how = {"dest": taken.option, "action": "store_false" if taken.default else "store_true"}
    else:
        name = f"--{taken.option}"
        how |= {"required": taken.required, "action": kind.action} | ({"nargs": "+"} if kind.words else {})
        text += "; may be repeated" if kind.action == "append" else ""
    text = text if "default" in text.lower() else text + _default(taken)
    group.add_argument(name, help=_filled(text), **how)


def _default(taken: Parameter) -> str:
    value = taken.default
    if isinstance(value, bool) or value in (None, "", (), []):
        return ""
    entries = value if isinstance(value, tuple) else (value,)
    texts = [f"{each:g}" if isinstance(each, float) else str(each) for each in entries]
    return f" (default: {('x' if taken.kind == 'tuple[int, int]' else ',').join(texts)})"


def _filled(text: str) -> str:
    """The text with all names in place of "a name of PLANNERS", or of another registry.

    At the end of the text, or before its default, each name has a line with its description.
    """

    def listed(reference: re.Match[str]) -> str:
        result = getattr(registry, reference[1], None)
        if result is None:
            return reference[0]
        if reference[2] is None:
            return ", ".join(result.entries)
        lines = (f"\n{name}: {entry.help}" for name, entry in result.entries.items())
        return f"one of these{reference[2]}:{''.join(lines)}"

    return re.sub(r"\ba name of (?:[a-z]\w*\.)*([A-Z_]+)(?:( \([^)]*\)|)$)?", listed, text).replace("%", "%%")


def _arguments(taken: Iterable[Parameter], given: Mapping[str, Any]) -> dict[str, Any]:
    """The given arguments by the parameters' names; those of a group become one object."""
    values: dict[str, Any] = {}
    for each in taken:
        if each.group:
            inner = _arguments(each.group, given)
            makes = each.makes
            make = getattr(importlib.import_module(makes.module), makes.node.name) if makes else dict
            values[each.name] = make(**inner)
        elif each.option in given:
            value = given[each.option]
            values[each.name] = tuple(value) if KINDS[each.kind].action == "append" else value
    return values


class _Parser(argparse.ArgumentParser):
    """Raises `InputError` for wrong words, and accepts a list of numbers that begins with a minus sign as a value."""

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        self._negative_number_matcher = re.compile(r"-\.?\d")

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message} ({self.prog} --help)")


class _Help(argparse.HelpFormatter):
    """Keeps line breaks, and adds none at hyphens."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        lines = text.splitlines()
        return [part for line in lines for part in textwrap.wrap(line, width, break_on_hyphens=False)]

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n".join(self._split_lines(text, width))
