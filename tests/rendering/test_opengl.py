from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import cache

import pytest

from lieednn_sim.errors import RenderingUnavailableError
from lieednn_sim.rendering import opengl

VARIABLES = ("MUJOCO_GL", "PYOPENGL_PLATFORM", "LIEEDNN_SIM_GL", "DISPLAY", "WAYLAND_DISPLAY")


@pytest.fixture(autouse=True)
def fresh(monkeypatch):
    """A process in which nothing has been chosen."""
    for variable in VARIABLES:
        # Set before deleting, so that what `configure` writes is undone too.
        monkeypatch.setenv(variable, "")
        monkeypatch.delenv(variable)
    monkeypatch.setattr(opengl, "configure", cache(opengl.configure.__wrapped__))
    monkeypatch.delitem(sys.modules, "mujoco.rendering.classic.gl_context", raising=False)


@pytest.fixture
def working(monkeypatch):
    """Pretend that just the named libraries work; returns the list of probes made."""

    def pretend(*names):
        asked = []

        def probe(name):
            asked.append(name)
            return (f"{name} renderer", "") if name in names else ("", f"no {name} here")

        monkeypatch.setattr(opengl, "_probe", probe)
        return asked

    return pretend


def run_python(*arguments, **changes):
    environment = {key: value for key, value in os.environ.items() if key not in VARIABLES} | changes
    command = [sys.executable, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("libraries", "expected", "probes"),
    [
        (("egl", "osmesa"), "egl", ["egl"]),
        (("osmesa",), "osmesa", ["egl", "osmesa"]),
        ((), "disable", ["egl", "osmesa"]),
    ],
)
def test_probe_order(working, monkeypatch, libraries, expected, probes):
    monkeypatch.setenv("MUJOCO_GL", "  ")  # an empty choice is none
    asked, before = working(*libraries), dict(os.environ)
    backend = opengl.choose_backend()
    assert (backend.name, backend.source, asked) == (expected, "probe", probes)
    failures = "; ".join(f"{name}: no {name} here" for name in probes)
    assert backend.detail == (f"{expected} renderer" if libraries else f"no OpenGL library works here ({failures})")
    assert dict(os.environ) == before


@pytest.mark.parametrize(("value", "name"), [("egl", "egl"), (" EGL ", "egl"), ("osmesa", "osmesa")])
def test_users_choice_wins_in_the_spelling_of_dm_control(working, monkeypatch, value, name):
    asked = working("egl", "osmesa")
    monkeypatch.setenv("MUJOCO_GL", value)
    backend = opengl.configure()
    assert (backend.name, backend.source, backend.detail) == (name, "MUJOCO_GL", f"{name} renderer")
    assert (os.environ["MUJOCO_GL"], asked) == (name, [name])


@pytest.mark.parametrize(
    ("value", "detail"),
    [
        ("osmesa", "MUJOCO_GL=osmesa is unusable (osmesa: no osmesa here)"),
        ("elg", "MUJOCO_GL=elg is not one of: egl, osmesa, glfw, disable"),
    ],
)
def test_unusable_choice_falls_back_to_physics_alone(working, monkeypatch, value, detail):
    working("egl")  # it would work, but was not asked for
    monkeypatch.setenv("MUJOCO_GL", value)
    backend = opengl.configure()
    assert (backend.name, backend.source) == ("disable", "MUJOCO_GL")
    assert detail in backend.detail
    assert os.environ["MUJOCO_GL"] == "disable"


@pytest.mark.parametrize(
    ("platform", "asked", "library", "probes", "variable"),
    [
        ("darwin", "", "cgl", ["cgl"], "on"),
        ("darwin", "", "glfw", ["cgl", "glfw"], "glfw"),
        ("darwin", "cgl", "cgl", ["cgl"], "on"),
        ("darwin", "egl", "cgl", ["egl"], "disable"),
        ("win32", "", "glfw", ["glfw"], "glfw"),
        ("win32", "wgl", "glfw", ["glfw"], "glfw"),
    ],
)
def test_elsewhere_it_is_the_window_system(working, monkeypatch, platform, asked, library, probes, variable):
    made = working(library)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setenv("MUJOCO_GL", asked)
    backend = opengl.configure()
    assert backend.renders == (variable != "disable")
    # What MuJoCo and dm_control both take; PyOpenGL finds its platform by itself.
    assert (made, os.environ["MUJOCO_GL"], os.environ.get("PYOPENGL_PLATFORM")) == (probes, variable, None)
    assert backend.missing_packages == []


@pytest.mark.parametrize("value", ["disable", "0"])
def test_user_can_turn_rendering_off(working, monkeypatch, value):
    asked = working("egl")
    monkeypatch.setenv("MUJOCO_GL", value)
    backend = opengl.choose_backend()
    assert (backend.name, backend.missing_packages, asked) == ("disable", [], [])
    with pytest.raises(RenderingUnavailableError, match="Unset MUJOCO_GL"):
        opengl.require()


def test_configure_probes_once_and_overrules_another_pyopengl_platform(working, monkeypatch):
    asked = working("osmesa")
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")  # with it, mujoco would refuse to be imported
    first = opengl.require()
    assert opengl.configure() is first
    assert asked == ["egl", "osmesa"]
    assert (os.environ["MUJOCO_GL"], os.environ["PYOPENGL_PLATFORM"]) == ("osmesa", "osmesa")


