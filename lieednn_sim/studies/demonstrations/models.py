"""Comparison of models of the same demonstrations: reproduction, generalisation, and attraction from other starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rich.console import Group
from scipy.spatial.transform import Rotation

from lieednn_sim.budget import cpu_time, one_blas_thread, report
from lieednn_sim.evaluation.display import table
from lieednn_sim.learning.demonstrations import Demonstrations
from lieednn_sim.learning.demonstrations.alignment import LEVER, displacement, warp
from lieednn_sim.learning.demonstrations.models import MotionModel
from lieednn_sim.learning.demonstrations.shaped import ShapedMotion
from lieednn_sim.lie.se3 import twist_of
from lieednn_sim.registry import RIVALS
from lieednn_sim.validation import Seed, as_count, as_floats, as_generator, as_positive
from lieednn_sim.values import Floats

SAMPLES = 1000  # of each path, at equal steps of its length: as many as in the LASA data set


@dataclass(frozen=True)
class PathErrors:
    """Errors of a path against the one it should follow, both sampled at `SAMPLES` equal steps of their length.

    Samples are paired by dynamic time warping (`warp`), whatever the timing; a radian counts as the lever.
    """

    rms_mm: float  #: root mean square distance of the pairs' positions
    rms_deg: float  #: root mean square angle between the pairs
    dtwd_mm: float  #: dynamic-time-warping distance: the sum of the distances of all pairs
    frechet_mm: float  #: discrete Frechet distance
    goal_mm: float  #: distance of the ends
    goal_deg: float  #: angle between the ends


def path_errors(reproduced: ArrayLike, shown: ArrayLike, lever: float = LEVER) -> PathErrors:
    """Compare two paths of twists ``(K, 6)`` and ``(L, 6)`` [rad, m]; a radian counts as ``lever`` metres of length."""
    lever = as_positive("lever", lever)
    given = {"reproduced": reproduced, "shown": shown}
    path, reference = (_spaced(displacement(as_floats(name, x, ("K", 6))), lever) for name, x in given.items())
    scale = np.array([lever] * 3 + [1.0] * 3)
    matched = warp(path * scale, reference * scale)
    first, second = path[matched.pairs[:, 0]], reference[matched.pairs[:, 1]]
    apart = np.linalg.norm(first[:, 3:] - second[:, 3:], axis=1)
    turned = (Rotation.from_rotvec(first[:, :3]) * Rotation.from_rotvec(second[:, :3]).inv()).magnitude()
    return PathErrors(
        rms_mm=1e3 * float(np.sqrt(np.mean(apart**2))),
        rms_deg=float(np.rad2deg(np.sqrt(np.mean(turned**2)))),
        dtwd_mm=1e3 * matched.total,
        frechet_mm=1e3 * matched.frechet,
        goal_mm=1e3 * float(apart[-1]),
        goal_deg=float(np.rad2deg(turned[-1])),
    )


def _spaced(displaced: Floats, lever: float) -> Floats:
    """Rotation vectors and positions ``(K, 6)`` at `SAMPLES` equal steps of the length."""
    turn = Rotation.from_rotvec(displaced[:, :3])
    turned = lever * (turn[1:] * turn[:-1].inv()).magnitude()
    steps = np.hypot(np.linalg.norm(np.diff(displaced[:, 3:], axis=0), axis=1), turned)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, length[-1], SAMPLES)
    return np.stack([np.interp(at, length, entry) for entry in displaced.T], axis=-1)


@dataclass(frozen=True)
class Attraction:
    """How many random starts arrived after ten durations, within a hundredth of the demonstrations' extent.

    Spurious attractors are places other than the goal at which starts came to rest.
    """

    starts: int
    arrived: int
    spurious: int


def random_starts(demonstrations: Demonstrations, count: int, seed: Seed = 0) -> Floats:
    """Random twists ``(count, 6)`` around the demonstrations.

    Positions are uniform in their bounding box, extended on all sides by its longest side; rotations, where poses were
    recorded, have a random axis and an angle of up to 162 degrees from the goal.
    """
    rng = as_generator("seed", seed)
    count = as_count("count", count)
    place = demonstrations.displaced[..., 3:].reshape(-1, 3)
    low, high = place.min(axis=0), place.max(axis=0)
    margin = np.ptp(place, axis=0).max()
    starts = np.zeros((count, 6))
    starts[:, 3:] = rng.uniform(low - margin, high + margin, (count, 3))
    if demonstrations.dof == 6:
        axis = rng.normal(size=(count, 3))
        turn = rng.uniform(0.0, 0.9 * np.pi, (count, 1))
        starts[:, :3] = turn * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    elif demonstrations.dof == 2:
        starts[:, 5] = 0.0
    return twist_of(starts)


def attraction(model: MotionModel, demonstrations: Demonstrations, starts: Floats) -> Attraction:
    """Run a model from start twists ``(n, 6)``; in distances a radian counts as the demonstrations' ``lever`` [m]."""
    t = demonstrations.duration * np.array([0.0, 9.0, 10.0])
    # In batches, to limit the memory.
    batches = [starts[k : k + 500] for k in range(0, len(starts), 500)]
    before, ends = (
        np.concatenate([displacement(model.reproduce(batch, t)[:, 1:]) for batch in batches])
        * demonstrations.scale
        / demonstrations.extent
    ).swapaxes(0, 1)
    arrived = np.linalg.norm(ends, axis=1) < 1e-2
    resting = ends[~arrived & (np.linalg.norm(ends - before, axis=1) < 1e-4)]
    spurious = 0
    while len(resting):
        spurious += 1
        # Points of rest within a twentieth of the extent count as one attractor.
        resting = resting[np.linalg.norm(resting - resting[0], axis=1) > 5e-2]
    return Attraction(len(starts), int(arrived.sum()), spurious)


