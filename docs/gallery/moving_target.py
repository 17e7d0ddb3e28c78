"""
A target that moves, and the lag behind it
==========================================

Follow a target that moves and jumps, for instance at a conveyor or in a handover. A certified network follows it by
changing only its bias, and its weights prove beforehand how far it may lag behind. This example compares the lag with
the proved bound, and with simply sending the target itself to the controller. If the target's motion is known
beforehand, plan it and track the plan instead.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls
from lieednn_sim.policies import NetworkPolicy, Policy

# %%
# The target oscillates about the middle between two keyframes, by 15 % of their difference, once in 6 s. Then it jumps
# by half of the difference and rests.

arm = ls.Arm.load("telescopic_pr")
home, extended = arm.keyframe("home"), arm.keyframe("extended")
t = np.arange(0.0, 9.0, arm.timestep)
where = np.where(t < 6.0, 0.5 + 0.15 * np.sin(2.0 * np.pi / 6.0 * t), 1.0)
target = home + where[:, None] * (extended - home)  # a row for each step

# %%
# The policies run without feedback, which the bound does not cover. The third policy is the second with feedforward of
# the target's velocity. The last one is just the target.


class Target(Policy):
    """The reference is the target itself."""

    def act(self, measured, target):
        velocity = np.clip((target - self.q) * self.rate, -arm.velocity_limits, arm.velocity_limits)
        return target, velocity


how = {"rate": 50.0, "feedback": None}
names = ("linear-attractor", "lieednn-certified")
policies = {name: ls.make_policy(name, arm, target[0], **how) for name in names}
network, speed = policies[names[1]].network, policies[names[1]].speed
policies["with feedforward"] = NetworkPolicy(arm, network, speed=speed, **how)
policies["the target itself"] = Target(arm, 50.0)

# %%
# The bound is a distance per unit of the target's speed, in the network's coordinates: the twists of all four links, in
# radians and metres together. The policy runs its network at ``speed`` units of network time per second. So the proved
# bound on the distance is the lag, times the largest speed of the encoded target, divided by the policy's ``speed``.

figure, (above, below) = plt.subplots(2, 1, figsize=(6.4, 5.0), sharex=True)
figure.set_layout_engine("constrained")
for colour, (name, policy) in zip(("C1", "C0", "C2", "C3"), policies.items(), strict=True):
    following = ls.follow(policy, target, 9.0, start=target[0])
    rollout = following.rollout
    error = 1e3 * np.linalg.norm(arm.tip(rollout.q) - arm.tip(following.target), axis=1)
    swings = rollout.t < 6.0
    fastest = np.abs(rollout.qd) / arm.velocity_limits
    print(f"{name}: {np.sqrt((error[swings] ** 2).mean()):.1f} mm RMS behind,")
    print(f"  velocity at the jump {fastest.max():.2f} times its limit, {error[-1]:.2f} mm off at the end")
    above.plot(rollout.t, rollout.q[:, 4], color=colour, label=name)
    if name in names:
        seen = slice(None, int(swings.sum()), following.period)
        goals = arm.encode(following.target[seen]).reshape(len(following.target[seen]), -1)
        distance = np.linalg.norm(following.states[: len(goals)].reshape(len(goals), -1) - goals, axis=1)
        below.plot(rollout.t[seen], distance, color=colour)
        quickest = np.linalg.norm(np.diff(goals, axis=0), axis=1).max() * policy.rate
        bound = policy.network.robustness().lag() * quickest / policy.speed
        print(f"  largest distance {distance.max():.3f}, proved {bound:.3f} [rad, m]")
        below.axhline(bound, color=colour, ls="--", label=f"proved, {name}")
above.plot(t, target[:, 4], "k:", label="target")
above.set(ylabel="yaw [rad]", title="one joint, and the network's distance from its target")
below.set(xlabel="time [s]", ylabel="distance [rad, m]", ylim=(0.0, 0.26))
above.legend(fontsize="small", ncols=2)
below.legend(fontsize="small", loc="upper left")