@pytest.mark.parametrize("libraries", [("egl",), ()])
def test_child_process_inherits_the_answer(working, monkeypatch, libraries):
    asked = working(*libraries)
    parent = opengl.configure()
    asked.clear()
    monkeypatch.setattr(opengl, "configure", cache(opengl.configure.__wrapped__))
    assert opengl.configure() == parent  # the reason too, and not taken for the user's choice
    assert asked == []


def test_users_later_choice_beats_the_inherited(working, monkeypatch):
    working("egl", "osmesa")
    opengl.configure()
    monkeypatch.setattr(opengl, "configure", cache(opengl.configure.__wrapped__))
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert opengl.configure().requested == "osmesa"


@pytest.mark.parametrize("text", ["{", "[]", '{"name": "egl"}'])
def test_broken_inheritance_is_ignored(working, monkeypatch, text):
    working("egl")
    monkeypatch.setenv("LIEEDNN_SIM_GL", text)
    assert opengl.choose_backend().detail == "egl renderer"


# What is chosen after MuJoCo was imported: a picture's shape, and whether the probe said by what it is drawn.
RENDERING = """
import os, mujoco
from lieednn_sim.errors import RenderingUnavailableError
from lieednn_sim.rendering import opengl

def render():
    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with mujoco.Renderer(model, 16, 16) as renderer:
        renderer.update_scene(mujoco.MjData(model))
        print(renderer.render().shape)
        from OpenGL import GL
        print(GL.glGetString(GL.GL_RENDERER).decode() == backend.detail, flush=True)

def forked():
    if os.fork() == 0:
        try:
            opengl.require()
            print("renders", flush=True)
        except RenderingUnavailableError as error:
            print(error, flush=True)
        os._exit(0)
    os.wait()
"""


@pytest.mark.rendering
def test_it_is_not_too_late_when_mujoco_is_imported_and_the_probe_says_what_it_finds():
    done = run_python("-c", f"{RENDERING}\nbackend = opengl.require()\nrender()")
    assert done.stdout == "(16, 16, 3)\nTrue\n", done.stderr


@pytest.mark.rendering
@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes cannot be forked here")
def test_another_platform_of_pyopengl_is_overruled_and_a_process_forked_after_egl_was_used_is_told_so():
    """It would wait forever for threads of the driver, which a fork does not copy."""
    before = "import os\nos.environ |= {'MUJOCO_GL': 'egl', 'PYOPENGL_PLATFORM': 'osmesa'}"
    done = run_python("-c", f"{before}{RENDERING}\nbackend = opengl.require()\nforked()\nrender()\nforked()")
    assert done.stdout.splitlines() == [
        "renders",
        "(16, 16, 3)",
        "True",
        "cannot render, since EGL was used before a fork: start processes by 'spawn'",
    ], done.stderr


def test_require_names_the_packages(working):
    working()
    with pytest.raises(RenderingUnavailableError) as caught:
        opengl.require()
    message = str(caught.value)
    assert "no egl here" in message
    assert message.endswith("On Debian or Ubuntu: apt-get install libegl1 libgl1")


@pytest.mark.parametrize(
    ("requested", "expected"), [("", ["libegl1", "libgl1"]), ("osmesa", ["libosmesa6"]), ("glfw", [])]
)
def test_missing_packages(working, monkeypatch, requested, expected):
    working()
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("MUJOCO_GL", requested)
    assert opengl.choose_backend().missing_packages == expected


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("print('a GPU')", ("a GPU", "")),
        ("import os; os.kill(os.getpid(), 11)", ("", "crashed (signal 11)")),
        ("import signal; signal.pause()", ("", "no answer within 0.1 s")),
        ("raise SystemExit('one line\\nlibGL: out of memory')", ("", "libGL: out of memory")),
        ("raise SystemExit(3)", ("", "failed (exit status 3)")),
    ],
)
def test_broken_driver_becomes_a_text(monkeypatch, code, expected):
    monkeypatch.setattr(opengl, "_PROBE", code)
    if "pause" in code:
        monkeypatch.setattr(opengl, "_PROBE_TIMEOUT", 0.1)
    assert opengl._probe("egl") == expected


def test_gl_imports_the_standard_library_alone():
    done = run_python(
        "-c", "import sys; import lieednn_sim.rendering.opengl; print('numpy' in sys.modules, 'mujoco' in sys.modules)"
    )
    assert done.stdout == "False False\n", done.stderr


@pytest.mark.parametrize("value", ["glfw", "elg"])
def test_mujoco_imports_whatever_the_user_exports(value):
    # With OpenGL's bindings broken, too, as where its library is missing.
    code = """
import importlib.abc, os, sys
class Broken(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("OpenGL", "glfw"):
            raise AttributeError(f"no {name} here")
sys.meta_path.insert(0, Broken())
from lieednn_sim._mujoco import mujoco
mujoco.MjData(mujoco.MjModel.from_xml_string("<mujoco/>"))
print(os.environ["MUJOCO_GL"])
"""
    done = run_python("-c", code, MUJOCO_GL=value)
    assert done.stdout == f"{value}\n", done.stderr


@pytest.mark.rendering
def test_the_doctor_is_asked_as_by_the_makefile():
    done = run_python("-m", "lieednn_sim", "doctor", "--json")
    found = json.loads(done.stdout)
    assert found["opengl"]["backend"] in ("egl", "osmesa"), done.stderr
    assert found["debian_packages_to_install"] == []
    assert "Warning" not in done.stderr
