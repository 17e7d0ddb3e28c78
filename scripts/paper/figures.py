"""The figures: those of the paper (loss, accuracy, weights, trajectory, equilibrium), and others beside them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from paper import network_figures, style
from paper.plan import INSIDE, OUTSIDE, PERIODS, TOLERANCE
from paper.results import Missing, Results, curves, seeds


def draw(results: Results, directory: Path) -> dict[str, str]:
    """Draw every figure for which there are results; returns captions by file name, in the order of the report."""
    makers: dict[str, Callable[[Results], tuple[Figure, str]]] = {
        "training": training,
        "oscillation": oscillation,
        "weights": network_figures.weights,
        "trajectory": network_figures.trajectories,
        "equilibrium": network_figures.equilibria,
        "stability": network_figures.stability,
    }
    captions = {}
    for name, make in makers.items():
        with matplotlib.rc_context(style.STYLE), suppress(Missing):
            figure, caption = make(results)
            captions[style.save(figure, directory, name)] = caption
    return captions


def training(results: Results) -> tuple[Figure, str]:
    """Loss and accuracy over epochs, paper's Fig. (a) and (b)."""
    names = [f"P={period}" for period in PERIODS]
    results.require(*names)
    drawn = style.figure(4.6)
    axes = drawn.subplots(2, 2, sharex=True, sharey="col")
    grid = np.unique(np.round(np.geomspace(1, results.plan.max_epochs, 200)))
    for row, chosen in enumerate((INSIDE, OUTSIDE)):
        lines = [(f"P={period}", f"$P={period}$", style.COLOURS[k], style.DASHES[k]) for k, period in enumerate(chosen)]
        if row == 0 and results["literal"]:
            lines.append(("literal", "as printed, $P=10$", style.GREY, ":"))
        for name, label, colour, dash in lines:
            low, middle, high = np.quantile(curves(results[name], "error_median", grid), [0.25, 0.5, 0.75], axis=0)
            axes[row, 0].fill_between(grid, low, high, color=colour, alpha=0.15, lw=0)
            axes[row, 0].plot(grid, middle, color=colour, ls=dash, label=label)
            axes[row, 1].plot(grid, curves(results[name], "accuracy", grid).mean(axis=0), color=colour, ls=dash)
        axes[row, 0].axhline(style.SETTLED, color="0.3", lw=0.8, ls=(0, (1, 2)))
        axes[row, 0].set_ylabel(r"loss $E = \|\xi^*-\xi_d\|_2$")
        axes[row, 1].set_ylabel("accuracy, mean over targets")
        handles, labels = axes[row, 0].get_legend_handles_labels()
        axes[row, 1].legend(handles, labels, loc="upper left", title=None)
    axes[0, 0].set(xscale="log", yscale="log")
    axes[0, 0].text(1.2, style.SETTLED * 1.2, r"$\sqrt{24}\,\tau$", va="bottom")
    axes[0, 1].set_ylim(-0.03, 1.03)
    style.letter(*axes.ravel())
    for axis in axes[1]:
        axis.set_xlabel("epoch")
    counts = f"{len(results['P=8'])} targets, {len(results['P=10'])} for P = 10, {len(results['literal'])} as printed"
    return drawn, (
        "Training with the repaired Algorithm 1: (a) loss and (b) accuracy for the projection periods that the paper "
        "recommends, (c) and (d) for other periods. Lines in (a) and (c) are medians over targets, and bands are their "
        f"quartiles ({counts}). Accuracy is the fraction of the 24 coordinates within tau = {TOLERANCE:g}; it is 1 "
        "only below the dotted line. A run that stopped keeps its last value."
    )


def oscillation(results: Results) -> tuple[Figure, str]:
    """One target in detail."""
    seed = results.example()
    record = results.of("P=10", seed)
    drawn = style.figure(2.5)
    left, right = drawn.subplots(1, 2, width_ratios=(1.25, 1.0))
    for k, period in enumerate(INSIDE):
        if seed not in seeds(results[f"P={period}"]):
            continue
        one = results.of(f"P={period}", seed)
        # Logarithmic axes have no epoch 0.
        epoch = one.arrays["epoch"] + 1.0
        low, high = one.arrays["error_low"], one.arrays["error_high"]
        left.fill_between(epoch, low, high, color=style.COLOURS[k], alpha=0.2, lw=0)
        left.plot(epoch, one.arrays["error_median"], color=style.COLOURS[k], ls=style.DASHES[k], label=f"$P={period}$")
    left.axhline(style.SETTLED, color="0.3", lw=0.8, ls=(0, (1, 2)))
    left.set(xscale="log", yscale="log", xlabel="epoch", ylabel=r"loss $E$")
    left.legend(loc="lower left")
    first = record.arrays["first_error"][:201]
    right.plot(np.arange(len(first)), first, color=style.COLOURS[1], lw=1.0)
    jumps = np.arange(0, len(first), 10)
    right.plot(jumps, first[jumps], "o", ms=3, color="0.2", label="after a projection")
    right.set(xlabel="epoch", ylabel=r"loss $E$")
    right.legend(loc="upper right")
    style.letter(left, right)
    return drawn, (
        f"Oscillation of the loss for one target (seed {seed}): (a) whole trainings, where lines are medians and bands "
        "the range of the loss in bins of epochs; (b) the first 200 epochs with P = 10, where every projection raises "
        "the loss again."
    )
