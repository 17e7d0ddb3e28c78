"""A motion among poles from above, and motions that deviate from it within the tube, each from another instant on."""

import matplotlib.pyplot as plt
import numpy as np
from drawings import style

import lieednn_sim as ls
from lieednn_sim.planning import find_tube

arm = ls.Arm.load("telescopic_pr", scene="poles", seed=0)
plan = ls.plan(arm, ls.draw_target(arm, seed=0), seed=0)
tube, motion = find_tube(arm, plan), plan.motion

_, axis = style.figure(3.9)
rng = np.random.default_rng(0)
low, high = (0.62, 0.46), (1.12, 0.88)
here = np.flatnonzero(np.all((arm.tip(motion.q)[:, :2] > low) & (arm.tip(motion.q)[:, :2] < high), axis=1))
for label in ["deviations of full size", *[None] * 39]:
    k = rng.choice(here)
    after = slice(k, None, 8)
    directions = rng.normal(size=(arm.n_links, 2, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    deviation = (directions * np.stack([tube.rotation, tube.translation], axis=1)[..., None]).reshape(-1, 6)
    # The network of this planner is a cascade: the deviation of its visible neurons decays as e^-tau, exactly.
    left = np.exp(-plan.network.gamma * (motion.tau[after] - motion.tau[k]))[:, None, None]
    tip = arm.tip(arm.decode(motion.xi[after] + left * deviation, start=motion.q[k]).q)
    axis.plot(tip[:, 0], tip[:, 1], color=style.BLUE, lw=0.7, alpha=0.6, label=label)
    axis.plot(*tip[0, :2], "o", color=style.BLUE, ms=3)
tip = arm.tip(motion.q)
axis.plot(tip[:, 0], tip[:, 1], color=style.ORANGE, lw=2.0, label="planned")
for geom in map(arm.model.geom, range(arm.model.ngeom)):
    if geom.name.startswith("obstacle_pole"):
        axis.add_patch(plt.Circle(geom.pos[:2], geom.size[0], color=style.GREY))
axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]")
axis.text(0.984, 0.51, "pole", ha="center", va="center")
axis.legend(loc="upper right")
