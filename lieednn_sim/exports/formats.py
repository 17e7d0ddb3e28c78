"""The function that writes any format, and what the writers share."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from lieednn_sim import io
from lieednn_sim.errors import InputError
from lieednn_sim.planning.motion import steps_of_rate
from lieednn_sim.registry import FORMATS
from lieednn_sim.simulation import Rollout
from lieednn_sim.validation import as_path, quoted


class Episode(NamedTuple):
    """An episode of a data set for imitation learning.

    Attributes:
        frames: features ``(T,)`` or ``(T, k)`` by name, of numbers or booleans.
        about: further values of the episode, such as its seed, for the table of episodes.
    """

    frames: Mapping[str, NDArray[Any]]
    about: Mapping[str, Any]


def export(
    source: Rollout | str | os.PathLike[str] | Mapping[str, Any],
    directory: str | os.PathLike[str],
    *,
    format: str = "csv",
    rate: float | None = None,
) -> list[Path]:
    """Write rollouts or comparisons in the format of another tool.

        ls.exports.export(rollout, "out", format="csv")             # out/motion.csv

    All files of a call appear together when they are complete.

    Args:
        source: a rollout, the directory of a comparison for a format of comparisons, or several of them by name.
            Files are called by these names; a single one is called ``motion`` or ``comparison``.
        directory: where to write; it is created if it is missing.
        format: a name of `FORMATS`.
        rate: samples per second [Hz], which must divide the rate of the simulation; by default all samples are written.

    Returns:
        The files written.

    Raises:
        InputError: an argument is malformed, or a source does not suit the format.
        FileError: the files cannot be written, or the directory holds anything but exports of this package.
        LieEDNNError: a library that the format needs is not installed.
    """
    chosen = FORMATS.require(format)
    kinds: Any
    kinds, expected, alone = Rollout, "a rollout", "motion"
    if chosen.of_comparison:
        kinds, expected, alone = (str, os.PathLike), "the directory of a comparison", "comparison"
        if rate is not None:
            raise InputError(f"the format {format} has no rate")
    sources = source if isinstance(source, Mapping) else {alone: source}
    if not sources:
        raise InputError("there is nothing to export")
    for name, item in sources.items():
        if not isinstance(item, kinds):
            raise InputError(f"the format {format} is made from {expected}, got {quoted(item)}")
        if not isinstance(name, str) or name in ("", ".", "..") or as_path("the name of an export", name).name != name:
            raise InputError(f"the name of an export must be that of a file, without folders, got {quoted(name)}")
    more = {} if chosen.of_comparison else {"rate": rate}
    with exporting(directory) as (folder, written):
        chosen.load()(sources, folder, **more)
    return written


def samples(rollout: Rollout, rate: float | None) -> slice:
    """The rows of a rollout at a rate [Hz], or all; `InputError` if the rate does not divide the simulation's."""
    return slice(None, None, 1 if rate is None else steps_of_rate("rate", rate, rollout.timestep))


@contextmanager
def exporting(directory: str | os.PathLike[str]) -> Iterator[tuple[Path, list[Path]]]:
    """Yield a folder for files, and the list to which their final paths are added when the block succeeds."""
    written: list[Path] = []
    # Libraries choose names in a folder of their own; only complete files are moved to where they are asked for.
    with io.output_folder(directory, "export") as target, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        yield folder, written
        result = sorted(path for path in folder.rglob("*") if path.is_file())
        paths = [target / path.relative_to(folder) for path in result]
        for parent in sorted({path.parent for path in paths}):
            io.make_directory(parent)
        with io.atomic_paths(paths) as temporaries:
            for path, temporary in zip(result, temporaries, strict=True):
                shutil.copyfile(path, temporary)
        written += paths
