"""Make the results below results/reference again, or say which are older than the code that they depend on.

    python scripts/reference.py [NAME ...] [--jobs N] [--demonstrations FOLDER] [--robots FOLDER ... --models TEXT]
                                [--problems FOLDER]
    python scripts/reference.py --stale [NAME ...]

By default all studies of `STUDIES` that are stale: those whose code has changed (comments, docstrings, and modules that
only show, store or check do not count), whose command is another, or whose files were changed or never recorded. Each
runs in ``results/making/NAME-...``, named after command, code and versions, so that an interrupted one goes on where it
was, and never with rows of other code. Studies on outside data need its folder: recordings of RoboTasks and LASA
(``demonstrations``), models of MuJoCo Menagerie and of ROS packages (``robots``, with what they are in ``--models``),
VAMP's ``resources`` (``problems``). ``results/reference/made.json`` records how each was made. With --stale nothing is
made; the exit status is 1 if anything is stale.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import fcntl
import hashlib
import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lieednn_sim import io
from lieednn_sim.errors import FileError, LieEDNNError
from lieednn_sim.versions import code_version, versions

ROOT = Path(__file__).resolve().parents[1]
REFERENCE = Path("results/reference")
# Read again each time, since code may change while studies run.
_code = code_version.__wrapped__
OBSTACLE_PLANNERS = "minimum-jerk,rrt-connect,lieednn-shaped,lieednn-filtered,lieednn-guided"


@dataclass(frozen=True)
class Study:
    """A study whose results are committed.

    Attributes:
        commands: as typed in the checkout; words in capitals stand for outside data and the date.
        outputs: where each committed file is copied from; a name with an asterisk stands for several, for a folder.
        roots: modules that make the results, see `code_version`.
        jobs: whether the last command takes ``--jobs``.
    """

    commands: tuple[str, ...]
    outputs: Mapping[str, str]
    roots: tuple[str, ...]
    jobs: bool = False


def _script(name: str, words: str, folder: str, *kinds: str, jobs: bool = False) -> Study:
    """A script that writes ``results/FOLDER/FOLDER.KIND``."""
    outputs = {f"{folder}.{kind}": f"results/{folder}/{folder}.{kind}" for kind in kinds}
    return Study((f"python scripts/{name}.py {words}".strip(),), outputs, (name,), jobs)


_TASKS = ("boom", "harvester", "crane", "slow_crane", "shelf")
_VIDEO = "lieednn_sim.rendering.video"
STUDIES = {
    "demo": Study(
        (
            "lieednn-sim demo",
            "lieednn-sim render results/demo --size 640x360 --fps 10 --output results/demo.gif",
        ),
        {
            "demo.gif": "results/demo.gif",
            "demo_metrics.json": "results/demo/metrics.json",
            "demo_metrics.csv": "results/demo/metrics.csv",
        },
        ("lieednn_sim.planning", "lieednn_sim.simulation", "lieednn_sim.evaluation.metrics", _VIDEO),
    ),
    "arms": Study(("python scripts/picture_arms.py",), {"arms.jpg": "results/arms.jpg"}, ("picture_arms", _VIDEO)),
    "growth": _script("growth", "", "growth", "md", "csv", "png"),
    "benchmark": _script("benchmark", "", "benchmark", "md", "json"),
    "robots": _script("real_robots", "ROBOTS --models MODELS", "robots", "md"),
    "robustness": Study(
        ("python scripts/robustness.py --cases 1000",),
        {"robustness.md": "results/robustness.md"},
        ("robustness",),
        jobs=True,
    ),
    "demonstrations": _script("evaluate_demonstrations", "DEMONSTRATIONS", "demonstrations", "md", jobs=True),
    "paper": Study(
        ("python scripts/reproduce_paper.py",), {"paper": "results/paper/*.*"}, ("reproduce_paper",), jobs=True
    ),
    "motion_bench_maker": _script("motion_bench_maker", "PROBLEMS", "motion_bench_maker", "md", jobs=True),
    "obstacles": Study(
        (
            f"lieednn-sim compare --scenes window,shelf,poles --seeds 10 --planners {OBSTACLE_PLANNERS} "
            "--controllers position-servo --output results/obstacles",
        ),
        {"obstacles.md": "results/obstacles/comparison.md"},
        ("lieednn_sim.studies.comparison.study",),
        jobs=True,
    ),
    "pushes": _script("evaluate_pushes", "", "pushes", "md"),
    "cost_over_time": _script("cost_over_time", "--seeds 4", "cost_over_time", "md", "csv", "png"),
    "learning": _script("learn_reach", "", "learning", "md", "png", jobs=True),
    "environment_overhead": _script("environment_overhead", "", "environment_overhead", "md"),
    "comparison": Study(
        ("lieednn-sim compare --seeds 20 --slow-seeds 3 --reactive 3 --views 3 --date DATE",),
        {name: f"results/comparison/{name}" for name in ("comparison.md", "comparison.html", "reactions.md")},
        ("lieednn_sim.studies.comparison.study", "lieednn_sim.studies.reactions.study"),
        jobs=True,
    ),
    "tasks": Study(
        ("python scripts/tasks.py --menagerie ROBOTS",),
        {
            "tasks.md": "results/tasks/tasks.md",
            **{f"tasks_{name}.gif": f"results/tasks/tasks_{name}.gif" for name in _TASKS},
        },
        ("tasks",),
    ),
    "shaped": Study(
        ("python scripts/shaped.py", "python scripts/shaped.py --scenes free --seeds 100"),
        {"shaped.md": "results/shaped/summary.md"},
        ("shaped",),
    ),
}


def stale(study: Study, record: Mapping[str, Any] | None, root: Path = ROOT) -> list[str]:
    """Why the committed results of a study are not those of today's code, given how they were made."""
    if record is None:
        return ["never recorded"]
    reasons = []
    if record["code"] != (now := _code(*study.roots, folder=root)):
        reasons.append(f"made by code {record['code']}, now {now}")
    if record["command"] != "; ".join(study.commands):
        reasons.append(f"made by another command, {record['command']}")
    for name, digest in record["outputs"].items():
        path = root / REFERENCE / name
        if not path.is_file():
            reasons.append(f"{name} is missing")
        elif _digest(path) != digest:
            reasons.append(f"{name} was changed since")
    return reasons


