"""Where the MJCF models live, in a checkout and in an installed wheel."""

from __future__ import annotations

from pathlib import Path

from lieednn_sim.errors import FileError
from lieednn_sim.validation import as_choice


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
