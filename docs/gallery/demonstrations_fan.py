"""
Learning from demonstrations, with a fan of starts
==================================================

Demonstrate a motion a few times, then reproduce it from other starts. In nine demonstrations a hand goes around an
obstacle to the same goal, in a wider curve if it starts higher. One certified network learns the mean and how the
motion depends on its start. The figures show the demonstrations, and the network's motions from new starts.
"""

import matplotlib.pyplot as plt
import numpy as np

from lieednn_sim.learning.demonstrations import Demonstration, ShapedMotion, align

s = np.linspace(0.0, 1.0, 150)
rng = np.random.default_rng(0)


def ideal(height):
    """The way from (-0.6, height) to the origin, as it is meant."""
    curve = (0.12 + 0.5 * height) * np.sin(np.pi * s) ** 2
    return np.column_stack([-0.6 * (1.0 - s), height * (1.0 - s) + curve])


def shaky(height):
    """The same by hand: two slow waves of some millimetres that vanish at both ends."""
    waves = np.sin(np.pi * np.outer(s, [1, 2])) @ rng.normal(scale=0.004, size=(2, 2))
    return Demonstration.from_samples(ideal(height) + waves, t=3.0 * s)


heights = np.linspace(-0.1, 0.3, 9)
shown = align([shaky(height) for height in heights])
family = ShapedMotion.fit(shown)
single = ShapedMotion.fit(shown, family=False)
print(family.network.certificate)
print(family.shaping.message)

# %%
# Starts are twists relative to the goal: no rotation, and a position. A family adapts the curve to the start; with a
# single curve the deviation of the start only decays.

new = np.linspace(-0.17, 0.37, 12)
starts = np.outer(new, np.eye(6)[4]) - 0.6 * np.eye(6)[3]
truth = np.array([ideal(height) for height in new])[:, None]
for name, model in (("single curve", single), ("family", family)):
    ways = model.reproduce(starts, shown.t)[..., 3:5]
    off = np.linalg.norm(ways[:, :, None] - truth, axis=-1).min(axis=2)
    print(f"{name}: {1e3 * off.mean():.1f} mm off on average, at most {1e3 * off.max():.0f}")

fig, (left, right) = plt.subplots(1, 2, figsize=(7, 4), layout="constrained", sharey=True)
for twists in shown.twists:
    left.plot(*twists[:, 3:5].T, color="0.6")
left.plot(*shown.mean[:, 3:5].T, "k", lw=2)
for height, way in zip(new, ways, strict=True):
    right.plot(*way.T, color="tab:blue" if -0.1 < height < 0.3 else "tab:orange")
for ax in (left, right):
    ax.plot(0, 0, "k*", ms=12)
    ax.set(xlabel="x [m]", ylabel="y [m]")
left.set_title("nine demonstrations and their mean")
right.set_title("new starts; orange: farther out")
