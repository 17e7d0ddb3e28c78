"""Headless OpenGL: choose a backend that works, on the first rendering.

MuJoCo reads ``MUJOCO_GL`` when it is imported; if unset it takes GLFW, which needs a display. `configure` finds a
backend by drawing a frame in a child process, and lets MuJoCo choose again. Until then nothing is probed or set.

``lieednn-sim doctor`` prints the backend and the packages to install. This module needs only the standard library.
"""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache

from lieednn_sim.errors import RenderingUnavailableError

# Values that MuJoCo and dm_control understand; MuJoCo ignores case and blanks, dm_control does not.
_SYNONYMS: Mapping[str, str] = {
    **{name: name for name in ("egl", "osmesa", "cgl")},
    **dict.fromkeys(("glfw", "glx", "wgl", "enable", "enabled", "on", "true", "1"), "glfw"),
    **dict.fromkeys(("disable", "disabled", "off", "false", "0"), "disable"),
}

# Backends to try, best first, by `sys.platform`; CGL needs no window, and GLFW opens one only in the main thread.
_ORDER: Mapping[str, tuple[str, ...]] = {"linux": ("egl", "osmesa"), "darwin": ("cgl", "glfw")}

# Packages of Debian and Ubuntu. EGL uses a GPU if there is one, else llvmpipe. Mesa 25.1 dropped OSMesa.
_PACKAGES: Mapping[str, list[str]] = {"egl": ["libegl1", "libgl1"], "osmesa": ["libosmesa6"]}

# Draws a frame in a process in which a crash or a hang of the driver does no harm, and prints the renderer's name. It
# skips the driver's clean-up at exit, in which some drivers hang or crash.
_PROBE = """
import mujoco, os
with mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16) as renderer:
    renderer.render()
    from OpenGL import GL
    print(GL.glGetString(GL.GL_RENDERER).decode(errors="replace"), flush=True)
    os._exit(0)
"""
_PROBE_TIMEOUT = 60.0  # [s]; takes about 1 s, or more with a cold disk or a sleeping GPU

# Passes the result of `configure` to child processes, so that these neither probe nor take it for the user's choice.
_INHERITED = "LIEEDNN_SIM_GL"

# The EGL display when this process was forked, or None. Its driver's threads are not in this process: rendering hangs.
_handed_down: list[object] = []
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        after_in_child=lambda: _handed_down.append(getattr(sys.modules.get("mujoco.egl"), "EGL_DISPLAY", None))
    )


@dataclass(frozen=True)
class Backend:
    """The OpenGL backend for MuJoCo.

    Attributes:
        name: ``egl``, ``osmesa``, ``cgl`` or ``glfw``; ``"disable"`` means physics without rendering.
        detail: the renderer found, or why there is none.
        requested: the user's ``MUJOCO_GL``, or empty.
    """

    name: str
    detail: str
    requested: str = ""

    @property
    def renders(self) -> bool:
        """Whether frames can be drawn."""
        return self.name != "disable"

    @property
    def source(self) -> str:
        """What chose the backend: the user's ``MUJOCO_GL``, or the probe."""
        return "MUJOCO_GL" if self.requested else "probe"

    @property
    def missing_packages(self) -> list[str]:
        """Debian or Ubuntu packages that make rendering work; empty when installing would not help."""
        if self.renders or not sys.platform.startswith("linux"):
            return []
        return list(_PACKAGES.get(_SYNONYMS.get(self.requested.lower(), "") if self.requested else "egl", []))


