"""``lieednn-sim doctor``: what is installed, whether rendering works, and what is missing."""

from __future__ import annotations

import platform
import sys
from json import dumps
from textwrap import shorten

from rich.table import Table
from rich.text import Text

from lieednn_sim.arm import arm_names
from lieednn_sim.cli.console import console
from lieednn_sim.entries import LIBRARIES, install_command
from lieednn_sim.errors import FileError
from lieednn_sim.registry import purpose
from lieednn_sim.rendering import opengl
from lieednn_sim.versions import installed

_PACKAGES = (
    "mujoco",
    # It has no release for Python 3.13.
    *(("dm-control",) if sys.version_info < (3, 13) else ()),
    *("dm-env", "numpy", "scipy", "daqp", "imageio-ffmpeg", "matplotlib", "jinja2", "pillow", "rich", "pyyaml"),
    "threadpoolctl",
)


def doctor(*, json: bool = False) -> int:
    """Check the installation: versions, headless OpenGL, what is missing.

    The exit code is 1 if physics or rendering does not work.

    Args:
        json: print JSON instead of a table.
    """
    versions = {"lieednn-sim": installed("lieednn-sim"), "python": platform.python_version()}
    versions |= {name: installed(name) for name in _PACKAGES}
    extras = {
        library.distribution or module: {
            "version": installed(library.distribution or module),
            "install": install_command(module),
            "for": purpose(module),
        }
        for module, library in LIBRARIES.items()
    }
    try:
        arms, models = arm_names(), ", ".join(arm_names())
    except FileError as error:
        arms, models = [], str(error)
    backend = opengl.configure()
    packages = backend.missing_packages
    missing = [name for name, version in versions.items() if version is None]
    healthy = bool(arms) and not missing and backend.renders
    if json:
        report = {
            "healthy": healthy,
            "versions": versions,
            "extras": extras,
            "arms": arms,
            "opengl": {"backend": backend.name, "source": backend.source, "detail": backend.detail},
            "debian_packages_to_install": packages,
            "python_packages_to_install": missing,
        }
        print(dumps(report, indent=2))
        return 0 if healthy else 1
    table = Table(show_header=False, title="lieednn-sim doctor", title_justify="left")
    for name, version in versions.items():
        table.add_row(name, version or Text("missing", "red"))
    for name, extra in extras.items():
        wanted = shorten(f"optional, for {extra['for']}", 59, placeholder=" ...")
        absent = f"not installed: {extra['install']}\n{wanted}"
        table.add_row(name, extra["version"] or absent)
    table.add_row("platform", f"{platform.system()} {platform.machine()}, {sys.executable}")
    table.add_row("arms", models)
    table.add_row("OpenGL backend", f"{backend.name} (by {backend.source})" if backend.renders else "none")
    verdict = "" if backend.renders else Text.assemble(("does not work", "red"), ": ")
    table.add_row("rendering", Text.assemble(verdict, backend.detail))
    console.print(table)
    if missing:
        console.print(f"install with pip: {' '.join(missing)}")
    if packages:
        console.print(f"for video, install on Debian or Ubuntu: apt-get install {' '.join(packages)}")
    if healthy:
        console.print("everything works")
    return 0 if healthy else 1
