"""Tables of recordings in files: their samples, chosen by the names of columns if there are any, and their times."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import Archive, opened, read_array
from lieednn_sim.validation import as_floats, as_path, as_times, quoted
from lieednn_sim.values import Floats, StrPath

Table = tuple[NDArray[Any], NDArray[Any] | None]  # samples, and their times if the file has them

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_LARGEST_TABLE = 10**8  # bytes of a text or mat file
_TEXT = (".csv", ".txt", ".tsv", ".tum")
#: Names of the column of times, which may name the unit, too, as in time_s.
TIME = re.compile(
    r"(t|times?|ts|time[ _]?stamps?|stamps?|secs?|seconds)([ _]*[\[(]?(?P<unit>s|ms|us|ns|secs?|seconds)[\])]?)?"
)
_LIKE_A_TIME = re.compile("time|stamp|clock|epoch|elapsed|date|sec|milli|micro|nano")


@dataclass(frozen=True)
class Layout:
    """The columns and times that a table of a recording may have."""

    counts: Sequence[int]  # the numbers of columns that its samples may have
    words: str  # these columns in words, for messages
    # Maps a text file and the names of its columns to those of the samples, in order.
    chosen: Callable[[Path, list[str]], Sequence[str]] = lambda _, names: names
    rate: float = 100.0  # sampling rate of tables without times [1/s]
    time_unit: str = "s"  # unit of the times, unless the name of their column has one; a name of `TIME_UNITS`


def as_recording(source: str, samples: ArrayLike, t: ArrayLike | None, layout: Layout) -> tuple[Floats, Floats]:
    """Samples ``(K, D)`` and their times ``(K,)`` from 0 [s], which may be the first column of a table without names.

    `InputError` if the table does not fit the layout or has one row, or has no increasing times of its rows.
    """
    table = as_floats(source, samples, ("K", "D"))
    count, columns = table.shape
    timed = t is None and columns not in layout.counts and columns - 1 in layout.counts
    if not timed and columns not in layout.counts:
        raise InputError(f"{source} must have {layout.words}; got {columns}")
    if count < 2:
        raise InputError(f"{source} must have at least two samples, got {count}")
    if timed:
        t, table = table[:, 0], table[:, 1:]
        if row := uneven_row(t):
            raise InputError(
                f"{source} must have {layout.words}; got {columns}, and the first is no time, which would increase "
                f"evenly: row {row} has {t[row]:.15g} after {t[row - 1]:.15g}; leave out what is no sample, such as a "
                "gripper, or name the columns in the first line of a text file"
            )
    if t is None:
        return table, np.arange(count) / layout.rate
    try:
        times = as_times(f"times of {source}", t)
    except InputError as error:
        raise InputError(f"{error}; drop the row, or leave out the times and give the sampling rate") from None
    if len(times) != count:
        raise InputError(f"{source} has {count} samples and {len(times)} times")
    return table, TIME_UNITS[layout.time_unit] * (times - times[0])


def read_tables(files: Iterable[StrPath], layout: Layout) -> list[tuple[str, Floats, Floats]]:
    """The source of each table in the files, its samples and times as `as_recording` takes them.

    `FileError` if a file cannot be read, or is of another kind; `InputError` also if there is no table.
    """
    results = []
    for name in files:
        path = as_path("the name of a file of demonstrations", name)
        tables = list(_tables(path, layout))
        for number, (samples, t) in enumerate(tables):
            source = path.name if len(tables) == 1 else f"{path.name}[{number}]"
            results.append((source, *as_recording(source, samples, t, layout)))
            step = float(np.median(np.diff(results[-1][2])))
            if step > max(0.9, 1.01 / layout.rate):
                warnings.warn(
                    f"the times of {source} step by {step:.3g} s, read in {layout.time_unit}; for another unit see "
                    f"time_unit: {', '.join(TIME_UNITS)}",
                    stacklevel=3,
                )
    if not results:
        raise InputError("there is no demonstration; name at least one file")
    return results


def _tables(path: Path, layout: Layout) -> Iterator[Table]:
    read = {".npy": _npy, ".npz": _npz, ".mat": _mat, **dict.fromkeys(_TEXT, _text)}.get(path.suffix.lower())
    if read is None:
        raise FileError(f"{path} is no file of demonstrations; allowed are .npy, .npz, .mat, {', '.join(_TEXT)}")
    try:
        yield from read(path, layout)
    except (FileError, InputError):
        raise
    except Exception as error:  # the readers raise all kinds of exceptions on a damaged file
        raise FileError(f"{path} is not a readable file of demonstrations ({type(error).__name__}: {error})") from None


def _several(path: Path, samples: NDArray[Any], t: NDArray[Any] | None = None) -> Iterator[Table]:
    """The demonstrations of an array ``(K, D)`` or ``(n, K, D)``."""
    if samples.ndim not in (2, 3):
        raise InputError(f"{path}: demonstrations must have shape (K, D) or (n, K, D), got {samples.shape}")
    if t is not None and t.shape not in (samples.shape[-2:-1], samples.shape[:-1]):
        raise InputError(f"{path}: times must have shape {samples.shape[-2:-1]}, one for each sample, got {t.shape}")
    for number, item in enumerate(samples if samples.ndim == 3 else samples[None]):
        yield item, t if t is None or t.ndim == 1 else t[number]


def _npy(path: Path, _: Layout) -> Iterator[Table]:
    with opened(path) as stream:
        return _several(path, read_array(stream, path.stat().st_size))


def _npz(path: Path, layout: Layout) -> Iterator[Table]:
    with opened(path) as stream:
        archive = Archive(stream)
        arrays = {name: archive.read(name) for name in archive.names}
    quaternions = arrays.pop("quaternions", None)
    named: list[str] = [name for name in ("poses", "positions") if name in arrays]
    named = named or [name for name in arrays if not TIME.fullmatch(name.lower())]
    if len(named) != 1:
        raise InputError(f"{path} must hold 'poses', or 'positions' and 'quaternions'; it holds: {', '.join(arrays)}")
    samples = arrays.pop(named[0])
    if quaternions is not None:
        samples = np.concatenate([samples, quaternions], axis=-1)
    one_each = (samples.shape[-2:-1], samples.shape[:-1])
    others = {
        name.lower(): array
        for name, array in arrays.items()
        if TIME.fullmatch(name.lower()) or (array.dtype.kind in "iuf" and array.shape in one_each)
    }
    return _several(path, samples, _times(path, others, layout))


def _text(path: Path, layout: Layout) -> Iterator[Table]:
    with opened(path, _LARGEST_TABLE) as stream:
        lines = [line for line in map(str.strip, stream.read().decode("utf-8-sig").splitlines()) if line]
    comments = next((k for k, line in enumerate(lines) if line[0] not in "#%"), None)
    if comments is None:
        raise FileError(f"{path} has no rows{', only comments' if lines else ''}")
    first = lines[comments]
    separator = next((mark for mark in ";,\t" if mark in first), None)

    def words(line: str) -> list[str]:
        return [name.strip(" ,\"'").lower() for name in line.strip("#% ").split(separator)]

    headed = any(name[:1].isalpha() and name not in ("nan", "inf") for name in words(first))
    try:
        if not (rows := lines[comments + headed :]):
            raise ValueError("there are no rows")
        if separator == ";":  # as spreadsheets write where the comma is the decimal sign
            rows = [row.replace(",", ".") for row in rows]
        table = np.loadtxt(rows, delimiter=separator, ndmin=2, quotechar='"')
    except ValueError as error:
        wanted = "must be separated by commas, blanks or tabs, with points in its numbers, or by semicolons"
        raise FileError(f"{path} {wanted}; {error}") from None
    if headed:
        names = words(first)
        if len(names) != table.shape[1]:
            raise InputError(f"{path} names {len(names)} columns, and its rows have {table.shape[1]}")
    else:  # a comment may name them, as np.savetxt writes it
        usual = ["timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"] if path.suffix.lower() == ".tum" else []
        named = (found for found in map(words, lines[:comments][::-1]) if len(found) == table.shape[1])
        names = next(named, usual)
    if not names:
        return _several(path, table)
    chosen = layout.chosen(path, names)
    others = {name: table[:, k] for k, name in enumerate(names) if name not in chosen}
    return _several(path, table[:, [names.index(name) for name in chosen]], _times(path, others, layout))


def _times(path: Path, others: Mapping[str, NDArray[Any]], layout: Layout) -> NDArray[Any] | None:
    """The times among the other columns, by lower-case names, in the layout's unit; None if there are none."""
    found = {name: match["unit"] for name in others if (match := TIME.fullmatch(name))}
    if len(times := [*found, *(name for name in others if found and re.search("nano|nsec", name))]) > 1:
        raise InputError(f"{path} may have only one column of times, it has: {', '.join(times)}")
    for name, unit in found.items():
        return others[name] * (TIME_UNITS.get(unit[:2], 1.0) / TIME_UNITS[layout.time_unit] if unit else 1)
    for name, values in others.items():
        even = values.ndim == 1 and not uneven_row(values) and (np.diff(values) != 1.0).any()
        if even or _LIKE_A_TIME.search(name):  # a column with steps of 1 numbers the rows
            raise InputError(
                f"{path}: {quoted(name)} may be the time, but is not named so; name it t, time, timestamp or time_ms, "
                "or leave it out"
            )
    return None


def uneven_row(values: NDArray[Any]) -> int:
    """The row at which numbers ``(K,)`` do not increase evenly, as times do and joints seldom; 0 if they do."""
    rising = np.diff(values) > 0.0
    if not rising.all():
        return int(np.argmin(rising)) + 1
    apart = np.abs(values - np.linspace(values[0], values[-1], len(values)))
    # Two per cent of the duration, or half a step.
    allowed = max(0.02, 0.5 / max(len(rising), 1)) * (values[-1] - values[0])
    return int(np.argmax(apart)) if apart.max() > allowed else 0


def _mat(path: Path, _: Layout) -> Iterator[Table]:
    from scipy.io import loadmat

    with opened(path, _LARGEST_TABLE) as stream:
        demos = loadmat(stream, simplify_cells=True, variable_names=["demos"]).get("demos")
    if demos is None:
        raise InputError(f"{path} has no structures 'demos', which files of the LASA data set have")
    for demo in [demos] if isinstance(demos, dict) else demos:
        yield np.asarray(demo["pos"]).T, np.ravel(demo["t"]) if "t" in demo else None
