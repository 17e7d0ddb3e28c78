"""
A blend of two motions
======================

Blend two planned motions into new ones without planning. One certified network makes every motion of an arm from a
*code*, the start of its hidden neurons. Halfway between two codes is a code of the same network, with the same proof of
arrival. Here an arm reaches for ten and for two o'clock on a clock face, and by blends for the hours in between.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
encoder = ls.synthesis.CurveEncoder(arm.n_links)
codes, ends = [], []
for hour in (10, 2):
    angle = np.pi * hour / 6
    place = (1.6, 0.3 - 0.6 * np.sin(angle), 1.4 + 0.6 * np.cos(angle))
    motion = ls.plan(arm, ls.solve_ik(arm, place), planner="minimum-jerk").motion
    codes.append(encoder.code(motion.xi))
    ends.append(motion.xi[[0, -1]])

# %%
# States are nearly linear in codes, so the path of a blend is nearly the blend of the paths. ``encoder.path`` gives it
# in closed form; the arm decodes it to joint positions.

fig, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for part in np.linspace(0.0, 1.0, 6):
    code = (1.0 - part) * codes[0] + part * codes[1]
    start, target = (1.0 - part) * ends[0] + part * ends[1]
    network = encoder.with_code(code, target)
    states = encoder.path(network, start)(np.linspace(0.0, 1.0 - 1e-6, 200))
    places = arm.tip(arm.decode(states, start=arm.keyframe("home")).q)
    print(f"{part:.0%} of the way: certified {network.certified}, arrives at {places[-1].round(3)}")
    ax.plot(*places[:, 1:].T, color="0.7" if 0.0 < part < 1.0 else "tab:red")
    ax.annotate({0.0: "10 h", 1.0: "2 h"}.get(part, f"{part:.0%}"), places[-1, 1:] + [0.0, 0.01], ha="center")
ax.set(title="Paths of the end effector, as the arm sees them", aspect="equal", ymargin=0.15)
ax.set(xlabel="y [m]", ylabel="z [m]")
ax.invert_xaxis()
