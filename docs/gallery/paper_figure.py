"""
The figure of the paper
=======================

Four neurons in se(3) converge to their target from sixteen random starts. This is the paper's figure of its four-link
example, for many starts instead of one. The network is certified, so the figure shows what is proved: the target
attracts every start.
"""

import matplotlib.pyplot as plt
import numpy as np

import lieednn_sim as ls

# %%
# The paper draws its targets at random: four twists, each coordinate uniform between -0.8 and 0.8. A twist is (omega,
# v): a rotation vector in radians and a translation in units of length. The bias is 1/8 in every coordinate.

rng = np.random.default_rng(0)
target = rng.uniform(-0.8, 0.8, (4, 6))
network = ls.synthesize(target, bias=np.full((4, 6), 0.125), seed=0).unwrap()
verdict = network.assess()
proved = verdict.strongest.rate
print(network.certificate)
print(f"proved rate from every start: {proved:.3f} gamma")

# %%
# Sixteen starts are drawn, uniform between -2 and 2, and run for 40 time units of 1/gamma.

times = np.linspace(0.0, 40.0, 401)
starts = rng.uniform(-2.0, 2.0, (16, 4, 6))
runs = np.stack([network.trajectory(start, 40.0)(times) for start in starts])

names = [rf"$\omega_{axis}$" for axis in "xyz"] + [rf"$v_{axis}$" for axis in "xyz"]
figure, axes = plt.subplots(2, 2, figsize=(6.4, 5.0), sharex="all", sharey="all")
figure.set_layout_engine("constrained")
for i, panel in enumerate(axes.flat):
    for k, name in enumerate(names):
        panel.plot(times, runs[:, :, i, k].T, color=f"C{k}", lw=0.7, alpha=0.5)
        panel.axhline(target[i, k], color=f"C{k}", ls="--", lw=1.2, label=name)
    panel.set_title(f"neuron {i + 1}")
axes[1, 0].set_xlim(0.0, 25.0)
figure.supxlabel(r"time [$1/\gamma$]", fontsize="medium")
figure.supylabel("coordinate [rad, length]", fontsize="medium")
handles, labels = axes[0, 0].get_legend_handles_labels()
figure.legend(handles, labels, loc="outside upper center", ncols=6, title="dashed: target")

# %%
# The distance to the target falls exponentially. The proof gives a lower bound on the rate that holds from any start,
# even far away, where the slopes of tanh are small. Near the target the linearised network has a higher rate.

distance = np.abs(runs - target).max(axis=(2, 3))
local = verdict["local"].rate
print(f"largest distance at the end: {distance[:, -1].max():.1e} [rad, length]")
figure, panel = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
panel.semilogy(times, distance.T, color="C0", lw=0.7, alpha=0.6)
for dash, rate, name in ("--", proved, "proved"), (":", local, "local"):
    label = rf"slope of the {name} rate, {rate:.3f} $\gamma$"
    panel.semilogy(times, 3.0 * np.exp(-rate * times), "k" + dash, label=label)
panel.set(xlabel=r"time [$1/\gamma$]", ylabel="largest distance\n[rad, length]")
panel.set_title("distance from the target, sixteen random starts")
panel.legend()
