"""Plots of models of demonstrations: their paths, and the field around them; PNG, or by the file's suffix."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from lieednn_sim.evaluation.figure_layout import COLOURS, drawn, entries_of, fitted_legend
from lieednn_sim.learning.demonstrations import Demonstrations
from lieednn_sim.learning.demonstrations.alignment import displacement
from lieednn_sim.learning.demonstrations.models import MotionModel
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.planning.demonstrated import JointDemonstrations
from lieednn_sim.planning.motion import travelled
from lieednn_sim.studies.demonstrations.models import random_starts, reproduction
from lieednn_sim.values import Floats, StrPath

# A name for the legend, paths, and the style of their lines.
Group = tuple[str, Sequence[Floats], dict[str, Any]]

# Wide enough to be seen below the network's paths.
_SHOWN: dict[str, Any] = {"color": "0.78", "lw": 2.6, "ls": "-"}
_ELSEWHERE = "0.45"
# Joints in a row, number of other starts drawn, and points of the field along each side.
_IN_ROW, _STARTS, _FIELD = 3, 12, 28
# Line styles of the models, the network's first.
_LINES: tuple[dict[str, Any], ...] = (
    {"color": COLOURS[0], "lw": 1.8, "ls": "-"},
    {"color": COLOURS[1], "lw": 1.3, "ls": "--"},
    {"color": COLOURS[2], "lw": 1.3, "ls": ":"},
    {"color": COLOURS[3], "lw": 1.0, "ls": "-."},
    {"color": COLOURS[5], "lw": 1.0, "ls": (0, (5, 1, 1, 1, 1, 1))},
)
_FAN: dict[str, Any] = {"color": COLOURS[0], "lw": 0.6, "ls": "-", "alpha": 0.6}
_BAND: dict[str, Any] = {"color": "#d9eaf3", "lw": 0.3}


def plot_paths(models: Mapping[str, MotionModel], demonstrations: Demonstrations, path: StrPath) -> None:
    """Plot demonstrations and each model's reproduction of their mean.

    Positions in a plane are shown in one view, positions in space in three. Below them, rotations, where they were
    recorded, are shown over the fraction of the path. Thin lines are the first model's reproductions from the
    demonstrations' own starts; the band about its reproduction of the mean is two standard deviations on each side.
    """
    start, (network, first) = demonstrations.mean[0], next(iter(models.items()))
    paths = {name: displacement(reproduction(model, demonstrations, start)) for name, model in models.items()}
    fan = [displacement(reproduction(first, demonstrations, twist[0], twist[-1])) for twist in demonstrations.twists]
    groups: list[Group] = [
        ("demonstrations", list(demonstrations.displaced), _SHOWN),
        (f"{network}, from their starts", fan, _FAN),
        *((name, [item], line) for (name, item), line in zip(paths.items(), _LINES, strict=False)),
    ]
    band, path_of_band = np.empty((0, 6, 6)), paths[network]
    if isinstance(first, ShapedMotion) and first.spread is not None:
        t = np.linspace(0.0, first.durations * demonstrations.duration, len(path_of_band))
        band = first.covariance(start, t)
    views = ((0, 1),) if demonstrations.dof == 2 else ((0, 1), (0, 2), (1, 2))
    turns = demonstrations.dof == 6
    with drawn(path, *((6.4, 5.6) if len(views) == 1 else (12.5, 7.6 if turns else 4.4))) as figure:
        axes = figure.subplots(2 if turns else 1, len(views), squeeze=False)
        for axis, (h, v) in zip(axes[0], views, strict=True):
            labelled = axis is axes[0, 0]
            _draw_paths(axis, groups, partial(_seen, view=[3 + h, 3 + v]), labelled)
            if len(band):
                _draw_band(axis, path_of_band, band, [3 + h, 3 + v], "two standard deviations" if labelled else None)
            ends = _seen(demonstrations.displaced[:, -1], [3 + h, 3 + v])
            axis.plot(*ends, "k*", ms=9, zorder=5, label="goal" if labelled else None)
            axis.set(xlabel=f"{'xyz'[h]} [mm]", ylabel=f"{'xyz'[v]} [mm]")
            axis.set_aspect("equal", adjustable="datalim")
        for c in range(3 if turns else 0):
            axis = axes[1, c]
            _draw_paths(axis, groups, partial(_over_path, lever=demonstrations.lever, c=c), False)
            if len(band):
                fraction, turn = _over_path(path_of_band, demonstrations.lever, c)
                width = 2.0 * np.rad2deg(np.sqrt(band[:, c, c]))
                axis.fill_between(fraction, turn - width, turn + width, **_BAND)
            axis.set(xlabel="fraction of the path", ylabel=f"turn about {'xyz'[c]} [deg]")
        fitted_legend(figure, entries_of(axes[0, 0]), 4)


def plot_joint_paths(
    demonstrations: JointDemonstrations,
    reproduction: Floats,
    path: StrPath,
    elsewhere: Sequence[Floats] = (),
    fan: Sequence[Floats] = (),
) -> None:
    """Plot each joint over the fraction of the path; all joint positions are ``(K, n)``.

    ``reproduction`` starts where the mean does, and each path of ``fan`` where its demonstration does; of the paths
    ``elsewhere``, from other starts, the first few are shown.
    """
    arm = demonstrations.arm
    rows = -(-arm.n_joints // _IN_ROW)
    groups: list[Group] = [
        ("demonstrations", list(demonstrations.q), _SHOWN),
        ("starts elsewhere", elsewhere[:_STARTS], {"color": _ELSEWHERE, "lw": 0.7, "ls": ":"}),
        ("lieednn-shaped, from their starts", fan, _FAN),
        ("lieednn-shaped, from their mean start", [reproduction], _LINES[0]),
    ]
    with drawn(path, 10.5, 0.9 + 2.1 * rows) as figure:
        axes = figure.subplots(rows, _IN_ROW, squeeze=False, sharex=True).ravel()
        for joint, axis in enumerate(axes):
            if joint >= arm.n_joints:
                axis.set_axis_off()
                continue
            seen = partial(lambda joint, q: (demonstrations.length_fractions(q), q[:, joint]), joint)
            _draw_paths(axis, groups, seen, joint == 0)
            axis.set(title=arm.joint_names[joint], ylabel=f"[{arm.unit(joint)}]")
            if joint + _IN_ROW >= arm.n_joints:
                axis.set_xlabel("fraction of the path")
                axis.xaxis.set_tick_params(labelbottom=True)
        fitted_legend(figure, entries_of(axes[0]), len(groups))


def plot_field(model: ShapedMotion, demonstrations: Demonstrations, path: StrPath, seed: int = 0) -> None:
    """Plot where a model leads from other starts: its velocity field in a plane, and paths from random starts.

    The field is that of the first instant, with hidden neurons or phase at their start; it changes over time. For
    positions in space, the plane is spanned by the two axes along which the demonstrations extend most.
    """
    twists = random_starts(demonstrations, _STARTS, seed)
    paths = displacement(np.stack([reproduction(model, demonstrations, start) for start in twists]))
    extent = np.ptp(demonstrations.displaced[..., 3:].reshape(-1, 3), axis=0)
    h, v = np.sort(np.argsort(-extent, kind="stable")[:2])
    mean = displacement(reproduction(model, demonstrations, demonstrations.mean[0]))
    groups: list[Group] = [
        ("starts elsewhere", list(paths), {"color": _ELSEWHERE, "lw": 0.8, "ls": "-", "marker": "o", "markevery": [0]}),
        ("demonstrations", list(demonstrations.displaced), {"color": COLOURS[4], "lw": 1.0, "ls": "-"}),
        (f"{model.name}, from their mean start", [mean], _LINES[0]),
    ]
    every = 1e3 * paths[..., [3 + h, 3 + v]]
    low, high = every.min(axis=(0, 1)), every.max(axis=(0, 1))
    low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    # The figure has the aspect ratio of the field.
    height = 1.0 + 6.0 * float(np.clip((high - low)[1] / (high - low)[0], 0.4, 1.5))
    with drawn(path, 6.8, height) as figure:
        axis = figure.subplots()
        if demonstrations.dof < 6:
            _draw_field(axis, model, demonstrations, (low, high), (h, v))
        _draw_paths(axis, groups, partial(_seen, view=[3 + h, 3 + v]), True)
        axis.plot(0.0, 0.0, "k*", ms=11, zorder=6, label="goal")
        axis.set(xlabel=f"{'xyz'[h]} [mm]", ylabel=f"{'xyz'[v]} [mm]", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axis.set_aspect("equal", adjustable="box")
        fitted_legend(figure, entries_of(axis), 2)


def _draw_paths(
    axis: Any, groups: Sequence[Group], shown: Callable[[Floats], tuple[Floats, Floats]], labelled: bool
) -> None:
    """Draw groups of paths, each at the coordinates that ``shown`` gives, with one label for each group."""
    for name, paths, line in groups:
        for number, item in enumerate(paths):
            axis.plot(*shown(item), **{"ms": 4, **line}, label=name if labelled and not number else None)


def _draw_field(
    axis: Any, model: MotionModel, demonstrations: Demonstrations, box: tuple[Floats, Floats], plane: tuple[int, int]
) -> None:
    """Streamlines of the model's initial velocity in a plane."""
    lines = [np.linspace(low, high, _FIELD) for low, high in zip(*box, strict=True)]
    grid = np.stack(np.meshgrid(*lines), axis=-1)
    starts = np.zeros((_FIELD**2, 6))
    starts[:, 3:] = demonstrations.displaced[..., 3:].mean(axis=(0, 1))
    starts[:, [3 + c for c in plane]] = 1e-3 * grid.reshape(-1, 2)
    # A twist without rotation is a position.
    step = 0.02 * demonstrations.duration
    moved = model.reproduce(starts, np.array([0.0, step]))
    flow = 1e3 * (moved[:, 1] - moved[:, 0])[:, [3 + c for c in plane]].reshape(_FIELD, _FIELD, 2)
    look = {"color": "0.85", "linewidth": 0.6, "arrowsize": 0.7, "density": 1.3, "zorder": 1}
    axis.streamplot(*lines, flow[..., 0], flow[..., 1], **look)


