"""The command ``problems``: planners on published problems."""

from __future__ import annotations

import argparse
import os

from lieednn_sim import io
from lieednn_sim.cli.console import to_stderr, wrote
from lieednn_sim.errors import InputError
from lieednn_sim.studies.problems.motion_bench_maker import ProblemSets
from lieednn_sim.studies.problems.study import PublishedProblems
from lieednn_sim.studies.problems.summary import write_problems
from lieednn_sim.studies.study import compute
from lieednn_sim.validation import quoted


def problems(arguments: argparse.Namespace) -> None:
    """Compute the missing rows of the table, then write its summary."""
    count = None if arguments.problems == "all" else _count(arguments.problems)
    sets = ProblemSets(arguments.folder)
    with io.output_folder(arguments.output, "table") as directory:
        summary = directory / "problems.md"
        names = [name for word in arguments.planners for name in word.split(",") if name]
        study = PublishedProblems(sets, names, count, arguments.time_budget)
        jobs = os.cpu_count() or 1 if arguments.jobs is None else arguments.jobs
        table = compute(study, directory, jobs=jobs, console=to_stderr())
        with io.atomic_path(summary) as temporary:
            write_problems(temporary, sets.robot, table.sorted_rows(), arguments.time_budget)
    wrote(table.csv, summary)


def _count(text: str) -> int:
    # Python reads no number of thousands of digits.
    if not (text.isascii() and text.isdecimal() and len(text) <= 9 and int(text)):
        raise InputError(f"--problems must be a number of at least 1, or all; got {quoted(text)}")
    return int(text)
