"""The points of meshes in COLLADA files (.dae), which MuJoCo does not read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import scipy

from lieednn_sim.errors import FileError
from lieednn_sim.io import opened
from lieednn_sim.values import Floats

_ById = dict[str | None, ElementTree.Element]


def read_points(path: Path) -> Floats:
    """The points ``(n, 3)`` [m] of a file's scene; they suffice for MuJoCo, which collides meshes as convex hulls.

    As in ROS, ``up_axis`` is ignored. `FileError` if the file is not COLLADA, or has no points.
    """
    try:
        with opened(path, 2 * 10**8) as stream:
            root = ElementTree.parse(stream).getroot()
        elements = {element.get("id"): element for element in root.iter() if element.get("id")}
        unit = next((float(unit.get("meter", "1")) for unit in root.iterfind(".//{*}unit")), 1.0)
        nodes = root.iterfind(".//{*}visual_scene/{*}node")
        parts = [part for node in nodes for part in _placed(node, np.eye(4), elements)]
        points = unit * np.concatenate(parts)
    except (ElementTree.ParseError, KeyError, ValueError, RecursionError) as error:
        raise FileError(f"{path} cannot be read as COLLADA: {error}; convert it to .stl or .obj") from None
    return points


def _placed(node: ElementTree.Element, outer: Floats, elements: _ById) -> Iterator[Floats]:
    """The points of a node's geometries and of its children's."""
    inner = outer
    for child in node:
        kind = _tag(child)
        if kind in ("matrix", "translate", "rotate", "scale"):
            inner = inner @ _transform(kind, np.array((child.text or "").split(), dtype=np.float64))
        elif kind in ("lookat", "skew"):
            raise ValueError(f"a node is placed by <{kind}>")
    for child in node:
        if _tag(child) == "node":
            yield from _placed(child, inner, elements)
        elif _tag(child) == "instance_node":
            yield from _placed(elements[child.get("url", "").removeprefix("#")], inner, elements)
        elif _tag(child) == "instance_geometry":
            for points in _positions(elements[child.get("url", "").removeprefix("#")], elements):
                yield points @ inner[:3, :3].T + inner[:3, 3]


def _positions(geometry: ElementTree.Element, elements: _ById) -> Iterator[Floats]:
    for given in geometry.iterfind(".//{*}input[@semantic='POSITION']"):
        source = elements[given.get("source", "").removeprefix("#")]
        numbers = source.findtext(".//{*}float_array", "").split()
        stride = next((int(accessor.get("stride", "3")) for accessor in source.iterfind(".//{*}accessor")), 3)
        yield np.array(numbers, dtype=np.float64).reshape(-1, stride)[:, :3]


def _transform(kind: str, values: Floats) -> Floats:
    matrix = np.eye(4)
    if kind == "matrix":
        return values.reshape(4, 4)
    if kind == "translate":
        matrix[:3, 3] = values
    elif kind == "scale":
        matrix[:3, :3] = np.diag(values)
    else:
        axis = values[:3] / np.linalg.norm(values[:3])
        matrix[:3, :3] = scipy.spatial.transform.Rotation.from_rotvec(np.deg2rad(values[3]) * axis).as_matrix()
    return matrix


def _tag(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]
