"""Kill, interrupt and terminate every long command at random moments, and see whether anything is lost.

    python scripts/signal_campaign.py [--times 30] [--jobs 1] [--seed 0] [--commands demo,train,...]

After each signal: the exit code is right, nothing is printed but the command's own lines, no process is left, every
file that was reported is there and readable, and the same command ends with the results of an undisturbed one. Exit code 1, with the seed of each case, where one of these fails.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lieednn_sim import storage
from lieednn_sim.rendering.ffmpeg import count_frames
from lieednn_sim.studies import Row, read_rows
from lieednn_sim.studies.comparison.rows import TIMING
from lieednn_sim.studies.problems.study import Solution

SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
# Time for children of a killed command to notice [s].
_PATIENCE = 60.0
PLAN = ["--target", "random:3", "--planner", "linear-attractor", "--duration", "1"]
TABLE = ["--planners", "minimum-jerk,se3-geodesic", "--arms", "telescopic_pr", "--scenes", "free", "--seeds", "2"]
TABLE += ["--controllers", "computed-torque", "--duration", "1", "--hold", "0", "--jobs", "1"]
LINK = '<link name="{}"><inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/>'
LINK += '</inertial><collision><origin xyz="{} 0 0"/><geometry><sphere radius="0.04"/></geometry></collision></link>'
JOINT = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="{} 0 0"/><axis xyz="0 0 1"/>'
)
JOINT += '<limit lower="-2" upper="2" velocity="1" effort="50"/></joint>'


class Command(NamedTuple):
    """A command that is disturbed, ``{0}`` being its folder, and what an undisturbed one ends with."""

    words: list[str]
    result: Callable[[Path], object]


def _fingerprints(*names: str) -> Callable[[Path], object]:
    return lambda folder: [storage.origin(folder / "out" / name)[0] for name in names]


def _rows(folder: Path) -> object:
    found: list[Row] = list(read_rows(folder / "out" / "comparison.csv", Row).values())
    times: dict[str, Any] = dict.fromkeys(TIMING)
    return sorted(str(replace(row, **times)) for row in found)


def _solutions(folder: Path) -> object:
    found = read_rows(folder / "out" / "problems.csv", Solution).values()
    return sorted(str(replace(row, solve_time=None)) for row in found)


COMMANDS = {
    "demo": Command(
        ["demo", "--no-video", *PLAN, "--hold", "0", "--output", "{0}/out"],
        _fingerprints("network.npz", "motion.npz", "rollout.npz"),
    ),
    "train": Command(
        ["train", "--target", "extended", "--algorithm", "repaired", "--period", "8", "--output", "{0}/out"],
        _fingerprints("network.npz"),
    ),
    "learn": Command(
        ["learn", "{0}/path.csv", "--rivals", "none", "--starts", "5", "--output", "{0}/out"],
        _fingerprints("network.npz"),
    ),
    "compare": Command(["compare", *TABLE, "--output", "{0}/out"], _rows),
    "merge": Command(["merge", "{0}/out", "{0}/one", "{0}/two"], _rows),
    "problems": Command(["problems", "{0}/tiny", "--planners", "minimum-jerk", "--output", "{0}/out"], _solutions),
    "render": Command(
        ["render", "{0}/out", "--size", "64x48", "--preset", "draft", "--fps", "10"],
        lambda folder: count_frames(folder / "out" / "video.mp4"),
    ),
}


def start(words: list[str], folder: Path) -> subprocess.Popen[str]:
    given = [word.format(folder) for word in words]
    # Interrupts may be ignored where this script runs in a shell's background.
    return subprocess.Popen(
        [sys.executable, "-m", "lieednn_sim", *given],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def finish(words: list[str], folder: Path) -> None:
    process = start(words, folder)
    output, errors = process.communicate()
    if process.returncode:
        raise AssertionError(f"{' '.join(words)} ended with {process.returncode}: {output[-500:]}{errors[-500:]}")


def prepare(name: str, folder: Path) -> None:
    """What a command needs to be there before."""
    folder.mkdir()
    s = np.linspace(0.0, 1.0, 50)
    np.savetxt(folder / "path.csv", np.column_stack([s, 0.3 * (1.0 - s), 0.1 * np.sin(np.pi * s)]), delimiter=",")
    if name == "render":
        finish([*COMMANDS["demo"].words], folder)
    elif name == "merge":
        for number, part in enumerate(("one", "two"), start=1):
            finish(["compare", *TABLE, "--output", f"{{0}}/{part}", "--shard", f"{number}/2"], folder)
    elif name == "problems":
        write_problems(folder / "tiny")


def write_problems(folder: Path) -> None:
    """Two joints, no obstacles, and three goals."""
    (folder / "problems" / "box").mkdir(parents=True)
    links = [LINK.format(*one) for one in (("base", 0.0), ("upper", 0.3), ("fore", 0.3))]
    joints = [JOINT.format("a", "base", "upper", 0.1), JOINT.format("b", "upper", "fore", 0.4)]
    (folder / "tiny.urdf").write_text(f'<robot name="tiny">{"".join(links + joints)}</robot>')
    for number in (1, 2, 3):
        goal = [{"joint_name": joint, "position": 0.2 * number} for joint in ("a", "b")]
        state = {"joint_state": {"name": ["a", "b"], "position": [0.0, 0.0]}}
        content = {"request": {"start_state": state, "goal_constraints": [{"joint_constraints": goal}]}}
        content |= {"scene": {"world": {"collision_objects": []}}}
        for kind, value in content.items():
            (folder / "problems" / "box" / f"{kind}{number:04}.yaml").write_text(json.dumps(value))


def faults(name: str, sent: signal.Signals, process: subprocess.Popen[str], output: str, errors: str) -> list[str]:
    """What is wrong with the end of a command, and with what it reported."""
    wrong = []
    # An interruption is a code above 128, which a shell gives too; the first imports end by the signal itself.
    allowed = {0, -sent} if sent == signal.SIGKILL else {0, -sent, 128 + sent}
    # Interrupted within its first milliseconds, Python itself ends with 1.
    own = "Fatal Python error: init_import_site" in errors
    if process.returncode not in allowed and not own:
        wrong.append(f"exit code {process.returncode}")
    # Not of the interpreter's own start, before this package is asked for.
    if ("Traceback" in errors and "lieednn_sim" in errors) or "Exception ignored" in errors:
        wrong.append(f"printed {errors[-2000:]}")
    for line in output.splitlines():
        path = Path(line.removeprefix("wrote "))
        if line.startswith("wrote ") and not readable(path):
            wrong.append(f"{path} was reported, and cannot be read")
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return wrong
        time.sleep(0.05)
    return [*wrong, "a process is left"]


def readable(path: Path) -> bool:
    try:
        if path.suffix == ".npz":
            return bool(storage.origin(path))
        if path.suffix == ".json":
            return bool(storage.load_json(path, "file"))
        return count_frames(path) > 0 if path.suffix == ".mp4" else path.stat().st_size > 0
    except OSError:
        return False


def disturb(
    name: str, place: Path, reference: tuple[Path, float, object], case: tuple[signal.Signals, int]
) -> list[str]:
    """Disturb a command once, then end it; ``reference``: its folder before, its duration [s] and its result."""
    sent, seed = case
    origin, seconds, expected = reference
    folder = place / f"{name}-{sent.name}-{seed}"
    shutil.copytree(origin, folder)
    rng = np.random.default_rng([seed, sent, *name.encode()])
    words = COMMANDS[name].words
    process = start(words, folder)
    time.sleep(seconds * rng.uniform())
    everyone = rng.uniform() < 0.3
    if process.poll() is None:
        (os.killpg if everyone else os.kill)(process.pid, sent)
    output, errors = process.communicate()
    wrong = faults(name, sent, process, output, errors)
    try:
        finish(words, folder)
        if COMMANDS[name].result(folder) != expected:
            wrong.append("ends with another result than without the signal")
    except (AssertionError, OSError) as error:
        wrong.append(f"cannot be continued: {error}")
    shutil.rmtree(folder, ignore_errors=True)
    return wrong


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=30, help="of each command and signal (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="commands at a time (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", default=",".join(COMMANDS))
    options = parser.parse_args(words)
    broken: Counter[Any] = Counter()
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(options.jobs) as pool:
        for name in options.commands.split(","):
            origin, copy = Path(place) / name, Path(place) / f"{name}-undisturbed"
            prepare(name, origin)
            shutil.copytree(origin, copy)
            begun = time.monotonic()
            finish(COMMANDS[name].words, copy)
            reference = origin, time.monotonic() - begun, COMMANDS[name].result(copy)
            cases = [(sent, options.seed + k) for sent in SIGNALS for k in range(options.times)]
            found = pool.map(partial(disturb, name, Path(place), reference), cases)
            for (sent, seed), wrong in zip(cases, found, strict=True):
                broken[name] += bool(wrong)
                for fault in wrong:
                    print(f"{name}, {sent.name}, seed {seed}: {fault}", flush=True)
            print(f"{name}: {len(cases)} signals in {reference[1]:.1f} s, {broken[name]} faults", flush=True)
    return int(broken.total() > 0)


if __name__ == "__main__":
    sys.exit(main())
