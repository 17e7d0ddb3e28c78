"""Bounds on what a model's file makes MuJoCo build, looked at before MuJoCo reads it."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

from lieednn_sim.errors import FileError
from lieednn_sim.reading import opened

# Bytes of a file with its includes, copies of repeated elements, and entries of height fields and textures.
_LARGEST, _MOST_COPIES, _MOST_ENTRIES = 10**8, 10_000, 2 * 10**7
_MOST_INCLUDES = 100
_COPIED = ("replicate", "composite", "flexcomp")
_SIZED = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}


def check_size(source: Path) -> None:
    """Raise `FileError` for an MJCF or URDF file that asks for more copies, entries or text than the bounds."""
    waiting, seen = [source], set[Path]()
    while waiting and len(seen) < _MOST_INCLUDES:
        path = waiting.pop()
        seen.add(path)
        try:
            with opened(path, _LARGEST) as stream:
                root = ElementTree.parse(stream).getroot()
        except FileError:
            raise
        except (OSError, ElementTree.ParseError, ValueError, RecursionError):
            # MuJoCo tells what is missing or wrong.
            continue
        _check(root, path)
        included = (source.parent / one.get("file", "") for one in root.iter("include") if one.get("file"))
        waiting += [one for one in included if one not in seen and one.is_file()]


def _check(root: ElementTree.Element, path: Path) -> None:
    """Walk the elements with the number of copies that those around them ask for."""
    waiting = [(root, 1.0)]
    while waiting:
        element, copies = waiting.pop()
        if element.tag in _COPIED:
            copies *= math.prod(map(_number, element.get("count", "1").split()))
            if copies > _MOST_COPIES:
                raise FileError(f"{path}: <{element.tag}> asks for {copies:g} copies; at most {_MOST_COPIES} are made")
        if element.tag in _SIZED:
            entries = math.prod(_number(element.get(side, "1")) for side in _SIZED[element.tag])
            if entries > _MOST_ENTRIES:
                raise FileError(f"{path}: <{element.tag}> has {entries:g} entries; at most {_MOST_ENTRIES} are read")
        waiting += [(child, copies) for child in element]


def _number(text: str) -> float:
    try:
        return max(float(text), 1.0)
    except ValueError:
        return 1.0  # MuJoCo says what is wrong
