"""Optional libraries of the planners and of `retime`: which are missing, and how to install them."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.planner_table import PLANNERS


def missing_planners() -> dict[str, str]:
    """Names of the planners whose libraries are not installed, with the commands that install them."""
    return {
        name: _install(entry.extra)
        for name, entry in PLANNERS.items()
        if any(importlib.util.find_spec(library) is None for library in entry.libraries)
    }


def require_planner(name: str) -> None:
    """Raise `LieEDNNError` if a library that a planner needs is not installed; the message says what to do.

    No other planner is taken instead, since results must not depend on what is installed.
    """
    missing = missing_planners()
    if name in missing:
        raise LieEDNNError(
            f"planner {name!r} is not installed: {missing[name]}; or name another one, as "
            "lieednn-filtered, which needs no extra"
        )


def optional_module(name: str) -> Any:
    """Import a module of an optional library.

    Raises:
        LieEDNNError: it is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        library = name.partition(".")[0]
        extras = {planner: entry.extra for planner, entry in PLANNERS.items() if library in entry.libraries}
        users = ", ".join(map(repr, extras))
        need = f"the planner{'s' * (len(extras) > 1)} {users} need{'s' * (len(extras) == 1)}"
        extra = next(iter(extras.values()), "timing")
        raise LieEDNNError(f"{need if extras else 'the fastest law needs'} {library}: {_install(extra)}") from None


def _install(extra: str) -> str:
    return f"pip install 'lieednn_sim[{extra}]'"
