"""Headless OpenGL: choose a backend that works, on the first rendering.

MuJoCo reads ``MUJOCO_GL`` when it is imported; if unset it takes GLFW, which needs a display. `configure` finds a
backend by probing the drivers in child processes, and lets MuJoCo choose again. Until then nothing is probed or set.

``python -m lieednn_sim.rendering.opengl`` prints the backend; if there is none, it prints the packages to install and
fails. This module needs only the standard library.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from lieednn_sim.errors import RenderingUnavailableError

__all__ = ["Backend", "choose_backend", "configure", "describe_renderer", "missing_packages", "require"]

BackendName = Literal["egl", "osmesa", "glfw", "disable"]
Source = Literal["MUJOCO_GL", "probe"]

# What MuJoCo and dm_control understand; MuJoCo ignores case and blanks, dm_control does not.
_SYNONYMS: Mapping[str, BackendName] = {
    "egl": "egl",
    "osmesa": "osmesa",
    **dict.fromkeys(("glfw", "glx", "wgl", "cgl", "enable", "enabled", "on", "true", "1"), "glfw"),
    **dict.fromkeys(("disable", "disabled", "off", "false", "0"), "disable"),
}

# Debian and Ubuntu packages. On a bare Debian 12 (download / on disk, with dependencies, without recommended packages):
#   libosmesa6                              43.5 MB / 192 MB   MuJoCo's OSMesa needs nothing else, not even libGL
#   libegl1 libopengl0 libgl1-mesa-dri      50.9 MB / 215 MB
#   libegl1 libgl1                          51.4 MB / 217 MB   the same driver, found through libGL
#   libegl1 libopengl0                       2.7 MB /   8 MB   not enough: no driver, eglInitialize fails
# Both are the same llvmpipe on a machine without a GPU; with one, EGL uses it. Mesa 25.1 dropped OSMesa.
_PACKAGES: Mapping[str, list[str]] = {"egl": ["libegl1", "libgl1"], "osmesa": ["libosmesa6"]}

_PROBE = Path(__file__).with_name("_opengl_probe.py")
_PROBE_TIMEOUT = 20.0  # [s]; takes 0.05 s, or some seconds with a cold disk or a sleeping GPU
_RENDER_TIMEOUT = 120.0  # [s]

# Passes the result of `configure` to child processes, so that they neither probe again nor take it for the user's own.
_INHERITED = "LIEEDNN_SIM_GL"

# The module in which MuJoCo decides which OpenGL context its renderer makes.
_CONTEXTS = "mujoco.rendering.classic.gl_context"

_configured: Backend | None = None


@dataclass(frozen=True)
class Backend:
    """The OpenGL backend for MuJoCo.

    Attributes:
        name: value for ``MUJOCO_GL``; ``"disable"`` means physics without rendering.
        source: who chose it: the user's ``MUJOCO_GL``, or the probe.
        detail: the renderer found, or why there is none.
        requested: the user's ``MUJOCO_GL``, or empty.
    """

    name: BackendName
    source: Source
    detail: str
    requested: str = ""

    @property
    def renders(self) -> bool:
        """Whether frames can be drawn."""
        return self.name != "disable"


def choose_backend() -> Backend:
    """Find a backend that works, without importing MuJoCo or changing the environment.

    The user's own ``MUJOCO_GL`` is taken if it works. If not, the result is ``disable`` rather than another backend,
    and ``detail`` says why. Without it the order is EGL, OSMesa, ``disable``.
    """
    inherited = _inherited()
    if inherited is not None:
        return inherited
    requested = os.environ.get("MUJOCO_GL", "").strip()
    if requested:
        return _check_requested(requested)
    if not sys.platform.startswith("linux"):
        return Backend("glfw", "probe", f"the window system of {sys.platform}")
    failures = []
    order: tuple[BackendName, ...] = ("egl", "osmesa")
    for name in order:
        report = _probe(name)
        if "error" not in report:
            return Backend(name, "probe", report["GL_RENDERER"])
        failures.append(f"{name}: {report['error']}")
    return Backend("disable", "probe", f"no OpenGL library works here ({'; '.join(failures)})")


def configure() -> Backend:
    """Set ``MUJOCO_GL`` (and ``PYOPENGL_PLATFORM`` to match) for this process and its children, and tell MuJoCo.

    Later calls change nothing. It never fails: without OpenGL it turns rendering off.
    """
    global _configured
    if _configured is None:
        _configured = choose_backend()
        os.environ["MUJOCO_GL"] = _configured.name
        os.environ[_INHERITED] = json.dumps(asdict(_configured))
        # MuJoCo refuses a PyOpenGL with another platform than its own.
        if _configured.name in ("egl", "osmesa"):
            os.environ["PYOPENGL_PLATFORM"] = _configured.name
        contexts = sys.modules.get(_CONTEXTS)
        if contexts is not None and _configured.renders:
            # It was imported before, with other settings.
            importlib.reload(contexts)
    return _configured


def require() -> Backend:
    """The configured backend.

    Raises:
        RenderingUnavailableError: it cannot render; the message says what to install or unset.
    """
    backend = configure()
    if not backend.renders:
        raise RenderingUnavailableError(f"cannot render: {backend.detail}. {_remedy(backend)}")
    return backend


def missing_packages() -> list[str]:
    """The smallest set of Debian or Ubuntu packages that makes rendering work; empty when installing would not help.

    EGL when the user asked for it, when there is a GPU for it, or when the release no longer has OSMesa; else OSMesa.
    """
    backend = configure()
    if backend.renders or not sys.platform.startswith("linux"):
        return []
    requested = _SYNONYMS.get(backend.requested.lower())
    if backend.requested and requested not in _PACKAGES:
        return []
    if requested is None:
        requested = "egl" if _has_gpu() or not _has_osmesa_package() else "osmesa"
    return list(_PACKAGES[requested])


def describe_renderer() -> dict[str, Any]:
    """Test the backend: draw a 16 x 16 MuJoCo frame in a child process.

    Returns:
        ``backend``; and ``GL_VENDOR``, ``GL_RENDERER``, ``GL_VERSION`` and ``frame_ms`` [ms] if it works, else
        ``error``.
    """
    backend = configure()
    if not backend.renders:
        return {"backend": backend.name, "error": backend.detail}
    return {"backend": backend.name, **_run_probe(["-P"], "render", _RENDER_TIMEOUT)}


def main() -> int:
    """Print the backend and succeed, or print the packages to install and fail; the reason goes to stderr."""
    backend = configure()
    print(f"OpenGL: {backend.name}, by {backend.source}: {backend.detail}", file=sys.stderr)
    if backend.renders:
        print(backend.name)
        return 0
    packages = missing_packages()
    if packages:
        print(*packages)
    else:
        print(_remedy(backend), file=sys.stderr)
    return 1


def _check_requested(requested: str) -> Backend:
    """The backend that the user requested, or ``disable`` if it does not work."""
    name = _SYNONYMS.get(requested.lower())
    if name is None:
        error = f"MUJOCO_GL={requested} is not one of: egl, osmesa, glfw, disable"
        return Backend("disable", "MUJOCO_GL", error, requested)
    if name == "disable":
        return Backend(name, "MUJOCO_GL", f"MUJOCO_GL={requested} turns rendering off", requested)
    if name == "glfw":
        has_display = any(os.environ.get(variable) for variable in ("DISPLAY", "WAYLAND_DISPLAY"))
        if has_display or not sys.platform.startswith("linux"):
            return Backend(name, "MUJOCO_GL", "the window system", requested)
        error = "there is no display (DISPLAY and WAYLAND_DISPLAY are empty)"
    else:
        report = _probe(name)
        if "error" not in report:
            return Backend(name, "MUJOCO_GL", report["GL_RENDERER"], requested)
        error = report["error"]
    return Backend("disable", "MUJOCO_GL", f"MUJOCO_GL={requested} is unusable: {error}", requested)


def _inherited() -> Backend | None:
    """The result of `configure` in the parent process, if ``MUJOCO_GL`` has not changed since."""
    try:
        backend = Backend(**json.loads(os.environ[_INHERITED]))
    except (KeyError, TypeError, ValueError):
        return None
    return backend if backend.name == os.environ.get("MUJOCO_GL") else None


def _remedy(backend: Backend) -> str:
    """What the user can do about it."""
    name = _SYNONYMS.get(backend.requested.lower())
    if backend.requested and name not in _PACKAGES:
        return "Unset MUJOCO_GL to let lieednn_sim choose"
    ways = [
        f"apt-get install {' '.join(_PACKAGES[way])} ({label})" for way, label in (("egl", "EGL"), ("osmesa", "OSMesa"))
    ]
    return f"On Debian or Ubuntu install one of: {', or '.join(ways)}"


def _probe(name: str) -> dict[str, Any]:
    """Query the driver's strings: ``GL_VENDOR`` ..., or ``error``. Takes about 45 ms, of which Python takes 15."""
    return _run_probe(["-I", "-S"], name, _PROBE_TIMEOUT)


