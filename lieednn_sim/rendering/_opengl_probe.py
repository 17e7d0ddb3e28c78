"""Child process of `lieednn_sim.rendering.opengl`: draws a frame where a crash or a hang of the driver does no harm.

Run by path, with the backend in ``MUJOCO_GL``. Prints one JSON object: the driver's strings, or ``{"error": ...}``.
Loading a driver that is not needed would cost the caller 100 MB and start threads that make a later ``fork`` hang.
"""

from __future__ import annotations

import json
import os


def render() -> dict[str, str]:
    """Draw a red ball with MuJoCo; returns vendor, renderer and version of the driver."""
    try:
        import mujoco
    except (ImportError, AttributeError) as error:
        raise RuntimeError(f"its library cannot be loaded ({error})") from None

    size = 16
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><light pos='0 0 3'/><geom type='sphere' size='1' rgba='1 0 0 1'/></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, height=size, width=size) as renderer:
        renderer.update_scene(data)
        red, green, blue = (int(value) for value in renderer.render()[size // 2, size // 2])
        if not red > max(green, blue):
            raise RuntimeError(f"the red ball came out in the colour {red, green, blue}")
        from OpenGL import GL

        names = ("GL_VENDOR", "GL_RENDERER", "GL_VERSION")
        return {name: GL.glGetString(getattr(GL, name)).decode(errors="replace") for name in names}


if __name__ == "__main__":
    try:
        report = render()
    except Exception as error:  # any failure is the result of the probe
        report = {"error": str(error) or type(error).__name__}
    print(json.dumps(report), flush=True)
    # Skip the drivers' clean-up at exit, in which some hang or crash; there is nothing left to save.
    os._exit(1 if "error" in report else 0)
