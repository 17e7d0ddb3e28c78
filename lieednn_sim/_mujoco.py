"""The one place that imports MuJoCo: it reads ``MUJOCO_GL`` at its first import, so OpenGL is chosen before."""

from lieednn_sim.rendering import opengl

opengl.configure()

import mujoco  # noqa: E402  (must follow the choice above)

__all__ = ["mujoco"]
