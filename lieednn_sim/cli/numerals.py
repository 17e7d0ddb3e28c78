"""Numbers as the command line takes them: plain ASCII decimals, not all that Python reads as a number."""

from __future__ import annotations

import argparse
import math
import re

_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")


def whole(text: str) -> int:
    """A whole number, or `argparse.ArgumentTypeError`."""
    if not _WHOLE.fullmatch(text):
        raise argparse.ArgumentTypeError(f"must be a whole number, as 12, got {text!r}")
    return int(text)


def decimal(text: str) -> float:
    """A finite number, or `argparse.ArgumentTypeError`."""
    value = float(text) if _DECIMAL.fullmatch(text) else math.inf
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"must be a finite decimal number, as 0.25 or 1e-3, got {text!r}")
    return value


def decimal_or_inf(text: str) -> float:
    """As `decimal`, or infinity for ``inf``."""
    return math.inf if text == "inf" else decimal(text)
