"""
A library of motions in one network
===================================

For an arm that needs many motions. All of them are starts of the hidden neurons of one certified network, so that two
can be blended and one changed in flight, under the same proof. Here an arm reaches to the twelve hours of a clock face.
The page shows a blend of two motions; the figure shows all paths, two blends, and a flight that is changed twice.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
library, paths = ls.MotionLibrary(arm.n_links), []
for hour in range(1, 13):
    angle = np.pi * hour / 6
    place = (1.6, 0.3 - 0.6 * np.sin(angle), 1.4 + 0.6 * np.cos(angle))
    motion = ls.plan(arm, ls.solve_ik(arm, place), planner="minimum-jerk").motion
    library.add(f"{hour} h", motion)
    paths.append(arm.tip(motion.q))
library.save("motions.npz")
size = Path("motions.npz").stat().st_size / 1024
print(f"{len(library.names)} motions, {size:.0f} KiB; {library.universal.certificate}")

# %%
# A blend is a motion that nobody has planned. ``library.plan`` checks it against the arm's limits and for contact.

blends = [library.plan(arm, "10 h", "2 h", part) for part in (0.3, 0.7)]
rollout = ls.simulate(arm, blends[1])
rollout.to_html("motion.html")

# %%
# In flight the visible neurons stay where they are and the hidden ones jump to another motion. The path has a corner
# there, which the policy ``lieednn-replanning`` avoids. After the last change the network runs on to its target.

state, pieces = library.start("12 h"), []
for name, span in (("12 h", 0.5), ("4 h", 0.5), ("8 h", 12.0)):
    network, state = library.switch(state, name)
    run = network.trajectory(state, span)
    pieces.append(arm.tip(arm.decode(run.xi[:, : arm.n_links]).q))
    state = run.xi[-1]
flight = np.concatenate(pieces)
print(f"{1e3 * np.linalg.norm(flight[-1] - paths[7][-1]):.2f} mm from 8 h at the end")

fig, ax = plt.subplots(figsize=(7, 6), layout="constrained")
for hour, path in enumerate(paths, start=1):
    ax.plot(*path[:, 1:].T, color="0.75")
    ax.annotate(str(hour), path[-1, 1:], ha="center", va="center", size="large")
for blend, name in zip(blends, ("mostly 10", "mostly 2"), strict=True):
    ax.plot(*arm.tip(blend.motion.q)[:, 1:].T, label=f"blend: {name}")
ax.plot(*flight[:, 1:].T, color="tab:red", label="12, then 4, then 8")
ax.plot(*pieces[0][-1, 1:], "o", *pieces[1][-1, 1:], "o", color="tab:red")
ax.set(title="Paths of the end effector, as the arm sees them", aspect="equal")
ax.set(xlabel="y [m]", ylabel="z [m]")
ax.invert_xaxis()
fig.legend(ncols=3, loc="outside lower center")
