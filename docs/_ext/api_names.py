"""What the API reference lists, taken from each subpackage's `__all__`, and how the site links to it."""

from __future__ import annotations

import ast
import functools
import inspect
import re
import sys
import types
from collections.abc import Iterator
from importlib import import_module
from typing import Any

from docutils import nodes
from docutils.parsers.rst import roles
from sphinx.addnodes import desc_signature, pending_xref
from sphinx.application import Sphinx
from sphinx.domains.python import PyClasslike
from sphinx.pycode import ModuleAnalyzer

import lieednn_sim
from lieednn_sim.studies.rows import TableRow, columns_of

# Public modules whose names are not in their subpackage's own `__all__`.
MODULES = {
    "arm": ("targets",),
    "environments": ("tasks", "suite", "gymnasium", "expert"),
    "evaluation": ("plots",),
    "learning": ("demonstrations",),
    "rendering": ("video", "still", "page", "opengl"),
    "studies": ("report",),
}
KINDS = {"function": "Functions", "class": "Classes", "data": "Constants"}
FURTHER = "Classes that these take, return or extend"


def _names(module: str) -> list[str]:
    value = import_module(module)
    local = [name for name, item in vars(value).items() if getattr(item, "__module__", None) == module]
    return getattr(value, "__all__", None) or [name for name in local if not name.startswith("_")]


def public(module: str) -> dict[str, list[str]]:
    """Public names of a subpackage by their kind; a name of one of its `MODULES` has that module before it."""
    subpackage = module.partition(".")[2]
    # An empty `__all__` is a subpackage without names of its own.
    own = _names(module) if subpackage != "environments" else []
    names = own + [f"{part}.{name}" for part in MODULES.get(subpackage, ()) for name in _names(f"{module}.{part}")]
    kinds: dict[str, list[str]] = {kind: [] for kind in KINDS.values()}
    for name in sorted(names, key=lambda name: name.rpartition(".")[2].lower()):
        value = find(f"{module}.{name}")
        kind = "class" if inspect.isclass(value) else "function" if inspect.isroutine(value) else "data"
        kinds[KINDS[kind]].append(name)
    further = [name.removeprefix(f"{module}.") for name in SUPPORT if name.startswith(f"{module}.")]
    return {kind: found for kind, found in (kinds | {FURTHER: further}).items() if found}


def find(name: str) -> Any:
    """The object of a full name; where a module and a public name are the same, the public name."""
    value = import_module(name.partition(".")[0])
    path = value.__name__
    for part in name.split(".")[1:]:
        path += f".{part}"
        value = getattr(value, part) if hasattr(value, part) else import_module(path)
    return value


def comment(name: str) -> str:
    """The comment ``#:`` above a constant, wherever in the package it is defined."""
    module, _, constant = name.rpartition(".")
    analyzer = ModuleAnalyzer.for_module(module)
    while ("", constant) not in (found := analyzer.find_attr_docs()):
        imports = [node for node in ast.parse(analyzer.code).body if isinstance(node, ast.ImportFrom)]
        module = next(node.module for node in imports if constant in {alias.name for alias in node.names})
        analyzer = ModuleAnalyzer.for_module(module)
    return " ".join(found["", constant])


def own(cls: type) -> list[str]:
    """Public methods and properties that a class defines itself."""
    kinds = (property, functools.cached_property, classmethod, staticmethod, types.FunctionType)
    return [name for name, item in vars(cls).items() if isinstance(item, kinds) and not name.startswith("_")]


def inherited(name: str) -> dict[str, list[str]]:
    """Public methods and properties that a class has from other documented classes, by the full names of these."""
    cls = find(name)
    members, known = {}, set(own(cls))
    for base in cls.__mro__[1:]:
        if base in DOCUMENTED:
            members[DOCUMENTED[base]] = sorted(set(own(base)) - known)
        known |= set(own(base))
    return {base: found for base, found in members.items() if found}


def extends(name: str) -> bool:
    """Whether a class extends documented ones."""
    return any(base in DOCUMENTED for base in find(name).__mro__[1:])


