"""Optional libraries of the rival planners: which are missing, and what to install."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from lieednn_sim.errors import LieEDNNError

# The libraries that a planner needs beside the package's own.
REQUIREMENTS: dict[str, tuple[str, ...]] = {
    # The primitives' library imports pytransform3d and does not say so.
    "dmp": ("movement_primitives", "pytransform3d"),
    "lieednn-guided": ("ompl",),
    "rrt-connect": ("ompl",),
    "rrt-star": ("ompl",),
}
_INSTALL = "pip install 'lieednn_sim[rivals]'"


def missing_planners() -> dict[str, str]:
    """Names of the planners whose libraries are not installed, with what installs them."""
    return {
        name: _INSTALL
        for name, modules in REQUIREMENTS.items()
        if any(importlib.util.find_spec(module) is None for module in modules)
    }


def optional_module(name: str) -> Any:
    """Import a module of an optional library.

    Raises:
        LieEDNNError: it is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(name)
    except ImportError:
        library = name.partition(".")[0]
        users = ", ".join(repr(planner) for planner, modules in REQUIREMENTS.items() if library in modules)
        raise LieEDNNError(f"the planners {users} need {library}: {_INSTALL}") from None
