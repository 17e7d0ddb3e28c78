"""Worker processes of the studies: started, shown and stopped in one way."""

from __future__ import annotations

import contextlib
import importlib
import itertools
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lieednn_sim.errors import LieEDNNError
from lieednn_sim.planning.registry import REGISTRY as PLANNER_REGISTRY
from lieednn_sim.simulation.controllers import REGISTRY as CONTROLLER_REGISTRY

# Tasks that an executor holds at once: enough for a cluster, and memory does not grow with the study.
_AHEAD = 4096


@contextlib.contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes; when the block fails or is interrupted they are stopped at once.

    None of them is left when the block is over, however it ends; other children of this process are left alone.
    """
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_worker, initargs=(_modules(),))
    try:
        yield pool
    except BaseException:
        # Including Ctrl-C: a job may take a minute, and its worker ignores the signal.
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise
    finally:
        # Waits for the workers: they finish what is left to do, or were told to end.
        pool.shutdown()


def run_each(
    run: Callable[..., Any],
    todo: Sequence[tuple[Any, ...]],
    done: Callable[[tuple[Any, ...], Any, Exception | None], None],
    *,
    workers: int,
    title: str,
    console: Console,
    executor: Executor | None = None,
) -> None:
    """Run tasks on processes of our own, or on an executor, which stays open.

    Args:
        run: does a task; it, arguments and results can be pickled.
        todo: arguments of each task.
        done: called here as a task ends, in whatever order, with its arguments, its result, and what it raised.
        workers: processes at most, where there is no executor.
        title: of the progress bar.
        console: for that.
        executor: does the tasks in place of processes of our own.

    Raises:
        BrokenExecutor: a process of our own died.
        LieEDNNError: an executor has no workers any more, or others than it needs.
        CancelledError: the executor gave up a task.
    """
    if not todo:
        return
    waiting, ended = iter(todo), queue.SimpleQueue[Future[Any]]()
    running: dict[Future[Any], tuple[Any, ...]] = {}
    pools = worker_pool(min(workers, len(todo))) if executor is None else contextlib.nullcontext(executor)
    with pools as pool, progress_bar(console) as progress:
        bar = progress.add_task(title, total=len(todo))
        try:
            for _ in todo:
                for task in itertools.islice(waiting, _AHEAD - len(running)):
                    future = pool.submit(run, *task)
                    running[future] = task
                    future.add_done_callback(ended.put)
                future = ended.get()
                task, error = running.pop(future), future.exception()
                if isinstance(error, BrokenExecutor) and executor is not None:
                    raise LieEDNNError(
                        f"the executor gave up: {error}; finished work is kept, the same command goes on"
                    )
                if isinstance(error, Exception) and not isinstance(error, BrokenExecutor):
                    done(task, None, error)
                else:
                    done(task, future.result(), None)
                progress.update(bar, advance=1)
        finally:
            # Our own processes are stopped instead.
            for future in running if executor is not None else ():
                future.cancel()


def progress_bar(console: Console) -> Progress:
    """What the work shows of itself."""
    times = (TimeElapsedColumn(), TextColumn("done, left"), TimeRemainingColumn())
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *times, console=console)


def exit_code(work: Callable[[], Path], console: Console, kept: str) -> int:
    """Do the work and print the path that it returns; 130 when it is stopped, 1 when it fails, with the reason."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        path = work()
    except KeyboardInterrupt:
        console.print(f"stopped; finished {kept} are kept, the same command goes on from there")
        return 130
    except BrokenExecutor:
        console.print("a worker process died (out of memory?); the same command goes on, --jobs 1 needs less")
        return 1
    except (LieEDNNError, OSError) as error:
        console.print(f"error: {error}", markup=False, emoji=False, highlight=False)
        return 1
    print(path)
    return 0


def _modules() -> list[str]:
    """Where planners and controllers of others are; what is registered here is to be registered in workers, too."""
    others = (*PLANNER_REGISTRY.given.values(), *CONTROLLER_REGISTRY.given.values())
    return sorted({str(one.__module__) for one in others} - {"__main__"})


def _prepare_worker(modules: Sequence[str]) -> None:
    for name in modules:
        # Who is missing is told by the rows.
        with contextlib.suppress(Exception):
            importlib.import_module(name)
    # Ctrl-C reaches the whole process group; the main process stops the workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A pool's worker waits for work for ever, also when the main process was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
