"""The commands ``compare`` and ``merge``, which write a table and a page."""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from lieednn_sim import filesystem
from lieednn_sim.cli.arms import print_import_report
from lieednn_sim.cli.console import console, progress, to_stderr, wrote
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.manifest import Manifest
from lieednn_sim.registry import CONTROLLERS, PLANNERS
from lieednn_sim.studies import Case, Comparison, Settings, compute, write_summary
from lieednn_sim.studies.cluster import dask_executor
from lieednn_sim.studies.comparison.merging import merge as merge_shards
from lieednn_sim.studies.comparison.study import Shard
from lieednn_sim.studies.reactions.study import Reactions, write_reactions
from lieednn_sim.studies.report import choose_cases, choose_problems, film, view, write_page
from lieednn_sim.studies.user_files import ARM, bare_arm, describe_files
from lieednn_sim.validation import as_count

_Wanted = TypeVar("_Wanted")
_Shown = TypeVar("_Shown")


def compare(arguments: argparse.Namespace) -> None:
    """Compute the missing rows of the table, then write summary and page."""
    settings = Settings(
        duration=arguments.duration,
        hold=arguments.hold,
        mass_scale=arguments.mass_scale,
        time_budget=arguments.time_budget,
    )
    shard = None if arguments.shard is None else Shard.parse(arguments.shard)
    study = Comparison(
        planners=_listed(arguments.planners),
        arms=_listed(arguments.arms),
        scenes=_listed(arguments.scenes),
        controllers=_listed(arguments.controllers),
        seeds=arguments.seeds,
        slow_seeds=arguments.slow_seeds,
        common=settings,
        shard=shard,
    )
    jobs = as_count("jobs", os.cpu_count() or 1 if arguments.jobs is None else arguments.jobs)
    # Check values before any work.
    as_count("videos", arguments.videos, least=0)
    as_count("views", arguments.views, least=0)
    as_count("reactive", arguments.reactive, least=0)
    cases = [Case.parse(text) for text in arguments.video]
    if shard is not None and (arguments.videos or cases or arguments.reactive):
        raise InputError("--shard makes only a part of the table; it cannot take --videos, --video or --reactive")
    for name, reason in study.absent.items():
        console.print(f"not compared: {name} is not installed ({reason})")
    cluster = contextlib.nullcontext() if arguments.scheduler is None else dask_executor(arguments.scheduler)
    with (
        cluster as executor,
        filesystem.created(arguments.output) as directory,
        filesystem.locked(directory),
    ):
        how: dict[str, Any] = {"jobs": jobs, "executor": executor, "console": to_stderr()}
        if executor is not None:
            console.print(f"{executor.n_workers} workers at {arguments.scheduler}; cases wait for the first one")
        summary, page = directory / "comparison.md", directory / "comparison.html"
        _check_outputs(directory, [summary, page, *([directory / "reactions.md"] if arguments.reactive else [])])
        _print_found(study)
        table = compute(study, directory, **how)
        if shard is not None:
            wrote(table.csv)
            return
        with table.manifest.writing(summary) as temporary:
            write_summary(temporary, table, study.absent)
        controller = study.controllers[0]
        problems = choose_problems(table, arguments.views, controller)
        places = {f"{some[0].arm}, {some[0].scene}": some for some in problems}
        views = _shown("view", places, lambda some, **told: view(table, some, controller, **told))
        filmed = {str(case): case for case in cases + choose_cases(table, arguments.videos)}
        clips = _shown("video", filmed, lambda case, **told: film(table, case, controller, **told))
        line = shlex.join(["lieednn-sim", *arguments.words])
        reactions, more = None, []
        if arguments.reactive:
            disturbed = Reactions(study.arms, study.scenes, arguments.reactive, user_files=study.user_files)
            reactions = compute(disturbed, directory, **how)
            more = [reactions.csv, directory / "reactions.md"]
            with table.manifest.writing(more[1]) as temporary:
                write_reactions(temporary, reactions)
        head = {"command": line, "date": arguments.date}
        with table.manifest.writing(page) as temporary:
            write_page(temporary, table, missing=study.absent, views=views, clips=clips, reactions=reactions, **head)
    wrote(table.csv, summary, *more, page)


def merge(arguments: argparse.Namespace) -> int:
    """Merge the tables of shards, and write summary and page; returns 1 if cases are missing."""
    line = shlex.join(["lieednn-sim", *arguments.words])
    with filesystem.created(arguments.output) as directory, filesystem.locked(directory):
        outputs = [directory / "comparison.md", directory / "comparison.html"]
        _check_outputs(directory, outputs)
        merged = merge_shards(directory, arguments.folders)
        with merged.table.manifest.replacing(outputs) as (summary, page):
            write_summary(summary, merged.table, merged.absent)
            write_page(page, merged.table, missing=merged.absent, command=line)
    wrote(merged.table.csv, *outputs)
    for shard, cases in sorted(merged.missing.items(), key=lambda one: one[0].number):
        where = ", ".join(str(folder) for folder, there in merged.shards.items() if there == shard) or "in no folder"
        console.print(f"shard {shard} ({where}) lacks {len(cases)} cases, such as {cases[0]}")
    return 1 if merged.missing else 0


def _check_outputs(directory: Path, outputs: Sequence[Path]) -> None:
    """Raise `FileError` if the table or one of the other outputs could not be written."""
    filesystem.check_outputs([directory / "comparison.csv", directory / "comparison.json"])
    Manifest(directory).check(outputs)


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
