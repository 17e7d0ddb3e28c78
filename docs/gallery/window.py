"""
Through a window
================

The target lies behind a narrow window. ``lieednn-shaped`` lets a sampling planner find the way and encodes it in a
certified network, so that the motion has the smoothness of its teacher and the network's proof. One sees the arm reach
through the window, and how far it stays away from the frame.
"""

import matplotlib.pyplot as plt

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr", scene="window", seed=1)
planned = ls.plan(arm, ls.draw_target(arm, seed=1))
rollout = ls.simulate(arm, planned, controller="computed-torque")
print(f"taught by {planned.teacher.planner}, {1e3 * planned.details.deviation:.4f} mm off its path")
rollout.to_html("motion.html")

# %%
# The clearance
# -------------

plt.plot(rollout.t, rollout.q)
