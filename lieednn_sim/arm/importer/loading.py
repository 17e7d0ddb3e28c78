"""Reading and compiling of models, with bounds on their size, and messages that say what is missing or wrong."""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from html import unescape
from pathlib import Path
from xml.etree import ElementTree

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.checks import check_numbers
from lieednn_sim.arm.equalities import equalities_hold
from lieednn_sim.arm.importer.collada import read_points
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import is_file, opened
from lieednn_sim.validation import as_path
from lieednn_sim.values import StrPath

_PACKAGES = "package://", "model://"  # of ROS, and of Gazebo and Drake
_POINTER = b"version https://git-lfs.github.com/"  # the first bytes of a Git LFS pointer file
# Most bytes of a file with its includes, copies of repeated elements, and entries of height fields and textures.
_LARGEST, _MOST_COPIES, _MOST_ENTRIES = 10**8, 10_000, 2 * 10**7
# Macros that xacro replaces, and comments, which may contain some.
_MACRO, _COMMENT = re.compile(rb"<xacro:|\$\{|\$\((find|arg|eval|env|optenv) "), re.compile(rb"<!--.*?-->", re.DOTALL)
# A mesh of a URDF, a quotation mark, and its file; meshes of an MJCF file have no such attribute.
_MESH = re.compile(r"""(<mesh\b[^>]*?\bfilename\s*=\s*(["'])(.*?)\2[^>]*>)""")
_SIZED = {"hfield": ("nrow", "ncol"), "texture": ("width", "height")}


def load_spec(model: StrPath | mujoco.MjSpec, notes: list[str] | None = None) -> mujoco.MjSpec:
    """A new spec from a file or another spec, ready for edits: no bodies are fused, and all have names.

    Conversions of its files are added to ``notes``. `FileError` if there is no such file, or MuJoCo cannot read it.
    """
    if isinstance(model, mujoco.MjSpec):
        compile_spec(model)  # a copy silently leaves out references to missing names
        spec = model.copy()
    else:
        source = as_path("the model", model)
        spec = read_model(source)
        _resolve_packages(spec, source.resolve())
        if (points := _read_collada(spec)) and notes is not None:
            notes.append(f"meshes in COLLADA taken as the convex hulls of their points: {', '.join(points)}")
    spec.compiler.fusestatic = False  # a link fixed to its parent would vanish
    spec.compiler.alignfree = False  # a locked object would keep the pose of its principal axes instead of its own
    for kind, elements in (("body", spec.bodies), ("joint", spec.joints), ("actuator", spec.actuators)):
        names = {element.name for element in elements}
        for number, element in enumerate(elements):
            if not element.name:
                element.name = unused(f"{kind}{number}", names)
                names.add(element.name)
            if kind == "joint" and element.type == mujoco.mjtJoint.mjJNT_FREE:
                element.align = 0
    for equality in spec.equalities:
        equality.active = bool(equality.active) and equalities_hold(spec.option)
    return spec


def read_model(source: Path) -> mujoco.MjSpec:
    """The spec of an MJCF or URDF file as it is; `FileError` if there is none, or MuJoCo cannot read it."""
    if not is_file(source):
        raise FileError(f"no such file: {source}")
    check_size(source)
    try:
        # To MuJoCo, paths are in UTF-8, whatever the locale.
        return _with_all_meshes(mujoco.MjSpec.from_file(os.fsencode(source.absolute()).decode()), source)
    except UnicodeError:
        raise FileError(f"MuJoCo reads no file with bytes in its path that are not UTF-8: {str(source)!r}") from None
    except (ValueError, RuntimeError) as error:
        raise FileError(f"MuJoCo cannot read {source}: {str(error).strip()}") from None


def _with_all_meshes(spec: mujoco.MjSpec, source: Path) -> mujoco.MjSpec:
    """The spec of a file, without MuJoCo's fault to take a URDF's meshes whose files have one name as the same mesh."""
    with opened(source, _LARGEST) as stream:
        text = stream.read().decode("utf-8-sig", "replace")
    meshes = {element: Path(file) for element, _, file in _MESH.findall(text)}
    if spec.strippath or len({file.stem for file in meshes.values()}) == len(meshes):
        return spec
    own = {element: f"{file.stem}_{k}{file.suffix}" for k, (element, file) in enumerate(meshes.items())}
    files = {unescape(own[element]): unescape(file) for element, _, file in _MESH.findall(text)}
    renamed = _MESH.sub(lambda match: match[1].replace(match[2] + match[3], match[2] + own[match[1]]), text)
    apart = mujoco.MjSpec.from_string(renamed)
    apart.modelfiledir = spec.modelfiledir
    for mesh in apart.meshes:
        mesh.file = files[mesh.file]
    return apart


def macros_left(path: Path) -> InputError:
    """The error for a file with macros of ROS."""
    return InputError(f"{path} holds ROS macros: make it a URDF with `xacro {path} -o robot.urdf`, and load that")


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile; `FileError` gives MuJoCo's message, or the files of meshes and textures that are missing."""
    try:
        model = spec.compile()
    except (ValueError, RuntimeError, MemoryError) as error:
        files = dict(_files(spec))
        if missing := [name for name, path in files.items() if path is None]:
            raise FileError(f"files of the model are missing: {_first(missing)}") from None
        if pointers := [name for name, path in files.items() if path is not None and _is_pointer(path)]:
            lacking = "Git LFS pointers instead of their contents; fetch these with `git lfs pull`"
            raise FileError(f"files of the model are {lacking}: {_first(pointers)}") from None
        raise FileError(f"MuJoCo cannot compile the model: {str(error).strip()}") from None
    check_numbers(model)
    return model


