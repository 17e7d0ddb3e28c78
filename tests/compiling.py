"""Exported C code as a shared library, without a warning."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

COMPILER = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic"]
compiled = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")


def library(folder: Path) -> ctypes.CDLL:
    """All C files of a folder."""
    path = folder / "code.so"
    sources = sorted(folder.glob("*.c"))
    subprocess.run([COMPILER, *FLAGS, "-shared", "-fPIC", *sources, "-o", path, "-lm"], check=True)
    return ctypes.CDLL(str(path))


def address(values) -> ctypes.c_void_p | None:
    """Of an array of doubles; None is NULL."""
    return None if values is None else np.ascontiguousarray(values, dtype=float).ctypes.data_as(ctypes.c_void_p)
