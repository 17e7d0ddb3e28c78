"""Exported C code as a shared library, without a warning."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

COMPILER = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
# More optimisation finds no more warnings, and takes twice as long.
FLAGS = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"]
compiled = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")


_made: dict[tuple[str, ...], ctypes.CDLL] = {}


def library(folder: Path, optimised: str = "-O0") -> ctypes.CDLL:
    """All C files of a folder; the same ones are compiled once, by default in half the time, with fewer warnings."""
    key = tuple(path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.[ch]")))
    if key not in _made:
        path = folder / "code.so"
        sources = sorted(folder.glob("*.c"))
        subprocess.run([COMPILER, *FLAGS, optimised, "-shared", "-fPIC", *sources, "-o", path, "-lm"], check=True)
        _made[key] = ctypes.CDLL(str(path))
    return _made[key]


def address(values) -> ctypes.c_void_p | None:
    """Of an array of doubles; None is NULL."""
    return None if values is None else np.ascontiguousarray(values, dtype=float).ctypes.data_as(ctypes.c_void_p)
