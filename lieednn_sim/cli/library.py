"""The command ``library``: store the motions of runs as codes of one network, and make runs from them."""

from __future__ import annotations

import argparse
from pathlib import Path

from lieednn_sim import io
from lieednn_sim.cli.arguments import load_arm, make_task
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress, wrote
from lieednn_sim.cli.planning import print_outcome
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.cli.task import LIBRARY
from lieednn_sim.errors import InputError
from lieednn_sim.evaluation.display import table
from lieednn_sim.planning import MotionLibrary
from lieednn_sim.planning.network_path import require_fit
from lieednn_sim.planning.shaped import lever_units
from lieednn_sim.validation import as_path


def library(arguments: argparse.Namespace) -> None:
    """Add motions to a library, list them, or make a run from one or two of them."""
    path = as_path("the name of a library", arguments.file)
    {"add": _add, "list": _list, "run": _run}[arguments.action](path, arguments)


def _add(path: Path, arguments: argparse.Namespace) -> None:
    io.check_outputs([path])
    runs = [RunDirectory(run).existing() for run in arguments.runs]
    names = [run.path.resolve().name if arguments.name is None else arguments.name for run in runs]
    if len(set(names)) < len(names):
        raise InputError("each motion needs a name of its own: add runs of the same name one by one, with --name")
    known = MotionLibrary.load(path) if path.exists() else None
    for run, name in zip(runs, names, strict=True):
        with io.locked(run.path, shared=True):
            task, arm = run.load_task()
            motion = run.load_motion(task, arm)
        known = MotionLibrary(arm.n_links) if known is None else known
        require_fit(arm, known.universal)
        known.add(name, motion, lever_units(arm, motion.q))
    assert known is not None
    known.save(path)
    console.print(f"motions: {', '.join(known.names)}")
    wrote(path)


def _list(path: Path, _: argparse.Namespace) -> None:
    known = MotionLibrary.load(path)
    rows = table(f"{path.name}: motions of {known.universal.n_visible} links", "motion")
    for name in known.names:
        rows.add_row(name)
    rows.caption = f"proof of arrival of all: {known.universal.certificate}"
    console.print(rows)


def _run(path: Path, arguments: argparse.Namespace) -> None:
    if arguments.blend is None and arguments.fraction is not None:
        raise InputError("--fraction needs --blend OTHER, the motion to blend with")
    fraction = 0.5 if arguments.fraction is None else arguments.fraction
    known, arm = MotionLibrary.load(path), load_arm(arguments)
    blend = {} if arguments.blend is None else {"blend": arguments.blend, "fraction": fraction}
    run = RunDirectory(arguments.output)
    with run.at_work():
        with progress("plan"):
            made = known.plan(arm, arguments.motion, duration=arguments.duration, **blend)
        task = make_task(
            arm,
            made.motion.q[0],
            made.target,
            arguments,
            planner=LIBRARY,
            reason=f"stored in {path.name}",
            options={"library": str(path.resolve()), "motion": arguments.motion, **blend},
        )
        written = run.save_network(task, made.network, made.motion)
    print_import_report(arm)
    print_outcome(made)
    wrote(*written)
