"""Versions of the packages on which results depend, and the commit of the checkout."""

from __future__ import annotations

import contextlib
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

# All results depend on the packages; those of some planners also on the optional ones.
_PACKAGES, _OPTIONAL = ("lieednn_sim", "mujoco", "numpy", "scipy"), ("daqp", "ompl", "toppra")
_version = cache(lambda name: installed(name) or "unknown")  # cached, since it is read for every table and file


def versions(*, optional: bool = False) -> dict[str, str]:
    """Versions by package, optionally with those of the planners' installed libraries."""
    result = {name: _version(name) for name in _PACKAGES}
    return result | {name: version for name in _OPTIONAL if optional and (version := installed(name))}


def installed(name: str) -> str | None:
    """Version of a package; None if it is not installed."""
    with contextlib.suppress(metadata.PackageNotFoundError):
        return metadata.version(name)
    return None


@cache
def commit() -> str:
    """The commit of the checkout that holds the package, ending with ``-dirty`` if files were changed since.

    Empty where the package is in no checkout, or git cannot tell.
    """
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return ""
    git = ["git", "--no-optional-locks", "-C", str(root), "describe"]
    git += ["--always", "--abbrev=12", "--exclude=*", "--dirty"]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        return subprocess.check_output(git, text=True, stderr=subprocess.DEVNULL, timeout=10.0).strip()
    return ""
