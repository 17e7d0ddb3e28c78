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
    "Each policy moves an arm from home to a random reachable target for 7 s, with feedback at 100 Hz and "
    "inverse-dynamics servos. After 35 % of its undisturbed path it meets one of four disturbances. Push: a force acts "
    "on a random link for 0.2 s, in the same direction for all. It is as large as this run needs for a joint to "
    "deviate by 8 to 12 % of its range during the force or soon after, and at most 20 kN. Payload: a weight of 10 N "
    "hangs on the end effector from then on. Target: the target moves by up to a tenth of the ranges. Obstacle: a pole "
    "moves 0.6 m in at most 0.6 s to a place that the end effector would pass on the policy's own path, and stays "
    "there; policies other than the tracker know its place in each period. A policy has arrived if every link ends "
    "within 1 mm and 0.1 degrees of the last target without contact. It is back once its deviation from the "
    "undisturbed path stays below a tenth of the largest, which a lasting weight prevents. Effort is the integral of "
    "the mean squared actuator force relative to its limits. The tracker plays the guide's motion, whatever arm and "
    "target do; all other policies see the measured joints and wait for the arm. Among obstacles and moving poles, "
    "fabric, path integral (mppi) and lieednn-replanning avoid contact by themselves; the other networks, primitives "
    "and the linear attractor use the safety filter. Except lieednn-replanning, policies without a time law of their "
    "own approach the target at 2/s. Only the CPU time of a control step (in Python) differs between runs."
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
    result.sort(key=lambda item: (item.key[0], order[item.key[1]], order.get(item.key[2], len(order)), item.key[2]))
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
