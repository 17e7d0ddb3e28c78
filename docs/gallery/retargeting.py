"""
One network, any target
=======================

Change the target during a motion, without planning again. A network is certified once; another target changes only its
bias, on which the proof does not depend. Here the target jumps four times while the arm moves. The page shows the
motion, and the figure the distance of the end effector from the current target.
"""

from time import process_time

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
home = arm.keyframe("home")
drawn = np.array([ls.draw_target(arm, seed) for seed in (2, 5, 8, 13, 7)])
targets = home + 0.6 * (drawn - home)
policy = ls.make_policy("lieednn-certified", arm, targets[0])
print(policy.network.certificate)

# %%
# Retargeting takes one product of the weights and the activations.

states = arm.encode(targets)
begun = process_time()
others = [policy.network.retarget(state) for state in states]
spent = (process_time() - begun) / len(others)
print(f"{1e6 * spent:.0f} us for a target")
print(f"all certified: {all(other.certified for other in others)}")

# %%
# The policy does this in every control period in which the target moved. The sphere marks the last target.


def target(t):
    return targets[min(int(t / 2.0), 4)]


following = ls.follow(policy, target, duration=12.0)
rollout = following.rollout
ls.render_page(rollout, "motion.html")

# %%
# The distance rises when the target jumps, and falls again. At the last target the arm arrives.

away = arm.tip(rollout.q) - arm.tip(following.target)
distance = np.linalg.norm(away, axis=1)
print(f"{1e3 * distance[-1]:.1f} mm from the last target after {rollout.t[-1]:.0f} s")

fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
ax.plot(rollout.t, distance, color="tab:orange")
for jump in following.jumps:
    ax.axvline(jump, color="0.8", zorder=0)
ax.set(title="Distance of the end effector from the present target", ylim=(0, None))
ax.set(xlabel="time [s]  (grey: the target jumps)", ylabel="distance [m]")
