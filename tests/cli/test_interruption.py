"""Signals whenever they arrive, and systems that refuse: one line, the right exit code, and nothing half done."""

from __future__ import annotations

import resource
import signal
import sys
import weakref

import pytest

from lieednn_sim.cli import doctor, main


def swallowing():
    """It arrives in a callback of a weak reference, where Python swallows exceptions."""
    thing = set()
    kept = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGTERM))
    del thing
    assert kept() is None


def test_a_signal_that_is_swallowed_is_told_by_the_exit_code(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "doctor", swallowing)
    assert main(["doctor"]) == 143
    assert capsys.readouterr().err == "lieednn-sim: interrupted; files already reported are complete\n"


def test_a_signal_after_the_last_line_is_no_traceback(start):
    code = "import atexit, os, signal, sys\nsys.argv[0] = 'lieednn-sim'\nfrom lieednn_sim.cli import main\n"
    code += "atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))\nsys.exit(main())"
    process = start("-c", code, "--version")
    output, errors = process.communicate()
    assert (process.returncode, errors) == (-signal.SIGINT, "")
    assert output.startswith("lieednn-sim ")


def test_a_signal_while_anything_else_is_imported_first_is_no_traceback(start):
    code = """
import importlib, os, signal, sys  # the first is needed for -m

class Interrupting:
    def find_spec(name, path=None, target=None):
        if not name.startswith("lieednn_sim") and name != "__future__":
            os.kill(os.getpid(), 2)

sys.argv = ["-m"]
for name in [name for name in sys.modules if name.split(".")[0] in ("enum", "signal", "typing")]:
    del sys.modules[name]
sys.meta_path.insert(0, Interrupting)
import lieednn_sim.cli
"""
    process = start("-c", code)
    assert process.communicate() == ("", "")
    assert process.returncode == -signal.SIGINT


def test_what_an_interruption_cut_off_disposes_of_itself_in_silence(start):
    code = """
import os, signal, sys
from lieednn_sim.cli import doctor, main

class CutOff:
    def __del__(self):
        raise ValueError("it is half made")

def interrupted():
    global kept
    kept = CutOff()
    CutOff()
    os.kill(os.getpid(), signal.SIGINT)
    CutOff()

doctor.doctor = interrupted
sys.exit(main())
"""
    process = start("-c", code, "doctor")
    _, errors = process.communicate()
    # What fails before has nothing to do with it.
    assert (process.returncode, errors.count("it is half made")) == (130, 1)
    assert errors.endswith("lieednn-sim: interrupted; files already reported are complete\n")


def test_a_group_is_interrupted_while_its_workers_start(tmp_path, start):
    """By the first worker, which imports the main module before it is prepared; a second signal would end all."""
    script = tmp_path / "script.py"
    script.write_text(
        """
import os, signal, sys
from lieednn_sim.cli import main
if __name__ == "__mp_main__":
    try:
        os.mkdir(__file__ + ".sent")
    except FileExistsError:
        pass
    else:
        os.killpg(0, signal.SIGINT)
if __name__ == "__main__":
    sys.exit(main())
"""
    )
    words = ["compare", "--planners", "minimum-jerk", "--arms", "telescopic_pr", "--scenes", "free", "--jobs", "2"]
    process = start(str(script), *words, "--output", str(tmp_path / "out"), start_new_session=True)
    _, errors = process.communicate()
    assert process.returncode == 130
    assert errors.splitlines() == ["lieednn-sim: interrupted; files already reported are complete"]


def test_a_refused_command_leaves_no_folder(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    assert main(["compare", "--merge", str(tmp_path / "empty"), "--output", str(tmp_path / "a" / "out")]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("system") / "run"
    words = "plan --target random:3 --planner linear-attractor --duration 1 --output"
    assert main([*words.split(), str(directory)]) == 0
    assert main(["simulate", str(directory), "--hold", "0"]) == 0
    return directory


@pytest.mark.rendering
def test_an_ffmpeg_that_does_not_exist_is_named(run, capsys, monkeypatch):
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nonexistent")
    assert main(["render", str(run), "--size", "64x48", "--preset", "draft", "--fps", "2"]) == 2
    assert "No such file or directory: '/nonexistent'; unset IMAGEIO_FFMPEG_EXE" in capsys.readouterr().err


@pytest.mark.rendering
def test_a_disk_that_is_full_is_one_line_with_the_name_that_was_asked_for(run, tmp_path, capsys):
    film = tmp_path / "film.gif"
    words = ["render", str(run), "--size", "64x48", "--preset", "draft", "--fps", "2", "--output", str(film)]
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, limits[1]))
    try:
        assert main(words) == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert capsys.readouterr().err == f"lieednn-sim: error: cannot write {film}: File too large\n"
    assert list(tmp_path.iterdir()) == []


def test_a_full_standard_error_changes_no_exit_code(tmp_path, monkeypatch):
    # To close it would fail, if anything waited there.
    with open("/dev/full", "w") as full:  # noqa: PTH123, a device
        monkeypatch.setattr(sys, "stderr", full)
        assert main(["simulate", str(tmp_path / "none")]) == 2


def test_signals_have_their_handlers_back(monkeypatch):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    monkeypatch.setattr(doctor, "doctor", lambda: signal.getsignal(signal.SIGINT) in before)
    assert main(["doctor"]) == 0
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
