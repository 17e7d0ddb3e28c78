"""A Dask cluster makes the same rows, and what does not fit is refused in words."""

from __future__ import annotations

import importlib.util
import socket
import sys
from dataclasses import replace

import pytest

from lieednn_sim.cli import main
from lieednn_sim.errors import InputError
from lieednn_sim.studies import Comparison, cluster

WORDS = ["--arms", "telescopic_pr", "--scenes", "free", "--planners", "minimum-jerk,se3-geodesic", "--seeds", "2"]
WORDS += ["--controllers", "position-servo", "--duration", "1.5", "--hold", "0.2", "--shard", "1/1", "--output"]


@pytest.fixture(scope="module")
def workers():
    """A function that starts workers in threads of this process, and gives their scheduler's address."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed, the extra 'cluster'")

    def start(threads):
        return distributed.LocalCluster(
            n_workers=1, threads_per_worker=threads, processes=False, protocol="tcp", dashboard_address=None
        )

    return start


def untimed(directory):
    return [replace(row, planning_s=None) for row in Comparison.read(directory).sorted_rows()]


def test_workers_make_the_rows_of_one_process_and_others_are_refused(
    workers, tmp_path, monkeypatch, capsys, in_this_process
):
    with workers(1) as found:
        words = ["--scheduler", found.scheduler_address]
        assert main(["compare", *WORDS, str(tmp_path / "dask"), *words]) == 0
        assert f"cases wait for workers at {found.scheduler_address}" in capsys.readouterr().out
        here = cluster.commit() or "none"
        monkeypatch.setattr(cluster, "commit", lambda: "0123456789ab")
        assert main(["compare", *WORDS, str(tmp_path / "other"), *words]) == 2
        assert f"has commit {here}, here 0123456789ab; finished work is kept" in capsys.readouterr().err
        monkeypatch.undo()
    with in_this_process():
        assert main(["compare", *WORDS, str(tmp_path / "serial")]) == 0
    assert untimed(tmp_path / "dask") == untimed(tmp_path / "serial")
    assert len(untimed(tmp_path / "dask")) == 4
    assert untimed(tmp_path / "other") == []
    with workers(2) as found:
        assert main(["compare", *WORDS, str(tmp_path / "more"), "--scheduler", found.scheduler_address]) == 2
        assert "has several threads; start workers with --nthreads 1" in capsys.readouterr().err


def test_no_scheduler_and_no_dask_are_said_before_the_work(tmp_path, monkeypatch, capsys):
    words = ["compare", *WORDS, str(tmp_path / "out"), "--scheduler"]
    if importlib.util.find_spec("distributed"):
        monkeypatch.setattr(cluster, "_PATIENCE", 0.2)
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
