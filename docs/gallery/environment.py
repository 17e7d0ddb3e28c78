"""
A learning environment and its expert
=====================================

Train an agent in ``TelescopicReach-v0``, a Gymnasium environment in which the arm must come to rest at a random target.
Its expert, a certified network, shows what reward is possible. The pictures show one episode, and the curves the
rewards of the expert and of random actions.
"""

import gymnasium
import matplotlib.pyplot as plt

from lieednn_sim.environments.expert import Expert

name = "lieednn_sim.environments.gymnasium:LieEDNN/TelescopicReach-v0"
environment = gymnasium.make(name, render_mode="rgb_array", size=(400, 300))
expert = Expert(environment)
print("action:", environment.action_space)
for name, space in environment.observation_space.items():
    print(f"observed {name}:", space.shape)

# %%
# With the same seed both act in the same episode.

SHOWN = (1, 40, 60, 90)


def episode(act, pictures=None):
    environment.reset(seed=1)
    rewards, truncated = [], False
    while not truncated:
        _, reward, _, truncated, info = environment.step(act())
        rewards.append(reward)
        if len(rewards) in SHOWN and pictures is not None:
            pictures.append(environment.render())
    print(f"return {sum(rewards):.0f} of {len(rewards)}, success: {info['success']}")
    return rewards


frames = []
by_expert = episode(expert.act, frames)
environment.action_space.seed(0)
at_random = episode(environment.action_space.sample)
environment.close()

fig, axes = plt.subplots(2, 2, figsize=(7, 5.3), layout="constrained")
step = environment.unwrapped.task.control_timestep
for ax, frame, number in zip(axes.flat, frames, SHOWN, strict=True):
    ax.imshow(frame)
    ax.set(title=f"{number * step:.2f} s", xticks=[], yticks=[])

# %%
# The reward is 1 exactly when the arm rests at the target.

fig, ax = plt.subplots(figsize=(7, 3.5), layout="constrained")
for rewards, label in ((by_expert, "expert"), (at_random, "random actions")):
    ax.plot([step * (k + 1) for k in range(len(rewards))], rewards, label=label)
ax.set(title="Reward in one episode", xlabel="time [s]", ylabel="reward", ylim=(0, 1.05))
ax.legend()
