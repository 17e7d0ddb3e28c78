r"""
A plan in somebody else's model
===============================

Plan for an arm in a compiled MuJoCo model, from a benchmark or your own simulator, around everything in it. Here it is
a task of dm_control: a Jaco arm among bricks. ``ls.Arm.of`` takes the compiled model and its state unchanged; plans and
simulations use the model's own order of joints.
"""

import numpy as np
from dm_control import manipulation
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls

task = manipulation.load("stack_2_bricks_features", seed=1)
task.reset()
model, data = task.physics.model.ptr, task.physics.data.ptr

# %%
# The named joints are the arm. Bricks, hand and floor are the scene, at their positions in the state.

joints = [f"jaco_arm/joint_{k}" for k in range(1, 7)]
hand = "jaco_arm/jaco_hand/pinchsite"
arm = ls.Arm.of(model, data, joints, tip=hand)
print(arm)

# %%
# The goal may be joint positions or, as here, a pose of the hand: close above the free brick.

brick = data.body("duplo2x4_2/").xpos
downwards = arm.link_poses(arm.keyframe("home"))[-1].rotation
pose = RigidTransform.from_components(brick + np.array([0.0, 0.0, 0.16]), downwards)
plan = ls.plan(arm, pose)
print(f"{plan.planner}, {plan.t[-1]:.1f} s, qpos {plan.qpos.shape}")
print(plan.network.certificate)

# %%
# Play the plan in the model by setting ``qpos``, or simulate it with the model's own actuators.

run = ls.simulate(arm, plan)
print(f"largest tracking error of the hand: {ls.evaluate(run).end_effector.tracking_max_mm:.2f} mm")
ls.render_page(run, "motion.html")
