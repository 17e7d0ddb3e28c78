"""Pushes on a certified network, and the bounds that are proved for them."""

import numpy as np
from drawings import style

import lieednn_sim as ls

arm = ls.Arm.load("telescopic_pr")
network = ls.plan(arm, "extended", seed=0).network
target = network.equilibrium().xi
robustness = network.robustness()
gain = robustness.push_gain()

_, axis = style.figure(3.0)
rng, t = np.random.default_rng(0), np.linspace(0.0, 8.0, 161)
for direction in rng.normal(size=(20, *target.shape)):
    start = target + direction / np.linalg.norm(direction)
    error = network.trajectory(start, t[-1], rtol=1e-6)(t) - target
    axis.plot(t, np.linalg.norm(error, axis=(1, 2)), color=style.BLUE, lw=0.8, alpha=0.7)
fractions = gain * np.logspace(0.0, -2.5, 60)
axis.plot([robustness.settling_time(f) for f in fractions], fractions, color=style.RED, lw=1.6)
axis.plot([0.0, robustness.settling_time(gain)], [gain, gain], color=style.RED, lw=1.6)
axis.text(0.15, gain + 0.04, f"proved: never above {gain:.2f}", color=style.RED, va="bottom")
axis.set(xlim=(0.0, 8.0), ylim=(0.0, 1.2 * gain), xlabel="network's own time", ylabel="distance from the target")
