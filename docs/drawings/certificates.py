"""Trajectories of a certified network from everywhere in a plane, and its lambda_max against the bound."""

import numpy as np
from drawings import style

import lieednn_sim as ls

target = np.random.default_rng(0).uniform(-0.8, 0.8, (4, 6))
network = ls.synthesize(target).unwrap()
certificate = network.certificate

_, (left, right) = style.figure(5.6, 2, 1, height_ratios=(4, 1))
# The plane through the target that two coordinates span, the others beginning at their targets.
around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
for angle in around:
    start = target.copy()
    start[0, 0] += 3.0 * np.cos(angle)
    start[1, 1] += 3.0 * np.sin(angle)
    path = network.trajectory(start, 30.0, until=target, rtol=1e-6).xi
    left.plot(path[:, 0, 0], path[:, 1, 1], color=style.BLUE, lw=0.9)
    left.plot(*start[[0, 1], [0, 1]], "o", color=style.BLUE, ms=3)
left.plot(target[0, 0], target[1, 1], "*", color=style.ORANGE, ms=13, zorder=3, label="target")
left.set(xlabel=r"$\omega_x$ of neuron 1 [rad]", ylabel=r"$\omega_y$ of neuron 2 [rad]", aspect="equal")
left.legend(loc="upper right")

scale = np.sqrt(certificate.lyapunov_diagonal)
scaled = network.rotational_weight * (scale[:, None] / scale)
values = np.linalg.eigvalsh(0.5 * (scaled + scaled.T))
plain = np.linalg.eigvalsh(0.5 * (network.rotational_weight + network.rotational_weight.T))
for height, eigenvalues, colour in ((1.0, plain, style.GREY), (0.0, values, style.BLUE)):
    right.plot(eigenvalues, np.full(12, height), "|", ms=16, mew=2, color=colour)
right.axvline(certificate.bound, color=style.RED, lw=1.2)
right.text(certificate.bound, 1.75, r"$\gamma/\mu$", color=style.RED, ha="center", va="center")
right.set_yticks([0.0, 1.0], ["sym(S W S⁻¹)", "sym(W)"])
right.set(ylim=(-0.6, 1.6), xlabel="eigenvalues of the rotational weights")
