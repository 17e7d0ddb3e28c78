"""Worker processes: none outlives the block that started it, and no other child is touched. Any executor does."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from rich.console import Console

from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES, Entry
from lieednn_sim.studies import workers
from lieednn_sim.studies.workers import run_each, worker_pool


def test_workers_import_the_modules_of_ones_own_planners_policies_and_controllers(monkeypatch):
    for number, kind in enumerate((PLANNERS, POLICIES, CONTROLLERS)):
        made = type("Mine", (), {"__module__": f"mine_{number}"})
        monkeypatch.setitem(kind.entries, "mine", Entry(made))
    assert {"mine_0", "mine_1", "mine_2"} <= set(workers._modules())


@pytest.mark.parametrize("reason", [KeyboardInterrupt, ValueError])
def test_a_block_that_fails_leaves_no_worker_and_no_other_child_is_stopped(reason, monkeypatch):
    """A worker that waits for ever is ended with the block; the child beside it is not."""
    # To import the package takes longer than all else, and nothing of it is asked of this worker.
    monkeypatch.setattr(workers, "_prepare_worker", tuple)
    other = multiprocessing.get_context("spawn").Process(target=signal.pause)
    other.start()
    try:
        with contextlib.suppress(reason), worker_pool(1) as pool:
            worker = pool.submit(os.getpid).result()
            pool.submit(signal.pause)
            raise reason
        with pytest.raises(ProcessLookupError):
            os.kill(worker, 0)
        assert multiprocessing.active_children() == [other]
    finally:
        other.kill()
        other.join()
        other.close()


def test_a_block_that_ends_well_finishes_its_work_and_leaves_no_worker():
    with worker_pool(1) as pool:
        results = [pool.submit(abs, -value) for value in range(3)]
    assert [future.result() for future in results] == [0, 1, 2]
    assert multiprocessing.active_children() == []


def test_an_executor_holds_few_tasks_at_once_and_is_left_open(monkeypatch):
    monkeypatch.setattr(workers, "_AHEAD", 3)
    held, most, results = set(), [], {}

    class Counting(ThreadPoolExecutor):
        def submit(self, *task):
            held.add(task[1:])
            most.append(len(held))
            return super().submit(*task)

    def done(task, result, error):
        held.remove(task)
        results[task] = result or type(error)

    tasks = [(value, value % 5) for value in range(20)]
    with Counting(2) as pool:
        run_each(divmod, tasks, done, workers=1, title="", console=Console(quiet=True), executor=pool)
        assert pool.submit(abs, -1).result() == 1
    assert max(most[:20]) == 3
    assert results == {(a, b): divmod(a, b) if b else ZeroDivisionError for a, b in tasks}


def test_what_has_not_begun_is_cancelled_when_the_work_stops():
    ran, over = [], threading.Event()

    def work(number):
        ran.append(number)
        assert number == 0 or over.wait(60)

    def done(*_):
        raise KeyboardInterrupt

    with ThreadPoolExecutor(1) as pool:
        with pytest.raises(KeyboardInterrupt):
            run_each(work, [(0,), (1,), (2,)], done, workers=1, title="", console=Console(quiet=True), executor=pool)
        over.set()
    assert 2 not in ran
