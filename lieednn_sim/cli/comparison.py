"""The command ``compare``, which writes a table and a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Any

from lieednn_sim import io
from lieednn_sim.arm.obstacles import describe, load_obstacles
from lieednn_sim.cli.console import console, print_import_report, progress, to_stderr, wrote
from lieednn_sim.cli.kinds import CommandLine, Directory, File
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES
from lieednn_sim.studies import Case, Comparison, Row, Table, compute, write_summary
from lieednn_sim.studies.comparison.study import Shard
from lieednn_sim.studies.comparison.study import merge as merge_tables
from lieednn_sim.studies.reactions.study import COMPARED, Reactions
from lieednn_sim.studies.reactions.summary import write_reactions
from lieednn_sim.studies.report import View, choose_problems, view, write_page
from lieednn_sim.studies.user_files import ARM, bare_arm
from lieednn_sim.validation import as_count, as_workers

# Files that are written beside the table.
_OUTPUTS = ("comparison.csv", "comparison.md", "comparison.html", "reactions.csv", "reactions.md")


def compare(
    *,
    cases: Annotated[dict[str, Any], Comparison],
    output: Directory = "results/comparison",
    jobs: int | None = None,
    reactive: int = 0,
    policy: tuple[str, ...] = (),
    views: int = 1,
    date: str = "",
    shard: str | None = None,
    merge: list[File] | None = None,
    line: CommandLine,
) -> None:
    """Compare planners on arms, scenes, controllers and seeds, in a table and a page.

    After an interruption, the same command continues. The defaults take a quarter of an hour of CPU time.

    Args:
        cases: the cases.
        output: directory of the table.
        jobs: number of worker processes (default: one for each core).
        reactive: number of seeds for a benchmark of policies under pushes, loads and new targets; 0 for none.
        policy: a further policy for --reactive: one of your own as FILE.py:FUNCTION, or a name of `POLICIES`.
        views: number of problems that the page shows in 3D, with the motions of several planners.
        date: date to print at the top of the page (default: none).
        shard: run only part K of N parts of the cases, given as K/N.
        merge: run nothing; add the rows of the tables in these directories, such as those of --shard.
        line: the words of the command, which the page shows.
    """
    study = Comparison(**cases, shard=None if shard is None else Shard.parse(shard))
    workers = as_workers("jobs", jobs)
    seeds, problems = as_count("reactive", reactive, least=0), as_count("views", views, least=0)
    if study.shard is not None and (seeds or merge):
        raise InputError("--shard makes only a part of the table; it takes no --reactive or --merge")
    if policy and not seeds:
        raise InputError("--policy adds to the benchmark of --reactive, which needs a number of seeds")
    ran = tuple(dict.fromkeys((*COMPARED, *policy)))
    pushed = Reactions(study.arms, study.scenes, seeds, ran, study.user_files) if seeds else None
    for name, reason in study.absent.items():
        console.print(f"not compared: {name} is not installed ({reason})")
    # Several shards may grow one table.
    with io.output_folder(output, "table", shared=study.shard is not None) as directory:
        how: dict[str, Any] = {"jobs": workers, "console": to_stderr()}
        if merge:
            table = merge_tables(directory, merge)
        else:
            _print_found(study, policy)
            with progress("compare"):
                table = compute(study, directory, **how)
        if study.shard is not None:
            wrote(table.path)
            return
        reactions = None
        if pushed is not None:
            with progress("reactions"):
                reactions = compute(pushed, directory, **how)
        controller = study.controllers[0]
        seen = _views(table, choose_problems(table, problems, controller), controller)
        head = {"command": line, "date": date}
        outputs = [directory / name for name in _OUTPUTS if reactions is not None or not name.startswith("reactions")]
        with io.atomic_paths(outputs) as (rows, summary, page, *more):
            table.write_csv(rows)
            write_summary(summary, table, study.absent)
            write_page(page, table, missing=study.absent, views=seen, reactions=reactions, **head)
            if reactions is not None:
                reactions.write_csv(more[0])
                write_reactions(more[1], reactions)
    asked, arrived = (Counter(row.planner for row in table.rows.values() if row.success >= least) for least in (0, 1))
    console.print(f"arrived: {', '.join(f'{planner} {arrived[planner]} of {asked[planner]}' for planner in asked)}")
    wrote(table.path, *outputs)


def _print_found(study: Comparison, policies: Sequence[str]) -> None:
    """Print the user's own arms, scenes, planners, controllers and policies in a comparison."""
    for file in study.user_files:
        arm = bare_arm(file.source) if file.kind == ARM else None
        what = f"{arm.n_links} links, {arm.n_joints} joints" if arm else describe(load_obstacles(file.source))[0]
        console.print(f"{file.kind} {file.name}: {what}, from {file.source}", markup=False)
        if arm:
            print_import_report(arm)
    for line in PLANNERS.origins(study.planners) + CONTROLLERS.origins(study.controllers) + POLICIES.origins(policies):
        console.print(line, markup=False)


def _views(table: Table[Row], problems: Sequence[Sequence[Case]], controller: str) -> list[View]:
    """Views of problems; prints the reason if one cannot be shown."""
    views: list[View] = []
    for cases in problems:
        try:
            with progress(f"view {len(views) + 1}"):
                views.append(view(table, cases, controller))
        except LieEDNNError as error:
            console.print(f"no view of {cases[0].arm}, {cases[0].scene}: {error}")
    return views
