"""The versions of the packages on which results depend."""

from __future__ import annotations

import contextlib
from importlib import metadata

# Every number depends on these, and those of some planners on the others.
_PACKAGES, _OPTIONAL = ("lieednn_sim", "mujoco", "numpy", "scipy"), ("daqp", "ompl", "movement_primitives")


def versions(*, optional: bool = False) -> dict[str, str]:
    """Versions by package; with those of the planners' libraries that are installed, if wanted."""
    found = {name: metadata.version(name) for name in _PACKAGES}
    for name in _OPTIONAL if optional else ():
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
