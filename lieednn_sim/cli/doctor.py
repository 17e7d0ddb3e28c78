"""``lieednn-sim doctor``: what is installed, whether rendering works, and what is missing."""

from __future__ import annotations

import argparse
import json
import platform
import sys
from importlib import metadata

from rich.table import Table
from rich.text import Text

from lieednn_sim.arm import arm_names
from lieednn_sim.cli.console import console
from lieednn_sim.errors import FileError
from lieednn_sim.rendering import opengl

_PACKAGES = (
    "mujoco",
    # It has no release for Python 3.13.
    *(("dm-control",) if sys.version_info < (3, 13) else ()),
    "dm-env",
    "numpy",
    "scipy",
    "daqp",
    "imageio",
    "imageio-ffmpeg",
    "matplotlib",
    "jinja2",
    "pillow",
    "rich",
    "pyyaml",
    "threadpoolctl",
)
# Optional packages, the extra that installs them, and their purpose.
_EXTRAS = {
    "ompl": ("rivals", "planners rrt-connect, rrt-star, informed-rrt-star, bit-star, aorrtc and lieednn-guided"),
    "mjpl": ("cbirrt", "planner mjpl"),
    "sscbirrt": ("cbirrt", "planner sscbirrt"),
    "toppra": ("timing", "the planned path in the least time, --fastest"),
    "movement_primitives": ("dmp", "planner dmp, rival promp; needs a C compiler and Python's headers"),
    "pytransform3d": ("dmp", "planner dmp, rival promp"),
    "gymnasium": ("gymnasium", "Gymnasium environments"),
    "distributed": ("cluster", "comparisons on a Dask cluster"),
    "cvxpy": ("lmi", "certificates by matrix inequalities"),
}


def doctor(arguments: argparse.Namespace) -> int:
    """Report on the installation; returns 1 when physics or rendering would not work."""
    versions = {"lieednn-sim": _version("lieednn-sim"), "python": platform.python_version()}
    versions |= {name: _version(name) for name in _PACKAGES}
    extras = {name: _version(name) for name in _EXTRAS}
    try:
        arms = arm_names()
    except FileError as error:
        arms, models = [], str(error)
    else:
        models = ", ".join(arms)
    backend = opengl.configure()
    renderer = opengl.describe_renderer()
    packages = opengl.missing_packages()
    missing = [name for name, version in versions.items() if version is None]
    healthy = bool(arms) and not missing and "error" not in renderer
    if arguments.json:
        print(
            json.dumps(
                {
                    "healthy": healthy,
                    "versions": versions,
                    "extras": {
                        name: {"version": version, "install": _install(name), "for": _EXTRAS[name][1]}
                        for name, version in extras.items()
                    },
                    "arms": arms,
                    "opengl": {"backend": backend.name, "source": backend.source, "detail": backend.detail, **renderer},
                    "debian_packages_to_install": packages,
                    "python_packages_to_install": missing,
                },
                indent=2,
            )
        )
        return 0 if healthy else 1
    table = Table(show_header=False, title="lieednn-sim doctor", title_justify="left")
    for name, version in versions.items():
        table.add_row(name, version or Text("missing", "red"))
    for name, version in extras.items():
        absent = f"not installed (optional, for {_EXTRAS[name][1]}): {_install(name)}"
        table.add_row(name, version or absent)
    table.add_row("platform", f"{platform.system()} {platform.machine()}, {sys.executable}")
    table.add_row("arms", models)
    table.add_row("OpenGL backend", f"{backend.name} (by {backend.source})")
    if "error" in renderer:
        table.add_row("rendering", Text.assemble(("does not work", "red"), f": {renderer['error']}"))
    else:
        table.add_row("rendering", f"{renderer['GL_RENDERER']}, a frame of 16x16 in {renderer['frame_ms']:.1f} ms")
    console.print(table)
    if missing:
        console.print(f"install with pip: {' '.join(missing)}")
    if packages:
        console.print(f"for video, install on Debian or Ubuntu: apt-get install {' '.join(packages)}")
    if healthy:
        console.print("everything works")
    return 0 if healthy else 1


def _install(name: str) -> str:
    return f"pip install 'lieednn_sim[{_EXTRAS[name][0]}]'"


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
