"""Processes that work for this one: none outlives it, however it ends."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection, Pipe, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any


class WorkerProcess(SpawnProcess):
    """A fresh process that ends at once when its starter does, even by SIGKILL, and leaves Ctrl-C to it.

    Both hold from before its own imports, which may take seconds.
    """

    def start(self) -> None:
        # Only this process holds the other end, which the system closes with it.
        self._starter, self._held = Pipe(duplex=False)
        with self._starter:
            if not hasattr(signal, "pthread_sigmask"):  # on Windows, where Ctrl-C leaves a traceback until `_begun`
                super().start()
                return
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            try:
                super().start()
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __reduce__(self) -> tuple[Callable[..., WorkerProcess], tuple[Any, ...], dict[str, Any]]:
        # The pickled stream holds `_begun` and its arguments first, so it is called before the rest imports anything.
        rest = {name: value for name, value in vars(self).items() if name not in ("_starter", "_held")}
        return _begun, (type(self), self._starter), rest


class LoneWorkerProcess(WorkerProcess):
    """A worker that does not run the program of the one that started it, which may be a script that moves a robot.

    The program does not wait at its end for this worker, which may be idle then.
    """

    def start(self) -> None:
        self.daemon = True
        program = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            super().start()
        finally:
            sys.modules["__main__"] = program


class WorkerContext(SpawnContext):
    """Context of `multiprocessing` whose processes are of a kind of `WorkerProcess`."""

    def __init__(self, kind: type[WorkerProcess] = WorkerProcess) -> None:
        super().__init__()
        self.Process = kind  # type: ignore[misc]


def _begun(kind: type[WorkerProcess], starter: Connection) -> WorkerProcess:
    # Ctrl-C reaches the whole process group; the main process stops the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_after, args=(starter,), daemon=True).start()
    return kind.__new__(kind)


def _end_after(starter: Connection) -> None:
    wait([starter])
    os._exit(1)
