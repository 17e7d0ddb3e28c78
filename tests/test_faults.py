"""Faults from outside: killed processes, full and read-only disks. What was there stays whole, work goes on."""

from __future__ import annotations

import errno
import os
import resource
import signal
import tempfile

import numpy as np
import pytest

from lieednn_sim.cli import main
from lieednn_sim.cli.run_directory import RunDirectory
from lieednn_sim.errors import FileError
from lieednn_sim.studies import Comparison

# A process that ends itself by SIGKILL where it is told to: no moment to wait for, no time to clean up.
KILL = "import os, signal, sys\nkill = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
# The progress of the simulation is where it dies.
AT_PROGRESS = """
from lieednn_sim.cli import main
from lieednn_sim.simulation import tracking
tracking.report = kill
sys.exit(main())
"""
PLAN = ["--target", "random:3", "--planner", "linear-attractor", "--duration", "3"]


def die(start, code, *words):
    """Run a command until it kills itself."""
    process = start("-c", KILL + code, *map(str, words))
    output, errors = process.communicate()
    assert process.returncode == -signal.SIGKILL, output + errors


def names(directory):
    return {path.name for path in directory.iterdir()}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A short simulated run; tests that change it work on a run of their own."""
    directory = tmp_path_factory.mktemp("faults") / "run"
    assert main(["plan", *PLAN, "--output", str(directory)]) == 0
    assert main(["simulate", str(directory), "--hold", "0"]) == 0
    return RunDirectory(directory)


def test_a_demo_that_is_killed_leaves_what_it_had_finished(tmp_path, start):
    directory = tmp_path / "run"
    die(start, AT_PROGRESS, "demo", "--no-page", "--no-video", *PLAN, "--output", directory)
    assert names(directory) == {"lieednn_sim.json", "task.json", "network.npz", "motion.npz"}
    # The lock died with it, and the next step goes on from there.
    assert main(["simulate", str(directory), "--hold", "0"]) == 0


def test_a_comparison_that_is_killed_goes_on_from_its_table(tmp_path, start, undrawn):
    code = """
from lieednn_sim.cli import main
from lieednn_sim.studies import table
add = table.Table.add
table.Table.add = lambda self, rows: (add(self, rows), kill())
if __name__ == "__main__":
    sys.exit(main())
"""
    words = ["--planners", "minimum-jerk", "--arms", "telescopic_pr", "--scenes", "free", "--seeds", "2", "--jobs", "1"]
    words += ["--controllers", "computed-torque", "--duration", "1", "--hold", "0", "--views", "0"]
    words += ["--output", str(tmp_path)]
    die(start, code, "compare", *words)
    ((_, row),) = Comparison.read(tmp_path).rows.items()
    assert main(["compare", *words]) == 0
    rows = Comparison.read(tmp_path).rows
    assert len(rows) == 2
    # Not computed again, for that takes another time.
    assert row in rows.values()


def test_no_process_outlives_a_comparison_that_is_killed(tmp_path, start):
    """Its workers neither, which would wait for ever where they are, nor what tracks their resources.

    The first worker to get there waits while it imports a planner, the other one while it plans.
    """
    (tmp_path / "deaf.py").write_text("""
import multiprocessing, pathlib, time
def planner(problem):
    print("\\nwaiting", flush=True)
    time.sleep(3600)
if multiprocessing.parent_process():
    try:
        pathlib.Path(__file__).with_name("first").touch(exist_ok=False)
    except FileExistsError:
        pass
    else:
        planner(None)
""")
    words = ["--planners", f"{tmp_path}/deaf.py:planner", "--arms", "telescopic_pr", "--scenes", "free", "--views", "0"]
    process = start(
        "-m", "lieednn_sim", "compare", *words, "--seeds", "2", "--jobs", "2", "--output", str(tmp_path / "table")
    )
    told = iter(process.stdout.readline, "")
    for _ in range(2):
        assert "waiting\n" in told, process.communicate()
    process.kill()
    # They have its output open, which ends with the last of them.
    process.communicate(timeout=60)


def test_a_full_disk_leaves_the_run_as_it_was(run, capsys):
    """Files may not grow beyond 20 kB for a while; a rollout has more."""
    before = {path: path.read_bytes() for path in run.path.iterdir()}
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        assert main(["simulate", str(run.path), "--hold", "0", "--payload", "1"]) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "cannot write" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in run.path.iterdir()} == before


def test_a_read_only_directory_is_named_before_the_work(run, tmp_path, capsys, monkeypatch):
    # Root may write everywhere: what the system would say is put into its mouth.
    monkeypatch.setattr(os, "access", lambda path, _: path != run.path)
    assert main(["simulate", str(run.path)]) == 2
    assert f"cannot write into {run.path}: permission denied" in capsys.readouterr().err
    assert main(["render", str(run.path), "--output", str(tmp_path / "page.html")]) == 0
    monkeypatch.undo()

    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(tempfile, "mkstemp", refuse)
    rollout = run.load_rollout(*run.load_task())
    with pytest.raises(FileError, match=r"cannot write .*rollout\.npz: Read-only file system"):
        rollout.save(run.rollout)
    monkeypatch.undo()
    np.testing.assert_array_equal(run.load_rollout(*run.load_task()).q, rollout.q)
