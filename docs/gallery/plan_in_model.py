r"""
A plan in somebody else's model
===============================

For whoever has a MuJoCo model in memory, from a benchmark or from a simulator of their own, and wants a motion of its
arm around everything that is in it. Here it is a task of dm_control: a Jaco arm among bricks. ``ls.plan_in`` takes the
compiled model and its state as they are, and returns positions in that model's own order.
"""

import numpy as np
from dm_control import manipulation
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls

task = manipulation.load("stack_2_bricks_features", seed=1)
task.reset()
model, data = task.physics.model.ptr, task.physics.data.ptr

# %%
# The named joints are the arm. Bricks, hand and floor are its scene, where the state has them.

joints = [f"jaco_arm/joint_{k}" for k in range(1, 7)]
hand = "jaco_arm/jaco_hand/pinchsite"
arm = ls.Arm.of(model, data, joints, tip=hand)
print(arm)

# %%
# The goal may be given by joint positions or, as here, by the pose of the hand: close above the brick that lies free.

brick = data.body("duplo2x4_2/").xpos
downwards = arm.link_poses(arm.keyframe("home"))[-1].rotation
pose = RigidTransform.from_components(brick + np.array([0.0, 0.0, 0.16]), downwards)
found = ls.plan_in(model, data, joints, pose, tip=hand)
print(f"{found.plan.planner}, {found.t[-1]:.1f} s, qpos {found.qpos.shape}")
print(found.plan.network.certificate)

# %%
# Played in their model by setting ``qpos``, or simulated there by its own actuators, while all else obeys physics.

run = ls.run_in(model, data, found)
apart = run.poses(run.tip).translation - run.poses(run.tip, planned=True).translation
print(f"largest tracking error of the hand: {1e3 * np.linalg.norm(apart, axis=1).max():.2f} mm")
ls.render_page(run, "motion.html")