def _draw_band(axis: Any, path: Floats, covariance: Floats, view: list[int], label: str | None) -> None:
    """Two standard deviations across a path ``(K, 6)``, on both sides, seen along an axis [mm]."""
    along = np.gradient(path[:, view], axis=0)
    across = along[:, ::-1] * [-1.0, 1.0] / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    seen = covariance[:, view][:, :, view]
    width = 2.0 * np.sqrt(np.einsum("ki,kij,kj->k", across, seen, across))[:, None] * across
    left, right = 1e3 * (path[:, view] + width), 1e3 * (path[:, view] - width)
    # By opaque pieces, which may overlap: where the path turns sharply, the edge of the whole would leave holes.
    axis.fill(*np.stack([left[:-1], left[1:], right[1:], right[:-1]]).transpose(2, 0, 1), **_BAND, label=label)


def _seen(displaced: Floats, view: list[int]) -> tuple[Floats, Floats]:
    """Two coordinates of a path [mm]."""
    return 1e3 * displaced[:, view[0]], 1e3 * displaced[:, view[1]]


def _over_path(displaced: Floats, lever: float, c: int) -> tuple[Floats, Floats]:
    length = travelled(displaced * ([lever] * 3 + [1.0] * 3))
    return length / length[-1], np.rad2deg(displaced[:, c])
