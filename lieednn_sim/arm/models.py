"""Models on disk: those of the package, in a checkout and in an installed wheel, and any other file."""

from __future__ import annotations

from pathlib import Path
from typing import Unpack

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm.importer import ImportOptions, ImportReport, import_arm
from lieednn_sim.errors import FileError
from lieednn_sim.storage import is_file
from lieednn_sim.validation import as_choice

# Files that are models, and no names of arms.
MODEL_SUFFIXES = (".xml", ".mjcf", ".urdf")


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
