"""Mutation testing: change the code slightly, with mutmut, and count the changes that a room's tests notice.

    pip install --group mutation
    python scripts/mutation.py [--rooms lie,motion] [--sample 40] [--seed 0] [--jobs 2] [--output results/mutation]

A seeded random sample of each room's mutants is tried (0: all of them), with its own fast tests, in a copy of the
checkout below the output. Writes ``ROOM.json`` for each room, with the diffs of the survivors, and the table
``mutation.md``. An interrupted run can be continued.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from lieednn_sim import io

ROOT = Path(__file__).resolve().parents[1]
# Files and folders that the tests read.
_COPIED = ("lieednn_sim", "assets", "tests", "scripts", "pyproject.toml", "README.md")
_BY_CODE = {1: "killed", 3: "killed", 0: "survived", 5: "no tests", 33: "no tests"}


@dataclass(frozen=True)
class Room:
    """Modules, as globs under the package; tests that should notice changes in them; and tests too slow for that."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]
    slow: tuple[str, ...] = ()


_ARM_TESTS = ("tests/arm/test_arm.py", "tests/arm/test_projection.py", "tests/arm/test_importer.py")
ROOMS = {
    "lie": Room(
        ("lie/*", "theory/groups.py", "theory/matrix_group.py"), ("tests/lie", "tests/theory/test_matrix_group.py")
    ),
    "stability": Room(("stability/*",), ("tests/stability",)),
    "synthesis": Room(("synthesis/*",), ("tests/synthesis",)),
    "motion": Room(("planning/motion.py", "planning/network_path.py"), ("tests/planning/test_motion.py",)),
    "planning": Room(("planning/certified.py",), ("tests/planning/test_motion.py",)),
    "filtering": Room(
        ("planning/safety_filter/*", "planning/filtered_planners.py"),
        ("tests/planning/test_filtering.py",),
        tuple(
            f"tests/planning/test_filtering.py::{name}"
            for name in (
                "test_the_planners_find_a_way_around",
                "test_a_hopeless_problem_says_what_blocks",
                "test_postures_on_the_way_are_passed_and_the_network_arrives_all_the_same",
                "test_no_wanted_velocity_breaks_a_limit_or_touches[telescopic_compound]",
            )
        ),
    ),
    "projection": Room(("arm/projection.py", "arm/nearest.py", "arm/kinematics.py"), _ARM_TESTS[:2]),
    "couplings": Room(("arm/couplings.py",), ("tests/arm/test_couplings.py", *_ARM_TESTS[1:])),
    "simulation": Room(
        ("simulation/*",),
        ("tests/simulation",),
        ("tests/simulation/test_rollout.py::test_final_pose_error_and_tracking_over_seeded_targets",),
    ),
    "metrics": Room(
        (
            "evaluation/metrics.py",
            "evaluation/motion_metrics.py",
            "studies/comparison/rows.py",
            "studies/statistics.py",
        ),
        (
            "tests/evaluation/test_metrics.py",
            "tests/evaluation/test_motion_metrics.py",
            "tests/studies/test_compare.py",
        ),
        ("tests/studies/test_compare.py::test_interrupting_keeps_what_is_done",),
    ),
    "limits": Room(("arm/parsing.py", "arm/coordinates.py"), _ARM_TESTS),
}


def measure(name: str, sample: int, seed: int, jobs: int, output: Path) -> dict[str, Any]:
    """Outcomes of a room's mutants by name, and the diffs of the survivors."""
    place = output / name
    if not (place / "mutants").exists():
        prepare(ROOMS[name], place)
        # Makes the mutants, and runs the tests once to find which functions they call; no mutant has this name.
        run(place, ["run", "--max-children", "1", "none"], check=False)
    known = sorted(outcomes(place))
    chosen = sorted(random.Random(seed).sample(known, min(sample, len(known)) if sample else len(known)))
    if not chosen:
        raise SystemExit(f"{name}: no mutants; the tests fail without any, see mutmut's words above")
    todo = [mutant for mutant in chosen if outcomes(place)[mutant] is None]
    # In parts, so that an interrupted run keeps what is done and no command is too long.
    for first in range(0, len(todo), 200):
        run(place, ["run", "--max-children", str(jobs), *todo[first : first + 200]])
    codes = outcomes(place)
    found = dict.fromkeys(chosen, "timeout or crash")
    found |= {mutant: _BY_CODE[code] for mutant, code in codes.items() if mutant in found and code in _BY_CODE}
    alive = {}
    for mutant, outcome in found.items():
        if outcome in ("survived", "no tests"):
            diff = run(place, ["show", mutant])
            # Mutmut runs only tests seen calling the function: of tests that share a fixture, only the first one.
            if not of_words_only(diff) and noticed(ROOMS[name], place, mutant):
                found[mutant] = "killed"
            else:
                alive[mutant] = diff
    result = {"room": name, "mutants": len(known), "seed": seed, "outcomes": found, "alive": alive}
    io.save_json(output / f"{name}.json", result)
    return result


