"""MuJoCo, imported even where ``MUJOCO_GL`` names an OpenGL that is not there: physics needs none.

MuJoCo imports the OpenGL bindings that the variable names, and fails when they do. What rendering takes is decided when
something is rendered, in `rendering.opengl`.
"""

import os

try:
    import mujoco
except Exception:  # of several OpenGL bindings, with no common base
    asked = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        import mujoco
    finally:
        if asked is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = asked

__all__ = ["mujoco"]
