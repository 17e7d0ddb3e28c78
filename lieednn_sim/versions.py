"""Versions of the packages on which results depend, and of the code itself."""

from __future__ import annotations

import contextlib
import hashlib
from functools import cache
from importlib import metadata
from pathlib import Path

# All results depend on the former, and those of some planners on the latter.
_PACKAGES, _OPTIONAL = ("lieednn_sim", "mujoco", "numpy", "scipy"), ("daqp", "ompl", "toppra", "movement_primitives")
# Modules that only present results.
_SHOWING = ("cli/", "rendering/", "environments/", "evaluation/report/")


@cache
def code_version() -> str:
    """Hash of the modules and models on which results depend, the same in a checkout and a wheel."""
    package = Path(__file__).parent
    # Beside the package in a checkout.
    assets = next((one for one in (package / "assets", package.parent / "assets") if one.is_dir()), package)
    files = {path.relative_to(package).as_posix(): path for path in package.rglob("*.py")}
    files |= {path.relative_to(assets).as_posix(): path for path in assets.glob("mjcf/**/*.xml")}
    digest = hashlib.sha256()
    for name in sorted(files):
        if not name.startswith(_SHOWING):
            digest.update(name.encode() + b"\0" + files[name].read_bytes())
    return digest.hexdigest()[:12]


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
