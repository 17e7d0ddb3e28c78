"""Make results below results/reference again, or check that today's code still makes a sample of each.

    python scripts/reference.py NAME ... [--jobs N] [--data WORD=FOLDER ...]
    python scripts/reference.py --check [NAME ...] [--data WORD=FOLDER ...]
    python scripts/reference.py --update NAME ...

``results/reference/studies.toml`` lists the studies. A study runs in ``results/making/NAME``, where an interrupted run
goes on, and ``made.json`` records how it was made. --check makes the samples of the studies, of all by default, and
compares each row of their tables with the committed row, except for measured times; the exit status is 1 if one
differs. Where the rows of a table are means over many cases, its sample has a committed file of its own, which --update
makes again. Some studies need outside data, such as ``--data PROBLEMS=vamp/resources``: recordings of RoboTasks and
LASA (``DEMONSTRATIONS``), models of MuJoCo Menagerie and of ROS packages (``ROBOTS``, which may be given several times,
with names and commits in ``MODELS``), VAMP's ``resources`` (``PROBLEMS``), checkouts of roahmlab's ``ARMOUR`` and
``SPARROWS``.
"""

from __future__ import annotations

import argparse
import csv
import datetime
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from lieednn_sim import io
from lieednn_sim.errors import FileError
from lieednn_sim.versions import commit, versions

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = ROOT / "results/reference"
STUDIES: dict[str, dict[str, Any]] = tomllib.loads((REFERENCE / "studies.toml").read_text(encoding="utf-8"))
# Columns of measured times, which are not compared.
TIMED = re.compile(
    r"planning \[s\]|CPU|control step|encoding|fit \[m?s\]|fit s|solve time|time of an epoch|times minimum|"
    r"^(measured|seconds)$"
)
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")
# Two numbers agree if they differ by at most this fraction (the last of three digits) or this much (rounding of mm).
RELATIVE, ABSOLUTE = 0.01, 1e-4


def rows_of(path: Path, keys: int) -> Iterator[tuple[tuple[str, ...], dict[str, str]]]:
    """Rows of the tables in a Markdown or CSV file: section and first cells, and all cells by their headings.

    Rows of a whole table, which begin with "all" or "mean", are left out; headings that occur again get a number.
    """
    section, head = "", list[str]()
    lines = path.read_text(encoding="utf-8").splitlines()
    if path.suffix == ".csv":
        lines = ["| " + " | ".join(cells) + " |" for cells in csv.reader(lines)]
    for line in lines:
        if not line.startswith("|"):
            section, head = line if line.startswith("#") else section, []
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if not head:
            head = [f"{name} {number}" if name in cells[:number] else name for number, name in enumerate(cells)]
        elif not set(line) <= set("|-: ") and cells[0] not in ("all", "**mean**"):
            yield (section, *cells[:keys]), dict(zip(head, cells, strict=True))


def differences(path: Path, committed: Path, keys: int) -> list[str]:
    """The differences between the rows of a sample and the committed rows of the same keys, in words."""
    known: dict[tuple[str, ...], list[dict[str, str]]] = {}
    for key, row in rows_of(committed, keys):
        known.setdefault(key, []).append(row)
    found = []
    for key, row in rows_of(path, keys):
        where = f"{committed.name}, {', '.join(key[1:])}"
        other = known[key].pop(0) if known.get(key) else {}
        if row.keys() != other.keys():
            lost = sorted(row.keys() ^ other.keys())
            found.append(f"{where}: {f'other columns: {lost}' if other else 'no such row is committed'}")
        found += [
            f"{where}, {name}: {other[name]}, now {cell}"
            for name, cell in row.items()
            if name in other and not TIMED.search(name) and not _agree(cell, other[name])
        ]
    return found


def _agree(cell: str, other: str) -> bool:
    """Whether two cells have the same words, and numbers within the tolerance."""
    if NUMBER.sub("", cell) != NUMBER.sub("", other):
        return False
    pairs = ((float(a), float(b)) for a, b in zip(NUMBER.findall(cell), NUMBER.findall(other), strict=True))
    return all(abs(a - b) <= ABSOLUTE + RELATIVE * max(abs(a), abs(b)) for a, b in pairs)


def check(study: Mapping[str, Any], given: Mapping[str, Sequence[str]], *, update: bool = False) -> list[str]:
    """Make a sample and return what differs from the committed rows; ``update`` replaces these first."""
    with tempfile.TemporaryDirectory() as folder:
        for command in study["sample"]:
            _run(command, given, Path(folder))
        compared = [(Path(folder) / page, REFERENCE / name) for page, name in study["compared"].items()]
        for page, committed in compared:
            if update and committed.parent.name == "samples":
                _take(page, committed, "; ".join(study["sample"]))
        return [words for pages in compared for words in differences(*pages, study["keys"])]


