"""The parser of a command's line, made from the signature of its function: names, kinds, defaults and texts.

These are read from the source, and nothing is imported: the packages behind a command take more than a second to load,
which its help must not. So an option of a command is what a parameter says where it is defined.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import importlib
import re
import shlex
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from lieednn_sim import registry
from lieednn_sim.cli.kinds import KINDS, kind_of
from lieednn_sim.errors import InputError

_PROGRAM = "lieednn-sim"
_ROOT = Path(__file__).resolve().parents[2]


class Definition(NamedTuple):
    """A name that a module defines: a function, a class or a constant; ``node`` is what the module says there."""

    module: str
    node: Any  # ast.FunctionDef, ast.ClassDef or ast.expr

    @property
    def docstring(self) -> str:
        """Docstring of the function or class, without indentation."""
        return ast.get_docstring(self.node) or ""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a function, or a field of a dataclass."""

    name: str
    kind: str  # its annotation without None, a name of `kinds.KINDS`; empty where it is a group of other parameters
    help: str  # its text in the docstring
    option: str  # its name on the command line
    positional: bool = False  # whether it is given by its place
    required: bool = False  # whether it has no default
    default: Any = None  # as far as its source tells
    group: tuple[Parameter, ...] = ()  # what its value is made of, if it is a dataclass or a mapping
    makes: Definition | None = None  # the class of which a group is made; None for a mapping


def find(module: str, name: str) -> Definition | None:
    """The definition of a name in a module of this package, also where that imports it from another one."""
    for node in _tree(module).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return Definition(module, node)
        if isinstance(node, ast.Assign) and any(isinstance(to, ast.Name) and to.id == name for to in node.targets):
            return Definition(module, node.value)
        if isinstance(node, ast.ImportFrom) and node.module is not None and node.module.startswith("lieednn_sim"):
            for alias in node.names:
                if name == (alias.asname or alias.name):
                    return find(node.module, alias.name)
    return None


def parameters(source: Definition) -> list[Parameter]:
    """The parameters of a function in their order, or the fields of a dataclass and its bases.

    Those that are neither of a kind of `kinds.KINDS`, nor a dataclass, nor ``Annotated``, are left out.
    """
    result: dict[str, Parameter] = {}
    for base in source.node.bases if isinstance(source.node, ast.ClassDef) else ():
        if isinstance(base, ast.Name) and (parent := find(source.module, base.id)) is not None:
            result |= {each.name: each for each in parameters(parent)}
    texts = {name: each.help for name, each in result.items()} | descriptions(source.docstring)
    for entry in _entries(source.node):
        if (own := _parameter(source.module, entry, texts)) is not None:
            result[own.name] = own
    return list(result.values())


# Name, annotation and default, and whether it is given by its place.
_Entry = tuple[str, ast.expr, ast.expr | None, bool]


def _entries(node: ast.AST) -> Iterator[_Entry]:
    if isinstance(node, ast.FunctionDef):
        given = node.args
        missing: list[None] = [None] * (len(given.args) - len(given.defaults))
        pairs = [
            *zip(given.args, [*missing, *given.defaults], [True] * len(given.args), strict=True),
            *zip(given.kwonlyargs, given.kw_defaults, [False] * len(given.kwonlyargs), strict=True),
        ]
        for argument, default, positional in pairs:
            if argument.annotation is not None:
                yield argument.arg, argument.annotation, default, positional
    elif isinstance(node, ast.ClassDef):
        # All that a TypedDict names may be left out.
        mapping = any(isinstance(base, ast.Name) and base.id == "TypedDict" for base in node.bases)
        for line in node.body:
            if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
                yield line.target.id, line.annotation, ast.Constant(None) if mapping else line.value, False


def _parameter(module: str, entry: _Entry, texts: dict[str, str]) -> Parameter | None:
    name, annotation, default, positional = entry
    help_text, option = texts.get(name, ""), name.replace("_", "-")
    if kind := kind_of(ast.unparse(annotation)):
        value = None if default is None else _value(module, default)
        return Parameter(name, kind, help_text, option, positional, default is None, value)
    if isinstance(annotation, ast.Name) and (alias := find(module, annotation.id)) and isinstance(alias.node, ast.expr):
        module, annotation = alias.module, alias.node
    chosen: list[str] = []
    makes = source = None
    if isinstance(annotation, ast.Subscript) and ast.unparse(annotation.value) == "Annotated":
        assert isinstance(annotation.slice, ast.Tuple)
        annotation, *more = annotation.slice.elts
        for part in more:
            if isinstance(part, ast.Name):
                source = find(module, part.id)
            else:
                chosen.append(ast.literal_eval(part))
    if isinstance(annotation, ast.Name):
        makes = find(module, annotation.id)
    source = source or makes
    if source is None or not isinstance(source.node, ast.FunctionDef | ast.ClassDef):
        return None
    return Parameter(name, "", help_text, option, group=tuple(_chosen(source, chosen)), makes=makes)


