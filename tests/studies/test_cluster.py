"""A real Dask cluster: a worker that is killed costs nothing, and what does not fit is refused in words."""

from __future__ import annotations

import importlib.util
import os
import signal
import socket
import sys
from dataclasses import replace

import pytest

from lieednn_sim.cli import main
from lieednn_sim.errors import InputError
from lieednn_sim.studies import Comparison, Table, cluster

WORDS = ["--arms", "telescopic_pr", "--scenes", "free", "--planners", "minimum-jerk,se3-geodesic", "--seeds", "3"]
WORDS += ["--controllers", "position-servo", "--duration", "1.5", "--hold", "0.2", "--shard", "1/1", "--output"]


@pytest.fixture(scope="module")
def scheduler():
    """A client of a scheduler with a worker process, in whose place another one starts when it is killed."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed, the extra 'cluster'")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
        ) as processes,
        distributed.Client(processes.scheduler_address, set_as_default=False) as client,
    ):
        yield client


def table(directory):
    return [replace(row, planning_s=None) for row in Comparison.read(directory).sorted_rows()]


def test_a_worker_that_is_killed_in_the_middle_changes_no_row(scheduler, tmp_path, monkeypatch, in_this_process):
    killed = []

    def add(self, rows):
        if not killed:
            pids = scheduler.run(os.getpid)
            killed.append(next(pids[worker] for worker, tasks in scheduler.processing().items() if tasks))
            os.kill(killed[0], signal.SIGKILL)
        added(self, rows)

    added = Table.add
    monkeypatch.setattr(Table, "add", add)
    assert main(["compare", *WORDS, str(tmp_path / "dask"), "--scheduler", scheduler.scheduler.address]) == 0
    assert killed[0] not in scheduler.run(os.getpid).values()
    monkeypatch.undo()
    with in_this_process():
        assert main(["compare", *WORDS, str(tmp_path / "serial")]) == 0
    assert table(tmp_path / "dask") == table(tmp_path / "serial")
    assert len(table(tmp_path / "dask")) == 6


def test_workers_with_other_code_are_refused(scheduler, tmp_path, monkeypatch, capsys):
    here = cluster.commit() or "none"
    monkeypatch.setattr(cluster, "commit", lambda: "0123456789ab")
    assert main(["compare", *WORDS, str(tmp_path), "--scheduler", scheduler.scheduler.address]) == 2
    assert f"has commit {here}, here 0123456789ab; finished work is kept" in capsys.readouterr().err
    assert table(tmp_path) == []


def test_no_scheduler_and_no_dask_are_said_before_the_work(tmp_path, monkeypatch, capsys):
    words = ["compare", *WORDS, str(tmp_path / "out"), "--scheduler"]
    if importlib.util.find_spec("distributed"):
        monkeypatch.setattr(cluster, "_PATIENCE", 0.5)
        with socket.socket() as nobody:
            # It takes calls and says nothing.
            nobody.bind(("127.0.0.1", 0))
            nobody.listen()
            for address in (f"tcp://127.0.0.1:{nobody.getsockname()[1]}", "somewhere", ""):
                assert main([*words, address]) == 2
                assert f"no Dask scheduler answers at {address!r}" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'lieednn_sim\[cluster\]'"), cluster.dask_executor("tcp://a:1"):
        pass
    assert not (tmp_path / "out").exists()
