"""The command ``export``: files in the formats of other tools."""

from __future__ import annotations

from typing import Annotated, Any

from lieednn_sim import io
from lieednn_sim.cli.console import progress, wrote
from lieednn_sim.cli.kinds import Directory, File
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import InputError
from lieednn_sim.exports import export as export_sources
from lieednn_sim.exports.formats import record
from lieednn_sim.registry import FORMATS
from lieednn_sim.validation import as_path


def export(
    runs: list[File] = [],  # noqa: B006, it is not changed
    *,
    format: str,
    rate: float | None = None,
    output: Directory = "results/export",
    episodes: int | None = None,
    recorded: Annotated[dict[str, Any], record, "arm", "scene", "scene_seed", "planner", "seed"],
) -> None:
    """Write runs or comparisons in the file formats of other tools, or episodes of an expert.

    Runs must have been simulated. The directory must be new, empty, or one of exports.

    Args:
        runs: run directories, or for plannerarena directories of 'compare'; none with --episodes.
        format: a name of `FORMATS`.
        rate: samples per second (default: every step of the simulation).
        output: directory of the files.
        episodes: record so many successful episodes of the expert of the learning environment TelescopicReach-v0
            instead; for lerobot.
        recorded: the episodes.
    """
    chosen = FORMATS.require(format)
    if episodes is not None:
        if format != "lerobot" or runs:
            raise InputError("--episodes are recorded in the format lerobot, and of no runs")
        with progress("record"):
            written = record(output, episodes, **recorded)
        wrote(*written)
        return
    if recorded:
        raise InputError(f"--{next(iter(recorded)).replace('_', '-')} is for --episodes")
    if not runs:
        raise InputError("name the directories to export, or the number of --episodes to record")
    sources: dict[str, Any] = {}
    for text in runs:
        path = as_path("the name of a run directory", text)
        name = path.resolve().name
        if name in sources:
            raise InputError(f"two of the directories are called {name!r}; export them into different directories")
        if chosen.of_comparison:
            sources[name] = path
            continue
        run = RunDirectory(path).existing()
        with io.locked(run.path, shared=True):
            sources[name] = run.load_rollout(*run.load_task())
    with progress("export"):
        written = export_sources(sources, output, format=format, rate=rate)
    wrote(*written)