def _chosen(source: Definition, names: list[str]) -> Iterator[Parameter]:
    """The parameters of these names, or all for ``*`` or none; ``seed as noise_seed`` gives one another name."""
    known = {each.name: each for each in parameters(source) if not each.positional}
    others = {name: other or name for name, _, other in (entry.partition(" as ") for entry in names or ["*"])}
    for name in known if "*" in others else others:
        yield replace(known[name], option=others.get(name, name).replace("_", "-"))


@cache
def _tree(module: str) -> ast.Module:
    path = _ROOT.joinpath(*module.split("."))
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(path.read_text(encoding="utf-8"))


def _value(module: str, node: ast.expr) -> Any:
    """The value of a default: a literal, or a constant of this package."""
    if isinstance(node, ast.Name) and (constant := find(module, node.id)) is not None:
        return _value(constant.module, constant.node) if isinstance(constant.node, ast.expr) else None
    try:
        return ast.literal_eval(node)
    except ValueError:
        return None


def descriptions(docstring: str) -> dict[str, str]:
    """What the docstring says of each argument or attribute, in one line and without marks of code."""
    section = re.search(r"^(?:Args|Attributes):\n(.*?)(?=^\S|\Z)", docstring, re.MULTILINE | re.DOTALL)
    entries = re.findall(r"^    (\w+): (.*(?:\n {5,}.*)*)", section[1] if section else "", re.MULTILINE)
    return {name: " ".join(text.replace("`", "").split()).rstrip(".") for name, text in entries}


def definition(module: str, command: str) -> Definition:
    """The function of a command in a module of `lieednn_sim.cli`."""
    result = find(f"lieednn_sim.cli.{module}", command)
    assert result is not None
    return result


def overview(description: str, commands: Mapping[str, Mapping[str, str]]) -> str:
    """The help of the program: its commands by groups, with the first lines of their docstrings."""
    lines = [f"usage: {_PROGRAM} COMMAND ...", "", *textwrap.wrap(description, 100), ""]
    for group, members in commands.items():
        lines.append(f"{group}:")
        for command, module in members.items():
            summary = definition(module, command).docstring.partition("\n")[0]
            lines.append(f"  {command:<12}{summary[0].lower()}{summary[1:].rstrip('.')}")
        lines.append("")
    last = f"{_PROGRAM} COMMAND --help explains the options of a command, --version prints the version"
    return "\n".join([*lines, last])


def bind(source: Definition, words: Sequence[str]) -> Callable[[], Any]:
    """A call of a command's function with what the words say, of which what is not given has the function's default.

    Raises:
        InputError: the words are wrong.
        SystemExit: the help is printed; nothing is imported for it.
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
    """What ``--option`` takes for the planner that the words name, a line for each."""
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
    """A question that names the known word which is nearest to another one, if any is."""
    close_matches = difflib.get_close_matches(word, list(known), 1)
    return f", did you mean {close_matches[0]}?" if close_matches else ""


def make_parser(source: Definition) -> argparse.ArgumentParser:
    """The parser of a command: its function's parameters, those in groups under a title of their own."""
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
    if isinstance(value, bool) or value in (None, "", ()):
        return ""
    entries = value if isinstance(value, tuple) else (value,)
    texts = [f"{each:g}" if isinstance(each, float) else str(each) for each in entries]
    return f" (default: {('x' if taken.kind == 'tuple[int, int]' else ',').join(texts)})"


def _filled(text: str) -> str:
    """The text with the names that there are in place of "a name of PLANNERS", or of another registry.

    At the end of the text, or before its default, each has a line and says what it is.
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
    """The given arguments by the parameters' names, with those of groups made."""
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
    """Raises `InputError` for wrong words, and takes several numbers of which the first is negative for a value."""

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
