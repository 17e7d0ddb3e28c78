"""The command ``compare``, which writes a table and a page."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from lieednn_sim import io
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress, to_stderr, wrote
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.registry import CONTROLLERS, PLANNERS
from lieednn_sim.studies import Case, Comparison, Settings, compute, write_summary
from lieednn_sim.studies.cluster import dask_executor
from lieednn_sim.studies.comparison.study import Shard, merge
from lieednn_sim.studies.reactions.study import Reactions, write_reactions
from lieednn_sim.studies.report import choose_problems, film, view, write_page
from lieednn_sim.studies.user_files import ARM, bare_arm, describe_files
from lieednn_sim.validation import as_count

# What is written beside the table.
_OUTPUTS = ("comparison.csv", "comparison.md", "comparison.html", "reactions.csv", "reactions.md")
_Wanted = TypeVar("_Wanted")
_Shown = TypeVar("_Shown")


def compare(arguments: argparse.Namespace) -> None:
    """Compute the missing rows of the table, or add those of other tables, then write summary and page."""
    study = Comparison(
        planners=_listed(arguments.planners),
        arms=_listed(arguments.arms),
        scenes=_listed(arguments.scenes),
        controllers=_listed(arguments.controllers),
        seeds=arguments.seeds,
        slow_seeds=arguments.slow_seeds,
        common=Settings(arguments.duration, arguments.hold, arguments.mass_scale, arguments.time_budget),
        shard=None if arguments.shard is None else Shard.parse(arguments.shard),
    )
    jobs = as_count("jobs", os.cpu_count() or 1 if arguments.jobs is None else arguments.jobs)
    # Check values before any work.
    for name in ("videos", "views", "reactive"):
        as_count(name, getattr(arguments, name), least=0)
    cases = [Case.parse(text) for text in arguments.video]
    if study.shard is not None and (arguments.videos or cases or arguments.reactive or arguments.merge):
        raise InputError("--shard makes only a part of the table; it takes no --videos, --video, --reactive or --merge")
    for name, reason in study.absent.items():
        console.print(f"not compared: {name} is not installed ({reason})")
    cluster = contextlib.nullcontext() if arguments.scheduler is None else dask_executor(arguments.scheduler)
    # Several shards may grow one table.
    folder = io.output_folder(arguments.output, "table", shared=study.shard is not None)
    with cluster as executor, folder as directory:
        how: dict[str, Any] = {"jobs": jobs, "executor": executor, "console": to_stderr()}
        if executor is not None:
            console.print(f"cases wait for workers at {arguments.scheduler}")
        if arguments.merge:
            table = merge(directory, arguments.merge)
        else:
            _print_found(study)
            table = compute(study, directory, **how)
        if study.shard is not None:
            wrote(table.path)
            return
        reactions = None
        if arguments.reactive:
            reactions = compute(
                Reactions(study.arms, study.scenes, arguments.reactive, user_files=study.user_files), directory, **how
            )
        controller = study.controllers[0]
        problems = choose_problems(table, arguments.views, controller)
        places = {f"{some[0].arm}, {some[0].scene}": some for some in problems}
        views = _shown("view", places, lambda some, **told: view(table, some, controller, **told))
        solved = itertools.chain(*choose_problems(table, arguments.videos, controller))
        filmed = {str(case): case for case in (*cases, *itertools.islice(solved, arguments.videos))}
        clips = _shown("video", filmed, lambda case, **told: film(table, case, controller, **told))
        head = {"command": shlex.join(["lieednn-sim", *arguments.words]), "date": arguments.date}
        outputs = [directory / name for name in _OUTPUTS if reactions is not None or not name.startswith("reactions")]
        with io.atomic_paths(outputs) as (rows, summary, page, *more):
            table.write_csv(rows)
            write_summary(summary, table, study.absent)
            write_page(page, table, missing=study.absent, views=views, clips=clips, reactions=reactions, **head)
            if reactions is not None:
                reactions.write_csv(more[0])
                write_reactions(more[1], reactions)
    wrote(table.path, *outputs)


def _listed(words: Sequence[str] | None) -> list[str]:
    """Names and files, separated by commas or spaces; the links of a model file extend to the end of the word."""
    listed = []
    for word in words or ():
        head, colon, links = word.partition(":")
        *others, last = head.split(",")
        listed += [*others, last + colon + links]
    return listed


def _print_found(study: Comparison) -> None:
    """Print the user's own arms, scenes, planners and controllers in a comparison."""
    for file in study.user_files:
        if file.kind == ARM:
            arm = bare_arm(file.source)
            console.print(
                f"arm {file.name}: {arm.n_links} links, {arm.n_joints} joints, from {file.source}", markup=False
            )
            print_import_report(arm)
    others = PLANNERS.origins(study.planners) + CONTROLLERS.origins(study.controllers)
    for line in others + describe_files(study.arms, study.scenes, study.user_files):
        console.print(line, markup=False)


def _shown(kind: str, wanted: Mapping[str, _Wanted], make: Callable[..., _Shown]) -> list[_Shown]:
    """Views or videos of what is wanted, by the words for each; prints why one cannot be shown."""
    made: list[_Shown] = []
    for words, each in wanted.items():
        try:
            with progress(f"{kind} {len(made) + 1}") as report:
                made.append(make(each, progress=report))
        except LieEDNNError as error:
            console.print(f"no {kind} of {words}: {error}")
    return made
