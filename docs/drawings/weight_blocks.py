"""The weight matrix of a certified network with its blocks, and what one block does to a twist."""

import numpy as np
from drawings import style

import lieednn_sim as ls

target = np.random.default_rng(0).uniform(-0.8, 0.8, (4, 6))
network = ls.synthesize(target).unwrap()
weight = network.weight
_, (left, right) = style.figure(5.6, 2, 1, height_ratios=(3, 2))
limit = np.abs(weight).max()
picture = left.imshow(weight, cmap="RdBu", vmin=-limit, vmax=limit)
for edge in range(0, 25, 6):
    left.axhline(edge - 0.5, color="black", lw=1.0)
    left.axvline(edge - 0.5, color="black", lw=1.0)
for edge in range(3, 24, 6):
    left.axhline(edge - 0.5, color=style.GREY, lw=0.5, ls=":")
    left.axvline(edge - 0.5, color=style.GREY, lw=0.5, ls=":")
middles = np.arange(2.5, 24, 6)
left.set_xticks(middles, [f"from {j}" for j in range(1, 5)])
left.set_yticks(middles, [f"to {i}" for i in range(1, 5)])
left.tick_params(length=0)
left.xaxis.tick_top()
left.figure.colorbar(picture, ax=left, shrink=0.8)

i, j = 0, 1
sent = np.tanh(target[j])
received = network.blocks[i, j] @ sent
places = np.arange(6)
right.bar(places - 0.2, sent, 0.38, color=style.GREY, label="tanh ξ₂, sent by neuron 2")
right.bar(places + 0.2, received, 0.38, color=style.ORANGE, label="α₁₂ Ad(θ₁₂) tanh ξ₂, received by neuron 1")
right.axhline(0.0, color="black", lw=0.8)
right.set_xticks(places, [f"${part}_{axis}$" for part in (r"\omega", "v") for axis in "xyz"])
right.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