def _run_probe(flags: list[str], name: str, timeout: float) -> dict[str, Any]:
    """Run `_opengl_probe` in a child process; a crash or hang is returned as ``error``."""
    command = [sys.executable, *flags, str(_PROBE), name]
    try:
        done = subprocess.run(
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return {"error": f"no answer within {timeout:g} s"}
    except (OSError, ValueError) as error:
        return {"error": f"cannot start {sys.executable or 'python'}: {error}"}
    if done.returncode < 0:
        return {"error": f"crashed (signal {-done.returncode})"}
    try:
        report: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        last_words = done.stderr.strip().splitlines()[-1:] or ["nothing"]
        return {"error": f"failed (exit status {done.returncode}): {last_words[0]}"}
    return report


def _has_gpu() -> bool:
    """Whether there is a device that EGL would use and OSMesa would not."""
    return Path("/dev/nvidiactl").exists() or any(Path("/dev/dri").glob("renderD*"))


def _has_osmesa_package() -> bool:
    """Whether apt can install OSMesa; true if apt has no package lists yet."""
    apt_cache = shutil.which("apt-cache")
    if apt_cache is None:
        return True
    command = [apt_cache, "policy", *_PACKAGES["egl"], *_PACKAGES["osmesa"]]
    environment = {**os.environ, "LC_ALL": "C"}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=20.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return True
    # One block per package: its name in the first column, the rest indented.
    blocks = re.split(r"\n(?=\S)", done.stdout)
    known = {block.split(":", 1)[0] for block in blocks if "Candidate: (none)" not in block}
    return not known.issuperset(_PACKAGES["egl"]) or known.issuperset(_PACKAGES["osmesa"])


if __name__ == "__main__":
    sys.exit(main())
