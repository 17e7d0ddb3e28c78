"""Handling of Ctrl-C and SIGTERM: a clean end and the shell's exit code, whenever they arrive."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any


class Interruption:
    """Context, for the main thread, in which SIGINT and SIGTERM raise `KeyboardInterrupt` once.

    The process ends at once on a second signal, and while its first modules are still being imported: these might turn
    the exception into another one, and there is nothing to clean up yet.

    Attributes:
        importing: whether the first modules are still being imported.
        received: the signal received, if any.
    """

    def __init__(self) -> None:
        self.importing = True
        self.received: int | None = None
        self._before: dict[int, Any] = {}

    @property
    def exit_code(self) -> int:
        """128 plus the number of the signal, as in shells: 130 or 143."""
        return 128 + int(self.received or signal.SIGINT)

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                # A shell's background job ignores Ctrl-C.
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def report(self) -> int:
        """Print that the command was interrupted; returns the exit code."""
        print("lieednn-sim: interrupted; files already reported are complete", file=sys.stderr)
        return self.exit_code

    def _handle(self, number: int, _: FrameType | None) -> None:
        if self.importing or self.received is not None:
            os.write(2, b"lieednn-sim: interrupted\n")
            os._exit(128 + number)
        self.received = number
        raise KeyboardInterrupt
