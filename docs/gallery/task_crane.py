"""
A crane with an elastic boom and a swinging log
===============================================

A timber crane lifts a log over a truck's stakes. The planner takes the crane as rigid; in simulation its last stage
bends and the log swings. How much swing is left depends on the timing of the path: smooth, as planned, or with a
trapezoidal speed in the same time.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import lieednn_sim as ls

scene = Path(ls.__file__).parents[1] / "assets/tasks/crane/scene.xml"
model = mujoco.MjModel.from_xml_path(str(scene))
data = mujoco.MjData(model)
start, goal = np.array([-1.5, 0.45, -1.45, 1.0]), [0.0, 0.7, -1.6, 0.2]
data.qpos[:4] = data.ctrl[:] = start
data.joint("swing_along").qpos = start[1] + start[2]
for _ in range(2000):  # until the log hangs at rest
    mujoco.mj_step(model, data)
    data.qvel[4:] *= 0.98
data.qpos[:4], data.qvel[:] = start, 0.0

# %%
# The scene has boxes that only the hook collides with. They keep it high enough for the log below it.

joints = ["slew", "inner", "outer", "telescope"]
arm = ls.Arm.of(model, data, joints, tip="tip")
found = ls.plan(arm, goal, planner="lieednn-shaped", duration=12.0)
print(found.network.certificate)

# %%
# The same path in the same time with a trapezoidal speed.

passed = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(found.motion.q, axis=0), axis=1)))
now = found.t / found.t[-1]
reached = np.cumsum(np.clip(np.minimum(now, 1.0 - now) / 0.25, 0.0, 1.0))
rows = np.interp(reached / reached[-1] * passed[-1], passed, np.arange(len(passed))).round().astype(int)
smooth = np.stack(
    [np.convolve(np.pad(q, 25, "edge"), np.ones(51) / 51, "valid") for q in found.motion.q[rows].T], axis=1
)
trapezoidal = replace(found.motion, q=smooth, qd=np.gradient(smooth, found.t, axis=0))

fig, ax = plt.subplots(figsize=(7, 3.5), layout="constrained")
for name, plan in (("as planned", found), ("trapezoidal speed", trapezoidal)):
    run = ls.simulate(arm, plan, hold=10.0)
    line = run.poses("tip").translation - run.poses("load").translation
    angle = np.rad2deg(np.arccos(line[:, 2] / np.linalg.norm(line, axis=1)))
    print(f"{name}: {angle[run.t > run.motion_end].max():.1f} degrees of swing left")
    ax.plot(run.t, angle, label=name)
    if plan is found:
        ls.render_page(run, "motion.html", title="crane")
ax.axvline(found.t[-1], color="0.6", lw=1)
ax.set(title="Swing of the log, and the end of the motion", xlabel="time [s]", ylabel="angle [degrees]")
ax.legend()
