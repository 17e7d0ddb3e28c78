"""The reactive benchmark, in which policies are disturbed, and its summary."""

from __future__ import annotations

import itertools
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from lieednn_sim import io
from lieednn_sim.studies.markdown import escaped
from lieednn_sim.studies.markdown import table as markdown_table
from lieednn_sim.studies.reactions.cases import (
    COMPARED,
    DISTURBANCES,
    MEASURED,
    Reaction,
    failed_reactions,
    run_reactions,
)
from lieednn_sim.studies.statistics import Group, grouped
from lieednn_sim.studies.study import Study
from lieednn_sim.studies.table import Table
from lieednn_sim.studies.user_files import UserFile
from lieednn_sim.validation import as_count
from lieednn_sim.values import check_fields

METHOD = (
    "From home to random reachable targets with feedback at 100 Hz and inverse-dynamics servos, for 7 s. After 35 % of"
    " its own undisturbed path each policy is disturbed: by a force of 0.2 s on a random link, in the same direction "
    "for all, as large as is needed in this run to make a joint deviate by 8 to 12 % of its range while the force acts"
    " or soon after, at most 20 kN; by a weight of 10 N at the end effector from then on; by another target, up to a "
    "tenth of the ranges away; or by a pole that walks 0.6 m, in at most 0.6 s, to a place which the end effector would"
    " pass on the policy's own path, and stays there. All but the tracker are told where it is in each period. A policy"
    " has arrived if every link ends within 1 mm and 0.1 degrees of the last target without any contact. It is back "
    "once its deviation from the undisturbed path stays below a tenth of the largest one, which a lasting weight "
    "prevents. Effort is the integral of the mean squared actuator force relative to its limits. All policies but the "
    "tracker see the measured joints and wait for the arm; the tracker plays the guide's motion, whatever arm and "
    "target do. Among obstacles, and where a pole walks, lieednn-replanning, fabric and path integral (mppi) avoid "
    "contact by themselves; the other networks, primitives and the linear attractor use the safety filter. "
    "Policies without a time law of their own, but for lieednn-replanning, approach the target at "
    "2/s. Only the CPU time of a control step, measured in Python, differs between runs."
)


@dataclass(frozen=True)
class Reactions(Study[Reaction]):
    """The reactive benchmark: each policy on all arms in all scenes, under each of `DISTURBANCES`.

    Attributes:
        arms: names of arms.
        scenes: names of scenes.
        seeds: number of seeds, starting at 0.
        policies: names of `COMPARED`.
        user_files: arms and scenes from files, by their names; see `Comparison.user_files`.

    Raises:
        InputError: ``seeds`` is less than 1.
    """

    name, kind = "reactions", Reaction
    run, failed = staticmethod(run_reactions), staticmethod(failed_reactions)

    arms: Sequence[str]
    scenes: Sequence[str]
    seeds: int
    policies: Sequence[str] = tuple(COMPARED)
    user_files: tuple[UserFile, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, as_count, "seeds")

    def todo(self, table: Table[Reaction]) -> list[tuple[str, str, str, int]]:
        """See `Study`; seeds first, so that an early stop leaves all policies on all arms."""
        return [
            (arm, scene, policy, seed)
            for seed, arm, scene, policy in itertools.product(range(self.seeds), self.arms, self.scenes, self.policies)
            if any((arm, scene, policy, name, seed) not in table.rows for name in DISTURBANCES)
        ]


class ReactionGroup(Group[Reaction]):
    """The rows of a policy under a disturbance in a scene."""

    @property
    def touched(self) -> int:
        """Number of rows with contact."""
        return sum(row.reason.startswith("contact") for row in self.rows)

    @property
    def back(self) -> int:
        """Number of rows that were back on their path."""
        return sum(row.back_s is not None for row in self.rows)

    @property
    def medians(self) -> list[float | None]:
        """Medians of the measured columns, None for empty ones."""
        return [self.median(column.name) for column in MEASURED]


def groups(rows: Iterable[Reaction]) -> list[ReactionGroup]:
    """Groups over arms and seeds, sorted by their keys: scene, disturbance and policy.

    Rows of a problem that could not be posed, such as a pole without a place in the arm's way, belong to none.
    """
    order = {name: index for index, name in enumerate((*DISTURBANCES, *COMPARED))}
    result = grouped((row for row in rows if row.posed), ("scene", "disturbance", "policy"))
    result.sort(key=lambda item: (item.key[0], order[item.key[1]], order[item.key[2]]))
    return [ReactionGroup(item.key, item.rows) for item in result]


def write_reactions(path: str | os.PathLike[str], table: Table[Reaction]) -> None:
    """Write the summary in Markdown: arrival, contact, and medians over arms and seeds."""
    rows = table.sorted_rows()
    arms, seeds = sorted({row.arm for row in rows}), len({row.seed for row in rows})
    lines = [
        "# Policies, disturbed",
        "",
        METHOD,
        "",
        f"Arms: {escaped(', '.join(arms))}; {seeds} seed{'s' if seeds != 1 else ''}; medians.",
    ]
    medians = []
    for group in groups(rows):
        counts = [f"{group.successes} of {group.total}", str(group.touched)]
        counts.append(str(group.back) if group.key[1] in ("push", "payload") else "-")
        cells = ["-" if value is None else f"{value:.3g}" for value in group.medians]
        medians.append([*map(escaped, group.key), *counts, *cells])
    heads = ["scene", "disturbance", "policy", "arrived", "touched", "back", *(column.heading for column in MEASURED)]
    lines += markdown_table(heads, medians)
    unposed = Counter((row.scene, row.disturbance, row.policy, row.reason) for row in rows if not row.posed)
    failed = [row for row in rows if row.reason.startswith(("plan", "simulation", "error"))]
    lines += ["", "## Could not be run", ""] if failed or unposed else []
    lines += [
        escaped(f"- {', '.join(key)}, {count} case{'s' if count != 1 else ''}: {reason}")
        for (*key, reason), count in sorted(unposed.items())
    ]
    lines += [
        escaped(f"- {row.policy}, {row.arm}, {row.scene}, {row.disturbance}, seed {row.seed}: {row.reason}")
        for row in failed
    ]
    with io.atomic_text(path) as stream:
        stream.write("\n".join(lines) + "\n")
