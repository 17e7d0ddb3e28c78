"""Models on disk: those of the package, in a checkout and in an installed wheel, and any other file."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, NamedTuple, Unpack

from lieednn_sim import storage
from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer import ImportOptions, ImportReport, import_arm
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.storage import is_file
from lieednn_sim.validation import as_choice, as_path

# Files that are models, and files that say how one becomes an arm; neither are names of arms.
MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")
DESCRIPTION_SUFFIXES = (".yaml", ".yml", ".json")
_MODEL_WITH_LINKS = re.compile(r"(.+(?:\.xml|\.mjcf|\.urdf)):(.+)", re.IGNORECASE | re.DOTALL)


class ModelFile(NamedTuple):
    """A model, what its arm is called, and the options of its import."""

    path: Path
    name: str
    options: ImportOptions


def models_directory() -> Path:
    """The folder of the arms: inside the package when installed, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "assets" / "mjcf", package.parent / "assets" / "mjcf"):
        if candidate.is_dir():
            return candidate
    raise FileError("the MJCF models are missing from this installation; reinstall lieednn_sim")


def arm_names() -> list[str]:
    """Names of the arms that come with the package."""
    return sorted(path.parent.name for path in models_directory().glob("*/scene.xml"))


def scene_path(arm: str) -> Path:
    """The scene file of an arm, or `InputError` listing the known arms."""
    return models_directory() / as_choice("arm", arm, arm_names()) / "scene.xml"


def is_arm_file(text: str) -> bool:
    """Whether an arm is a file, by how it is called, and none of the package."""
    return bool(_MODEL_WITH_LINKS.fullmatch(text)) or Path(text).suffix.lower() in MODEL_SUFFIXES + DESCRIPTION_SUFFIXES


def find_model(arm: str | os.PathLike[str], options: ImportOptions) -> ModelFile:
    """What an arm is loaded from: one of the package's by name, a model file, or a file that describes the import.

    Links may follow the name of a model file, ``robot.urdf:wrist,tool``; they are part of the arm's name then. A
    description is a mapping in YAML or JSON, ``model`` the file, beside it or absolute, the rest `ImportOptions`.

    Args:
        arm: name or file.
        options: further ones of the import; they go before those of a description.

    Raises:
        FileError: there is no such description, or it holds something else.
        InputError: an unknown arm, or options of one of the package's.
    """
    path = as_path("the name of an arm", arm)
    suffix = path.suffix.lower()
    if suffix == ".xacro":
        raise InputError(f"{path} holds macros of ROS: make a URDF of it, `xacro {path} -o robot.urdf`, and load that")
    if suffix in DESCRIPTION_SUFFIXES:
        model, described = _read_description(path)
        return ModelFile(model, path.stem, {**described, **chosen(options)})
    if named := _MODEL_WITH_LINKS.fullmatch(str(path)):
        if options.get("links"):
            raise InputError(f"the links of {path} are given twice: behind its name, and as an option")
        model = Path(named[1])
        return ModelFile(model, f"{label_of(model)}({named[2]})", {**options, "links": named[2].split(",")})
    if suffix in MODEL_SUFFIXES:
        return ModelFile(path, label_of(path), options)
    if given := chosen(options):
        raise InputError(f"arm {str(arm)!r} has its own frames, servos and home; for files only: {', '.join(given)}")
    return ModelFile(scene_path(str(arm)), str(arm), {})


def _read_description(path: Path) -> tuple[Path, ImportOptions]:
    value: Any = storage.load_description(path, "description of an arm")
    model = value.pop("model", None)
    if not isinstance(model, str) or Path(model).suffix.lower() not in MODEL_SUFFIXES:
        raise FileError(f"{path} names no model of an arm: it needs an entry as `model: robot.urdf`, got {model!r}")
    if unknown := [str(name) for name in value if name not in ImportOptions.__optional_keys__]:
        allowed = ", ".join(sorted(ImportOptions.__optional_keys__))
        raise FileError(f"{path}: a description of an arm has no {', '.join(unknown)}; allowed: model, {allowed}")
    return path.parent / model, value


def label_of(source: Path) -> str:
    """What the arm of a model file is called: the file's name, or its folder's when it is ``scene.xml``."""
    return source.parent.name if source.stem == "scene" else source.stem


def chosen(options: ImportOptions) -> ImportOptions:
    """The options that are not as by default."""
    return {name: value for name, value in options.items() if value not in (None, (), [], {}, "keep")}  # type: ignore[return-value]


def open_model(source: Path, **options: Unpack[ImportOptions]) -> tuple[mujoco.MjSpec, ImportReport | None]:
    """The spec of a file in the package's conventions, imported where it has others or where the options ask for it.

    Raises:
        FileError: there is no such file, or MuJoCo cannot compile it.
        InputError: it holds no arm.
    """
    if not is_file(source):
        raise FileError(f"no such file: {source}")
    try:
        spec = mujoco.MjSpec.from_file(str(source))
    except ValueError as error:
        raise FileError(f"MuJoCo cannot compile {source}: {str(error).strip()}") from None
    if chosen(options) or spec.site("base_frame") is None or spec.site("link1_frame") is None:
        return import_arm(source, **chosen(options))
    return spec, None