def records(root: Path = ROOT) -> dict[str, Any]:
    """How the committed results were made, by study."""
    path = root / REFERENCE / "made.json"
    return dict(io.load_json(path, "references")["studies"]) if path.exists() else {}


def make(name: str, study: Study, given: Mapping[str, Sequence[str]], jobs: int, root: Path = ROOT) -> None:
    """Run a study, or the rest of it, and copy and record its results.

    Args:
        name: name of the study.
        study: the study.
        given: words in place of those in capitals.
        jobs: number of worker processes.
        root: the checkout.

    Raises:
        FileError: a command failed, or the code was changed meanwhile.
    """
    code, used = _code(*study.roots, folder=root), versions(optional=True)
    # Tables are continued with the very same code alone.
    how = json.dumps([study.commands, code, _code(folder=root), used])
    work = root / "results/making" / f"{name}-{hashlib.sha256(how.encode()).hexdigest()[:8]}"
    io.make_directory(work / "results")
    with io.locked(work), _timed(work / "spent.json") as spent:
        for command in study.commands:
            words = [part for word in shlex.split(command) for part in given.get(word, [word])]
            if study.jobs and command == study.commands[-1]:
                words += ["--jobs", str(jobs)]
            _run(words, work, root)
    if _code(*study.roots, folder=root) != code:
        raise FileError(f"the code of {name} was changed while it ran; run it again")
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    command = "; ".join(study.commands)
    made = f"{today} with {', '.join(f'{package} {version}' for package, version in used.items())}, code {code}"
    outputs: dict[str, str] = {}
    for target, source in study.outputs.items():
        found = sorted(work.glob(source))
        if not found:
            raise FileError(f"{name} made no {source} in {work}")
        for path in found:
            copy = root / REFERENCE / target / (path.name if "*" in source else "")
            io.make_directory(copy.parent)
            content = path.read_bytes()
            if path.suffix == ".md":
                content = content.rstrip() + f"\n\nMade by `{command}`, {made}.\n".encode()
            with io.atomic_path(copy) as temporary:
                temporary.write_bytes(content)
            outputs[copy.relative_to(root / REFERENCE).as_posix()] = _digest(copy)
    entry = {
        "command": command,
        "date": today,
        "versions": used,
        "code": code,
        "cpu_s": float(f"{spent['cpu_s']:.3g}"),
        "wall_s": float(f"{spent['wall_s']:.3g}"),
        "cores": os.cpu_count(),
        "jobs": jobs if study.jobs else 1,
        "outputs": outputs,
    }
    handle = os.open(root / REFERENCE, os.O_RDONLY)
    try:
        # Several studies may run at once.
        fcntl.flock(handle, fcntl.LOCK_EX)
        studies = {**records(root), name: entry}
        io.save_json(root / REFERENCE / "made.json", {"studies": dict(sorted(studies.items()))})
    finally:
        os.close(handle)


