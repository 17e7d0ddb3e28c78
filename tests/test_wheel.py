"""The packages hold what they should, and the wheel, in a fresh environment, finds its models and does its work."""

import contextlib
import gzip
import json
import os
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from functools import partial
from pathlib import Path

import pytest
from hatchling import build
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def run(*command, cwd):
    # Where a checkout is on the path of the one who tests, it would be found before the wheel.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """The sdist, the wheel built from it, and the wheel built from the checkout, as `python -m build` asks for them."""
    dist, direct, unpacked = (tmp_path_factory.mktemp(name) for name in ("dist", "direct", "unpacked"))
    with contextlib.chdir(ROOT), pytest.MonkeyPatch.context() as patch:
        # To compress takes longer than all else.
        patch.setattr(gzip, "GzipFile", partial(gzip.GzipFile, compresslevel=0))
        sdist = dist / build.build_sdist(str(dist))
        wheel = direct / build.build_wheel(str(direct))
    with tarfile.open(sdist) as archive:
        archive.extraction_filter = getattr(tarfile, "data_filter", None)  # Debian's Python 3.11.2 has none
        archive.extractall(unpacked)
    with contextlib.chdir(next(unpacked.iterdir())):
        return sdist, dist / build.build_wheel(str(dist)), wheel


def names(path):
    """Files in a package; those of an sdist without its folder."""
    if path.suffix == ".whl":
        return sorted(zipfile.ZipFile(path).namelist())
    with tarfile.open(path) as archive:
        return sorted(member.name.partition("/")[2] for member in archive if member.isfile())


def files(*folders):
    """What is committed, or will be, below some folders: all but caches and what the site's build makes."""
    left_out = {"__pycache__", "_build", "_made"}
    return {
        path.relative_to(ROOT).as_posix()
        for folder in folders
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and not left_out & set(path.parts) and path.name != "sg_execution_times.rst"
    }


def test_wheel_and_sdist_hold_what_they_should(packages):
    sdist, wheel, direct = packages
    about = f"lieednn_sim-{PROJECT['project']['version']}.dist-info/"
    metadata = {about + name for name in ("METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE")}
    assets = {f"lieednn_sim/{name}" for name in files("assets/mjcf")}
    assert set(names(wheel)) == files("lieednn_sim") | assets | metadata
    assert names(wheel) == names(direct)
    assert "lieednn_sim/py.typed" in names(wheel)
    assert "lieednn_sim/assets/mjcf/telescopic_pr/scene.xml" in names(wheel)

    folders = ("lieednn_sim", "assets/mjcf", "docs", "tests", "scripts", "results/reference", "results/records")
    single = {"PKG-INFO", ".gitignore", "pyproject.toml", "Makefile", "uv.lock", "LICENSE", "CITATION.cff", "paper.bib"}
    texts = {path.name for path in ROOT.glob("*.md")}
    assert set(names(sdist)) == files(*folders) | single | texts | {"results/README.md"}


def test_an_index_would_take_the_packages(packages):
    from twine.commands.check import check  # which imports much, in every worker if it were above

    assert not check([str(path) for path in packages[:2]], strict=True)


def test_the_installed_wheel_works_from_an_empty_directory(packages, tmp_path):
    fresh = tmp_path / "fresh"
    run(sys.executable, "-m", "venv", "--without-pip", fresh, cwd=tmp_path)
    python = fresh / "bin" / "python"
    alone = ("--no-deps", "--no-index", "--no-compile")
    run(sys.executable, "-m", "pip", "--python", python, "install", *alone, packages[1], cwd=tmp_path)
    # The dependencies come from this environment; its editable install of the package does not, being a .pth itself.
    (site,) = (fresh / "lib").glob("python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    where = run(python, "-c", "import lieednn_sim; print(lieednn_sim.__file__)", cwd=tmp_path).strip()
    assert Path(where).is_relative_to(fresh)
    command = fresh / "bin" / "lieednn-sim"
    assert PROJECT["project"]["version"] in run(command, "--version", cwd=tmp_path)
    run(command, "plan", "--target", "extended", "--option", "n_networks=2", "--output", tmp_path / "run", cwd=tmp_path)
    assert json.loads((tmp_path / "run" / "task.json").read_text())["arm"] == "telescopic_pr"


def test_the_lock_file_is_in_step_and_names_no_other_index():
    text = (ROOT / "uv.lock").read_text()
    lock = tomllib.loads(text)
    (own,) = (package for package in lock["package"] if package["name"] == "lieednn-sim")
    assert own["version"] == PROJECT["project"]["version"], "uv lock"

    # As uv writes them: the extra is a part of the marker.
    by_extra = {"": PROJECT["project"]["dependencies"], **PROJECT["project"]["optional-dependencies"]}
    wanted = []
    for extra, entries in by_extra.items():
        for entry in map(Requirement, entries):
            marker = str(entry.marker or "").replace("python_version", "python_full_version").replace('"', "'")
            wanted.append((entry.name, entry.specifier, f"extra == '{extra}'" if extra else marker))
    locked = [(e["name"], SpecifierSet(e["specifier"]), e.get("marker", "")) for e in own["metadata"]["requires-dist"]]
    assert sorted(wanted, key=str) == sorted(locked, key=str), "uv lock"
    assert {package["source"].get("registry", "its own") for package in lock["package"]} == {
        "https://pypi.org/simple",
        "its own",
    }
    assert text.count("url = ") == text.count('url = "https://files.pythonhosted.org/')
