"""Reproduce the experiments of the paper: figures, tables, and a verdict on each claim.

    python scripts/reproduce_paper.py [--quick] [--output results/paper] [--jobs N] [--fresh]

The same command continues an interrupted run; --fresh starts over, as after a change of the code.
"""

from __future__ import annotations

import os
from pathlib import Path

# Set before NumPy loads, and inherited by the workers: the matrices are far too small for threads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from common import options
from paper import figures, report
from paper.plan import FULL, QUICK, Plan, jobs
from paper.results import Results, run_all

from lieednn_sim import io


def reproduce(plan: Plan, directory: str | os.PathLike[str], workers: int, command: str) -> Path:
    """Run missing jobs on processes; write figures and report, and return the report's path."""
    output = io.make_directory(directory)
    results = Results.collect(plan, run_all(jobs(plan), output / "jobs", workers))
    return report.write(results, figures.draw(results, output), command, output)


def main(arguments: list[str] | None = None) -> None:
    given = options(arguments, __doc__, "results/paper", quick=False, jobs=os.cpu_count() or 1, fresh=False)
    command = "python scripts/reproduce_paper.py" + (" --quick" if given.quick else "")
    for path in (given.output / "jobs").glob("*.json") if given.fresh else ():
        path.unlink()
    plan = QUICK if given.quick else FULL
    print(reproduce(plan, given.output, given.jobs, command))


if __name__ == "__main__":
    main()
