"""Committed results: made by one command, recorded, and stale when the code that they depend on has changed."""

from __future__ import annotations

import json
import os
import signal
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import reference

from lieednn_sim.versions import versions

ROOT = Path(reference.__file__).parents[1]
FILES = {
    "lieednn_sim/__init__.py": "",
    "lieednn_sim/used.py": "speed = 1.0\n",
    "lieednn_sim/unused.py": "speed = 1.0\n",
    # A study that does half of its work in its first run.
    "scripts/study.py": """
import sys
from pathlib import Path
import lieednn_sim.used
rows = Path("results/study/rows.csv")
rows.parent.mkdir(parents=True, exist_ok=True)
with rows.open("a") as stream:
    stream.write(f"{sys.argv[1:]}\\n")
if len(rows.read_text().splitlines()) < 2:
    sys.exit("no more paper")
Path("results/study/study.md").write_text("# Study\\n\\n" + rows.read_text())
""",
}
STUDY = reference.Study(("python scripts/study.py DATA --fast",), {"study.md": "results/study/study.md"}, ("study",))


@pytest.fixture
def root(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def run(root, *words, study=STUDY):
    return reference.main([*words], {"study": study}, root)


def change(path, text):
    """Write a file with another time of change, however coarse the file system's clock."""
    path.write_text(text)
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 10**9))


def test_a_study_that_stopped_goes_on_and_is_recorded_and_stale_when_what_it_uses_changes(root, capsys):
    made = root / "results/reference/study.md"
    assert run(root, "--stale") == 1
    assert "study: never recorded" in capsys.readouterr().out
    assert run(root, "--jobs", "1") == 1
    assert "failed with status 1" in (said := capsys.readouterr().err)
    assert "no more paper" in said
    assert not made.exists()
    assert run(root) == 0
    assert "study: made in" in capsys.readouterr().out
    record = json.loads((root / "results/reference/made.json").read_text())["studies"]["study"]
    assert made.read_text() == (
        "# Study\n\n['DATA', '--fast']\n['DATA', '--fast']\n\n"
        f"Made by `python scripts/study.py DATA --fast`, {record['date']} with "
        f"{', '.join(f'{name} {version}' for name, version in versions(optional=True).items())}, "
        f"code {record['code']}.\n"
    )
    assert record["versions"] == versions(optional=True)
    assert record["cpu_s"] > 0.0
    assert (record["jobs"], record["cores"], list(record["outputs"])) == (1, os.cpu_count(), ["study.md"])
    for same in ("unused.py", "used.py"):
        change(root / "lieednn_sim" / same, "# Faster.\nspeed = 1.0\n" if same == "used.py" else "speed = 2.0\n")
        assert run(root, "--stale") == 0
        assert run(root) == 0
        assert capsys.readouterr().out == "study: up to date\n" * 2
    change(root / "lieednn_sim/used.py", "speed = 2.0\n")
    assert run(root, "--stale", "study") == 1
    assert f"study: made by code {record['code']}, now " in capsys.readouterr().out
    # Rows of other code are not continued.
    assert run(root) == 1
    assert run(root) == 0
    assert run(root, "--stale") == 0


def test_changed_and_missing_files_and_another_command_are_stale(root, capsys):
    run(root)
    run(root)
    made = root / "results/reference/study.md"
    capsys.readouterr()
    other = replace(STUDY, commands=("python scripts/study.py",))
    assert run(root, "--stale", study=other) == 1
    assert "made by another command, python scripts/study.py DATA --fast" in capsys.readouterr().out
    made.write_text(made.read_text() + "By hand.\n")
    assert run(root, "--stale") == 1
    assert capsys.readouterr().out == "study: study.md was changed since\n"
    made.unlink()
    assert run(root, "--stale") == 1
    assert capsys.readouterr().out == "study: study.md is missing\n"
    assert run(root) == 0
    assert "By hand" not in made.read_text()


def test_an_interrupted_study_is_stopped_and_goes_on(root, capsys):
    os.mkfifo(root / "begun")
    (root / "scripts/study.py").write_text(
        "import signal\n"
        "from pathlib import Path\n"
        "done = Path('results/study/study.md')\n"
        "if Path('rows').exists():\n"
        "    done.parent.mkdir(parents=True)\n"
        "    done.write_text('done')\n"
        "else:\n"
        "    Path('rows').touch()\n"
        f"    Path({str(root / 'begun')!r}).write_text('now')\n"
        "    signal.pause()\n"
    )

    def interrupt():
        (root / "begun").read_text()
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    before = signal.getsignal(signal.SIGTERM)
    try:
        thread.start()
        assert run(root) == 130
        thread.join()
        assert "study: stopped; the same command continues" in capsys.readouterr().err
        assert run(root) == 0
    finally:
        signal.signal(signal.SIGTERM, before)


def test_outside_data_is_asked_for(root, capsys):
    study = replace(STUDY, commands=("python scripts/study.py PROBLEMS",))
    assert run(root, study=study) == 1
    assert capsys.readouterr().out == "study: never recorded; left out, since it needs --problems\n"
    run(root, "--problems", "some", study=study)
    assert run(root, "--problems", "some", study=study) == 0
    assert f"['{Path('some').resolve()}']" in (root / "results/reference/study.md").read_text()
    assert "Made by `python scripts/study.py PROBLEMS`" in (root / "results/reference/study.md").read_text()
    with pytest.raises(SystemExit):
        run(root, "stdy", study=study)
    assert "no study 'stdy'; studies are: study" in capsys.readouterr().err


def test_each_committed_result_is_of_a_study_and_each_root_is_there():
    owned = {name for study in reference.STUDIES.values() for name in study.outputs}
    assert {path.name for path in (ROOT / reference.REFERENCE).iterdir()} - {"made.json"} == owned
    for name, study in reference.STUDIES.items():
        for root in study.roots:
            path = ROOT / ("" if root.startswith("lieednn_sim.") else "scripts") / root.replace(".", "/")
            assert path.is_dir() or path.with_name(f"{path.name}.py").is_file(), name
        assert f"| `{name}` |" in (ROOT / "docs/development/references.md").read_text(encoding="utf-8")
