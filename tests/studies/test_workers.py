"""Worker processes: none outlives the block that started it, and no other child is touched."""

from __future__ import annotations

import contextlib
import multiprocessing
import operator
import os
import pickle
import signal
import subprocess
import sys
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor

import pytest

from lieednn_sim.entries import Entry, PlannerEntry
from lieednn_sim.errors import LieEDNNError
from lieednn_sim.registry import CONTROLLERS, PLANNERS, POLICIES
from lieednn_sim.studies import compare
from lieednn_sim.studies import study as workers
from lieednn_sim.studies.comparison.study import Comparison
from lieednn_sim.studies.study import run_each, worker_pool


def test_workers_import_the_modules_of_ones_own_planners_policies_and_controllers(monkeypatch):
    for number, kind in enumerate((PLANNERS, POLICIES, CONTROLLERS)):
        made = type("Mine", (), {"__module__": f"mine_{number}"})
        monkeypatch.setitem(kind.entries, "mine", Entry(made))
    assert {(number, "mine", f"mine_{number}") for number in range(3)} <= set(workers._of_users())


def test_what_workers_cannot_find_is_named_before_the_work(tmp_path, monkeypatch):
    """As a planner of a notebook; the table would keep its failures."""
    monkeypatch.setattr(workers, "worker_pool", lambda _: worker_pool(1))
    monkeypatch.setitem(PLANNERS.entries, "mine", PlannerEntry(type("Mine", (), {"__module__": "__main__"})))
    with pytest.raises(LieEDNNError, match=r"workers do not find planner 'mine': give it as file\.py:name, or use one"):
        compare(tmp_path, planners=["mine", "dmp"], arms=["telescopic_pr"], scenes=["free"], seeds=1, jobs=2)
    assert not Comparison.read(tmp_path).rows


def test_workers_run_the_files_of_ones_own_planners(tmp_path, monkeypatch):
    """By what they are begun with, in this process, which has lost its own."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "planner_of_a_file.py").write_text("def halver(problem): ...\n")
    name, begun = f"{tmp_path}/planner_of_a_file.py:halver", {}
    monkeypatch.setattr(workers, "ProcessPoolExecutor", lambda *_, **how: begun.update(how) or ThreadPoolExecutor(1))
    with monkeypatch.context() as patch:
        patch.setattr(PLANNERS, "entries", dict(PLANNERS.entries))
        PLANNERS.find(name)
        with worker_pool(1):
            pass
    monkeypatch.setattr(PLANNERS, "entries", dict(PLANNERS.entries))
    assert name not in PLANNERS
    begun["initializer"](*pickle.loads(pickle.dumps(begun["initargs"])))
    assert name in PLANNERS


@pytest.mark.parametrize("reason", [KeyboardInterrupt, ValueError])
def test_a_block_that_fails_leaves_no_worker_and_no_other_child_is_stopped(reason, monkeypatch):
    """A worker that waits for ever is ended with the block; the child beside it is not."""
    # To import the package takes longer than all else, and nothing of it is asked of this worker.
    monkeypatch.setattr(workers, "_prepare_worker", print)
    # Such as the process in which policies search, where other tests have started it.
    before = set(multiprocessing.active_children())
    other = multiprocessing.get_context("spawn").Process(target=signal.pause)
    other.start()
    try:
        with contextlib.suppress(reason), worker_pool(1) as pool:
            worker = pool.submit(os.getpid).result()
            pool.submit(signal.pause)
            raise reason
        with pytest.raises(ProcessLookupError):
            os.kill(worker, 0)
        assert set(multiprocessing.active_children()) - before == {other}
    finally:
        other.kill()
        other.join()
        other.close()


def test_outcomes_come_as_tasks_end_and_few_are_submitted_ahead(monkeypatch):
    submitted, results = [], {}

    class Recording(ThreadPoolExecutor):
        def submit(self, *task):
            submitted.append(len(submitted) - len(results))
            return super().submit(*task)

    monkeypatch.setattr(workers, "worker_pool", Recording)

    def done(task, result, error):
        results[task] = result or type(error)

    tasks = [(value, value % 5) for value in range(20)]
    for number in (1, 2):
        results.clear()
        run_each(divmod, tasks, done, workers=number)
        assert results == {(a, b): divmod(a, b) if b else ZeroDivisionError for a, b in tasks}
    assert (len(submitted), max(submitted)) == (20, 3)


def test_a_worker_that_dies_loses_no_finished_task(monkeypatch):
    monkeypatch.setattr(workers, "worker_pool", lambda _: worker_pool(1))
    monkeypatch.setattr(workers, "_prepare_worker", print)  # as above
    kept, tasks, before = [], [(abs, -1), (os._exit, 1), (abs, -2)], set(multiprocessing.active_children())
    with pytest.raises(LieEDNNError, match=r"a worker process died, .* continues, and one job needs less"):
        run_each(operator.call, tasks, lambda *it: kept.append(it), workers=2)
    assert kept == [((abs, -1), 1, None)]
    assert set(multiprocessing.active_children()) <= before


def test_a_task_that_ends_at_the_same_time_counts_before_a_worker_that_dies(monkeypatch):
    class Ended(ThreadPoolExecutor):
        def submit(self, run, *task):
            future = Future()
            future.set_result(run(*task)) if task[0] else future.set_exception(BrokenExecutor())
            return future

    monkeypatch.setattr(workers, "worker_pool", Ended)
    kept = []
    with pytest.raises(LieEDNNError, match="a worker process died"):
        run_each(abs, [(0,), (-1,)], lambda *it: kept.append(it), workers=2)
    assert kept == [((-1,), 1, None)]


def test_a_program_from_the_standard_input_starts_workers():
    program = """if True:
        from lieednn_sim.studies import study
        study._prepare_worker = print  # as above
        study.run_each(abs, [(-1,), (-2,)], lambda task, result, _: print(task, result), workers=2)
        print(__import__("__main__").study is study)
    """
    done = subprocess.run([sys.executable, "-"], input=program, capture_output=True, text=True, check=False)
    assert sorted(filter(None, done.stdout.splitlines())) == ["(-1,) 1", "(-2,) 2", "True"], done.stderr


def test_a_daemonic_process_is_told_that_it_can_start_no_workers(monkeypatch):
    monkeypatch.setitem(multiprocessing.current_process()._config, "daemon", True)
    with pytest.raises(LieEDNNError, match=r"a daemonic process, .* can start no workers: use one job"):
        run_each(abs, [(-1,), (-2,)], print, workers=2)
