"""
A push, and the proved return
=============================

For whoever wants to know what happens when something hits the arm. A force throws the arm off its way. A tracker plays
its motion as if nothing had happened. A certified network lets the arm pull its state along, and goes to the target
from there; the figure shows the proved bound on its distance.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.stability import Decay

arm = ls.Arm.load("telescopic_pr")
target = arm.keyframe("extended")
push = ls.Push("end effector", force=(0.0, -500.0, 0.0), start=0.6, duration=0.2)
disturbances = ls.Disturbances(pushes=(push,))
network = ls.make_policy("lieednn-certified", arm, target)
tracker = ls.make_policy("tracker", arm, target)
runs = {}
for name, policy in (("network", network), ("tracker", tracker)):
    runs[name] = ls.follow(policy, target, duration=6.0, disturbances=disturbances)
    rollout = runs[name].rollout
    thrown = np.linalg.norm(arm.tip(rollout.q) - arm.tip(rollout.q_ref), axis=1).max()
    off = np.linalg.norm(arm.tip(rollout.q[-1]) - arm.tip(target))
    print(f"{name}: thrown {thrown:.1f} m off, {1e3 * off:.1f} mm off at the end")

# %%
# The page shows how the arm with the network gives way and returns.

following, rollout = runs["network"], runs["network"].rollout
ls.render_page(rollout, "motion.html")

# %%
# The bound holds from the moment at which the arm no longer pulls the network's state, that is, when it is within the
# tolerance of 1 % of the joints' ranges. While the network waits for the arm, its own time is slower than the clock's.

goal = arm.encode(target)
error = (following.states - goal).reshape(len(following.states), -1)
behind, pace = (rollout.channels[key][:: following.period] for key in ("behind", "pace"))
first = np.flatnonzero(behind > 0.01)[-1] + 1
own_time = network.speed / network.rate * (np.cumsum(pace[first:]) - pace[first])
decay = Decay(network.network.robustness(), error.shape[1])
bound = [decay.bound(decay.begin(error[first]), time) for time in own_time]
distance = np.linalg.norm(error, axis=1)
print(f"bound kept: {(distance[first:] <= bound).all()}")

t = rollout.t[:: following.period]
fig, ax = plt.subplots(figsize=(7, 4.5), layout="constrained")
for name, run in runs.items():
    apart = (arm.encode(run.rollout.q) - goal).reshape(len(run.rollout.t), -1)
    ax.semilogy(run.rollout.t, np.linalg.norm(apart, axis=1), label=f"arm behind the {name}")
ax.semilogy(t, distance, "k:", label="state of the network")
ax.semilogy(t[first:], bound, "k--", label="proved bound on it")
ax.axvspan(push.start, push.end, color="0.85", label="push")
ax.set(title="Distance from the target after a push", xlabel="time [s]", ylim=(1e-4, 10))
ax.set_ylabel("distance in the network's coordinates")
ax.legend()
