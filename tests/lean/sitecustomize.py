"""Python runs this first in the processes of the tests: SciPy is imported without what nobody needs there.

It reads the documentation of its functions to add notes to it, and imports all of NumPy, with a reader of Fortran. That
takes a fifth of the time until a process that a test starts has imported the package.
"""

from __future__ import annotations

import sys
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType, SimpleNamespace
from typing import Any


class Unwritten:
    """Documentation without sections."""

    def __init__(self, *_: object) -> None: ...

    def __getitem__(self, _: str) -> list[object]:
        return []

    def __setitem__(self, *_: object) -> None: ...

    def __str__(self) -> str:
        return "\n"


def find_spec(name: str, *given: Any) -> ModuleSpec | None:
    """Of one module nothing is there, of the other all but its reader."""
    if name == "numpy.f2py":
        return ModuleSpec(name, SimpleNamespace(create_module=lambda _: None, exec_module=lambda _: None))
    spec = PathFinder.find_spec(name, *given) if name == "scipy._lib._docscrape" else None
    if spec:
        run = spec.loader.exec_module

        def without_reader(module: ModuleType) -> None:
            run(module)
            module.FunctionDoc = Unwritten

        spec.loader.exec_module = without_reader
    return spec


sys.meta_path.insert(0, SimpleNamespace(find_spec=find_spec))
