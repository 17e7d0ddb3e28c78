r"""
A plan in somebody else's model
===============================

For whoever has a MuJoCo model in memory, from a benchmark or from a simulator of their own, and wants a motion of its
arm around everything that is in it. Here it is a task of dm_control: a Jaco arm among bricks. ``ls.Arm.of`` takes the
compiled model and its state as they are, and plans and simulations are in that model's own order.
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
plan = ls.plan(arm, pose)
print(f"{plan.planner}, {plan.t[-1]:.1f} s, qpos {plan.qpos.shape}")
print(plan.network.certificate)

# %%
# Played in their model by setting ``qpos``, or simulated there by its own actuators, while all else obeys physics.

run = ls.simulate(arm, plan)
print(f"largest tracking error of the hand: {ls.evaluate(run).end_effector.tracking_max_mm:.2f} mm")
ls.render_page(run, "motion.html")
