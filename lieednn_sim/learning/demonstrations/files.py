"""Files of demonstrations: NumPy's npy and npz, csv, and the mat files of the LASA handwriting data set.

A demonstration is a table with a row for each sample and the columns x, y or x, y, z, or x, y, z and a unit quaternion;
an array with three axes holds several demonstrations of the same length.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import Archive, opened, read_array
from lieednn_sim.learning.demonstrations.recording import QUATERNIONS, Demonstration
from lieednn_sim.validation import as_choice, as_path, as_positive, quoted

# Samples, and their times if the file has them.
Table = tuple[NDArray[Any], NDArray[Any] | None]
# Maps a csv file and the names of its columns to those of the samples, in order.
Columns = Callable[[Path, list[str]], Sequence[str]]

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_COLUMNS = ("x", "y", "z")
# Names of the column of times.
TIMES = ("t", "time")
# Bytes of a csv or mat file.
_LARGEST_TABLE = 10**8
_QUATERNION_COLUMNS = tuple(f"q{letter}" for letter in "wxyz")


def load_demonstrations(
    files: Iterable[str | os.PathLike[str]], *, unit: str = "m", quaternion: str = "wxyz", rate: float = 100.0
) -> tuple[Demonstration, ...]:
    """Read demonstrations of one motion, one or several from each file.

    - ``.npy``: ``(K, D)`` or ``(n, K, D)`` with D = 2, 3 or 7.
    - ``.npz``: such an array, the only one or named ``poses`` or ``positions``; optionally separate ``quaternions``
      ``(..., K, 4)``, and times ``t`` ``(K,)`` or ``(n, K)`` [s].
    - ``.csv``: one demonstration, separated by commas. A first line may name the columns x, y, z, qw, qx, qy, qz and t
      or time [s] in any order; others are ignored.
    - ``.mat``: the structures ``demos`` of the LASA data set, with ``pos`` ``(2, K)`` and ``t``.

    Args:
        files: at least one.
        unit: unit of the positions, a name of `UNITS`.
        quaternion: order of the quaternions' entries, a name of `QUATERNIONS`.
        rate: sampling rate of files without times [1/s].

    Raises:
        FileError: a file cannot be read, or is of another kind.
        InputError: a file's numbers are no demonstration, or demonstrations record different quantities.
    """
    length = UNITS[as_choice("unit", unit, UNITS)]
    as_choice("order of quaternions", quaternion, QUATERNIONS)
    rate = as_positive("rate", rate)
    result: list[Demonstration] = []
    for source, samples, t in read_tables(files, partial(_pose_columns, quaternion)):
        result.append(Demonstration.from_samples(samples, t, length, quaternion, rate, source))
    for other in result[1:]:
        if other.dof != result[0].dof:
            raise InputError(
                f"demonstrations must all show the same: {result[0].source} has {result[0].shown}, "
                f"{other.source} {other.shown}"
            )
    return tuple(result)


def read_tables(
    files: Iterable[str | os.PathLike[str]], columns: Columns
) -> list[tuple[str, NDArray[Any], NDArray[Any] | None]]:
    """The source of each table in the files, its samples, and its times if it has them.

    Raises:
        FileError: a file cannot be read, or is of another kind.
        InputError: there is no table, or a csv file's columns are not those of ``columns``.
    """
    results = []
    for name in files:
        path = as_path("the name of a file of demonstrations", name)
        tables = list(_tables(path, columns))
        for number, table in enumerate(tables):
            results.append((path.name if len(tables) == 1 else f"{path.name}[{number}]", *table))
    if not results:
        raise InputError("there is no demonstration; name at least one file")
    return results


def _tables(path: Path, columns: Columns) -> Iterator[Table]:
    read = {".npy": _npy, ".npz": _npz, ".csv": _csv, ".mat": _mat}.get(path.suffix.lower())
    if read is None:
        raise FileError(f"{path} is no file of demonstrations; allowed are .npy, .npz, .csv and .mat")
    try:
        yield from read(path, columns)
    except (FileError, InputError):
        raise
    # The readers raise all kinds of exceptions on a damaged file.
    except Exception as error:
        raise FileError(f"{path} is not a readable file of demonstrations ({type(error).__name__}: {error})") from None


def _several(path: Path, samples: NDArray[Any], t: NDArray[Any] | None = None) -> Iterator[Table]:
    """The demonstrations of an array ``(K, D)`` or ``(n, K, D)``."""
    if samples.ndim not in (2, 3):
        raise InputError(f"{path}: demonstrations must have shape (K, D) or (n, K, D), got {samples.shape}")
    if t is not None and t.shape not in (samples.shape[-2:-1], samples.shape[:-1]):
        raise InputError(f"{path}: times must have shape {samples.shape[-2:-1]}, one for each sample, got {t.shape}")
    if samples.ndim == 2:
        yield samples, t
    else:
        for number, item in enumerate(samples):
            yield item, t if t is None or t.ndim == 1 else t[number]


def _npy(path: Path, _: Columns) -> Iterator[Table]:
    with opened(path) as stream:
        return _several(path, read_array(stream, path.stat().st_size))


def _npz(path: Path, _: Columns) -> Iterator[Table]:
    with opened(path) as stream:
        archive = Archive(stream)
        arrays = {name: archive.read(name) for name in archive.names}
    t, quaternions = arrays.pop("t", None), arrays.pop("quaternions", None)
    named: list[str] = [name for name in ("poses", "positions") if name in arrays] or [*arrays]
    if len(named) != 1:
        raise InputError(f"{path} must hold one array named 'poses' or 'positions'; it holds: {', '.join(arrays)}")
    samples = arrays[named[0]]
    if quaternions is not None:
        samples = np.concatenate([samples, quaternions], axis=-1)
    return _several(path, samples, t)


def _csv(path: Path, columns: Columns) -> Iterator[Table]:
    with opened(path, _LARGEST_TABLE) as stream:
        first = stream.readline().decode("utf-8-sig")
    if ";" in first or "\t" in first:
        raise FileError(
            f"{path} must be separated by commas, with points in its numbers; its first line is {quoted(first.strip())}"
        )
    names = [word.strip().lower() for word in first.split(",")]
    headed = any(name[:1].isalpha() and name not in ("nan", "inf") for name in names)
    table = np.loadtxt(path, delimiter=",", skiprows=int(headed), ndmin=2, encoding="utf-8-sig")
    if not headed:
        return _several(path, table)
    chosen = columns(path, names)
    t = next((table[:, names.index(name)] for name in TIMES if name in names), None)
    return _several(path, table[:, [names.index(name) for name in chosen]], t)


def _pose_columns(quaternion: str, path: Path, names: list[str]) -> Sequence[str]:
    chosen = [name for name in _COLUMNS if name in names]
    if any(name in names for name in _QUATERNION_COLUMNS):
        chosen = [*_COLUMNS, *(f"q{letter}" for letter in quaternion)]
    if chosen[:2] != ["x", "y"] or not set(chosen) <= set(names):
        raise InputError(f"{path} must have columns x, y, z and qw, qx, qy, qz, or x, y; it has: {', '.join(names)}")
    return chosen


def _mat(path: Path, _: Columns) -> Iterator[Table]:
    from scipy.io import loadmat

    with opened(path, _LARGEST_TABLE) as stream:
        demos = loadmat(stream, simplify_cells=True, variable_names=["demos"]).get("demos")
    if demos is None:
        raise InputError(f"{path} has no 'demos', as the files of the LASA data set have")
    for demo in [demos] if isinstance(demos, dict) else demos:
        yield np.asarray(demo["pos"]).T, np.ravel(demo["t"]) if "t" in demo else None
