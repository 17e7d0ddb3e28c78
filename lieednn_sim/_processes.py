"""Worker processes, none of which outlives this process, however it ends."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from multiprocessing.connection import Connection, Pipe, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import ModuleType
from typing import Any

_STARTING = threading.Lock()  # `__main__` may be another module while a process starts


class WorkerProcess(SpawnProcess):
    """A fresh process that ends at once when its parent ends, even by SIGKILL, and ignores Ctrl-C.

    Both hold before the worker imports its modules, which may take seconds, and its parent's program, if it is a file.
    """

    _lone = False

    def start(self) -> None:
        self.daemon = self._lone
        # Only this process holds the other end; the system closes it when this process ends.
        self._starter, self._held = Pipe(duplex=False)
        with self._starter, _STARTING, ExitStack() as after:
            if hasattr(signal, "pthread_sigmask"):  # not on Windows, where Ctrl-C leaves a traceback until `_begun`
                before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
                after.callback(signal.pthread_sigmask, signal.SIG_SETMASK, before)
            program = sys.modules["__main__"]
            if self._lone or not Path(getattr(program, "__file__", None) or "<stdin>").exists():
                after.callback(sys.modules.__setitem__, "__main__", program)
                sys.modules["__main__"] = ModuleType("__main__")
            super().start()

    def __reduce__(self) -> tuple[Callable[..., WorkerProcess], tuple[Any, ...], dict[str, Any]]:
        # In the stream, the call of `_begun` comes before the rest, and so before the imports that the rest causes.
        rest = {name: value for name, value in vars(self).items() if name not in ("_starter", "_held")}
        return _begun, (type(self), self._starter), rest


class LoneWorkerProcess(WorkerProcess):
    """A worker that does not import its parent's main program, which may be a script that moves a robot.

    It is a daemon, since it may be idle when its parent ends, which must not wait for it.
    """

    _lone = True


class WorkerContext(SpawnContext):
    """Context of `multiprocessing` whose processes are of a kind of `WorkerProcess`."""

    def __init__(self, kind: type[WorkerProcess] = WorkerProcess) -> None:
        super().__init__()
        self.Process = kind  # type: ignore[misc]  # the base has one kind for all its instances


def _begun(kind: type[WorkerProcess], starter: Connection) -> WorkerProcess:
    # Ctrl-C reaches the whole process group; the main process stops the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_after, args=(starter,), daemon=True).start()
    return kind.__new__(kind)


def _end_after(starter: Connection) -> None:
    wait([starter])
    os._exit(1)
