"""Memory of a worker of each study as it computes case after case; it should be flat after the first hundred.

    python scripts/benchmark_memory.py [--cases 2000] [--problems FOLDER] [--output results/memory]

Each study runs in one fresh process, with cases as cheap as they can be; those of published problems need the folder of
a robot (docs/howto/published_problems.md). Writes ``memory.md``: resident memory [MB] after so many cases.
"""

from __future__ import annotations

import argparse
import itertools
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from lieednn_sim import filesystem
from lieednn_sim.learning.demonstrations import Demonstration, Demonstrations, ShapedMotion, align
from lieednn_sim.studies.comparison.cases import Settings, run_case
from lieednn_sim.studies.comparison.rows import Case
from lieednn_sim.studies.demonstrations.models import compare_models
from lieednn_sim.studies.problems.motion_bench_maker import ProblemSets
from lieednn_sim.studies.problems.study import solve
from lieednn_sim.studies.reactions.cases import run_reactions
from lieednn_sim.studies.workers import released

# Fractions of the cases after which the memory is read.
_READ = (0.05, 0.25, 0.5, 1.0)
_PLANNERS = ("minimum-jerk", "rrt-connect", "lieednn-shaped")


def comparison() -> Iterator[Callable[[], object]]:
    """Cases of a comparison, each among other obstacles."""
    settings = Settings(duration=2.0, hold=0.0)
    for seed in itertools.count():
        case = Case("telescopic_pr", "poles", _PLANNERS[seed % len(_PLANNERS)], seed)
        yield partial(run_case, case, ["inverse-dynamics"], settings)


def reactions() -> Iterator[Callable[[], object]]:
    """Cases of the reactive benchmark."""
    for seed in itertools.count():
        yield partial(run_reactions, "telescopic_pr", "free", "linear-attractor", seed)


def demonstrations() -> Iterator[Callable[[], object]]:
    """Comparisons of models of two demonstrations."""
    s = np.linspace(0.0, 1.0, 60)
    for seed in itertools.count():
        heights = np.random.default_rng(seed).uniform(0.05, 0.15, 2)
        paths = [np.column_stack([0.3 * (1.0 - s), height * np.sin(np.pi * s)]) for height in heights]
        yield partial(_compared, align([Demonstration.from_samples(path) for path in paths], samples=60))


def _compared(shown: Demonstrations) -> object:
    return compare_models(shown, ShapedMotion.fit(shown), rivals=["linear-attractor"], starts=5)


def problems(folder: str) -> Iterator[Callable[[], object]]:
    """A robot's published problems, again and again."""
    for name, number in itertools.cycle(ProblemSets(folder).selection()):
        for planner in _PLANNERS:
            yield partial(solve, folder, name, number, planner, 10.0)


STUDIES: dict[str, Callable[..., Iterator[Callable[[], object]]]] = {
    study.__name__: study for study in (comparison, reactions, demonstrations, problems)
}


def resident() -> float:
    """Resident memory of this process [MB]; Linux only."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def run(study: str, cases: int, *given: str) -> None:
    """Run the cases of a study here, and print the memory after each fraction of them."""
    wanted = [max(int(fraction * cases), 1) for fraction in _READ]
    for done, case in enumerate(itertools.islice(STUDIES[study](*given), cases), start=1):
        released(case)
        if done in wanted:
            print(f"{done} {resident():.0f}", flush=True)


def main(words: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=2000, help="of each study (default: %(default)s)")
    parser.add_argument("--problems", default="", help="folder of a robot's published problems")
    parser.add_argument("--studies", default=",".join(STUDIES), help="some of them (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path("results/memory"))
    options = parser.parse_args(words)
    directory = filesystem.make_directory(options.output)
    lines = [f"# Memory of a worker\n\n`python scripts/benchmark_memory.py --cases {options.cases}`: resident [MB].\n"]
    lines.append(f"| study | {' | '.join(f'{fraction:.0%} of {options.cases} cases' for fraction in _READ)} |")
    lines.append("| --- |" + " ---: |" * len(_READ))
    for study in options.studies.split(","):
        given = [options.problems] if study == "problems" else []
        if given == [""]:
            continue
        code = f"import benchmark_memory as b; b.run({study!r}, {options.cases}, *{given!r})"
        folder = Path(__file__).parent
        done = subprocess.run([sys.executable, "-c", code], cwd=folder, stdout=subprocess.PIPE, text=True, check=True)
        found = dict(line.split() for line in done.stdout.splitlines())
        lines.append(f"| {study} | {' | '.join(found.values())} |")
        print(lines[-1], flush=True)
        with filesystem.atomic_text(directory / "memory.md") as stream:
            stream.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
