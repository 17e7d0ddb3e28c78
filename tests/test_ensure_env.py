"""`scripts/ensure_env.sh`, which `make` calls first, with a Python that installs nothing and notes how it is called."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# A Python that notes how it was called, copies itself where an environment is wanted, and never reaches an index.
STUB = """\
#!/bin/sh
echo "$*" >>'{log}'
case "$*" in
    "-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
    "-m pip --version") [ ! -e "$(dirname "$0")/no-pip" ] ;;
    "-m pip install "* | "-m pip download "*) [ ! -e '{offline}' ] ;;
    *) exec '{python}' -IS "$@" ;;
esac
"""


@dataclass
class Checkout:
    """A checkout with nothing but what the script needs, in a directory with a space, and a Python in another."""

    path: Path
    python: Path
    log: Path
    offline: Path

    @property
    def venv(self) -> Path:
        return self.path / ".venv"

    def ensure(self, *wanted: str, **variables: str) -> subprocess.CompletedProcess[str]:
        self.log.write_text("")
        return subprocess.run(
            ["bash", self.path / "scripts" / "ensure_env.sh", *wanted],
            env={**os.environ, "PYTHON": str(self.python), **variables},
            capture_output=True,
            text=True,
            check=False,
        )

    def installed(self) -> list[str]:
        """What pip was asked to install by the last call, but the wheel that it was to download, and small releases."""
        calls = re.findall(r" install .*--no-compile (?:--editable )?(.*)", self.log.read_text())
        small = ' imageio-ffmpeg<0.8 zstandard<0.22; python_version < "3.12"'
        return [call.removesuffix(small) for call in calls if "*.whl" not in call]

    def own_environment(self) -> Path:
        """An environment as the user would make it; returns its interpreter."""
        python = self.venv / "bin" / "python"
        python.parent.mkdir(parents=True)
        shutil.copy(self.python, python)
        return python


@pytest.fixture
def checkout(tmp_path):
    path, python = tmp_path / "check out", tmp_path / "a python" / "python"
    for name in ("scripts/ensure_env.sh", "scripts/debian.sh", "pyproject.toml"):
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, path / name)
    made = Checkout(path, python, tmp_path / "log", tmp_path / "offline")
    made.log.touch()
    python.parent.mkdir()
    python.write_text(STUB.format(log=made.log, offline=made.offline, python=sys.executable))
    python.chmod(0o755)
    return made


def test_an_environment_is_made_once_and_used_as_it_is_without_a_network(checkout):
    done = checkout.ensure()
    assert done.returncode == 0, done.stderr
    assert checkout.installed() == [".[view]"]
    checkout.offline.touch()
    # Git leaves a newer file of the same content; the linter's options are no metadata.
    project = checkout.path / "pyproject.toml"
    project.write_text(project.read_text().replace("line-length = 120", "line-length = 100") + "\n# A comment.\n")
    os.utime(project, (2e9, 2e9))
    done = checkout.ensure()
    assert (done.returncode, done.stderr, checkout.installed()) == (0, "", [])


def test_what_the_tests_need_is_added_and_serves_the_demo_too(checkout):
    assert checkout.ensure().returncode == 0
    done = checkout.ensure("dev")
    assert done.returncode == 0, done.stderr
    extras = "view,gymnasium,rivals,timing,cbirrt,onnx,ros2,lerobot,rerun"
    assert checkout.installed() == ["pip>=25.1", f".[{extras}] --group dev"]
    (checkout.venv / ".lieednn-sim-demo").unlink()
    assert checkout.ensure().returncode == 0
    assert checkout.installed() == []


def test_without_a_network_it_says_what_is_out_of_date(checkout):
    checkout.offline.touch()
    done = checkout.ensure()
    assert done.returncode == 1
    assert "the first time it needs the network" in done.stderr
    checkout.offline.unlink()
    assert checkout.ensure().returncode == 0
    checkout.offline.touch()
    project = checkout.path / "pyproject.toml"
    project.write_text(project.read_text().replace('"rich>=', '"rich!=14.3.1,>='))
    for _ in range(2):
        done = checkout.ensure()
        assert done.returncode == 1
        assert "could not bring .venv up to date with pyproject.toml" in done.stderr
    checkout.offline.unlink()
    assert checkout.ensure().returncode == 0
    assert checkout.installed() == [".[view]"]


def test_an_environment_of_the_users_own_is_used(checkout):
    python = checkout.own_environment()
    done = checkout.ensure()
    assert done.returncode == 0, done.stderr
    assert "-m venv" not in checkout.log.read_text()
    # It does not become the script's by that.
    (python.parent / "no-pip").touch()
    assert checkout.ensure().returncode == 1
    assert python.exists()


@pytest.mark.parametrize("fault", ["no pip", "old Python", "dangling link", "another checkout's"])
def test_an_environment_that_it_did_not_make_is_never_removed(checkout, tmp_path, fault):
    if fault == "dangling link":
        checkout.venv.symlink_to(tmp_path / "nowhere")
    else:
        python = checkout.own_environment()
    if fault == "no pip":
        (python.parent / "no-pip").touch()
    elif fault == "old Python":
        python.write_text("#!/bin/sh\nexit 1\n")
    elif fault == "another checkout's":
        checkout.venv.rename(tmp_path / "shared")
        (tmp_path / "shared" / ".made-in").write_text("/somewhere/else\n")
        checkout.venv.symlink_to(tmp_path / "shared")
    before = sorted(tmp_path.rglob("*"))
    done = checkout.ensure()
    assert done.returncode == 1
    reason = {"no pip": "has no pip", "another checkout's": "was made for /somewhere/else"}
    assert f".venv {reason.get(fault, 'has no Python 3.11, 3.12 or 3.13 that runs')}" in done.stderr
    assert "mend it, or move it away" in done.stderr
    assert sorted(tmp_path.rglob("*")) == before
    assert checkout.installed() == []


@pytest.mark.parametrize("fault", ["moved", "no pip", "half made"])
def test_its_own_environment_is_made_anew(checkout, tmp_path, fault):
    assert checkout.ensure().returncode == 0
    if fault == "moved":
        checkout.path = checkout.path.rename(tmp_path / "moved here")
    elif fault == "no pip":
        (checkout.venv / "bin" / "no-pip").touch()
    else:
        shutil.rmtree(checkout.venv / "bin")
    done = checkout.ensure()
    assert done.returncode == 0, done.stderr
    assert "Making .venv" in done.stderr
    assert checkout.installed() == [".[view]"]


def test_an_unsuitable_interpreter_is_named(checkout):
    done = checkout.ensure(PYTHON="/no such/python")
    assert done.returncode == 1
    assert "no Python 3.11, 3.12 or 3.13 found (looked for: /no such/python)" in done.stderr
    assert not checkout.venv.exists()