@dataclass(frozen=True)
class ModelRow:
    """One model of one set of demonstrations."""

    model: str
    n_parameters: int  #: number of fitted parameters
    fit_s: float  #: CPU time of the fit [s]
    mean: PathErrors  #: errors against the mean demonstration, from its start
    training: PathErrors  #: errors against each demonstration, from its start, on average
    #: As ``training``, by models fitted without that demonstration; None for a single one, or if not requested.
    left_out: PathErrors | None
    attraction: Attraction  #: where random starts ended


def reproduction(
    model: MotionModel, demonstrations: Demonstrations, start: Floats, goal: Floats | None = None
) -> Floats:
    """Twists ``(K, 6)`` from a twist ``(6,)`` until the model's motion ends; to ``goal`` if goals are kept."""
    if isinstance(model, ShapedMotion) and demonstrations.goals_kept and goal is not None:
        model = model.toward(goal)
    return model.reproduce(start, np.linspace(0.0, model.durations * demonstrations.duration, 600))


def compare_models(
    demonstrations: Demonstrations,
    shaped: ShapedMotion,
    *,
    rivals: Sequence[str] | None = None,
    aligned: Demonstrations | None = None,
    starts: int = 1000,
    leave_one_out: bool = True,
    seed: int = 0,
) -> tuple[list[ModelRow], dict[str, MotionModel]]:
    """Compare a network shaped by all demonstrations with models that have as many parameters.

    The result is a row for each model, and the models by name, the network first.

    Args:
        rivals: names of `RIVALS`; by default all.
        aligned: if goals are kept, the same demonstrations with aligned goals, since rivals know only one goal; errors
            do not depend on the alignment.
        starts, seed: number and seed of random starts, see `random_starts`.
        leave_one_out: fit each model again without each of the demonstrations, the network with as many hidden neurons.
    """
    names = [shaped.name, *(RIVALS if rivals is None else rivals)]
    for name in names[1:]:
        RIVALS.find(name)
    n, places = len(demonstrations), random_starts(demonstrations, starts, seed)
    folds = range(n) if leave_one_out and n > 1 else range(0)
    rows: list[ModelRow] = []
    models: dict[str, MotionModel] = {}
    with one_blas_thread():
        for number, name in enumerate(names):
            start = cpu_time()
            shown = demonstrations if aligned is None or name == shaped.name else aligned
            model = shaped if name == shaped.name else _fit(shaped, name, shown)
            seconds = shaped.cpu_time if name == shaped.name else cpu_time() - start
            without = []
            for k in folds:
                report(number * (len(folds) + 1) + k, len(names) * (len(folds) + 1))
                without.append(_errors(_fit(shaped, name, shown.without(k)), shown, shown.twists[k]))
            mean = _errors(model, shown, shown.mean)
            training = mean_of([_errors(model, shown, twist) for twist in shown.twists])
            left_out, elsewhere = mean_of(without) if without else None, attraction(model, shown, places)
            rows.append(ModelRow(name, model.n_parameters, seconds, mean, training, left_out, elsewhere))
            models[name] = model
    return rows, models


