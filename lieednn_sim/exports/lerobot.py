"""Data sets in the format of LeRobot, version 3.0, written by pyarrow alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from lieednn_sim import io
from lieednn_sim.errors import InputError
from lieednn_sim.exports.formats import Episode, samples
from lieednn_sim.simulation import Rollout
from lieednn_sim.validation import as_positive

_FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FIRST = _FILE.format(chunk_index=0, file_index=0)
# All files of a data set.
FILES = (f"data/{_FIRST}", f"meta/episodes/{_FIRST}", "meta/tasks.parquet", "meta/info.json", "meta/stats.json")


def write(rollouts: Mapping[str, Rollout], folder: Path, rate: float | None = None) -> None:
    """Write a data set with one episode for each rollout; see `formats.export`.

    ``observation.state`` holds the measured positions and velocities, and ``action`` the planned positions one sample
    later. ``rate`` must be a whole number that divides the simulation's rate, by default the one nearest to 50 Hz.
    `InputError` for another rate, or if the rollouts are of arms with different joints.
    """
    (first, timestep), episodes = next((item.arm, item.timestep) for item in rollouts.values()), []
    fps = _frames_per_second(rate, timestep)
    for name, rollout in rollouts.items():
        if rollout.arm.joint_names != first.joint_names:
            raise InputError(f"a data set is of one arm: {name!r} has other joints than the first run")
        rows = samples(rollout, fps)
        state = np.hstack([rollout.q, rollout.qd])[rows][:-1]
        if not len(state):
            raise InputError(f"{name!r} is too short for one sample at this rate")
        frames = {"observation.state": state, "action": rollout.q_ref[rows][1:]}
        episodes.append(Episode(frames, {"run": name}))
    names = {"observation.state": state_names(first.joint_names), "action": list(first.joint_names)}
    write_dataset(folder, episodes, names, fps=fps, task="Follow the planned motion.", robot=first.name)


def _frames_per_second(rate: float | None, timestep: float) -> int:
    """The rate [Hz], by default the nearest to 50; `InputError` unless whole and a divisor of the simulation's rate."""
    most = round(1.0 / timestep)
    allowed = [k for k in range(1, most + 1) if most % k == 0] if abs(most * timestep - 1.0) < 1e-6 else []
    wanted = 50.0 if rate is None else as_positive("rate", rate)
    if not allowed:
        raise InputError(
            f"LeRobot's format has a whole number of frames per second, and none divides the simulation's "
            f"{1.0 / timestep:.6g} Hz; simulate with another time step, such as 0.002 or 0.005 s"
        )
    nearest = min(allowed, key=lambda k: abs(k - wanted))
    if rate is not None and nearest != rate:
        demands = f"divide the simulation's {most} Hz and be a whole number of frames per second in LeRobot's format"
        raise InputError(f"rate must {demands}, got {rate:g} Hz; for example {nearest} Hz")
    return nearest


def state_names(joints: Sequence[str], *parts: str) -> list[str]:
    """Names of the components of a state, by default of positions and velocities."""
    return [f"{joint} {part}" for part in parts or ("position", "velocity") for joint in joints]


def write_dataset(
    folder: Path, episodes: Sequence[Episode], names: Mapping[str, Sequence[str]], *, fps: float, task: str, robot: str
) -> None:
    """Write a data set of episodes with the same features into a folder; numbers are stored with 32 bits.

    ``names`` are the names of the components, by feature; ``task`` describes the task of all episodes in words.
    `InputError` if ``fps`` [Hz] is not a whole number.
    """
    if abs(fps - round(fps)) > 1e-6:
        raise InputError(f"LeRobot's format has a whole number of frames per second, got {fps:g}")
    data, told, tasks, *described = (folder / name for name in FILES)
    for path in (data, told):
        path.parent.mkdir(parents=True)
    tables, rows, begin = [], [], 0
    for number, episode in enumerate(episodes):
        frames = _with_indices(episode.frames, number, begin, fps)
        tables.append(frames)
        end = begin + len(frames["index"])
        rows.append(
            {
                **{"episode_index": number, "tasks": [task], "length": end - begin},
                **{"data/chunk_index": 0, "data/file_index": 0, "dataset_from_index": begin, "dataset_to_index": end},
                **{"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0, **episode.about},
                **{f"stats/{name}/{what}": s for name, v in frames.items() for what, s in _statistics(v).items()},
            }
        )
        begin = end
    schema = _table(tables[0]).schema
    with parquet.ParquetWriter(data, schema) as writer:
        # One row group per episode, so that readers find it.
        for frames in tables:
            writer.write_table(_table(frames))
    parquet.write_table(pa.Table.from_pylist(rows), told)
    _write_task(tasks, task)
    whole = {name: np.concatenate([frames[name] for frames in tables]) for name in tables[0]}
    features = {}
    for name, values in whole.items():
        known = list(names[name]) if name in names else None
        features[name] = {"dtype": values.dtype.name, "shape": list(values.shape[1:] or (1,)), "names": known}
    info = {
        **{"codebase_version": "v3.0", "robot_type": robot, "total_episodes": len(rows), "total_frames": begin},
        **{"total_tasks": 1, "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 500},
        **{"fps": round(fps), "splits": {"train": f"0:{len(rows)}"}, "data_path": f"data/{_FILE}", "video_path": None},
        "features": features,
    }
    statistics = {name: _statistics(values) for name, values in whole.items()}
    for path, content in zip(described, (info, statistics), strict=True):
        io.save_json(path, content)


def _with_indices(frames: Mapping[str, NDArray[Any]], number: int, begin: int, fps: float) -> dict[str, NDArray[Any]]:
    """The features of an episode in the types of the format, with its indices and times."""
    result = {name: values if values.dtype == bool else values.astype(np.float32) for name, values in frames.items()}
    # A single component is stored as a number, not as a list.
    result = {name: values[:, 0] if values.shape[1:] == (1,) else values for name, values in result.items()}
    index = np.arange(len(next(iter(result.values()))))
    return result | {
        **{"timestamp": (index / fps).astype(np.float32), "frame_index": index},
        **{"episode_index": np.full_like(index, number), "index": begin + index, "task_index": np.zeros_like(index)},
    }


def _table(frames: Mapping[str, NDArray[Any]]) -> Any:
    def column(values: NDArray[Any]) -> Any:
        flat = pa.array(values.ravel())
        return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])

    return pa.table({name: column(values) for name, values in frames.items()})


def _statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Statistics over the frames, one number for each component."""
    columns = values.reshape(len(values), -1).astype(float)
    results = {"min": columns.min(0), "max": columns.max(0), "mean": columns.mean(0), "std": columns.std(0)}
    quantiles = (1, 10, 50, 90, 99)
    results |= {f"q{q:02d}": np.percentile(columns, q, axis=0) for q in quantiles}
    return {**{name: numbers.tolist() for name, numbers in results.items()}, "count": [len(values)]}


def _write_task(path: Path, task: str) -> None:
    """The table of tasks; its index, in pandas' words, is the text, as LeRobot reads it."""
    index = "__index_level_0__"
    named = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"}
    unnamed = {"name": None, "field_name": index, "pandas_type": "unicode", "numpy_type": "object"}
    columns = [column | {"metadata": None} for column in (named, unnamed)]
    told = {"index_columns": [index], "column_indexes": [], "columns": columns, "pandas_version": "2.0.0"}
    table = pa.table({"task_index": [0], index: [task]})
    parquet.write_table(table.replace_schema_metadata({"pandas": json.dumps(told)}), path)