def make(name: str, study: Mapping[str, Any], given: Mapping[str, Sequence[str]], jobs: int) -> None:
    """Run a study, or the rest of it, then copy and record its results; `FileError` if a command fails."""
    work = io.make_directory(ROOT / "results/making" / name)
    more = f" --jobs {jobs}" if study.get("jobs") else ""
    # The times of an interrupted run count.
    path = work / "spent.json"
    spent = io.load_json(path, "times") if path.exists() else {"cpu_s": 0.0, "wall_s": 0.0}
    begin, used = time.perf_counter(), _cpu()
    try:
        for command in (*study["commands"][:-1], study["commands"][-1] + more):
            _run(command, given, work)
    finally:
        spent = {"cpu_s": spent["cpu_s"] + _cpu() - used, "wall_s": spent["wall_s"] + time.perf_counter() - begin}
        io.save_json(path, spent)
    command, outputs = "; ".join(study["commands"]), []
    for target, source in study["outputs"].items():
        for path in sorted(work.glob(source)):
            outputs.append(f"{target}/{path.name}" if "*" in source else target)
            _take(path, REFERENCE / outputs[-1], command)
    entry = {
        "command": command,
        "date": _today(),
        "versions": versions(optional=True),
        "commit": commit(),
        **{name: float(f"{value:.3g}") for name, value in spent.items()},
        "cores": os.cpu_count(),
        "jobs": jobs if more else 1,
        "outputs": outputs,
    }
    studies = {**io.load_json(REFERENCE / "made.json", "references")["studies"], name: entry}
    io.save_json(REFERENCE / "made.json", {"studies": dict(sorted(studies.items()))})
    shutil.rmtree(work)


def _run(command: str, given: Mapping[str, Sequence[str]], folder: Path) -> None:
    """Run a command of the checkout in a folder, with its output in a file there; `FileError` if it fails."""
    program, *words = [part for word in shlex.split(command) for part in given.get(word, [word])]
    start = ["-m", "lieednn_sim"] if program == "lieednn-sim" else [str(ROOT / words.pop(0))]
    # One thread, whose sums are always in the same order.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    log = folder / "output.log"
    with log.open("ab") as stream:
        done = subprocess.run(
            [sys.executable, *start, *words], cwd=folder, env=environment, stdout=stream, stderr=stream
        )
    if done.returncode:
        last = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-5:]
        raise FileError(f"{command} failed with status {done.returncode}:\n" + "\n".join(last))


def _take(path: Path, target: Path, command: str) -> None:
    """Copy a result into the committed ones; a Markdown file says how it was made."""
    content = path.read_bytes()
    if path.suffix == ".md":
        packages = ", ".join(f"{package} {version}" for package, version in versions(optional=True).items())
        content = content.rstrip() + f"\n\nMade by `{command}`, {_today()} with {packages}.\n".encode()
    io.make_directory(target.parent)
    with io.atomic_path(target) as temporary:
        temporary.write_bytes(content)


def _today() -> str:
    return datetime.datetime.now(datetime.UTC).date().isoformat()


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(arguments: Sequence[str] | None = None) -> int:
    """Make studies, or check or update their samples; returns 1 if one failed or differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(STUDIES)}")
    parser.add_argument("--check", action="store_true", help="compare samples, by default of all studies")
    parser.add_argument("--update", action="store_true", help="make the committed samples again")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="worker processes (default: all cores)")
    parser.add_argument("--data", action="append", default=[], metavar="WORD=FOLDER", help="outside data")
    options = parser.parse_args(arguments)
    names, sampled = options.names or list(STUDIES), options.check or options.update
    if not options.names and not options.check:
        parser.error(f"name what to make, of {', '.join(STUDIES)}")
    if unknown := [name for name in names if name not in STUDIES]:
        parser.error(f"no study {unknown[0]!r}; studies are: {', '.join(STUDIES)}")
    given = {"DATE": [_today()]}
    for word, _, value in (text.partition("=") for text in options.data):
        given.setdefault(word, []).append(value if word == "MODELS" else str(Path(value).resolve()))

    def work(name: str) -> bool:
        """Do what is asked for with a study; returns whether it is as committed."""
        study, begin, differ = STUDIES[name], time.perf_counter(), list[str]()
        words = shlex.split(" ".join(study.get("sample", ()) if sampled else study["commands"]))
        missing = " and ".join(word for word in words if word.isupper() and word not in given)
        try:
            if missing or not words:
                said = f"left out, it {f'needs --data {missing}=...' if missing else 'has no sample'}"
            elif sampled:
                differ = check(study, given, update=options.update)
                said = "differs from what is committed:" if differ else "as committed"
            else:
                make(name, study, given, options.jobs)
                said = "made"
        except FileError as error:
            differ, said = [""], str(error)
        print(f"{name}: {said} ({time.perf_counter() - begin:.0f} s)", *differ, sep="\n  ", flush=True)
        return not differ

    # What is made has worker processes of its own, and its times count; samples run side by side.
    with ThreadPoolExecutor(options.jobs if sampled else 1) as pool:
        return 0 if all(list(pool.map(work, names))) else 1


if __name__ == "__main__":
    sys.exit(main())
