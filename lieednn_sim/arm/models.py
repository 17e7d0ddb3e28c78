"""Model files: those of the package, in a checkout or an installed wheel, and the user's own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

from lieednn_sim import io
from lieednn_sim.arm.importer.loading import macros_left
from lieednn_sim.arm.importer.report import ImportOptions
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.registry import ARMS
from lieednn_sim.validation import as_path
from lieednn_sim.values import StrPath

# Suffixes of model files, and of files that describe an import; both tell a file from the name of an arm.
MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")
DESCRIPTION_SUFFIXES = (".yaml", ".yml", ".json")
_MODEL_WITH_LINKS = re.compile(r"(.+(?:\.xml|\.mjcf|\.urdf)):(.+)", re.IGNORECASE | re.DOTALL)


class ModelFile(NamedTuple):
    """A model file, its arm's name, and the options of its import."""

    path: Path
    name: str
    options: ImportOptions


def models_directory() -> Path:
    """The folder of the package's arms: inside the package when installed, beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for candidate in (package / "assets" / "mjcf", package.parent / "assets" / "mjcf"):
        if candidate.is_dir():
            return candidate
    raise FileError("the MJCF models are missing from this installation; reinstall lieednn_sim")


def arm_names() -> list[str]:
    """Names of the arms that come with the package."""
    folder = models_directory()
    return [name for name in ARMS if (folder / name / "scene.xml").is_file()]


def scene_path(arm: str) -> Path:
    """The scene file of an arm; `InputError` listing the known ones, or `FileError` for what looks like a file."""
    if Path(arm).suffix:
        raise FileError(f"no arm {arm!r}: the files of arms end in {', '.join(MODEL_SUFFIXES + DESCRIPTION_SUFFIXES)}")
    ARMS.find(arm)
    return models_directory() / arm / "scene.xml"


def is_arm_file(text: str) -> bool:
    """Whether a name refers to a file, by its suffix, rather than to an arm of the package."""
    return bool(_MODEL_WITH_LINKS.fullmatch(text)) or Path(text).suffix.lower() in MODEL_SUFFIXES + DESCRIPTION_SUFFIXES


def find_model(arm: StrPath, options: ImportOptions) -> ModelFile:
    """Find what an arm is loaded from: an arm of the package, a model file, or a file that describes an import.

    The name of a model file may be followed by links, as in ``robot.urdf:wrist,tool``, which become part of the arm's
    name. A description is a mapping in YAML or JSON: ``model`` is the file, relative to the description or absolute,
    and the rest are `ImportOptions`; ``options`` take precedence over them. `FileError` if there is no such
    description, or it is malformed; `InputError` if the arm is unknown, or one of the package, with options.
    """
    if isinstance(arm, str) and arm.lstrip().startswith("<"):
        raise InputError("an arm needs a path, got the text of a model: Arm.from_spec(mujoco.MjSpec.from_string(text))")
    path = as_path("the name of an arm", arm)
    suffix = path.suffix.lower()
    if suffix == ".xacro":
        raise macros_left(path)
    if suffix in DESCRIPTION_SUFFIXES:
        described: Any = io.load_description(path, "description of an arm")
        name = described.pop("model", None)
        if not isinstance(name, str) or Path(name).suffix.lower() not in MODEL_SUFFIXES:
            raise FileError(f"{path} names no model: it needs an entry such as `model: robot.urdf`, got {name!r}")
        if unknown := [str(key) for key in described if key not in ImportOptions.__optional_keys__]:
            allowed = ", ".join(sorted(ImportOptions.__optional_keys__))
            raise FileError(f"{path}: a description of an arm has no {', '.join(unknown)}; allowed: model, {allowed}")
        return ModelFile(path.parent / name, path.stem, {**described, **chosen(options)})
    if named := _MODEL_WITH_LINKS.fullmatch(str(path)):
        if options.get("links"):
            raise InputError(f"the links of {path} are given twice: after its name, and as an option")
        model = Path(named[1])
        return ModelFile(model, f"{label_of(model)}({named[2]})", {**options, "links": named[2].split(",")})
    if suffix in MODEL_SUFFIXES:
        return ModelFile(path, label_of(path), options)
    if given := chosen(options):
        raise InputError(f"arm {str(arm)!r} of the package takes no import options, got: {', '.join(given)}")
    return ModelFile(scene_path(str(arm)), str(arm), {})


def label_of(source: Path) -> str:
    """The name of the arm in a model file: the file's stem, or its folder's name when it is ``scene.xml``."""
    return source.parent.name if source.stem == "scene" else source.stem


def chosen(options: ImportOptions) -> ImportOptions:
    """The options that differ from their defaults; `InputError` for others than those of an import."""
    if unknown := options.keys() - ImportOptions.__optional_keys__:
        allowed = ", ".join(sorted(ImportOptions.__optional_keys__))
        raise InputError(f"no option {', '.join(map(repr, sorted(unknown)))} of an import; allowed: {allowed}")
    usual = {"servos": "keep", "overlaps": "ignore", "floor": "auto"}
    # A comprehension is a plain dict to mypy, whatever keys it has.
    return {name: value for name, value in options.items() if value not in (None, (), [], {}, usual.get(name))}  # type: ignore[return-value]