def choose_backend() -> Backend:
    """Find a backend that works by trying each once, without importing MuJoCo or changing the environment.

    The user's own ``MUJOCO_GL`` is taken if it works. If not, the result is ``disable`` rather than another backend,
    and ``detail`` says why. If unset: EGL, OSMesa on Linux; CGL, GLFW on macOS; else GLFW; and at last ``disable``.
    """
    try:
        inherited = Backend(**json.loads(os.environ[_INHERITED]))
    except (KeyError, TypeError, ValueError):
        pass  # this process inherits none
    else:
        if _variables(inherited.name)["MUJOCO_GL"] == os.environ.get("MUJOCO_GL"):
            return inherited
    requested = os.environ.get("MUJOCO_GL", "").strip()
    asked = _SYNONYMS.get(requested.lower())
    if requested and asked is None:
        error = f"MUJOCO_GL={requested} is not one of: egl, osmesa, glfw, disable"
        return Backend("disable", error, requested)
    if asked == "disable":
        return Backend("disable", f"MUJOCO_GL={requested} turns rendering off", requested)
    failures = []
    for name in _ORDER.get(sys.platform, ("glfw",)) if asked is None else (asked,):
        renderer, failure = _probe(name)
        if not failure:
            return Backend(name, renderer, requested)
        failures.append(f"{name}: {failure}")
    verdict = f"MUJOCO_GL={requested} is unusable" if requested else "no OpenGL library works here"
    return Backend("disable", f"{verdict} ({'; '.join(failures)})", requested)


@cache
def configure() -> Backend:
    """Set ``MUJOCO_GL`` (and ``PYOPENGL_PLATFORM`` to match) for this process and its children, and tell MuJoCo.

    Later calls change nothing. It never fails: without OpenGL it turns rendering off.
    """
    backend = choose_backend()
    os.environ.update(_variables(backend.name))
    os.environ[_INHERITED] = json.dumps(asdict(backend))
    # The module in which MuJoCo decides which OpenGL context its renderer makes.
    contexts = sys.modules.get("mujoco.rendering.classic.gl_context")
    if contexts is not None and backend.renders:
        # The module was imported before, with other settings.
        importlib.reload(contexts)
    mujoco = sys.modules.get("mujoco")
    if mujoco is not None and backend.renders and not hasattr(mujoco, "Renderer"):
        # MuJoCo was imported with a PYOPENGL_PLATFORM other than MUJOCO_GL, and so has no renderer yet.
        vars(mujoco)["Renderer"] = importlib.import_module("mujoco.rendering.classic.renderer").Renderer
    return backend


def require() -> Backend:
    """The OpenGL backend in use, which is known to render.

    `RenderingUnavailableError` if the chosen backend cannot render; the message says what to install or unset; or if
    the process was forked after EGL had been used.
    """
    if any(display is not None for display in _handed_down):
        raise RenderingUnavailableError("cannot render, since EGL was used before a fork: start processes by 'spawn'")
    backend = configure()
    if not backend.renders:
        packages = backend.missing_packages
        remedy = [f"On Debian or Ubuntu: apt-get install {' '.join(packages)}"] if packages else []
        remedy += ["Unset MUJOCO_GL to let lieednn_sim choose"] if backend.requested else []
        raise RenderingUnavailableError(f"cannot render: {backend.detail}. {'. '.join(remedy)}")
    return backend


def _variables(name: str) -> dict[str, str]:
    """Environment variables of a backend; MuJoCo refuses PyOpenGL on a different platform.

    On macOS, CGL is called "on", which MuJoCo accepts; dm_control does not know CGL.
    """
    return {"MUJOCO_GL": "on" if name == "cgl" else name, **({"PYOPENGL_PLATFORM": name} if name in _PACKAGES else {})}


def _probe(name: str) -> tuple[str, str]:
    """Draw a frame in a child process; returns the renderer, or an empty text and why it failed, crashed or hung."""
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", _PROBE],
            env={**os.environ, **_variables(name)},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PROBE_TIMEOUT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", f"no answer within {_PROBE_TIMEOUT:g} s"
    except (OSError, ValueError) as error:
        return "", f"cannot start {sys.executable or 'python'}: {error}"
    if done.returncode == 0:
        return done.stdout.strip(), ""
    if done.returncode < 0:
        return "", f"crashed (signal {-done.returncode})"
    return "", (done.stderr.strip().splitlines() or [f"failed (exit status {done.returncode})"])[-1]
