"""
A boom of 22 m through a pipe
=============================

Inspect a vessel that no person can enter. A boom of 22 m passes through a hole of 0.55 m in the vessel's wall, which
leaves a margin of about 40 mm, and through the opening of a pedestal behind it. Then it turns its head and lowers a
wand with a camera. Its dimensions are published ones of a real boom (``assets/tasks/boom`` in the repository).
"""

from pathlib import Path

import mujoco

import lieednn_sim as ls

scene = Path(ls.__file__).parents[1] / "assets/tasks/boom/scene.xml"
model = mujoco.MjModel.from_xml_path(str(scene))
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
joints = ["carriage", "telescope", "yaw", "pitch", "reach"]
goal = [4.95, 4.2, 0.45, 1.0, 0.4]  # m, m, rad, rad, m

arm = ls.Arm.of(model, data, joints, tip="tip", clearance=0.03)

# %%
# Minimum jerk moves all joints at once, into the pipe.

try:
    ls.plan(arm, goal, planner="minimum-jerk", duration=60.0)
except ls.PlanError as error:
    print(f"minimum-jerk: {error}")

# %%
# ``lieednn-shaped`` lets a guide find a path that keeps 30 mm, and encodes it in a network with a proof.

found = ls.plan(arm, goal, planner="lieednn-shaped", duration=60.0)
print(f"{found.planner}, {found.t[-1]:.0f} s, guided by {found.guide.planner}")
print(found.network.certificate)

# %%
# The scene's own servos follow it.

run = ls.simulate(arm, found, hold=2.0)
print(f"largest tracking error: {1e3 * abs(run.tracking_error).max():.2g} mm or mrad")
ls.render_page(run, "motion.html", title="boom")
