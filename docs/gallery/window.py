"""
Through a window
================

Reach through an opening: the target is behind a window. ``lieednn-shaped`` first lets a guide find a motion that
touches nothing, and then encodes its path in a certified network. The page shows the motion, and the figure compares
every error during the motion with the clearance.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.planning import find_tube

arm = ls.Arm.load("telescopic_pr", scene="window", seed=2)
planned = ls.plan(arm, ls.draw_target(arm, seed=2))
print(f"planner {planned.planner}, guided by {planned.guide.planner}")
print(planned.network.certificate)

# %%
# The arm follows the plan with a controller that knows its dynamics, and 1 kg that the controller does not know.

load = ls.Disturbances(payload=1.0)
rollout = ls.simulate(arm, planned, controller="computed-torque", disturbances=load)
ls.render_page(rollout, "motion.html")

# %%
# ``find_tube`` proves how far all links may deviate from the planned path, at any instant, and still end at the target
# without contact.

clearance = ls.evaluate(rollout).clearance_mm
tube = find_tube(arm, planned)
print(tube)

# %%
# The network's deviation from its guide's path is far smaller than the arm's deviation from its plan.

motion, shown = planned.motion, planned.guide.motion
network_off = 1e3 * np.linalg.norm(arm.tip(motion.q) - arm.tip(shown.q), axis=1)
arm_off = 1e3 * np.linalg.norm(arm.tip(rollout.q) - arm.tip(rollout.q_ref), axis=1)
print(f"network off its guide: at most {network_off.max():.3f} mm")
print(f"arm off its plan: at most {arm_off.max():.1f} mm")
print(f"least clearance: {clearance:.0f} mm")

fig, ax = plt.subplots(figsize=(7, 4), layout="constrained")
ax.axhline(clearance, color="0.3", label="least clearance of the arm")
ax.axhline(1e3 * tube.size, color="0.3", ls="--", label="proved tube")
ax.semilogy(rollout.t, arm_off, label="simulated arm from its plan")
ax.semilogy(motion.t, network_off, label="network from its guide")
ax.set(title="Errors on the way, and the room for them", xlabel="time [s]")
ax.set(ylabel="distance at the end effector [mm]", ylim=(1e-4, 1e3))
ax.legend(ncols=2, loc="upper center")
