"""How the scripts end whose work can be continued."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from lieednn_sim.errors import LieEDNNError


def exit_code(work: Callable[[], Path], console: Console, kept: str) -> int:
    """Run ``work`` and print the path that it returns; returns 0, 130 when interrupted, or 1 with the error printed."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        path = work()
    except KeyboardInterrupt:
        console.print(f"stopped; finished {kept} are kept, the same command continues from there")
        return 130
    except (LieEDNNError, OSError) as error:
        console.print(f"error: {error}", markup=False, emoji=False, highlight=False)
        return 1
    print(path)
    return 0
