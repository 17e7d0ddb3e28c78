"""Signals before and after the work of a command end it at once, as other programs, without a traceback."""

from __future__ import annotations

# The built-in half of `signal`, which would import others first.
import _signal as signal  # type: ignore[import-not-found]
import sys

# Only where this package is the program: the installed command, or `python -m`, also while it looks for the module.
_ENDS = ("lieednn-sim", "lieednn-sim.exe", "lieednn_sim/__main__.py", "lieednn_sim\\__main__.py")
_program = sys.argv[:1] == ["-m"] or "".join(sys.argv[:1]).endswith(_ENDS)
# Not if a shell's background job ignores it.
if _program and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
