"""Views of a comparison: one problem solved by several planners, side by side in 3D, for viser's player in the page."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lieednn_sim.errors import InputError
from lieednn_sim.rendering.recording import Recording, record
from lieednn_sim.studies.comparison.rows import Case, Row
from lieednn_sim.studies.comparison.together import replay_together
from lieednn_sim.studies.table import Table


@dataclass(frozen=True)
class View:
    """One problem solved by several planners.

    Attributes:
        rows: their rows in the table, from left to right.
        recording: their motions.
    """

    rows: tuple[Row, ...]
    recording: Recording

    @property
    def base64(self) -> str:
        """The recording as text for the page."""
        return base64.b64encode(self.recording.content).decode("ascii")


def view(
    table: Table[Row],
    cases: Sequence[Case],
    controller: str,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> View:
    """Plan and simulate cases of one problem again, and record them side by side.

    Raises:
        InputError: the table has no such case, or they are of several problems.
        LieEDNNError: viser is not installed.
    """
    rows = [table.rows.get((case.arm, case.scene, case.planner, controller, case.seed)) for case in cases]
    found = tuple(row for row in rows if row is not None)
    if len(found) < len(rows) or len({(row.arm, row.scene, row.seed) for row in found}) != 1:
        raise InputError("a view is of one problem that the table has, by one planner or more")
    rollouts = replay_together(table, cases, controller)
    return View(found, record(list(rollouts.values()), list(rollouts), progress=progress))
