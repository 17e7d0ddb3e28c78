"""Command line ``lieednn-sim``; commands import their dependencies when they run, so that ``--help`` is quick."""

from __future__ import annotations

# isort: off
from lieednn_sim.cli import starting  # noqa: F401, first, before the slow imports
# isort: on

import contextlib
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, TextIO

import lieednn_sim
from lieednn_sim.cli import parser
from lieednn_sim.errors import FileError, InputError, LieEDNNError

_DESCRIPTION = """Plan the motion of a robot arm with LieEDNN networks that carry a proof of global
stability, simulate it in MuJoCo, render and evaluate it."""
_HANGUP = getattr(signal, "SIGHUP", signal.SIGTERM)  # of a closed terminal; Windows has none
#: The commands by groups, with the modules of their functions; signature and docstring of a function give its options.
COMMANDS = {
    "one motion": {
        "demo": "commands",
        "plan": "planning",
        "train": "training",
        "learn": "demonstrations",
        "simulate": "commands",
        "evaluate": "commands",
        "render": "commands",
    },
    "many motions": {"compare": "comparison", "export": "commands"},
    "robots and this installation": {"arms": "arms", "view": "arms", "doctor": "doctor"},
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    0: success; 1: ``doctor`` found a problem, or ``train`` learned no network; 2: error; 129: its terminal was closed;
    130: interrupted; 141: the reader of the output closed it; 143: terminated.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # closed, as by a service or `>&-`; the next file would take its place
            setattr(sys, name, open(os.devnull, "r+", encoding="utf-8"))  # noqa: SIM115, PTH123
    # Paths and messages may hold characters that the output's encoding lacks.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    # Plots only go to files; a backend that the user chose for windows may not exist here.
    os.environ["MPLBACKEND"] = "agg"
    # What an unknown width is called in some terminals; rich would print nothing.
    if os.environ.get("COLUMNS") == "0":
        del os.environ["COLUMNS"]
    if argv is None:
        warnings.showwarning = lambda message, *_: say(f"warning: {message}")
    interruption = Interruption(last=argv is None)
    try:
        call = bind(words)
        # From here on a terminated run cleans up like an interrupted one.
        with interruption:
            code = int(call() or 0)
            # A failure of the output is noticed here, not at exit.
            print(end="", flush=True)
        return code if interruption.received is None else interruption.report()
    except KeyboardInterrupt:
        return interruption.report()
    except Exception as error:
        if interruption.received is not None:
            return interruption.report()
        if isinstance(error, BrokenPipeError) and not _print("", sys.stdout):
            # The output's reader closed it, as in `lieednn-sim demo | head`.
            return 141
        if isinstance(error, OSError) and not isinstance(error, LieEDNNError):
            # An error of the system: too many open files or processes, or a full disk.
            why = "the system does not permit this" if _print("", sys.stdout) else "cannot write to the standard output"
            error = FileError(f"{why}: {error.strerror or error}")
        elif isinstance(error, MemoryError):
            error = LieEDNNError(f"out of memory ({error})" if str(error) else "out of memory")
        elif not isinstance(error, LieEDNNError):
            raise
        say(f"error: {error}")
        return 2


def bind(words: Sequence[str]) -> Callable[[], Any]:
    """The call that the words ask for: a command, the help or the version; raises as `parser.bind`."""
    command = words[0] if words else ""
    if command in ("", "-h", "--help"):
        return lambda: print(parser.overview(_DESCRIPTION, COMMANDS))
    if command == "--version":
        return lambda: print(f"lieednn-sim {lieednn_sim.__version__}")
    modules = {command: module for members in COMMANDS.values() for command, module in members.items()}
    if command not in modules:
        raise InputError(f"no command {command!r}{parser.near(command, modules)}; commands: {', '.join(modules)}")
    return parser.bind(parser.definition(modules[command], command), words[1:])


class Interruption:
    """Context, for the main thread, in which the first SIGINT, SIGTERM or SIGHUP raises `KeyboardInterrupt`.

    A second signal ends the process at once, but not a second SIGHUP: a closed terminal often sends two. Objects that
    an interruption leaves half released, such as an OpenGL context, may raise when Python deletes them; these errors
    are not printed in the block or, if it is the ``last`` one before the process ends, after it. ``received`` is the
    signal, if any: libraries may swallow or change exceptions.
    """

    def __init__(self, *, last: bool = False) -> None:
        self.received: int | None = None
        self._last = last
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interruption:
        self._unraisable = sys.unraisablehook
        if threading.current_thread() is threading.main_thread():
            for number in {signal.SIGINT, signal.SIGTERM, _HANGUP}:
                # A background job of a shell ignores Ctrl-C, and one of nohup SIGHUP, and must go on doing so.
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if not self._last:
            sys.unraisablehook = self._unraisable

    def report(self) -> int:
        """Print that the command was interrupted; returns 128 plus the signal's number, as shells do, such as 130."""
        say("interrupted; files already reported are complete")
        return 128 + int(self.received or signal.SIGINT)

    def _handle(self, number: int, _: FrameType | None) -> None:
        self.received = number
        sys.unraisablehook = lambda _: None
        for each in self._before:
            signal.signal(each, signal.SIG_IGN if each == _HANGUP else signal.SIG_DFL)
        raise KeyboardInterrupt


def say(message: str) -> None:
    """Print a line about the command to the standard error, if that can be written."""
    _print(f"lieednn-sim: {message}", sys.stderr)


def _print(text: str, stream: TextIO) -> bool:
    """Print a line; returns whether the stream can be written, unlike one that is closed or on a full disk."""
    try:
        print(text, file=stream, flush=True)  # flushing alone does not test an unbuffered stream
    except OSError:
        # Buffered text would fail again at exit, with another exit code.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return False
    return True
