"""
A pole walks into the way
=========================

Replan around obstacles that move. Here a pole moves into the way of an arm that is already moving. An arm that plays
its planned motion hits the pole. The policy ``lieednn-replanning`` slows down, searches for a path around the pole by
RRT-Connect (extra ``rivals``), and follows that path with the same proof of arrival.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.simulation import MovingObstacle

# %%
# A scene is a file of shapes. The pole is 1.7 m high and stands aside at first.

Path("pole.yaml").write_text("""
obstacles:
  - {shape: cylinder, name: pole, radius: 0.05, length: 1.7, position: [1.9, 2.2, 0.85]}
""")
arm = ls.Arm.load("telescopic_pr", scene="pole.yaml")
target = arm.keyframe("home").copy()
target[0] += 1.6  # turn by 92 degrees, at the same reach
motion = ls.plan(arm, target, planner="minimum-jerk", duration=4.0)

# %%
# The pole moves to where the end effector would pass later. The page shows the replanned motion and the final position
# of the pole.

places = ((1.9, 2.2, 0.85), (0.66, 1.6, 0.85))
walk = MovingObstacle("obstacle_pole", times=(0.8, 1.6), positions=places)
walks = ls.Disturbances(obstacles=(walk,))
rollouts = {}
for name in ("tracker", "lieednn-replanning"):
    policy = ls.make_policy(name, arm, motion, rate=50)
    shown = ls.follow(policy, target, 6.0, disturbances=walks).rollout
    rollouts[name], judged = shown, ls.evaluate(shown)
    force, away = judged.peak_contact_force_n, judged.final_effector_mm
    print(f"{name}: contact force {force:.0f} N, ends {away:.1f} mm off")
print(f"paths taken: {shown.channels['changes'][-1]:.0f}")
shown = replace(shown, arm=arm.with_moved_bodies({"obstacle_pole": places[-1]}))
ls.render_page(shown, "pole.html")

# %%
# At first both arms follow the same path. With replanning the arm slows down during the search, then goes around the
# pole.

figure, (above, speed) = plt.subplots(1, 2, figsize=(6.4, 3.2), layout="constrained")
for width, (name, one) in zip((3.0, 1.5), rollouts.items(), strict=True):
    x, y, _ = one.link_position[:, -1].T
    above.plot(x, y, lw=width, label=name)
    velocity = np.gradient(one.link_position[:, -1], one.timestep, axis=0)
    speed.plot(one.t, np.linalg.norm(velocity, axis=1), lw=width)
above.plot(*np.array(places)[:, :2].T, "k:o", label="pole")
above.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="seen from above")
speed.axvspan(*walk.times, color="0.9")
speed.set(xlabel="time [s]", ylabel="speed [m/s]", title="speed (grey: the pole walks)")
figure.legend(*above.get_legend_handles_labels(), loc="outside upper center", ncols=3)
