"""The summary of the benchmark of disturbed policies in Markdown, and the groups of its rows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from lieednn_sim import io
from lieednn_sim.evaluation.display import escaped, markdown_table
from lieednn_sim.studies.reactions.study import COMPARED, DISTURBANCES, MEASURED, Reaction
from lieednn_sim.studies.rows import Group, grouped
from lieednn_sim.studies.table import Table
from lieednn_sim.values import StrPath

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


def groups(rows: Iterable[Reaction]) -> list[ReactionGroup]:
    """Groups of `posed` rows over arms and seeds, sorted by their keys: scene, disturbance and policy."""
    order = {name: index for index, name in enumerate((*DISTURBANCES, *COMPARED))}
    result = grouped((row for row in rows if row.posed), ("scene", "disturbance", "policy"))
    result.sort(key=lambda item: (item.key[0], order[item.key[1]], order[item.key[2]]))
    return [ReactionGroup(item.key, item.rows) for item in result]


def write_reactions(path: StrPath, table: Table[Reaction]) -> None:
    """Write the summary in Markdown: arrival, contact, and medians over arms and seeds."""
    rows = list(table.rows.values())
    arms, seeds = sorted({row.arm for row in rows}), len({row.seed for row in rows})
    head = f"Arms: {escaped(', '.join(arms))}; {seeds} seed{'s' if seeds != 1 else ''}; medians."
    lines, medians = ["# Policies, disturbed", "", METHOD, "", head], []
    for group in groups(rows):
        counts = [f"{group.successes} of {group.total}", str(group.touched)]
        counts.append(str(group.back) if group.key[1] in ("push", "payload") else "-")
        found = (group.median(column.name) for column in MEASURED)
        cells = ["-" if value is None else f"{value:.3g}" for value in found]
        medians.append([*map(escaped, group.key), *counts, *cells])
    heads = ["scene", "disturbance", "policy", "arrived", "touched", "back", *(column.heading for column in MEASURED)]
    lines += markdown_table(heads, medians)
    unposed = Counter((row.scene, row.disturbance, row.policy, row.reason) for row in rows if not row.posed)
    failures = [
        f"- {', '.join(key)}, {count} case{'s' if count != 1 else ''}: {reason}"
        for (*key, reason), count in sorted(unposed.items())
    ] + [
        f"- {row.policy}, {row.arm}, {row.scene}, {row.disturbance}, seed {row.seed}: {row.reason}"
        for row in rows
        if row.reason.startswith(("plan", "simulation", "error"))
    ]
    lines += ["", "## Could not be run", "", *map(escaped, failures)] if failures else []
    io.save_text(path, "\n".join(lines) + "\n")
