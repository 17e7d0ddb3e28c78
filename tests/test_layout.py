"""The layout: a subpackage uses only what stands below it, and the package offers each of its names."""

from __future__ import annotations

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import lieednn_sim as ls

PACKAGE = Path(ls.__file__).parent
GROUND = (
    "errors",
    "validation",
    "typecheck",
    "values",
    "versions",
    "io",
    "budget",
    "entries",
    "registry",
    "_mujoco",
    "_processes",
)
SUBPACKAGES = (
    "lie",
    "stability",
    "network",
    "theory",
    "synthesis",
    "learning",
    "arm",
    "planning",
    "policies",
    "simulation",
    "rendering",
    "evaluation",
    "studies",
    "environments",
    "exports",
    "live",
    "cli",
    "__main__",
)


@cache
def imports(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """The imports anywhere in a module."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def imported(path: Path) -> set[str]:
    """What of the package, by the name of its subpackage, a module imports anywhere in it."""
    subpackages = set()
    for node in imports(path):
        if isinstance(node, ast.ImportFrom) and node.module == "lieednn_sim":
            subpackages |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("lieednn_sim."):
            subpackages.add(node.module.split(".")[1])
        elif isinstance(node, ast.Import):
            subpackages |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("lieednn_sim.")}
    return subpackages


def test_there_are_no_other_rooms():
    found = {
        path.name.removesuffix(".py") for path in PACKAGE.iterdir() if path.suffix == ".py" or any(path.rglob("*.py"))
    }
    assert found - {"__pycache__", "__init__", "assets"} == {*GROUND, *SUBPACKAGES}


def test_nothing_is_imported_from_a_room_above():
    order = (*GROUND, *SUBPACKAGES)
    upwards = {
        f"{path.relative_to(PACKAGE)} imports {subpackage}"
        for path in PACKAGE.rglob("*.py")
        if path.parent != PACKAGE or path.stem != "__init__"
        for subpackage in imported(path)
        if order.index(subpackage) > order.index(path.relative_to(PACKAGE).parts[0].removesuffix(".py"))
    }
    assert upwards == set()


def test_no_module_needs_itself():
    """Not even for types, or on the way through the `__init__` of a subpackage."""
    paths = {path: path.relative_to(PACKAGE.parent).with_suffix("").parts for path in PACKAGE.rglob("*.py")}
    modules = {".".join(parts).removesuffix(".__init__"): path for path, parts in paths.items()}
    needs: dict[str, set[str]] = {module: set() for module in modules}
    for module, path in modules.items():
        for node in imports(path):
            if isinstance(node, ast.ImportFrom) and node.module in modules:
                names = (f"{node.module}.{alias.name}" for alias in node.names)
                needs[module] |= {name if name in modules else node.module for name in names}
            elif isinstance(node, ast.Import):
                needs[module] |= {alias.name for alias in node.names} & modules.keys()
    assert needs["lieednn_sim.simulation.log"] >= {"lieednn_sim.simulation.simulation", "lieednn_sim.values"}
    TopologicalSorter(needs).prepare()  # raises CycleError, with the modules


def test_the_front_door_knows_each_name_and_where_it_lives():
    named = re.findall(
        r"from lieednn_sim\.(\S+) import (\w+) as \2$", (PACKAGE / "__init__.pyi").read_text(), re.MULTILINE
    )
    assert {name: subpackage for subpackage, name in named} == ls._MODULE_OF
    for name in ls.__all__:
        value = getattr(ls, name)
        assert value.__name__ == name
        assert value.__module__.startswith(f"lieednn_sim.{ls._MODULE_OF[name]}")
    assert {*ls.__all__, "__version__"} <= set(dir(ls))
    stub = ast.parse((PACKAGE / "__init__.pyi").read_text())
    rooms = [name.name for node in stub.body if getattr(node, "module", "") == "lieednn_sim" for name in node.names]
    assert rooms == sorted(ls._SUBPACKAGES)
    # Type checkers find names that are misspelt.
    assert not any(isinstance(node, ast.FunctionDef) for node in stub.body)


def test_the_api_reference_has_a_page_for_each_room():
    """On which its `__all__` is, by the template."""
    listed = re.findall(r"^   lieednn_sim\.(\w+)$", (PACKAGE.parent / "docs/api/index.md").read_text(), re.MULTILINE)
    assert listed == ["errors", "budget", *SUBPACKAGES[: SUBPACKAGES.index("cli")]]


def test_the_tests_that_the_documents_name_are_there():
    root = PACKAGE.parent
    named = [
        (document.name, *reference)
        for document in (*root.glob("docs/**/*.md"), *root.glob("results/reference/*.md"), *root.glob("*.md"))
        for reference in re.findall(r"(tests/[\w/]+\.py)(?:::(\w+))?", document.read_text(encoding="utf-8"))
    ]
    assert len(named) > 10
    for document, path, test in named:
        assert (root / path).is_file(), f"{document} names {path}"
        assert not test or f"def {test}(" in (root / path).read_text(encoding="utf-8"), (
            f"{document} names {path}::{test}"
        )
