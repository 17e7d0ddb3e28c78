"""Compare planners and controllers on random reachable targets: the command `lieednn-sim compare`, as a study.

    python scripts/evaluate_tracking.py [--seeds 20] [--planners ...] [--controllers ...] [--output results/comparison]

Writes a table with one row for each arm, scene, planner, controller and seed (``comparison.csv``), the settings common
to all rows (``comparison.json``), a Markdown summary and an HTML page. Existing rows are not computed again, so an
interrupted run can be continued, and a larger --seeds adds rows; remove the table after a change of the code. All
columns except the planning time (``planning_s``) are reproducible.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from lieednn_sim.cli import main as command_line


def main(arguments: Sequence[str] | None = None) -> int:
    return command_line(["compare", *(sys.argv[1:] if arguments is None else arguments)])


if __name__ == "__main__":
    sys.exit(main())
