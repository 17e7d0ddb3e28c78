"""Child process of `lieednn_sim.rendering.opengl`: tries the OpenGL libraries where a crash does no harm.

Run by path, with the standard library alone (``egl``, ``osmesa``) or with MuJoCo (``render``). Prints one JSON object:
the three strings of the driver, or ``{"error": ...}``. Loading a driver into the caller would cost it 100 MB of LLVM,
start threads that make a later ``fork`` hang, and crash it when the driver is broken.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import time
from typing import Any

Strings = dict[str, str]

_GL_STRINGS = {"GL_VENDOR": 0x1F00, "GL_RENDERER": 0x1F01, "GL_VERSION": 0x1F02}

# Constants of EGL, named as in its headers, and the framebuffer attributes that mujoco.egl requests.
_EGL_PLATFORM_DEVICE_EXT = 0x313F
_EGL_OPENGL_API = 0x30A2
_EGL_ATTRIBUTES = (
    *(0x3024, 8),  # EGL_RED_SIZE
    *(0x3023, 8),  # EGL_GREEN_SIZE
    *(0x3022, 8),  # EGL_BLUE_SIZE
    *(0x3021, 8),  # EGL_ALPHA_SIZE
    *(0x3025, 24),  # EGL_DEPTH_SIZE
    *(0x3026, 8),  # EGL_STENCIL_SIZE
    *(0x303F, 0x308E),  # EGL_COLOR_BUFFER_TYPE, EGL_RGB_BUFFER
    *(0x3033, 0x0001),  # EGL_SURFACE_TYPE, EGL_PBUFFER_BIT
    *(0x3040, 0x0008),  # EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT
    0x3038,  # EGL_NONE
)
_MAX_EGL_DEVICES = 10  # as in mujoco.egl

_OSMESA_RGBA = 0x1908
_GL_FLOAT = 0x1406


class ProbeError(Exception):
    """The backend cannot be used; the message says what is missing."""


def load(name: str) -> ctypes.CDLL:
    """Load ``lib<name>.so`` as PyOpenGL does: the unversioned name, then ``.9`` down to ``.0``."""
    for suffix in ("", *(f".{version}" for version in range(9, -1, -1))):
        try:
            return ctypes.CDLL(f"lib{name}.so{suffix}", mode=ctypes.RTLD_GLOBAL)
        except OSError:
            continue
    raise ProbeError(f"lib{name}.so cannot be loaded")


def gl_strings(get_string: Any) -> Strings:
    """Vendor, renderer and version of the current context."""
    values = {name: get_string(code) for name, code in _GL_STRINGS.items()}
    if not all(values.values()):
        raise ProbeError("the OpenGL context has no version")
    return {name: value.decode(errors="replace") for name, value in values.items()}


def probe_egl() -> Strings:
    """Follow the steps of ``mujoco.egl.GLContext`` up to a current context."""
    try:
        load("OpenGL")
    except ProbeError:
        try:
            load("GL")
        except ProbeError:
            raise ProbeError("neither libOpenGL.so nor libGL.so can be loaded") from None
    egl = load("EGL")
    pointer = ctypes.c_void_p
    integer = ctypes.c_int32
    egl.eglGetProcAddress.restype = pointer
    egl.eglGetProcAddress.argtypes = [ctypes.c_char_p]

    def extension(name: str, result: Any, *arguments: Any) -> Any:
        address = egl.eglGetProcAddress(name.encode())
        if not address:
            raise ProbeError(f"libEGL has no {name}")
        return ctypes.CFUNCTYPE(result, *arguments)(address)

    query_devices = extension(
        "eglQueryDevicesEXT", ctypes.c_uint, integer, ctypes.POINTER(pointer), ctypes.POINTER(integer)
    )
    get_display = extension("eglGetPlatformDisplayEXT", pointer, ctypes.c_uint, pointer, pointer)
    get_string = extension("glGetString", ctypes.c_char_p, ctypes.c_uint)
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    egl.eglChooseConfig.argtypes = [
        pointer,
        ctypes.POINTER(integer),
        ctypes.POINTER(pointer),
        integer,
        ctypes.POINTER(integer),
    ]
    egl.eglCreateContext.restype = pointer
    egl.eglCreateContext.argtypes = [pointer, pointer, pointer, pointer]
    egl.eglMakeCurrent.argtypes = [pointer, pointer, pointer, pointer]

    devices = (pointer * _MAX_EGL_DEVICES)()
    found = integer()
    if not query_devices(_MAX_EGL_DEVICES, devices, ctypes.byref(found)) or found.value < 1:
        raise ProbeError("EGL finds no device")
    candidates = devices[: found.value]
    chosen = os.environ.get("MUJOCO_EGL_DEVICE_ID")
    if chosen is not None:
        if not (chosen.strip().isdigit() and int(chosen) < found.value):
            raise ProbeError(f"MUJOCO_EGL_DEVICE_ID={chosen!r} is not one of the {found.value} EGL devices, from 0")
        candidates = [devices[int(chosen)]]

    for device in candidates:
        display = get_display(_EGL_PLATFORM_DEVICE_EXT, device, None)
        if display and egl.eglInitialize(display, None, None):
            break
    else:
        raise ProbeError(f"none of the {len(candidates)} EGL devices can be initialised: no driver")
    # MuJoCo takes the first display that initialises, so a failure from here on is final.
    config = pointer()
    count = integer()
    attributes = (integer * len(_EGL_ATTRIBUTES))(*_EGL_ATTRIBUTES)
    if not egl.eglChooseConfig(display, attributes, ctypes.byref(config), 1, ctypes.byref(count)) or count.value < 1:
        raise ProbeError("EGL has no framebuffer configuration for MuJoCo")
    egl.eglBindAPI(_EGL_OPENGL_API)
    context = egl.eglCreateContext(display, config, None, None)
    if not context or not egl.eglMakeCurrent(display, None, None, context):
        raise ProbeError("EGL cannot create an OpenGL context")
    return gl_strings(get_string)


def probe_osmesa() -> Strings:
    """Follow the steps of ``mujoco.osmesa.GLContext`` up to a current context."""
    mesa = load("OSMesa")
    pointer = ctypes.c_void_p
    try:
        create, make_current, get_string = mesa.OSMesaCreateContextExt, mesa.OSMesaMakeCurrent, mesa.glGetString
    except AttributeError as error:
        raise ProbeError(f"libOSMesa is incomplete: {error}") from None
    create.restype = pointer
    create.argtypes = [ctypes.c_uint, ctypes.c_int, ctypes.c_int, ctypes.c_int, pointer]
    make_current.argtypes = [pointer, pointer, ctypes.c_uint, ctypes.c_int, ctypes.c_int]
    make_current.restype = ctypes.c_ubyte
    get_string.restype = ctypes.c_char_p
    get_string.argtypes = [ctypes.c_uint]
    context = create(_OSMESA_RGBA, 24, 8, 0, None)
    size = 16
    pixels = (ctypes.c_float * (size * size * 4))()
    if not context or not make_current(context, pixels, _GL_FLOAT, size, size):
        raise ProbeError("OSMesa cannot create an OpenGL context")
    return gl_strings(get_string)


def render() -> dict[str, Any]:
    """Draw a tiny MuJoCo scene; needs the backend in ``MUJOCO_GL``."""
    import mujoco

    size = 16
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><light pos='0 0 3'/><geom type='sphere' size='1' rgba='1 0 0 1'/></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, height=size, width=size) as renderer:
        elapsed = 0.0
        for _ in range(3):  # the first frame also uploads meshes and compiles shaders
            start = time.perf_counter()
            renderer.update_scene(data)
            frame = renderer.render()
            elapsed = time.perf_counter() - start
        from OpenGL import GL

        strings = gl_strings(GL.glGetString)
    red, green, blue = (int(value) for value in frame[size // 2, size // 2])
    if not red > max(green, blue):
        raise ProbeError(f"the red ball came out in the colour {red, green, blue}")
    return {**strings, "frame_ms": round(1e3 * elapsed, 3)}


def main() -> int:
    """Run the probe that the first argument names."""
    probes = {"egl": probe_egl, "osmesa": probe_osmesa, "render": render}
    try:
        report: dict[str, Any] = dict(probes[sys.argv[1]]())
    except Exception as error:  # any failure is the result of the probe
        report = {"error": str(error) if isinstance(error, ProbeError) else f"{type(error).__name__}: {error}"}
    print(json.dumps(report), flush=True)
    # Skip the drivers' clean-up at exit, in which some hang or crash; there is nothing left to save.
    os._exit(1 if "error" in report else 0)


if __name__ == "__main__":
    main()
