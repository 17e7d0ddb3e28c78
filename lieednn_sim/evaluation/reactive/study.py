"""The reactive benchmark: its cases on several cores, resumable, and its summary."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.console import Console

from lieednn_sim import filesystem
from lieednn_sim.evaluation.entries import Entry, record
from lieednn_sim.evaluation.reactive.cases import DISTURBANCES, MEASURED, Reaction, failed_reactions, run_reactions
from lieednn_sim.evaluation.reactive.leaders import LEADERS
from lieednn_sim.evaluation.study import complete
from lieednn_sim.evaluation.summary import escaped, table_head, table_line
from lieednn_sim.evaluation.table import Rows
from lieednn_sim.validation import as_count, as_workers

METHOD = (
    "From home to random reachable targets with feedback at 100 Hz and inverse-dynamics servos, for 7 s. After 35 % of"
    " its own undisturbed path each leader is disturbed: by a force of 0.2 s on a random link, in the same direction "
    "for all, as large as is needed in this run to make a joint deviate by 8 to 12 % of its range while the force acts"
    " or soon after, at most 20 kN; by a weight of 10 N at the end effector from then on; or by another target, up to "
    "a tenth of the ranges away. A leader has arrived if every link ends within 1 mm and 0.1 degrees of the last "
    "target without any contact. It is back once its deviation from the undisturbed path stays below a tenth of the "
    "largest one, which a lasting weight prevents. Effort is the integral of the mean squared actuator force relative "
    "to its limits. All leaders but the tracker see the measured joints and wait for the arm; the tracker plays the "
    "teacher's motion, whatever arm and target do. Among obstacles, networks, primitives and the linear attractor use "
    "the safety filter; fabric and path integral (mppi) avoid contact by themselves. Leaders without a time law of "
    "their own approach the target at 2/s. Only the CPU time of a control step, measured in Python, differs between "
    "runs."
)


class ReactionTable(Rows[Reaction]):
    """Rows of the benchmark, which share no settings; raises as `Rows`."""

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        super().__init__(directory, "reactions", Reaction, {})


def compare_reactions(
    directory: str | os.PathLike[str],
    arms: Sequence[str],
    scenes: Sequence[str],
    seeds: int,
    *,
    leaders: Sequence[str] = tuple(LEADERS),
    jobs: int = 1,
    console: Console | None = None,
    executor: Executor | None = None,
    entries: tuple[Entry, ...] = (),
) -> ReactionTable:
    """Compute the rows that the directory's table lacks; finished cases are kept when it is interrupted.

    Args:
        directory: directory of the table.
        arms: names of arms.
        scenes: names of scenes.
        seeds: number of seeds, starting at 0.
        leaders: names of `LEADERS`.
        jobs: number of worker processes.
        console: console for a progress bar; None for no bar.
        executor: runs the cases instead of worker processes.
        entries: arms and scenes from files, by their names; see `Selection.entries`.

    Raises:
        InputError: ``jobs`` or ``seeds`` is less than 1.
        FileError: see `Rows`.
        LieEDNNError: a worker process died, or the executor gave up.
    """
    workers, count = as_workers("jobs", jobs), as_count("seeds", seeds)
    record(filesystem.make_directory(directory), entries)
    table = ReactionTable(directory)
    # Seeds first, so that an early stop leaves all leaders on all arms.
    wanted = itertools.product(range(count), arms, scenes, leaders)
    todo = [
        (arm, scene, leader, seed)
        for seed, arm, scene, leader in wanted
        if any((arm, scene, leader, name, seed) not in table.rows for name in DISTURBANCES)
    ]
    runs = partial(run_reactions, entries=entries) if entries else run_reactions, failed_reactions
    complete(table, *runs, todo, workers=workers, title="reactions", console=console, executor=executor)
    return table


@dataclass(frozen=True)
class ReactionGroup:
    """Rows of a leader under a disturbance.

    Attributes:
        key: scene, disturbance, leader.
        arrived: number of rows that arrived.
        touched: number of rows with contact.
        back: number of rows that were back on their path.
        total: number of rows.
        medians: medians of the measured columns, None for empty ones.
    """

    key: tuple[str, str, str]
    arrived: int
    touched: int
    back: int
    total: int
    medians: tuple[float | None, ...]


def groups(rows: Iterable[Reaction]) -> list[ReactionGroup]:
    """Groups over arms and seeds, sorted by scene, disturbance and leader."""
    found: dict[tuple[str, str, str], list[Reaction]] = {}
    for row in rows:
        found.setdefault((row.scene, row.disturbance, row.leader), []).append(row)
    order = {name: index for index, name in enumerate((*DISTURBANCES, *LEADERS))}
    made = []
    for key in sorted(found, key=lambda key: (key[0], order[key[1]], order[key[2]])):
        own = found[key]
        values = [[value for row in own if (value := getattr(row, column.name)) is not None] for column in MEASURED]
        made.append(
            ReactionGroup(
                key,
                sum(row.success for row in own),
                sum(row.reason.startswith("contact") for row in own),
                sum(row.back_s is not None for row in own),
                len(own),
                tuple(float(np.median(column)) if column else None for column in values),
            )
        )
    return made


def write_reactions(path: str | os.PathLike[str], table: ReactionTable) -> None:
    """Write the summary in Markdown: arrival, contact, and medians over arms and seeds."""
    rows = table.sorted_rows()
    arms, seeds = sorted({row.arm for row in rows}), len({row.seed for row in rows})
    lines = [
        "# Planners that react, disturbed",
        "",
        METHOD,
        "",
        f"Arms: {escaped(', '.join(arms))}; {seeds} seed{'s' if seeds != 1 else ''}; medians.",
        "",
    ]
    lines += table_head(["scene", "disturbance", "leader", "arrived", "touched", "back"], MEASURED)
    for group in groups(rows):
        counts = [f"{group.arrived} of {group.total}", str(group.touched)]
        counts.append(str(group.back) if group.key[1] in ("push", "payload") else "-")
        cells = ["-" if value is None else f"{value:.3g}" for value in group.medians]
        lines.append(table_line([*group.key, *counts, *cells]))
    failed = [row for row in rows if row.reason.startswith(("problem", "plan", "simulation", "error"))]
    lines += ["", "## Could not be run", ""] if failed else []
    lines += [
        escaped(f"- {row.leader}, {row.arm}, {row.scene}, {row.disturbance}, seed {row.seed}: {row.reason}")
        for row in failed
    ]
    with filesystem.atomic_text(path) as stream:
        stream.write("\n".join(lines) + "\n")