def _run(words: list[str], work: Path, root: Path) -> None:
    """Run a command of the checkout in a folder, with its output in a file there; `FileError` if it fails."""
    program = {"python": [str(root / words[1])], "lieednn-sim": ["-m", "lieednn_sim", words[1]]}[words[0]]
    log = work / "output.log"
    process = None
    with log.open("ab") as stream:
        try:
            process = subprocess.Popen(
                [sys.executable, *program, *words[2:]],
                cwd=work,
                env={**os.environ, "PYTHONPATH": str(root)},
                stdout=stream,
                stderr=subprocess.STDOUT,
                # Interrupted by this process alone, and once.
                start_new_session=True,
            )
            status = process.wait()
        except KeyboardInterrupt:
            if process is not None:
                # A process in the background may ignore SIGINT, and its children do then.
                process.terminate()
                process.wait()
            raise
    if status:
        last = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()[-5:]
        raise FileError(f"{shlex.join(words)} failed with status {status}; the end of {log}:\n" + "\n".join(last))


@contextlib.contextmanager
def _timed(path: Path) -> Iterator[dict[str, float]]:
    """Times that a study takes, added to those of its interrupted runs."""
    spent = dict(json.loads(path.read_text())) if path.exists() else {"cpu_s": 0.0, "wall_s": 0.0}
    wall, cpu = time.perf_counter(), _cpu()
    try:
        yield spent
    finally:
        spent["wall_s"] += time.perf_counter() - wall
        spent["cpu_s"] += _cpu() - cpu
        io.save_json(path, spent)


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def main(arguments: Sequence[str] | None = None, studies: Mapping[str, Study] | None = None, root: Path = ROOT) -> int:
    """Make stale results, or list them; returns 1 if any are left stale, 130 when interrupted."""
    studies = STUDIES if studies is None else studies
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(studies)} (default: all)")
    parser.add_argument("--stale", action="store_true", help="only say which are stale, and why")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="worker processes (default: all cores)")
    parser.add_argument("--demonstrations", metavar="FOLDER", help="recordings of RoboTasks and LASA")
    parser.add_argument("--robots", nargs="+", metavar="FOLDER", help="models of robots, see real_robots.py")
    parser.add_argument("--models", metavar="TEXT", help="what these are: names and commits")
    parser.add_argument("--problems", metavar="FOLDER", help="VAMP's resources")
    options = parser.parse_args(arguments)
    if unknown := [name for name in options.names if name not in studies]:
        parser.error(f"no study {unknown[0]!r}; studies are: {', '.join(studies)}")
    if options.jobs < 1:
        parser.error(f"--jobs must be at least 1, got {options.jobs}")
    given = {"DATE": [datetime.datetime.now(datetime.UTC).date().isoformat()]}
    folders = {"DEMONSTRATIONS": options.demonstrations, "ROBOTS": options.robots, "PROBLEMS": options.problems}
    for word, found in folders.items():
        if found:
            given[word] = [str(Path(one).resolve()) for one in ([found] if isinstance(found, str) else found)]
    if options.models:
        given["MODELS"] = [options.models]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    left = 0
    for name, study in studies.items():
        if options.names and name not in options.names:
            continue
        try:
            reasons = stale(study, records(root).get(name), root)
            words = {word for command in study.commands for word in shlex.split(command)}
            missing = [f"--{word.lower()}" for word in (*folders, "MODELS") if word in words and word not in given]
            if not reasons:
                print(f"{name}: up to date")
            elif options.stale or missing:
                left += 1
                needs = f"; left out, since it needs {' and '.join(missing)}" if not options.stale else ""
                print(f"{name}: {'; '.join(reasons)}{needs}")
            else:
                print(f"{name}: {'; '.join(reasons)}; running {'; '.join(study.commands)}", flush=True)
                make(name, study, given, options.jobs, root)
                entry = records(root)[name]
                print(f"{name}: made in {entry['wall_s']:.0f} s, {entry['cpu_s']:.0f} s of CPU time", flush=True)
        except LieEDNNError as error:
            left += 1
            print(f"{name}: {error}", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            print(f"{name}: stopped; the same command continues from there", file=sys.stderr)
            return 130
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