def prepare(room: Room, place: Path) -> None:
    """Copy the checkout, and configure mutmut."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    for name in _COPIED:
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, place / name)
    values = {
        "source_paths": ["lieednn_sim"],
        "only_mutate": [f"lieednn_sim/{module}" for module in room.modules],
        "pytest_add_cli_args_test_selection": list(room.tests),
        "pytest_add_cli_args": ["-p", "no:cacheprovider", *(f"--deselect={test}" for test in room.slow)],
        "also_copy": ["assets", "scripts", "README.md"],
    }
    lines = ["[mutmut]", "timeout_multiplier = 10", "track_dependencies = false"]
    for key, entries in values.items():
        lines += [f"{key} =", *(f"    {entry}" for entry in entries)]
    (place / "setup.cfg").write_text("\n".join(lines) + "\n", encoding="utf-8")


def noticed(room: Room, place: Path, mutant: str) -> bool:
    """Whether any of a room's tests fails with a mutant."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ".", "MUTANT_UNDER_TEST": mutant}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *room.tests]
    command += [f"--deselect={test}" for test in room.slow]
    return bool(subprocess.run(command, cwd=place / "mutants", env=environment, capture_output=True).returncode)


def run(place: Path, arguments: list[str], *, check: bool = True) -> str:
    """Run mutmut in a copy; returns its output."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(place)}
    done = subprocess.run(
        [sys.executable, "-m", "mutmut", *arguments], cwd=place, env=environment, capture_output=True, text=True
    )
    if check and done.returncode:
        raise SystemExit(f"mutmut {arguments[0]} failed in {place}:\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    return done.stdout


def outcomes(place: Path) -> dict[str, int | None]:
    """Exit codes of the tests by mutant, None for one that was not tried."""
    codes: dict[str, int | None] = {}
    for path in sorted((place / "mutants").rglob("*.meta")):
        codes |= json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
    return codes


def of_words_only(diff: str) -> bool:
    """Whether a mutant only changes text: one line whose strings differ, or lose their names for messages."""
    lines = diff.splitlines()
    old, new = ([line[1:] for line in lines if re.match(rf"\{sign}(?!\{sign})", line)] for sign in "-+")
    blank = re.compile(r"""f?(["']).*?\1""")
    plain = [[blank.sub("_", line) for line in side] for side in (old, new)]
    return plain[0] == plain[1] and old != new


def table(results: list[dict[str, Any]]) -> str:
    """The results in Markdown."""
    lines = [
        "| room | mutants | tried | killed | timeout or crash | words only | alive | killed of those that act |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    sums = [0] * 6
    for result in results:
        found = list(result["outcomes"].values())
        words = sum(of_words_only(diff) for diff in result["alive"].values())
        counts = [
            result["mutants"],
            len(found),
            found.count("killed"),
            found.count("timeout or crash"),
            words,
            len(result["alive"]) - words,
        ]
        sums = [total + count for total, count in zip(sums, counts, strict=True)]
        lines.append(_line(result["room"], counts))
    return "\n".join([*lines, _line("all", sums)]) + "\n"


def _line(name: str, counts: list[int]) -> str:
    noticed, acting = counts[2] + counts[3], counts[1] - counts[4]
    interval = binomtest(noticed, acting).proportion_ci(0.95, method="wilson")
    fraction = f"{noticed / acting:.0%} ({interval.low:.0%} to {interval.high:.0%})"
    return f"| {name} | {' | '.join(map(str, counts))} | {fraction} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", default=",".join(ROOMS), help=f"of {', '.join(ROOMS)}")
    parser.add_argument("--sample", type=int, default=40, help="mutants of each room, 0 for all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path("results/mutation"))
    options = parser.parse_args()
    names = options.rooms.split(",")
    if unknown := sorted(set(names) - set(ROOMS)):
        parser.error(f"no room {unknown[0]!r}; rooms are: {', '.join(ROOMS)}")
    if find_spec("mutmut") is None:
        parser.error("mutmut is not installed; install it with `pip install --group mutation`")
    output = options.output.resolve()
    results = []
    for name in names:
        results.append(measure(name, options.sample, options.seed, options.jobs, output))
        print(table(results[-1:]).splitlines()[2], flush=True)
    with io.atomic_text(output / "mutation.md") as stream:
        stream.write(table(results))


if __name__ == "__main__":
    main()
