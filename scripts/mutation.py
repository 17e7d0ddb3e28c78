"""Mutation testing: change modules slightly, with mutmut, and count the changes that tests notice.

    pip install --group mutation
    python scripts/mutation.py tests/lie --modules 'lie/*' 'theory/groups.py' [--sample 40] [--seed 0] [--jobs 2]

A seeded random sample of the mutants is tried (0: all of them), in a copy of the checkout below the output. What mutmut
itself calls a survivor is tried with all of the tests again, since it runs only those seen calling the function: of
tests that share a fixture, the first one. Writes ``mutation.json`` with the outcomes and the diffs of the survivors.
The same command continues an interrupted run.
"""

from __future__ import annotations

import argparse
import collections
import json
import os
import random
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

from lieednn_sim import io

ROOT = Path(__file__).resolve().parents[1]
# Files and folders that the tests read.
COPIED = ("lieednn_sim", "assets", "tests", "scripts", "pyproject.toml", "README.md")
OUTCOMES: dict[int | None, str] = {1: "killed", 3: "killed", 0: "survived", 5: "no tests", 33: "no tests"}


def prepare(place: Path, modules: list[str], tests: list[str]) -> None:
    """Copy the checkout, configure mutmut, and make the mutants."""
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    for name in COPIED:
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, place / name)
    values = {
        "source_paths": ["lieednn_sim"],
        "only_mutate": [f"lieednn_sim/{module}" for module in modules],
        "pytest_add_cli_args_test_selection": tests,
        "pytest_add_cli_args": ["-p", "no:cacheprovider"],
        "also_copy": ["assets", "scripts", "README.md"],
    }
    lines = ["[mutmut]", "timeout_multiplier = 10", "track_dependencies = false"]
    for key, entries in values.items():
        lines += [f"{key} =", *(f"    {entry}" for entry in entries)]
    (place / "setup.cfg").write_text("\n".join(lines) + "\n", encoding="utf-8")
    # Runs the tests once to find which functions they call; no mutant has this name.
    run(place, "mutmut", "run", "--max-children", "1", "none", check=False)


def run(place: Path, *words: str, check: bool = True, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a module of Python in the copy; a failure ends the script, unless it is not to be checked."""
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(place)} | variables
    command = [sys.executable, "-m", *words]
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, check=False)
    if check and done.returncode:
        raise SystemExit(f"{' '.join(words[:2])} failed in {place}:\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")
    return done


def exit_codes(place: Path) -> dict[str, int | None]:
    """Exit codes of the tests by mutant, None for one that was not tried."""
    codes: dict[str, int | None] = {}
    for path in sorted((place / "mutants").rglob("*.meta")):
        codes |= json.loads(path.read_text(encoding="utf-8"))["exit_code_by_key"]
    return codes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tests", nargs="+", help="tests that should notice the changes")
    parser.add_argument("--modules", nargs="+", required=True, help="what is changed, as globs below the package")
    parser.add_argument("--sample", type=int, default=40, help="number of mutants, 0 for all (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--output", type=Path, default=Path("results/mutation"))
    options = parser.parse_args()
    if find_spec("mutmut") is None:
        parser.error("mutmut is not installed; install it with `pip install --group mutation`")
    place = options.output.resolve() / "checkout"
    if not (place / "mutants").exists():
        prepare(place, options.modules, options.tests)
    known = sorted(exit_codes(place))
    if not known:
        raise SystemExit("no mutants; the tests fail without any, or no module has this name")
    chosen = sorted(random.Random(options.seed).sample(known, min(options.sample or len(known), len(known))))
    todo = [mutant for mutant in chosen if exit_codes(place)[mutant] is None]
    # In parts, so that an interrupted run keeps what is done and no command is too long.
    for first in range(0, len(todo), 200):
        run(place, "mutmut", "run", "--max-children", str(options.jobs), *todo[first : first + 200])
    codes, alive = exit_codes(place), {}
    results = {mutant: OUTCOMES.get(codes[mutant], "timeout or crash") for mutant in chosen}
    for mutant in [name for name, outcome in results.items() if outcome in ("survived", "no tests")]:
        words = ("pytest", "-x", "-q", "-p", "no:cacheprovider", *options.tests)
        if run(place / "mutants", *words, check=False, MUTANT_UNDER_TEST=mutant).returncode:
            results[mutant] = "killed"
        else:
            alive[mutant] = run(place, "mutmut", "show", mutant).stdout
            print(alive[mutant], flush=True)
    io.save_json(options.output / "mutation.json", {"outcomes": results, "alive": alive})
    print(f"of {len(known)} mutants, {len(chosen)} tried:", dict(collections.Counter(results.values())))


if __name__ == "__main__":
    main()
