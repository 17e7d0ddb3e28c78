"""Versions of the packages on which results depend, and of the code itself."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import re
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

# All results depend on the former, and those of some planners on the latter.
_PACKAGES, _OPTIONAL = ("lieednn_sim", "mujoco", "numpy", "scipy"), ("daqp", "ompl", "toppra")
_HERE = Path(__file__).parents[1]
# What makes the rows of tables.
_TABLES = ("studies.comparison.study", "studies.reactions.study", "studies.problems.study")
# Modules and rooms that no number depends on: they show results, store them, divide the work, or refuse bad input.
_LEFT_OUT = (
    *("cli", "rendering", "studies.report", "studies.comparison.summary", "studies.problems.summary"),
    *("evaluation.display", "evaluation.figure_layout", "evaluation.plots", "studies.demonstrations.plots"),
    *("evaluation.plot_training", "studies.table", "io", "versions"),
    *("studies.cluster", "studies.study", "studies.comparison.merging", "studies.workers"),
    *("studies.markdown", "errors", "validation"),
)
_PACKAGE = "lieednn_sim"
# Something in a module of the package, as in `registry`.
_PLACE = re.compile(r"([a-z_]+(?:\.[a-z_]+)+):\w+")


@cache
def code_version(*roots: str, folder: Path = _HERE) -> str:
    """Hash of the code that results depend on: syntax trees of modules without docstrings, and all MJCF files.

    Comments and layout do not change it, nor does it differ between a checkout and a wheel or versions of Python.

    Args:
        roots: names of modules, such as ``lieednn_sim.planning`` or of a script; they count, and so does what they
            import, anywhere in them and in turn, but for modules that only show, store or check. By default, what
            makes the rows of tables.
        folder: folder of the package, with ``scripts`` beside it if scripts are among the roots.
    """
    digest = hashlib.sha256()
    for name, path in sorted(modules(*roots, folder=folder).items()):
        digest.update(name.encode() + b"\0" + _read(path).digest)
    # Beside the package in a checkout.
    assets = next((one for one in (folder / _PACKAGE / "assets", folder / "assets") if one.is_dir()), folder)
    for path in sorted(assets.glob("mjcf/**/*.xml")):
        digest.update(path.relative_to(assets).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def modules(*roots: str, folder: Path = _HERE) -> dict[str, Path]:
    """Files by the names of the modules that count for `code_version`; arguments as there."""
    roots = roots or tuple(f"{_PACKAGE}.{name}" for name in _TABLES)
    # A root's own room counts, although others leave it out.
    left_out = [f"{_PACKAGE}.{part}" for part in _LEFT_OUT]
    left_out = [part for part in left_out if not any(_within(root, part) for root in roots)]
    found: dict[str, Path] = {}
    todo = list(roots)
    while todo:
        name = todo.pop()
        path = _file(name, folder)
        if name in found or path is None or any(_within(name, one) for one in left_out):
            continue
        found[name] = path
        for module, item, _ in _read(path).imports:
            # The package needs no scripts.
            if _within(module, _PACKAGE) or not _within(name, _PACKAGE):
                todo.append(_home(module, item, folder))
    return found


def _within(name: str, package: str) -> bool:
    return name == package or name.startswith(f"{package}.")


def _file(module: str, folder: Path) -> Path | None:
    """The module's file; None if it is of another package."""
    base = (folder if _within(module, _PACKAGE) else folder / "scripts").joinpath(*module.split("."))
    return next((one for one in (base.with_name(f"{base.name}.py"), base / "__init__.py") if one.is_file()), None)


def _home(module: str, item: str, folder: Path) -> str:
    """The module in which what is imported from a module lives: a room's names are those of its modules."""
    if not item or _file(f"{module}.{item}", folder):
        return f"{module}.{item}" if item else module
    path = _file(module, folder)
    if path is not None and path.name == "__init__.py":
        for other, name, alias in _read(path).imports:
            if alias == item:
                return _home(other, name, folder)
    return module


class _Module(NamedTuple):
    """Digest of a module's syntax tree, and what it imports: modules, names of theirs if any, and names for these."""

    digest: bytes
    imports: tuple[tuple[str, str, str], ...]


def _read(path: Path) -> _Module:
    return _read_once(path, path.stat().st_mtime_ns)


@cache
def _read_once(path: Path, _modified: int) -> _Module:
    parts: list[str] = []
    imports: list[tuple[str, str, str]] = []
    _tell(ast.parse(path.read_bytes()), parts, imports)
    return _Module(hashlib.sha256(" ".join(parts).encode()).digest(), tuple(imports))


def _tell(node: ast.AST, parts: list[str], imports: list[tuple[str, str, str]]) -> None:
    """Add the parts of a syntax tree, without what differs between versions of Python, and its imports."""
    parts.append(type(node).__name__)
    if isinstance(node, ast.ImportFrom):
        imports += [(node.module or "", one.name, one.asname or one.name) for one in node.names]
    elif isinstance(node, ast.Import):
        imports += [(one.name, "", "") for one in node.names]
    for name in node._fields:
        value = getattr(node, name, None)
        if value is None or name == "ctx":
            continue
        if isinstance(value, ast.AST):
            parts.append(name)
            _tell(value, parts, imports)
        elif isinstance(value, list):
            if value:
                parts.append(name)
                for one in value[1:] if name == "body" and _documented(value[0]) else value:
                    if isinstance(one, ast.AST):
                        _tell(one, parts, imports)
                    else:
                        parts.append(repr(one))
        else:
            parts += (name, repr(value))
            if isinstance(value, str) and isinstance(node, ast.Constant):
                # A module that is imported by its name, or something in it.
                if value.startswith("lieednn_sim."):
                    imports.append((value, "", ""))
                elif place := _PLACE.fullmatch(value):
                    imports.append((f"lieednn_sim.{place[1]}", "", ""))
    parts.append(")")


def _documented(statement: ast.stmt) -> bool:
    """Whether a body's first statement is a docstring."""
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


# Cached, since every task on a cluster asks.
_version = cache(metadata.version)


def versions(*, optional: bool = False, code: bool = False) -> dict[str, str]:
    """Versions by package, optionally with those of the planners' installed libraries, and of the code."""
    found = {name: _version(name) for name in _PACKAGES}
    if code:
        found["code"] = code_version()
    for name in _OPTIONAL if optional else ():
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = _version(name)
    return found
