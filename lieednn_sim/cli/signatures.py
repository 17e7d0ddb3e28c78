"""The options of a command: the parameters of its function, read from the source without importing anything.

The packages behind a command take more than a second to import, which is too long for its help. So annotation, default
and text of an option are read where its parameter is defined.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from lieednn_sim.cli.kinds import kind_of

_ROOT = Path(__file__).resolve().parents[2]


class Definition(NamedTuple):
    """A name that a module defines: a function, a class or a constant; ``node`` is its syntax tree."""

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
    kind: str  # its annotation without None, a name of `kinds.KINDS`; empty for a group of other parameters
    help: str  # its text in the docstring
    option: str  # its name on the command line
    positional: bool = False  # whether it is a positional argument
    required: bool = False  # whether it has no default
    default: Any = None  # its default, if that can be read from the source
    group: tuple[Parameter, ...] = ()  # the parameters of its value, if that is a dataclass or a mapping
    makes: Definition | None = None  # the class of which a group is made; None for a mapping


def find(module: str, name: str) -> Definition | None:
    """The definition of a name in a module of this package, which may import it from another module."""
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

    Parameters are left out unless they are of a kind of `kinds.KINDS`, a dataclass, or ``Annotated``.
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
        # Every key of a TypedDict may be omitted.
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
    """The docstring's text on each argument or attribute, in one line and without backquotes."""
    section = re.search(r"^(?:Args|Attributes):\n(.*?)(?=^\S|\Z)", docstring, re.MULTILINE | re.DOTALL)
    entries = re.findall(r"^    (\w+): (.*(?:\n {5,}.*)*)", section[1] if section else "", re.MULTILINE)
    return {name: " ".join(text.replace("`", "").split()).rstrip(".") for name, text in entries}
