"""The commands ``export`` and ``record``: files in the formats of other tools."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from lieednn_sim import io
from lieednn_sim.cli.console import progress, wrote
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.exports import export as export_sources
from lieednn_sim.exports import record as record_episodes
from lieednn_sim.registry import FORMATS
from lieednn_sim.validation import as_path


def export(arguments: argparse.Namespace) -> None:
    """Write the runs, or the tables of comparisons, in the chosen format."""
    chosen = FORMATS.find(arguments.format)
    FORMATS.require(arguments.format)
    sources: dict[str, Any] = {}
    for text in arguments.runs:
        path = as_path("the name of a run directory", text)
        name = path.resolve().name
        if name in sources:
            raise InputError(f"two of the directories are called {name!r}; export them into different directories")
        sources[name] = path if chosen.of_comparison else _rollout(path)
    with progress("export"):
        written = export_sources(sources, arguments.output, format=arguments.format, rate=arguments.rate)
    wrote(*written)


def record(arguments: argparse.Namespace) -> None:
    """Record episodes of the expert."""
    with progress("record") as report:
        written = record_episodes(
            arguments.output,
            arguments.episodes,
            arm=arguments.arm,
            scene=arguments.scene,
            scene_seed=arguments.scene_seed,
            planner=arguments.planner,
            seed=arguments.seed,
            progress=report,
        )
    wrote(*written)


def _rollout(path: Path) -> Any:
    run = RunDirectory(path).existing()
    with io.locked(run.path, shared=True):
        task, arm = run.load_task()
        if not run.rollout.exists():
            raise FileError(f"{path} has not been simulated; run: lieednn-sim simulate {path}")
        return run.load_rollout(task, arm)