def foreign(name: str) -> str:
    """Base classes of a class whose members are not repeated on its page: documented ones and other packages'."""
    bases = find(name).__mro__[1:]
    return ", ".join(b.__name__ for b in bases if b in DOCUMENTED or not b.__module__.startswith("lieednn_sim"))


def _annotated(value: Any) -> Iterator[type]:
    """Classes of the package that a function or a class mentions in its annotations, or that a class extends."""
    functions, texts = [value] if inspect.isroutine(value) else [], []
    for base in value.__mro__ if inspect.isclass(value) else ():
        if base.__module__.startswith("lieednn_sim"):
            yield base
            texts.append((vars(sys.modules[base.__module__]), vars(base).get("__annotations__", {})))
            items = (vars(base)[name] for name in own(base))
            functions += [
                getattr(item, "func", getattr(item, "fget", getattr(item, "__func__", item))) for item in items
            ]
    texts += [(one.__globals__, one.__annotations__) for one in map(inspect.unwrap, functions)]
    for scope, hints in texts:
        for words in re.findall(r"[\w.]+", " ".join(map(str, hints.values()))):
            first, *rest = words.split(".")
            found = functools.reduce(lambda item, name: getattr(item, name, None), rest, scope.get(first))
            if inspect.isclass(found) and found.__module__.startswith("lieednn_sim"):
                yield found


SUBPACKAGES = ("errors", "budget", *(subpackage for subpackage in lieednn_sim._SUBPACKAGES if subpackage != "cli"))
SUPPORT: list[str] = []
ALL = [
    f"lieednn_sim.{subpackage}.{name}"
    for subpackage in SUBPACKAGES
    for group in public(f"lieednn_sim.{subpackage}").values()
    for name in group
]
DOCUMENTED = {value: name for name in ALL if inspect.isclass(value := find(name))}
waiting = [find(name) for name in ALL]
while waiting:
    for cls in _annotated(waiting.pop()):
        if cls not in DOCUMENTED and not cls.__name__.startswith("_"):
            DOCUMENTED[cls] = f"{cls.__module__}.{cls.__qualname__}"
            SUPPORT.append(DOCUMENTED[cls])
            waiting.append(cls)
SUPPORT.sort(key=lambda name: name.rpartition(".")[2].lower())
ALL += SUPPORT
FRONT = {
    name: next(full for full in ALL if full.rpartition(".")[2] == name and find(full) is getattr(lieednn_sim, name))
    for name in lieednn_sim.__all__
}


def _arguments(value: Any) -> set[str]:
    try:
        found = set(inspect.signature(value).parameters) if callable(value) else set()
    except ValueError:  # exceptions and dictionaries
        return set()
    return found.union(*(_arguments(getattr(value, name)) for name in own(value))) if inspect.isclass(value) else found


# Words in single backticks that are both a public name and an argument's mean the argument.
ARGUMENTS = set().union(*(_arguments(find(name)) for name in ALL))
SHORT = {name.rpartition(".")[2]: name for name in reversed(ALL)}

_FLOATS = re.compile(
    r"(~?numpy\.)?ndarray\[tuple\[(~?typing\.)?Any, \.\.\.\], (~?numpy\.)?dtype\[(~?numpy\.)?float64\]\]"
)
_ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)|<factory>")


def role(_: str, raw: str, text: str, line: int, inliner: Any, options: Any = None, content: Any = ()) -> Any:
    """Single backticks in docstrings: code, which links to the API reference where it is a public name."""
    literal = nodes.literal(raw, text.replace("\0", ""), classes=["py"])
    first, dot, rest = literal.astext().removesuffix("()").partition(".")
    if literal.astext() in SUBPACKAGES:
        first = f"lieednn_sim.{first}"
    elif first.islower() and rest.partition(".")[0] in SHORT:  # after its subpackage or module
        first, dot, rest = rest.partition(".")
    if first in ARGUMENTS or not (first in SHORT or first.startswith("lieednn_sim")):
        return [literal], []
    target = SHORT.get(first, first) + dot + rest
    module = inliner.document.settings.env.ref_context.get("py:module")
    reference = pending_xref(
        raw, literal, refdomain="py", reftype="obj", reftarget=target, refexplicit=True, refwarn=False
    )
    reference["py:module"] = module
    return [reference], []


