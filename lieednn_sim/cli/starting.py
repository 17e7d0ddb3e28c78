"""Lets signals before and after the work of a command end it at once without a traceback, as other programs do."""

# The built-in part of `signal`, which itself imports other modules first.
import _signal as signal  # type: ignore[import-not-found]  # it has no stubs
import sys

# Only if this package is the program: the installed command, or `python -m`, whose argv[0] is "-m" during the search.
_ENDS = ("lieednn-sim", "lieednn-sim.exe", "lieednn_sim/__main__.py", "lieednn_sim\\__main__.py")
_program = sys.argv[:1] == ["-m"] or "".join(sys.argv[:1]).endswith(_ENDS)
# Not in a background job of a shell, which ignores Ctrl-C.
if _program and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
