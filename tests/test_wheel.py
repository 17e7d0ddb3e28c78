"""The wheel, installed in a fresh environment, finds its models and does its work."""

import json
import os
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def run(*command, cwd):
    # Where a checkout is on the path of the one who tests, it would be found before the wheel.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_installed_wheel_works_from_an_empty_directory(tmp_path):
    run(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", tmp_path / "dist", ROOT, cwd=tmp_path)
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    fresh = tmp_path / "fresh"
    run(sys.executable, "-m", "venv", "--without-pip", fresh, cwd=tmp_path)
    python = fresh / "bin" / "python"
    alone = ("--no-deps", "--no-index", "--no-compile")
    run(sys.executable, "-m", "pip", "--python", python, "install", *alone, wheel, cwd=tmp_path)
    # The dependencies come from this environment; its editable install of the package does not, being a .pth itself.
    (site,) = (fresh / "lib").glob("python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")

    where = run(python, "-c", "import lieednn_sim; print(lieednn_sim.__file__)", cwd=tmp_path).strip()
    assert Path(where).is_relative_to(fresh)
    command = fresh / "bin" / "lieednn-sim"
    run(command, "synthesize", "--target", "extended", "--n-networks", "2", "--output", tmp_path / "run", cwd=tmp_path)
    assert json.loads((tmp_path / "run" / "task.json").read_text())["arm"] == "telescopic_pr"