def _finish(_app: Sphinx, what: str, _name: str, value: Any, _options: Any, lines: list[str]) -> None:
    """Absolute values are no substitutions of reStructuredText; rows of tables have their columns."""
    if what == "class" and issubclass(value, TableRow) and value is not TableRow:
        last = max(index for index, line in enumerate(lines) if line.startswith(":ivar"))
        last += next((i for i, line in enumerate(lines[last:]) if not line.strip()), len(lines))
        lines[last:last] = [f":ivar {entry.name}: {entry.meaning}." for entry in columns_of(value)]
    for index, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`.*?`)", line)
        lines[index] = "".join(part if part.startswith("`") else part.replace("|", r"\|") for part in parts)


def _shorten_types(
    _app: Sphinx, _what: str, _name: str, _object: Any, _options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None]:
    """Arrays of floats by the name that the package gives them, and defaults that are no Python as dots."""
    short = (
        text and _FLOATS.sub("Floats", _ALIAS.sub(lambda match: match[1] or "...", text))
        for text in (signature, returns)
    )
    return next(short), next(short)


def _is_field(_app: Sphinx, what: str, _name: str, value: Any, skip: bool, _options: Any) -> bool | None:
    """Leave out fields with defaults: the section of attributes has them."""
    described = inspect.isroutine(value) or inspect.isclass(value) or inspect.isdatadescriptor(value)
    return True if what == "class" and not (described or hasattr(value, "__get__")) else None


def _resolve_front(app: Sphinx, env: Any, node: pending_xref, content: Any) -> Any:
    """Names of the front door, such as `lieednn_sim.plan`, and inherited methods link to where they are documented."""
    words = node.get("reftarget", "").removeprefix("lieednn_sim.").split(".")
    if node.get("refdomain") != "py" or not words[0]:
        return None
    name = ".".join([FRONT.get(words[0], node["reftarget"]), *words[1:]]) if words[0] in FRONT else node["reftarget"]
    owner, _, member = name.rpartition(".")
    if owner in ALL and inspect.isclass(find(owner)):
        name = next((f"{base}.{member}" for base, found in inherited(owner).items() if member in found), name)
    if name == node["reftarget"]:
        return None
    return env.get_domain("py").resolve_xref(env, node["refdoc"], app.builder, "obj", name, node, content)


def _also_by_subpackage(_app: Sphinx, doctree: nodes.document) -> None:
    """Names of modules can be reached by their subpackage, too: pages of sources link back by one prefix a module."""
    for signature in doctree.findall(desc_signature):
        subpackage = ".".join((signature.get("module") or "").split(".")[:2])
        name = f"{subpackage}.{signature.get('fullname')}"
        if subpackage.startswith("lieednn_sim.") and name not in signature["ids"]:
            signature["ids"].append(name)


def _defining_module(_app: Sphinx, module: str, name: str) -> str | None:
    """Where the source of a public name is, past the check of its arguments' types."""
    try:
        return getattr(inspect.unwrap(find(f"{module}.{name}")), "__module__", None)
    except (AttributeError, ModuleNotFoundError):
        return None


# Pages of names that differ in case alone, such as `plan` and `Plan`, have different files in every file system.
filenames = {name: f"{name}_class" for name in ALL if inspect.isclass(find(name)) and name.lower() in ALL}
# What the templates use.
context = {"comment": comment, "extends": extends, "foreign": foreign, "inherited": inherited, "public": public}
context["FRONT"] = FRONT


def setup(app: Sphinx) -> None:
    for field in PyClasslike.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"
    roles.register_local_role("name", role)
    app.connect("autodoc-process-docstring", _finish)
    app.connect("autodoc-process-signature", _shorten_types)
    app.connect("autodoc-skip-member", _is_field)
    app.connect("missing-reference", _resolve_front)
    app.connect("viewcode-follow-imported", _defining_module)
    app.connect("doctree-read", _also_by_subpackage)