def _resolve_packages(spec: mujoco.MjSpec, source: Path) -> None:
    """Resolve file names of the form ``package://NAME/...``, ``model://NAME/...`` and ``file://...``."""
    for element in (*spec.meshes, *spec.textures):
        scheme, _, path = element.file.partition("://")
        if scheme == "file":
            element.file = path
        elif element.file.startswith(_PACKAGES):
            package, _, inside = path.lstrip("/").partition("/")
            candidates = (folder / inside for folder in _folders(package, source))
            element.file = str(next((file for file in candidates if is_file(file)), element.file))


def _folders(package: str, source: Path) -> Iterator[Path]:
    """Folders that a ROS package may be in: above the file, beside one of these, or on ROS's search paths."""
    for folder in source.parents:
        yield folder / package
        # A folder above may itself be the package, checked out under another name.
        if package in (folder.name, _package_name(folder)):
            yield folder
    for variable, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        for entry in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(entry) / below / package


@functools.lru_cache(maxsize=256)
def _package_name(folder: Path) -> str:
    """The name of the ROS package in a folder, or an empty string."""
    try:
        return (ElementTree.parse(folder / "package.xml").findtext("name") or "").strip()
    except (OSError, ElementTree.ParseError):
        return ""


def _read_collada(spec: mujoco.MjSpec) -> list[str]:
    """Replace meshes in COLLADA, which MuJoCo does not read, by their points; return the files' names."""
    read = []
    for mesh in spec.meshes:
        path = Path(spec.modelfiledir) / spec.meshdir / mesh.file
        if path.suffix.lower() == ".dae" and is_file(path) and not _is_pointer(path):
            mesh.uservert, mesh.file = read_points(path).ravel(), ""
            read.append(path.name)
    return list(dict.fromkeys(read))


def _is_pointer(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(_POINTER)) == _POINTER


def _first(names: list[str]) -> str:
    return ", ".join(names[:10]) + (f" and {len(names) - 10} more" if len(names) > 10 else "")


def unused(name: str, names: set[str], suffix: str = "_") -> str:
    """The name, with suffixes appended until it is not one of ``names``."""
    while name in names:
        name += suffix
    return name


def _files(spec: mujoco.MjSpec) -> Iterator[tuple[str, Path | None]]:
    """The files of meshes and textures that a model names, and where they are; None for a missing one."""
    known, own = set(spec.assets), Path(spec.modelfiledir)
    meshes = [("meshdir", element) for element in (*spec.meshes, *spec.hfields, *spec.skins)]
    for folder, element in (*meshes, *(("texturedir", texture) for texture in spec.textures)):
        if element.file:
            if element.file.startswith(_PACKAGES):
                package = element.file.partition("://")[2].lstrip("/").partition("/")[0]
                where = f"no folder {package!r} beside {own.absolute()} or above, nor in ROS_PACKAGE_PATH, holds it"
                yield f"{element.file} ({where})", None
                continue
            below = getattr(element.compiler, folder, "") or getattr(spec, folder, "")
            path = own / below / element.file
            if below and not path.is_file() and path.is_relative_to(own) and Path(element.file).is_absolute():
                # From an <include>: MuJoCo lastly tries the included file's own folder, without meshdir.
                path = own / below / path.name
            if path.is_file():
                yield str(path), path
            elif not known.intersection((element.file, path.name, str(Path(below) / element.file))):
                yield str(path), None


def check_size(source: Path) -> None:
    """Raise `FileError` for an MJCF or URDF file that asks for more copies, entries or text than the bounds.

    And `InputError` for one with macros of ROS, whose elements MuJoCo leaves out. MuJoCo would build all of it, so this
    is checked before MuJoCo reads the file.
    """
    waiting, seen = [source], set[Path]()
    while waiting and len(seen) < 100:
        path = waiting.pop()
        seen.add(path)
        with opened(path, _LARGEST) as stream:
            text = stream.read()
        if _MACRO.search(_COMMENT.sub(b"", text)):
            raise macros_left(path)
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError, RecursionError):
            # MuJoCo will report what is missing or wrong.
            continue
        _check_elements(root, path)
        if root.tag == "robot":
            _check_links(root, path)
        included = (source.parent / item.get("file", "") for item in root.iter("include") if item.get("file"))
        waiting += [item for item in included if item not in seen and item.is_file()]


def _check_links(robot: ElementTree.Element, path: Path) -> None:
    """Raise `InputError` for missing links of a URDF and for loops of links, which MuJoCo's message does not name."""
    links, carriers = {link.get("name") for link in robot.iterfind("link")}, dict[str | None, list[str | None]]()
    for joint in robot.iterfind("joint"):
        ends = [end.get("link") for tag in ("child", "parent") for end in joint.findall(tag)]
        if len(ends) != 2:
            continue  # MuJoCo reports it
        child, parent = ends
        if missing := [end for end in ends if end not in links]:
            raise InputError(f"{path}: joint {joint.get('name')!r} is of a link {missing[0]!r} that is not there")
        if child in carriers:
            raise InputError(f"{path}: link {child!r} is the child of several joints, a loop; take out all but one")
        carriers[child] = [parent]
    try:
        TopologicalSorter(carriers).prepare()
    except CycleError as error:
        circle = " - ".join(map(str, error.args[1]))
        raise InputError(f"{path}: links carry each other in a circle: {circle}; take out one of its joints") from None


def _check_elements(root: ElementTree.Element, path: Path) -> None:
    """Walk the elements with the number of copies that those around them ask for."""
    waiting = [(root, 1.0)]
    while waiting:
        element, copies = waiting.pop()
        if element.tag in ("replicate", "composite", "flexcomp"):
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
