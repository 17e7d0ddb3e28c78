"""
On a straight line
==================

Keep the end effector on a line or at an orientation, to open a drawer, insert a part or carry a full cup.
`path_constraint` takes the region in which the end effector must stay, here a line with an orientation. The network
that follows the motion has its certificate as always.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_rrp")
here = arm.link_poses(arm.keyframe("home"))[-1]
there = here.translation + np.array([0.0, 1.2, 0.0])

# %%
# The goal is the end of the line. The path constraint is the line with the orientation at the start.

line = ls.TaskSpaceRegion.line(here.translation, there, here.rotation)
kept = ls.plan(arm, ls.TaskSpaceRegion.box(there, there), path_constraint=line)
free = ls.plan(arm, kept.target)
print(line)
print(kept.network.certificate)

# %%
# Both motions have the same ends. The simulated arm carries 1 kg that its controller does not know.

load = ls.Disturbances(payload=1.0)
rollout = ls.simulate(arm, kept, controller="computed-torque", disturbances=load)
ls.render_page(rollout, "motion.html")

# %%
# Distance and rotation of the end effector from the line: planned with the path constraint, simulated, and planned
# without it.

motions = {"planned without a line": free.motion, "planned on the line": kept.motion, "simulated": rollout}
fig, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained")
for label, motion in motions.items():
    distance, angle = np.transpose([line.distance(arm.link_poses(q)[-1]) for q in motion.q[::10]])
    print(f"{label}: at most {1e3 * distance.max():.2g} mm and {np.rad2deg(angle.max()):.2g} degrees")
    path = arm.tip(motion.q)
    axes[0].plot(path[:, 1], path[:, 0], label=label)
    axes[1].semilogy(motion.t[::10], 1e3 * distance + 1e-6)
    axes[2].semilogy(motion.t[::10], np.rad2deg(angle) + 1e-6)
axes[0].set(title="The way of the end effector", xlabel="y [m]", ylabel="x [m]")
axes[1].set(title="Off the line [mm]", xlabel="time [s]")
axes[2].set(title="Turned [degrees]", xlabel="time [s]")
fig.legend(loc="outside lower center", ncols=3)
