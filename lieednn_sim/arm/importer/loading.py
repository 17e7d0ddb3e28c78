"""Reading and compiling of models, with messages that say what is missing."""

from __future__ import annotations

import os
from pathlib import Path

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.parsing import check_numbers
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.storage import is_file
from lieednn_sim.validation import as_path

_PACKAGE = "package://"


def load_spec(model: str | os.PathLike[str] | mujoco.MjSpec) -> mujoco.MjSpec:
    """A spec of one's own from a file or another spec, ready for edits: bodies stay apart, all have names.

    Raises:
        FileError: there is no such file, or MuJoCo cannot read it.
        InputError: neither a path nor a spec.
    """
    if isinstance(model, mujoco.MjSpec):
        compile_spec(model)  # a copy leaves out, without a word, what refers to names that aren't there
        spec = model.copy()
    else:
        if not isinstance(model, str | os.PathLike):
            raise InputError(f"the model must be a file or a mujoco.MjSpec, got {type(model).__name__}")
        source = as_path("the model", model)
        if not is_file(source):
            raise FileError(f"no such file: {source}")
        try:
            spec = mujoco.MjSpec.from_file(str(source))
        except ValueError as error:
            raise FileError(f"MuJoCo cannot read {source}: {str(error).strip()}") from None
        _resolve_packages(spec, source.resolve())
    spec.compiler.fusestatic = False  # a link that doesn't move in its parent would vanish
    spec.compiler.alignfree = False  # a locked object would keep the pose of its principal axes instead of its own
    for kind, elements in (("body", spec.bodies), ("joint", spec.joints)):
        names = {element.name for element in elements}
        for number, element in enumerate(elements):
            if not element.name:
                element.name = unused(f"{kind}{number}", names)
                names.add(element.name)
            if kind == "joint" and element.type == mujoco.mjtJoint.mjJNT_FREE:
                element.align = 0
    return spec


def compile_spec(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile; `FileError` says what MuJoCo says, and which files of meshes and textures are missing."""
    try:
        model = spec.compile()
    except ValueError as error:
        missing = _missing_files(spec)
        if missing:
            shown = ", ".join(missing[:10]) + (f" and {len(missing) - 10} more" if len(missing) > 10 else "")
            raise FileError(f"files of the model are missing: {shown}") from None
        raise FileError(f"MuJoCo cannot compile the model: {str(error).strip()}") from None
    check_numbers(model)
    return model


def _resolve_packages(spec: mujoco.MjSpec, source: Path) -> None:
    """Find the files of ``package://NAME/...`` in the folder NAME beside the model or above; ``file://`` is no part."""
    for element in (*spec.meshes, *spec.textures):
        scheme, _, path = element.file.partition("://")
        if scheme == "file":
            element.file = path
        elif scheme == "package":
            inside = path.partition("/")[2]
            # A folder above may itself be the package.
            candidates = [
                folder / below
                for folder in source.parents
                for below in ([path, inside] if folder.name == path.partition("/")[0] else [path])
            ]
            element.file = str(next((c for c in candidates if c.is_file()), element.file))


def unused(name: str, names: set[str], suffix: str = "_") -> str:
    """The name, with suffixes until none of ``names`` is the same."""
    while name in names:
        name += suffix
    return name


def _missing_files(spec: mujoco.MjSpec) -> list[str]:
    missing = []
    known = set(spec.assets)
    for folder, elements in (
        ("meshdir", [*spec.meshes, *spec.hfields, *spec.skins]),
        ("texturedir", list(spec.textures)),
    ):
        for element in elements:
            if not element.file:
                continue
            if element.file.startswith(_PACKAGE):
                package = element.file.removeprefix(_PACKAGE).partition("/")[0]
                missing.append(f"{element.file} (no folder {package!r} beside {spec.modelfiledir} or above holds it)")
                continue
            below = getattr(element.compiler, folder, "") or getattr(spec, folder, "")
            own = Path(spec.modelfiledir)
            path = own / below / element.file
            if below and not path.is_file() and path.is_relative_to(own) and Path(element.file).is_absolute():
                # Behind an <include>, where MuJoCo tries the included file's own folder at last, without meshdir.
                path = own / below / path.name
            if not path.is_file() and not known.intersection(
                (element.file, path.name, str(Path(below) / element.file))
            ):
                missing.append(str(path))
    return missing
