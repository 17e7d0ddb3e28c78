"""Figures of trained networks: weights, trajectories, equilibria during training, norms and certificates."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from paper import style
from paper.experiments import target, trajectory
from paper.results import Missing, Results, column

_COORDINATES = [rf"$\omega_{a}$" for a in "xyz"] + [rf"$v_{a}$" for a in "xyz"]


def weights(results: Results) -> tuple[Figure, str]:
    """Weight matrices with and without projection, paper's Fig. (c) and (d)."""
    seed = results.example()
    records = [results.of("P=10", seed), results.of("no projection", seed)]
    matrices = [record.arrays["weight"] for record in records]
    drawn = style.figure(2.9)
    axes = drawn.subplots(1, 2)
    style.letter(*axes)
    for axis, matrix in zip(axes, matrices, strict=True):
        n, largest = len(matrix), float(np.abs(matrix).max())
        image = axis.imshow(matrix, cmap="RdBu_r", vmin=-largest, vmax=largest, extent=(0, n, n, 0))
        for edge in range(0, n + 1, 3):
            block = edge % 6 == 0
            for line in (axis.axhline, axis.axvline):
                line(edge, color="0.15" if block else "0.6", lw=0.9 if block else 0.4, ls="-" if block else ":")
        ticks = np.arange(3, n, 6)
        for part in (axis.set_xticks, axis.set_yticks):
            part(ticks, [str(k + 1) for k in range(len(ticks))])
        axis.tick_params(length=0)
        axis.grid(visible=False)
        axis.spines[:].set_visible(False)
        axis.set_xlabel("sending neuron $j$")
        drawn.colorbar(image, ax=axis, shrink=0.72, pad=0.03, label="weight")
    axes[0].set_ylabel("receiving neuron $i$")
    errors = [record["structure_error"] for record in records]
    return drawn, (
        f"Trained weights for one target (seed {seed}): (a) with projection every 10 epochs, (b) without projection. "
        "Solid lines separate the 6 x 6 blocks, and dotted lines their 3 x 3 parts: R twice, hat(t) R below left, zero "
        "above right. The colour scales differ. Relative distances to the nearest weights alpha Ad are "
        f"{errors[0]:.1g} and {errors[1]:.2f}."
    )


def trajectories(results: Results) -> tuple[Figure, str]:
    """The trained network on its way to the equilibrium, paper's second figure (a)."""
    seed = results.example()
    record = results.of("P=10", seed)
    times = np.linspace(0.0, 25.0, 251)
    bias = record.arrays["bias"].ravel()
    states = trajectory(record.arrays["weight"], bias, np.zeros(bias.size), times)
    drawn = _neurons(times, states.reshape(-1, 4, 6), target(seed))
    for axis in drawn.axes:
        axis.set_xlabel(r"time [$1/\gamma$]")
    return drawn, (
        f"The trained network (P = 10, seed {seed}), started from zero: the six coordinates of each neuron (angles "
        "[rad], translations [length units]). Targets are dashed."
    )


def equilibria(results: Results) -> tuple[Figure, str]:
    """The equilibrium during training, paper's second figure (b)."""
    seed = results.example()
    record = results.of("P=10", seed)
    drawn = _neurons(record.arrays["epoch"] + 1.0, record.arrays["equilibrium"], target(seed))
    for axis in drawn.axes:
        axis.set(xscale="log", xlabel="epoch")
    return drawn, "The equilibrium of the same network during training. Targets are dashed."


def stability(results: Results) -> tuple[Figure, str]:
    """The paper's norm against the diagonal Lyapunov condition, network by network."""
    makers = {
        "P=10": ("repaired, $P=10$", style.BLUE, "o"),
        "tracked": ("tracked", style.VERMILION, "s"),
        "stability-aware": ("stability-aware", style.PURPLE, "D"),
        "certified synthesis": ("certified synthesis", style.GREEN, "^"),
    }
    shown = {name: results.successes(name) for name in makers if results.successes(name)}
    if not shown:
        raise Missing("any success")
    drawn = style.figure(2.8)
    axis = drawn.subplots()
    axis.axvspan(0.1, 1.0, color="0.9", lw=0)
    axis.axvline(1.0, color="0.3", lw=0.8)
    axis.axhline(1.0, color="0.3", lw=0.8, ls="--")
    for name, records in shown.items():
        label, colour, mark = makers[name]
        x = [record["one_norm"] for record in records]
        y = [record["lambda_max"] for record in records]
        axis.plot(x, y, mark, ms=3.2, mew=0, alpha=0.65, color=colour, label=label)
    every = next(iter(shown.values()))
    least = column(results["P=10"] or every, "smallest_one_norm")
    axis.set(xscale="log", xlim=(0.5, 40.0))
    axis.set_xticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    axis.minorticks_off()
    bottom, top = axis.get_ylim()
    rug = bottom - 0.08 * (top - bottom)
    axis.plot(least, [rug] * len(least), "|", color="k", ms=6, mew=0.6, label="least norm possible")
    axis.set_ylim(rug - 0.06 * (top - bottom), top)
    axis.text(0.71, top, "norm\ncondition\nholds", ha="center", va="top", color="0.3", fontsize=8)
    axis.text(1.05, 0.98, "certified below", ha="left", va="top", color="0.3", fontsize=8)
    axis.set_xlabel(r"$\|W\|_1$ in units of $\gamma/\mu$")
    axis.set_ylabel(r"$\lambda_{\max}$ of sym$(S\,W_R\,S^{-1})$")
    handles, labels = axis.get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside right center")
    return drawn, (
        "Networks that reach their target: the paper's norm and the diagonal Lyapunov condition. The paper's condition "
        "holds left of the solid line. The ticks are the least norms that any network with these equilibria can have. "
        "Global stability is proved below the dashed line."
    )


def _neurons(x: np.ndarray, states: np.ndarray, goal: np.ndarray) -> Figure:
    """One panel for each neuron, with its six coordinates over ``x``."""
    drawn = style.figure(2.5)
    axes = drawn.subplots(1, 4, sharey=True)
    for i, axis in enumerate(axes):
        for c, name in enumerate(_COORDINATES):
            axis.plot(x, states[:, i, c], color=style.COLOURS[c], lw=1.1, label=name)
            axis.axhline(goal[i, c], color=style.COLOURS[c], ls="--", lw=0.7)
        axis.set_title(rf"$\xi_{i + 1}$", fontsize=8.5, pad=4)
    axes[0].set_ylabel(r"coordinate [rad, length units]")
    handles, labels = axes[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside upper center", ncols=6)
    return drawn
