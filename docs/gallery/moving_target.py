"""
A target that moves, and the lag behind it
==========================================

An arm that hands something over, or that works at a conveyor, has a target that moves. A certified network follows it
by changing its bias alone, and its weights prove beforehand how far it may lag behind. This example moves a target to
and fro. It compares the lag with the proved bound for a certified network and for the plain linear attractor, and shows
what remains of the lag when the network knows the target's velocity.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.policies import NetworkPolicy

# %%
# The target swings about the middle between two keyframes, by 15 % of the difference between them, once in 6 s.

arm = ls.Arm.load("telescopic_pr")
home, extended = arm.keyframe("home"), arm.keyframe("extended")
middle = 0.5 * (home + extended)
swing = 0.15 * np.sin(2.0 * np.pi / 6.0 * np.arange(0.0, 6.0, arm.timestep))
target = middle + swing[:, None] * (extended - home)  # a row for each step

# %%
# Each policy follows the target for 6 s, without feedback from the measured joints, about which the bound says nothing.
# The third policy is the second with feedforward, which adds the target's velocity.

how = {"rate": 50.0, "feedback": None}
names = ("linear-attractor", "lieednn-certified")
policies = {name: ls.make_policy(name, arm, middle, **how) for name in names}
network, speed = policies[names[1]].network, policies[names[1]].speed
policies["with feedforward"] = NetworkPolicy(arm, network, speed=speed, **how)

# %%
# The bound is a distance per unit of the target's speed, in the network's coordinates: the twists of all four links, in
# radians and metres together. The policy runs its network at ``speed`` units of network time per second. So the proved
# bound on the distance is the lag, times the largest speed of the encoded target, divided by the policy's ``speed``.

figure, (above, below) = plt.subplots(2, 1, figsize=(6.4, 5.0), sharex=True)
figure.set_layout_engine("constrained")
for colour, (name, policy) in zip(("C1", "C0", "C2"), policies.items(), strict=True):
    following = ls.follow(policy, target, 6.0, start=middle)
    errors = ls.evaluate_following(following)
    print(f"{name}: {errors.rms_mm:.1f} mm RMS behind, {errors.lag_s:.3f} s late")
    above.plot(following.rollout.t, following.rollout.q[:, 4], color=colour, label=name)
    t = following.rollout.t[:: following.period]
    goals = arm.encode(following.target[:: following.period]).reshape(len(t), -1)
    distance = np.linalg.norm(following.states.reshape(len(t), -1) - goals, axis=1)
    below.plot(t, distance, color=colour)
    if name in names:
        fastest = np.linalg.norm(np.diff(goals, axis=0), axis=1).max() * policy.rate
        bound = policy.network.robustness().lag() * fastest / policy.speed
        print(f"  largest distance {distance.max():.3f}, proved {bound:.3f} [rad, m]")
        below.axhline(bound, color=colour, ls="--", label=f"proved, {name}")
above.plot(following.rollout.t, following.target[:, 4], "k:", label="target")
above.set(ylabel="yaw [rad]", title="one joint, and the network's distance from its target")
below.set(xlabel="time [s]", ylabel="distance [rad, m]", ylim=(0.0, 0.26))
above.legend(fontsize="small", ncols=2)
below.legend(fontsize="small", loc="upper left")
