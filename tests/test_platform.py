"""The main road where POSIX is hidden: the package uses nothing that the standard library lacks or refuses on Windows.

The platform keeps its name there, since the standard library itself would look for its parts of another one.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from lieednn_sim.studies.study import worker_pool

# Worker processes run it too, as a part of the main module.
HIDING = '''
import ctypes, errno, os, re, signal, sys

for name in ("fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "syslog"):
    sys.modules[name] = None
# But for what the standard library and NumPy need here: waitpid, uname, sysconf and the like.
ABSENT = {
    signal: "SIG(?!INT$|TERM$|ABRT$|FPE$|ILL$|SEGV$|_DFL$|_IGN$)|pthread_|sig(wait|pend|interrupt|timed)|.*itimer|"
    "ITIMER|alarm|pause",
    os: "fork|set|get(e|res)?[ug]id|getp?g|getsid|killpg|l?chown|fch|chroot|mkfifo|mknod|posix_|nice|sync|"
    "fdatasync|f?statvfs|pread|pwrite|openpty|ttyname|getloadavg|lockf|wait[34i]?$|O_DIRECTORY|O_NO|O_SYNC",
}
for module, names in ABSENT.items():
    for name in filter(re.compile(names).match, dir(module)):
        delattr(module, name)


def refusing(module, name, refused, error):
    allowed = getattr(module, name)

    def checked(first, *others, **options):
        if refused(first, *others):
            raise error
        return allowed(first, *others, **options)

    setattr(module, name, checked)


def is_reading(handle):
    with open(f"/proc/self/fdinfo/{handle}") as told:
        return not int(re.search(r"flags:\\s*(\\d+)", told.read())[1], 8) & (os.O_WRONLY | os.O_RDWR)


def is_open(*paths):
    """Whether this process has one of the files open."""
    links = [f"/proc/self/fd/{handle}" for handle in os.listdir("/proc/self/fd")]
    return not {os.readlink(link) for link in links if os.path.lexists(link)}.isdisjoint(map(os.path.realpath, paths))


refusing(os, "open", lambda path, *_: os.path.isdir(path), PermissionError(errno.EACCES, "a directory is opened"))
refusing(os, "fsync", is_reading, OSError(errno.EBADF, "what is open for reading is synced"))
refusing(ctypes, "CDLL", lambda name, *_: name is None, TypeError("the program itself is asked for"))
for name in ("replace", "rename", "unlink", "remove"):
    refusing(os, name, is_open, PermissionError(errno.EACCES, "an open file is renamed or removed"))
'''

ROAD = """
def walk(folder):
    from lieednn_sim.cli import main
    from lieednn_sim.evaluation import plots
    from lieednn_sim.studies import study
    from lieednn_sim.studies.report import figures, page

    # Figures are matplotlib's alone, and take long.
    for what in ("network", "tracking", "joints", "clearance"):
        setattr(plots, f"plot_{what}", lambda *given: given[-1].write_bytes(b""))
    page.plots = lambda rows, controller: [figures.Plot(controller, "<svg/>", "")]
    # One worker is enough, though it takes another number to ask for one.
    pool, study.worker_pool = study.worker_pool, lambda _: pool(1)
    demo = ["demo", "--no-video", "--output", f"{folder}/run", "--duration", "1", "--hold", "0", "--planner"]
    assert main([*demo, "linear-attractor"]) == 0
    few = ["--planners", "minimum-jerk", "--arms", "telescopic_pr", "--scenes", "free", "--seeds", "2"]
    few += ["--controllers", "computed-torque", "--duration", "1", "--hold", "0"]
    assert main(["compare", *few, "--jobs", "2", "--views", "0", "--output", f"{folder}/table"]) == 0

    # After the commands, whose workers import what is imported here.
    import importlib, pkgutil
    import lieednn_sim

    for module in pkgutil.iter_modules(lieednn_sim.__path__):
        if module.name != "__main__":
            importlib.import_module(f"lieednn_sim.{module.name}")


if __name__ == "__main__":
    walk(sys.argv[1])
    assert sys.modules["fcntl"] is None and not hasattr(signal, "setitimer") and not hasattr(os, "fork")
    print("walked")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="it looks at open files in /proc")
def test_the_main_road_needs_no_posix(tmp_path: Path) -> None:
    script = tmp_path / "road.py"
    script.write_text(HIDING + ROAD)
    done = subprocess.run(
        [sys.executable, script, tmp_path], cwd=tmp_path, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.endswith("walked\n")
    assert "Traceback" not in done.stderr
    rows = (tmp_path / "table" / "comparison.csv").read_text().splitlines()
    assert len(rows) > 2
    assert not [row for row in rows if "error" in row]
    assert not list(tmp_path.rglob("*unfinished*"))


def test_a_pool_has_as_many_workers_as_windows_can_wait_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    # The standard library's pool refuses more there.
    with worker_pool(100) as pool:
        assert pool._max_workers == 61
