"""The road from a target to a video: each step of one run, as a small picture."""

import numpy as np
from drawings import style

import lieednn_sim as ls
from lieednn_sim.rendering.still import still

arm = ls.Arm.load("telescopic_pr")
plan = ls.plan(arm, "extended", seed=0)
rollout = ls.simulate(arm, plan)
motion, size, crop = plan.motion, (600, 400), (0.12, 0.96, 0.98, 0.14)
half = len(motion.t) // 2

_, axes = style.figure(7.6, 4, 2)
titles = ("target", "network: its weights", "states ξ(t)", "pose of each joint", "joint trajectory q(t)", "simulation")
axes = axes.ravel()
for number, (axis, title) in enumerate(zip(axes, (*titles, "metrics", "video, page, pictures"), strict=True), 1):
    axis.set_title(f"{number}  {title}", loc="left", fontweight="bold", fontsize=8.5)

style.show_arm(axes[0], arm, plan.target, target=plan.target, size=size, crop=crop)
poses = arm.compose(ls.lie.exp(motion.xi[half] * arm.twist_units)).as_matrix()
style.draw_frames(axes[3], style.show_arm(axes[3], arm, motion.q[half], size=size, crop=crop), poses, 0.25)
style.show_arm(axes[5], arm, rollout.q[half], target=plan.target, size=size, crop=crop)
axes[7].imshow(still(rollout, camera=None, size=size, preset="draft"))
axes[7].set(xlim=axes[5].get_xlim(), ylim=axes[5].get_ylim())
axes[7].set_axis_off()

limit = np.abs(plan.network.weight).max()
axes[1].imshow(plan.network.weight, cmap="RdBu", vmin=-limit, vmax=limit)
axes[1].set_axis_off()
shown = motion.tau < 8.0
axes[2].plot(motion.tau[shown], motion.xi[shown].reshape(shown.sum(), -1), color=style.BLUE, lw=0.8)
axes[2].set(xlabel="network's own time", ylabel="rad, m")
axes[4].plot(motion.t, motion.q, color=style.GREEN, lw=0.9)
axes[4].set(xlabel="time [s]", ylabel="rad, m")
error = 1e3 * np.linalg.norm(arm.tip(rollout.q_ref) - rollout.link_position[:, -1], axis=1)
axes[6].plot(rollout.t, error, color=style.ORANGE, lw=1.0)
axes[6].set(xlabel="time [s]", ylabel="error [mm]")
