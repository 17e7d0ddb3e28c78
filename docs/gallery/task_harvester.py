"""
Picking fruit
=============

A telescopic arm picks a fruit behind a trellis: it moves in front of the fruit, approaches it straight along its own
axis, and returns to where fruit is put down. All motions are timed to the arm's limits. Published orchard robots need
about six seconds for a fruit (``assets/tasks/harvester`` in the repository has the sources).
"""

from pathlib import Path

import mujoco
import numpy as np

import lieednn_sim as ls

scene = Path(ls.__file__).parents[1] / "assets/tasks/harvester/scene.xml"
model = mujoco.MjModel.from_xml_path(str(scene))
data = mujoco.MjData(model)
mujoco.mj_resetDataKeyframe(model, data, 0)
mujoco.mj_forward(model, data)
joints, home = ["yaw", "pitch", "extend"], data.qpos.copy()

# %%
# The arm points at a fruit by two angles and a length. Its tip is 0.5 m from the axes when it is not extended.

away = data.body("fruit0").xpos - data.body("cart").xpos
far = np.linalg.norm(away)
angles = [np.arctan2(away[1], away[0]), np.arcsin(away[2] / far)]
before, at = (np.array([*angles, far - 0.04 - gap - 0.5]) for gap in (0.11, 0.01))

# %%
# Three plans in a row, each from where the simulation of the plan before ended.

taken = []
for goal, hold in ((before, 0.0), (at, 1.0), (home, 0.5)):
    arm = ls.Arm.of(model, data, joints, tip="tip")
    found = ls.plan(arm, goal, planner="lieednn-shaped", duration=1.5, fastest=True)
    run = ls.simulate(arm, found, hold=hold)
    data.qpos[:] = run.qpos[-1]
    taken.append(found.t[-1])
    if goal is before:
        ls.render_page(run, "motion.html", title="harvester")
print("moving: " + ", ".join(f"{time:.2f} s" for time in taken))
print(f"a fruit in {sum(taken) + 1.0:.2f} s, with a second for the vacuum")
