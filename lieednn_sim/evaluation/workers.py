"""Worker processes of the studies: started, shown and stopped in one way."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from lieednn_sim.errors import LieEDNNError


@contextlib.contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of fresh processes; when the block fails or is interrupted they are stopped at once.

    None of them is left when the block is over, however it ends; other children of this process are left alone.
    """
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_prepare_worker)
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
    except BrokenProcessPool:
        console.print("a worker process died (out of memory?); the same command goes on, --jobs 1 needs less")
        return 1
    except (LieEDNNError, OSError) as error:
        console.print(f"error: {error}", markup=False, emoji=False, highlight=False)
        return 1
    print(path)
    return 0


def _prepare_worker() -> None:
    # Ctrl-C reaches the whole process group; the main process stops the workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A pool's worker waits for work for ever, also when the main process was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
