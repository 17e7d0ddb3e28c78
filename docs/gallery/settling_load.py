"""
A load that hangs still when it arrives
=======================================

Move a hanging load so that it is at rest at the end. A timber crane lifts a log over a truck's stakes in 8 s; its last
stage bends, and the log swings. ``settle="least-energy"`` follows the planned path with another time law, after which
little swing is left, also if the load is a fifth heavier or hangs lower than the planner assumes.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import lieednn_sim as ls
from lieednn_sim.arm.oscillation import PassiveJoints, with_load

scene = Path(ls.__file__).parents[1] / "assets/tasks/crane/scene.xml"
model = mujoco.MjModel.from_xml_path(str(scene))
data = mujoco.MjData(model)
joints, start, goal = ["slew", "inner", "outer", "telescope"], [-1.5, 0.45, -1.45, 1.0], [0.0, 0.7, -1.6, 0.2]
data.qpos[:4] = data.ctrl[:] = start

# %%
# The natural frequencies and damping of the log about its rest position, from MuJoCo's mass matrix and linearised
# forces.

arm = ls.Arm.of(model, data, joints, tip="tip")
data.qpos[:] = PassiveJoints(arm).at_rest(data.qpos[None])[0]
arm = arm.at(data)
for mode in PassiveJoints(arm).modes(start):
    print(mode)

# %%
# The path with the planner's own time law.

plain = ls.plan(arm, goal, planner="lieednn-shaped", duration=8.0)
run = ls.simulate(arm, plain, hold=6.0)
print(f"without: {ls.evaluate(run).load}")
ls.render_page(run, "without.html", title="the planner's own time law")

# %%
# The same path in the same time, and the same network with its certificate.

calm = ls.plan(arm, goal, planner="lieednn-shaped", duration=8.0, settle="least-energy")
print(calm.network.certificate)
settled = ls.simulate(arm, calm, hold=6.0)
print(f"with: {ls.evaluate(settled).load}")
ls.render_page(settled, "with.html", title="least energy left")

# %%
# What swings, and how its frequencies change along the path. The plan knows only the model's load; the swing left with
# other loads is below.

figure, (above, middle, below) = plt.subplots(3, 1, figsize=(6.4, 7.2), layout="constrained")
for name, each in (("planner's own", run), ("least energy", settled)):
    line = each.poses("tip").translation - each.poses("load").translation
    above.plot(each.t, np.rad2deg(np.arccos(line[:, 2] / np.linalg.norm(line, axis=1))), label=name)
above.axvline(calm.t[-1], color="0.6", lw=1)
above.set(xlabel="time [s]", ylabel="log off vertical [degrees]")
rows = np.linspace(0, len(calm.t) - 1, 25).astype(int)
modes = [PassiveJoints(arm).modes(q) for q in calm.motion.q[rows]]
labels = [mode.joint for mode in modes[0]]
middle.plot(calm.t[rows], [[mode.frequency for mode in each] for each in modes], label=labels)
middle.set(xlabel="time [s]", ylabel="natural frequencies [Hz]", yscale="log")

errors = np.linspace(-0.2, 0.2, 9)
for name, plan, style in (("planner's own", plain, "C0"), ("least energy", calm, "C1")):
    for what, line in (("mass", "-"), ("length", "--")):
        loads = [ls.simulate(with_load(arm, **{what: 1.0 + error}), plan, hold=6.0) for error in errors]
        left = [ls.evaluate(load, clearance=False).load.swing_deg for load in loads]
        below.semilogy(100.0 * errors, left, style + line, label=f"{name}, {what}")
below.set(xlabel="load's error [%]", ylabel="swing left [degrees]")
for axis in (above, middle, below):
    axis.legend()
