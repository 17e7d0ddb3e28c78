"""How values are read from the command line, by the annotation of the parameter that takes them.

Numbers are plain ASCII decimals, a subset of what Python accepts.
"""

from __future__ import annotations

import math
import re
from argparse import ArgumentTypeError
from collections.abc import Callable
from typing import Any, NamedTuple

_WHOLE = re.compile(r"[+-]?[0-9]{1,18}")
_DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")

# Functions that take these values check their range, and whether the files exist.
Directory = str
File = str
Point = tuple[float, ...]
Pose = tuple[float, ...]
Joints = str
Setting = str
CommandLine = str
Force = tuple[str, tuple[float, ...]]


def whole(text: str) -> int:
    """A whole number, or `ArgumentTypeError`."""
    if not _WHOLE.fullmatch(text):
        raise ArgumentTypeError(f"must be a whole number, such as 12, got {text!r}")
    return int(text)


def decimal(text: str) -> float:
    """A finite number, or `ArgumentTypeError`."""
    value = float(text) if _DECIMAL.fullmatch(text) else math.inf
    if not math.isfinite(value):
        raise ArgumentTypeError(f"must be a finite decimal number, such as 0.25 or 1e-3, got {text!r}")
    return value


def decimal_or_inf(text: str) -> float:
    """As `decimal`, or infinity for ``inf``."""
    return math.inf if text == "inf" else decimal(text)


def numbers(text: str, count: int) -> tuple[float, ...]:
    """``count`` comma-separated finite numbers, or `ArgumentTypeError`."""
    try:
        values = tuple(decimal(part.strip(" ")) for part in text.split(","))
    except ArgumentTypeError as error:
        raise ArgumentTypeError(f"must be {count} comma-separated numbers, got {text!r}: one {error}") from None
    if len(values) != count:
        raise ArgumentTypeError(f"must be {count} comma-separated numbers, got {len(values)}: {text!r}")
    return values


def names(text: str) -> list[str]:
    """Comma-separated names; all names after a model's colon belong to the model, as in ``arm.xml:link,tool``."""
    parts = text.split(",")
    links = (k for k, part in enumerate(parts) if ":" in part and ".py:" not in part)
    last = next(links, len(parts) - 1)
    return [*parts[:last], ",".join(parts[last:])]


def named_numbers(text: str) -> dict[str, float]:
    """Numbers by name, from ``NAME=1,OTHER=2``."""
    pairs = [part.rpartition("=") for part in text.split(",")]
    try:
        return {name.strip(" "): decimal(value.strip(" ")) for name, _, value in pairs}
    except ArgumentTypeError as error:
        raise ArgumentTypeError(f"must look like NAME=0.3,OTHER=-1, got {text!r}: a number {error}") from None


def number_or_word(text: str) -> float | str:
    """A number if the text ends like one, else the text."""
    return decimal(text) if re.search(r"[0-9]\.?$", text) else text


def size(text: str) -> tuple[int, int]:
    """Width and height in pixels."""
    match = re.fullmatch(r"([0-9]{1,5})x([0-9]{1,5})", text)
    if match is None:
        raise ArgumentTypeError(f"must look like 1280x720, got {text!r}")
    return int(match[1]), int(match[2])


def force(text: str) -> Force:
    """A body, and the components of a force on it [N], its start and duration [s]."""
    body, _, rest = text.partition(",")
    try:
        return body, numbers(rest, 5)
    except ArgumentTypeError:
        wanted = "must look like BODY,FX,FY,FZ,START,DURATION, e.g. 'link 2,0,50,0,1.5,0.2'"
        raise ArgumentTypeError(f"{wanted}, got {text!r}") from None


def flag(text: str) -> bool:
    """A truth value, from ``true`` or ``false``."""
    if text not in ("true", "false"):
        raise ArgumentTypeError(f"must be true or false, got {text!r}")
    return text == "true"


class Kind(NamedTuple):
    """How a value is read."""

    read: Callable[[str], Any]  # maps a text to the value; raises `ArgumentTypeError`
    metavar: str  # placeholder for the value in the help
    action: str = "store"  # of `argparse`: ``append`` and ``extend`` let each use of the option add to the value
    words: bool = False  # whether it is a list of several words


def _listed(read: Callable[[str], Any]) -> Callable[[str], Any]:
    return lambda text: tuple(read(part) for part in text.split(","))


#: The kinds by their annotation.
KINDS = {
    "str": Kind(str, "NAME"),
    "StrPath": Kind(str, "NAME"),
    "int": Kind(whole, "N"),
    "float": Kind(decimal_or_inf, "X"),
    "bool": Kind(flag, "true|false"),
    "Seed": Kind(whole, "N"),
    "float | str": Kind(number_or_word, "X"),
    "tuple[int, int]": Kind(size, "WxH"),
    "tuple[int, ...]": Kind(_listed(whole), "N,N,..."),
    "tuple[float, ...]": Kind(_listed(decimal), "X,X,..."),
    "Sequence[str]": Kind(names, "A,B,...", action="extend"),
    "Mapping[str, float]": Kind(named_numbers, "NAME=X,..."),
    "tuple[str, ...]": Kind(str, "NAME", action="append"),
    "tuple[Setting, ...]": Kind(str, "NAME=VALUE", action="append"),
    # Given by the program itself.
    "CommandLine": Kind(str, ""),
    "Directory": Kind(str, "DIR"),
    "File": Kind(str, "FILE"),
    "list[File]": Kind(str, "FILE", words=True),
    "Joints": Kind(str, "Q"),
    "Point": Kind(lambda text: numbers(text, 3), "X,Y,Z"),
    "tuple[Pose, ...]": Kind(lambda text: numbers(text, 6), "X,Y,Z,RX,RY,RZ", action="append"),
    "tuple[Force, ...]": Kind(force, "BODY,FX,FY,FZ,START,DURATION", action="append"),
}


def kind_of(annotation: str) -> str:
    """The name in `KINDS` of an annotation without None, or of the first part of a union; empty if there is none."""
    alone = annotation.removesuffix(" | None")
    return next((name for name in (alone, alone.partition(" | ")[0]) if name in KINDS), "")
