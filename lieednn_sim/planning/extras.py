"""Optional libraries of planners and of the fastest time law: which are missing, and what to install."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.learning.demonstrations import probabilistic

# Libraries that planners need besides the package's dependencies.
REQUIREMENTS: dict[str, tuple[str, ...]] = {
    "dmp": probabilistic.LIBRARIES,
    **dict.fromkeys(
        ("lieednn-guided", "rrt-connect", "rrt-star", "informed-rrt-star", "bit-star", "aorrtc"), ("ompl",)
    ),
    "mjpl": ("mjpl",),
    "sscbirrt": ("sscbirrt",),
}
# Commands that install them.
INSTALL: dict[str, str] = {
    **dict.fromkeys(probabilistic.LIBRARIES, probabilistic.INSTALL),
    "ompl": "pip install 'lieednn_sim[rivals]'",
    **dict.fromkeys(("mjpl", "sscbirrt"), "pip install 'lieednn_sim[cbirrt]'"),
    "toppra": "pip install 'lieednn_sim[timing]'",
}


def missing_planners() -> dict[str, str]:
    """Names of the planners whose libraries are not installed, with the commands that install them."""
    missing = {}
    for planner, modules in REQUIREMENTS.items():
        absent = [module for module in modules if importlib.util.find_spec(module) is None]
        if absent:
            missing[planner] = INSTALL[absent[0]]
    return missing


def require_planner(name: str) -> None:
    """Raise `LieEDNNError` if a library that a planner needs is not installed; the message says what to do.

    No other planner takes its place: results must not depend on what is installed.
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
        users = [repr(planner) for planner, modules in REQUIREMENTS.items() if library in modules]
        need = (
            "the planner {} needs" if len(users) == 1 else "the planners {} need" if users else "the fastest law needs"
        )
        raise LieEDNNError(f"{need.format(', '.join(users))} {library}: {INSTALL[library]}") from None
