"""Committed results: each is of a study, is made by one command, and is compared with a sample by numbers."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import reference

from lieednn_sim.versions import commit, versions

ROOT = Path(reference.__file__).parents[1]
PAGE = """# Study

## Motions

| arm | planner | made | planning [s] | final [mm] |
| --- | --- | --- | ---: | ---: |
| crane | dmp | 3 of 3 | 0.5 | {} |
| crane | fabric | 2 of 3 | 0.7 | 2.5 / 3 |
| all | all | 5 of 6 | 0.7 | 2.5 / 3 |
"""
SCRIPT = """
import sys
from pathlib import Path
page = Path("results/study/study.md")
page.parent.mkdir(parents=True, exist_ok=True)
if not Path("begun").exists() and "die" in sys.argv:
    Path("begun").touch()
    sys.exit("no more paper")
page.write_text(Path(__file__).with_name("page.md").read_text())
"""
STUDY = {
    "commands": ["python scripts/study.py"],
    "outputs": {"study.md": "results/study/study.md"},
    "sample": ["python scripts/study.py"],
    "compared": {"results/study/study.md": "study.md"},
    "keys": 2,
}


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A checkout with one study, whose page is as the file beside its script."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "results/reference").mkdir(parents=True)
    (tmp_path / "scripts/study.py").write_text(SCRIPT)
    (tmp_path / "scripts/page.md").write_text(PAGE.format("0.25"))
    (tmp_path / "results/reference/made.json").write_text('{"studies": {}}')
    monkeypatch.setattr(reference, "ROOT", tmp_path)
    monkeypatch.setattr(reference, "REFERENCE", tmp_path / "results/reference")
    monkeypatch.setattr(reference, "STUDIES", {"study": STUDY})
    return tmp_path


def test_a_study_is_made_recorded_and_checked(root, capsys):
    assert reference.main(["study"]) == 0
    record = json.loads((root / "results/reference/made.json").read_text())["studies"]["study"]
    made = f"Made by `python scripts/study.py`, {record['date']} with "
    made += ", ".join(f"{name} {version}" for name, version in versions(optional=True).items())
    assert (root / "results/reference/study.md").read_text() == f"{PAGE.format('0.25')}\n{made}.\n"
    assert (record["versions"], record["commit"]) == (versions(optional=True), commit())
    assert (record["jobs"], record["outputs"]) == (1, ["study.md"])
    assert record["cpu_s"] > 0.0
    assert not (root / "results/making/study").exists()
    assert reference.main(["--check"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("study: as committed (")
    (root / "scripts/page.md").write_text(PAGE.format("0.26"))
    assert reference.main(["--check", "study"]) == 1
    said = capsys.readouterr().out
    assert "study: differs from what is committed: (" in said
    assert "\n  study.md, crane, dmp, final [mm]: 0.25, now 0.26\n" in said


def test_a_study_that_stopped_goes_on(root, capsys, monkeypatch):
    monkeypatch.setitem(reference.STUDIES, "study", {**STUDY, "commands": ["python scripts/study.py die"]})
    assert reference.main(["study"]) == 1
    assert "study.py die failed with status 1:\nno more paper" in capsys.readouterr().out
    assert not (root / "results/reference/study.md").exists()
    assert reference.main(["study"]) == 0
    assert (root / "results/reference/study.md").exists()


def test_samples_of_means_have_files_of_their_own(root, capsys, monkeypatch):
    monkeypatch.setitem(
        reference.STUDIES, "study", {**STUDY, "compared": {"results/study/study.md": "samples/study.md"}}
    )
    assert reference.main(["--update", "study"]) == 0
    assert (root / "results/reference/samples/study.md").read_text().startswith(PAGE.format("0.25"))
    (root / "scripts/page.md").write_text(PAGE.format("7"))
    assert reference.main(["--check", "study"]) == 1
    assert "now 7" in capsys.readouterr().out


def test_what_cannot_be_made_is_said(root, capsys, monkeypatch):
    monkeypatch.setitem(reference.STUDIES, "other", {**STUDY, "sample": ["python scripts/study.py PROBLEMS"]})
    monkeypatch.setitem(reference.STUDIES, "third", {"commands": ["python scripts/gone.py"], "outputs": {}})
    assert reference.main(["--check", "other", "third"]) == 0
    said = capsys.readouterr().out
    assert "other: left out, it needs --data PROBLEMS=... (" in said
    assert "third: left out, it has no sample (" in said
    assert reference.main(["third"]) == 1
    assert "third: python scripts/gone.py failed with status 2" in capsys.readouterr().out
    for words, message in ((["stdy"], "no study 'stdy'; studies are: study"), ([], "name what to make, of study")):
        with pytest.raises(SystemExit):
            reference.main(words)
        assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("0.7 | 2.5 / 3 |\n| all", "9.9 | 2.51 / 3 |\n| all", []),
        ("| all | all | 5 of 6", "| all | all | 9 of 9", []),
        ("| 1e-06 |", "| 3e-05 |", []),
        ("2.5 / 3 |\n| all", "2.5 / 4 |\n| all", ["crane, fabric, final [mm]: 2.5 / 3, now 2.5 / 4"]),
        ("2 of 3", "2 of 4", ["crane, fabric, made: 2 of 3, now 2 of 4"]),
        ("1e-06 |", "- |", ["crane, dmp, final [mm]: 1e-06, now -"]),
        ("| fabric", "| mppi", ["crane, mppi: no such row is committed"]),
        ("## Motions", "## Tracking", [f"crane, {name}: no such row is committed" for name in ("dmp", "fabric")]),
        (
            "final [mm]",
            "final [m]",
            [f"crane, {name}: other columns: ['final [m]', 'final [mm]']" for name in ("dmp", "fabric")],
        ),
    ],
)
def test_rows_are_compared_by_their_keys_but_for_times(tmp_path, old, new, said):
    committed, sample, page = tmp_path / "study.md", tmp_path / "sample.md", PAGE.format("1e-06")
    assert old in page
    committed.write_text(page)
    sample.write_text(page.replace(old, new))
    assert reference.differences(sample, committed, 2) == [f"study.md, {words}" for words in said]


def test_rows_of_a_csv_file(tmp_path):
    (tmp_path / "a.csv").write_text("name,final_mm\nlink 1,1.0\n")
    (tmp_path / "b.csv").write_text("name,final_mm\nlink 1,1.2\n")
    assert reference.differences(tmp_path / "a.csv", tmp_path / "a.csv", 1) == []
    assert reference.differences(tmp_path / "b.csv", tmp_path / "a.csv", 1) == ["a.csv, link 1, final_mm: 1.0, now 1.2"]


def test_each_committed_result_is_of_a_study_and_each_sample_has_rows_to_compare_with():
    studies = reference.STUDIES
    files = {path.name for path in reference.REFERENCE.iterdir()} - {"made.json", "studies.toml", "samples"}
    assert files == {name for study in studies.values() for name in study["outputs"]}
    samples = {path.name for path in (reference.REFERENCE / "samples").iterdir()}
    compared = {name for study in studies.values() for name in study.get("compared", {}).values()}
    assert samples == {name.removeprefix("samples/") for name in compared if name.startswith("samples/")}
    record = json.loads((reference.REFERENCE / "made.json").read_text(encoding="utf-8"))["studies"]
    assert record.keys() <= studies.keys()
    page = (ROOT / "docs/development/references.md").read_text(encoding="utf-8")
    for name, study in studies.items():
        assert f"| `{name}` |" in page
        assert bool(study.get("sample")) == bool(study.get("compared"))
        for committed in study.get("compared", {}).values():
            rows = list(reference.rows_of(reference.REFERENCE / committed, study["keys"]))
            assert rows, committed
            assert any(not reference.TIMED.search(head) for head in rows[0][1])
