"""Plot of a training; PNG, or by the file's suffix."""

from __future__ import annotations

import os

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import ArrayLike

from lieednn_sim.evaluation import figure_layout
from lieednn_sim.evaluation.figure_layout import COLOURS, STYLE
from lieednn_sim.learning import History


def plot_training(history: History, target: ArrayLike, tolerance: float, path: str | os.PathLike[str]) -> None:
    """Error, accuracy and learning rate by epoch, and the equilibrium's distance to the target by coordinate."""
    goal = np.asarray(target)
    error = np.abs(history.equilibrium - goal)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10, 6.4), layout="constrained")
        axes = figure.subplots(2, 2, sharex=True)
        distance, accuracy, rate, equilibrium = axes.ravel()
        distance.semilogy(history.epoch, history.error, lw=1.2, label="$\\Vert\\xi^*-\\xi_d\\Vert_2$ (loss E)")
        distance.semilogy(history.epoch, error.max(axis=(-2, -1)), lw=1.2, label="largest coordinate")
        distance.axhline(tolerance, color="0.4", ls="--", lw=0.9, label="tolerance")
        distance.set_title("distance of the equilibrium to the target", loc="left")
        distance.set_ylabel("[rad, length units]")
        distance.legend()
        accuracy.plot(history.epoch, 100.0 * history.accuracy)
        accuracy.set_ylim(-2.0, 102.0)
        accuracy.set_title("accuracy: coordinates within the tolerance", loc="left")
        accuracy.set_ylabel("[%]")
        rate.semilogy(history.epoch, history.rate)
        # Otherwise a range of less than a decade has no tick, or too many.
        low, high = float(history.rate.min()), float(history.rate.max())
        rate.set_ylim(10.0 ** np.floor(np.log10(low) - 1e-9), 10.0 ** np.ceil(np.log10(high) + 1e-9))
        rate.yaxis.set_minor_formatter(NullFormatter())
        rate.set_title("learning rate", loc="left")
        rate.set_ylabel("$\\eta$")
        # Rotation and translation of SE(3) by colour; other groups have one kind of coordinate.
        spatial = goal.shape[-1] == 6
        kinds = (("rotation $\\omega$", slice(0, 3)), ("translation $v$", slice(3, 6)))
        for colour, (name, chosen) in zip(COLOURS, kinds if spatial else [("coordinates", slice(None))], strict=False):
            lines = equilibrium.plot(
                history.epoch, history.equilibrium[..., chosen].reshape(len(history), -1), color=colour, ls="-", lw=0.9
            )
            lines[0].set_label(name)
            for value in goal[..., chosen].ravel():
                equilibrium.axhline(value, color=colour, ls="--", lw=0.6)
        equilibrium.plot([], [], color="0.3", ls="--", lw=0.9, label="target")
        equilibrium.set_title("equilibrium $\\xi^*$ by coordinate", loc="left")
        equilibrium.set_ylabel("[rad, length units]")
        equilibrium.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.16))
        for axis in (rate, equilibrium):
            axis.set_xlabel("epoch")
        figure_layout.save_figure(figure, path)