def _fit(shaped: ShapedMotion, name: str, demonstrations: Demonstrations) -> MotionModel:
    """The named model, with about as many parameters as the shaped network; or another shaped network."""
    if name == ShapedMotion.name:
        options, family = shaped.shaping.options, shaped.response is not None
        return ShapedMotion.fit(demonstrations, options=options, family=family)
    model: MotionModel = RIVALS[name].load()(demonstrations, shaped.n_parameters)
    return model


def _errors(model: MotionModel, demonstrations: Demonstrations, shown: Floats) -> PathErrors:
    return path_errors(reproduction(model, demonstrations, shown[0], shown[-1]), shown, demonstrations.lever)


def family_deviation(shaped: ShapedMotion, demonstrations: Demonstrations) -> float | None:
    """Largest standard deviation of a family's position along the mean motion [m]; None without a spread."""
    if shaped.spread is None:
        return None
    covariance = shaped.covariance(demonstrations.mean[0], demonstrations.t)[:, 3:, 3:]
    return float(np.sqrt(np.trace(covariance, axis1=1, axis2=2).max()))


def mean_of(items: Sequence[Any]) -> Any:
    """The mean of each number over dataclasses of one type, also of numbers in nested dataclasses and tuples."""
    first = items[0]
    if isinstance(first, tuple):
        return tuple(map(mean_of, zip(*items, strict=True)))
    if isinstance(first, float):
        return float(np.mean(items))
    return replace(first, **{f.name: mean_of([getattr(item, f.name) for item in items]) for f in fields(first)})


def models_table(rows: Sequence[ModelRow], *, turns: bool) -> Group:
    """Tables of a comparison for the terminal; ``turns`` if poses were recorded."""
    angle = ["deg"] if turns else []
    errors = table("reproduction", "model", "path", "RMS mm", *angle, "DTWD mm", "Frechet mm", "goal mm")
    starts = table("models and starts elsewhere", "model", "parameters", "fit s", "arrived", "spurious attractors")
    for row in rows:
        name = row.model
        for path, result in (("mean", row.mean), ("training", row.training), ("left out", row.left_out)):
            if result is None:
                continue
            cells = [f"{result.rms_mm:.2f}", *([f"{result.rms_deg:.2f}"] if turns else [])]
            cells += [f"{result.dtwd_mm:.0f}", f"{result.frechet_mm:.2f}", f"{result.goal_mm:.2g}"]
            errors.add_row(name, path, *cells)
            name = ""
        reached = row.attraction
        shown = [str(row.n_parameters), f"{row.fit_s:.1f}", f"{reached.arrived}/{reached.starts}"]
        starts.add_row(row.model, *shown, str(reached.spurious))
    errors.caption = "From the start of the mean and of each demonstration; left out: fitted without the compared one."
    return Group(errors, starts)
