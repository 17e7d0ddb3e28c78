"""A family of motions from three demonstrations: a fan of starts, and the starts of the hidden neurons."""

import numpy as np
from drawings import style

from lieednn_sim.learning.demonstrations import Demonstration, ShapedMotion, align

s = np.linspace(0.0, 1.0, 100)


def bend(y, height):
    return np.column_stack([0.3 * (1 - s), y * (1 - s) + height * np.sin(np.pi * s)])


shown = align([Demonstration.from_samples(bend(y, h)) for y, h in ((-0.08, 0.05), (0.0, 0.10), (0.08, 0.15))])
model = ShapedMotion.fit(shown)
network = model.network

_, (above, below) = style.figure(4.8, 2, 1, height_ratios=(3, 2))
for y in np.linspace(-0.12, 0.12, 13):
    path = model.reproduce(np.array([0.0, 0.0, 0.0, 0.3, y, 0.0]), shown.t)
    above.plot(path[:, 3], path[:, 4], color=style.GREY, lw=0.8)
for demonstration, colour in zip(shown.twists, (style.BLUE, style.GREEN, style.ORANGE), strict=True):
    above.plot(demonstration[:, 3], demonstration[:, 4], color=colour, lw=2.0, ls="--")
    shift = network.start(demonstration[:1]) - network.start(network.start_reference)
    below.plot(np.arange(1, network.n_hidden + 1), shift[1:, 4], color=colour, marker="o", ms=2.5, lw=0.8)
above.plot(0.0, 0.0, "*", color=style.RED, ms=13, zorder=3)
above.set(xlabel="x from the goal [m]", ylabel="y from the goal [m]", aspect="equal", ylim=(-0.13, 0.26))
below.set(xlabel="hidden neuron", ylabel="change of its start")
