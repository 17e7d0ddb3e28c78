"""Shards of a comparison: cases are dealt for good, and what is merged is what one machine would have made."""

from __future__ import annotations

import csv
import itertools
import json
import shutil

import pytest

from lieednn_sim.cli import main
from lieednn_sim.errors import InputError
from lieednn_sim.studies import Case, Row, read_rows
from lieednn_sim.studies.comparison.study import Shard
from lieednn_sim.studies.table import checksum

WORDS = ["--arms", "telescopic_pr", "--scenes", "free", "--planners", "minimum-jerk,se3-geodesic", "--seeds", "5"]
WORDS += ["--controllers", "mocap,computed-torque", "--output"]


@pytest.fixture(autouse=True, scope="module")
def invented(in_this_process):
    """Rows whose numbers follow from the case, but for a planning time that is another each time."""
    clock = itertools.count()

    def run(case, controllers, settings):
        where = case.arm, case.scene, case.planner
        spent, reason = float(next(clock)), "" if case.seed % 3 else "contact: 3 mm deep"
        return [
            Row(*where, name, case.seed, 1.0, reason, planning_s=spent, gap_mm=1.0 / (1 + case.seed))
            for name in controllers
        ]

    with pytest.MonkeyPatch.context() as patch, in_this_process():
        patch.setattr("lieednn_sim.studies.comparison.study.run_case", run)
        yield


@pytest.fixture(scope="module")
def made(invented, tmp_path_factory):
    directory = tmp_path_factory.mktemp("shards")
    for number in (1, 2, 3):
        folder = directory / f"shard{number}"
        assert main(["compare", *WORDS, str(folder), "--shard", f"{number}/3"]) == 0
        assert {path.name for path in folder.iterdir()} == {"comparison.csv", "comparison.json", "lieednn_sim.json"}
    return directory


@pytest.fixture
def shards(made, tmp_path, undrawn):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return [tmp_path / f"shard{number}" for number in (1, 2, 3)]


def merge(output, *folders):
    return main(["compare", "--output", str(output), "--merge", *map(str, folders)])


def content(folder, *but):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in but}


def test_which_shard_has_a_case_depends_on_its_name_alone():
    # The first 8 bytes of its SHA-256 are 0x825e7b6ff1eb909f, 2 modulo 5.
    assert Shard.holding(Case("telescopic_pr", "free", "minimum-jerk", 0), 5) == Shard(3, 5)


def test_slow_planners_have_fewer_seeds_in_shards_too_and_reports_say_so(tmp_path, capsys, undrawn):
    words = [*WORDS[:4], "--planners", "minimum-jerk,lieednn-trained", "--seeds", "5", "--slow-seeds", "2", "--output"]
    shards = [tmp_path / "shard1", tmp_path / "shard2"]
    for number, folder in enumerate(shards, start=1):
        assert main(["compare", *words, str(folder), "--shard", f"{number}/2"]) == 0
    assert merge(tmp_path / "merged", *shards) == 0
    cases = {(row.planner, row.seed) for row in read_rows(tmp_path / "merged/comparison.csv", Row).values()}
    assert cases == {("minimum-jerk", seed) for seed in range(5)} | {("lieednn-trained", seed) for seed in range(2)}
    text = (tmp_path / "merged/comparison.md").read_text(encoding="utf-8")
    assert "Planners have 5 seeds, but lieednn-trained 2: rows" in text
    assert "| lieednn-trained | position-servo | 1 of 2 |" in text
    page = (tmp_path / "merged/comparison.html").read_text(encoding="utf-8")
    assert "2 to 5 seeds: 14 attempts" in page
    assert "but lieednn-trained 2: rows" in page


def test_shards_merge_to_the_table_of_one_machine_and_always_to_the_same_bytes(shards, tmp_path, capsys):
    one, out = tmp_path / "one", tmp_path / "out"
    assert main(["compare", *WORDS, str(one)]) == 0
    assert merge(out, *shards) == 0
    rows = [
        [{**row.as_texts(), "planning_s": ""} for row in read_rows(at / "comparison.csv", Row).values()]
        for at in (one, out)
    ]
    assert rows[0] == rows[1]
    assert len(rows[0]) == 20
    assert (one / "comparison.json").read_bytes() == (out / "comparison.json").read_bytes()
    first = content(out)
    assert merge(out, *shards) == 0
    assert content(out) == first
    # In another order, and with a shard that was also begun elsewhere, where it was slower.
    begun, words = tmp_path / "begun", ("comparison.html", "lieednn_sim.json")
    assert main(["compare", *WORDS, str(begun), "--shard", "2/3"]) == 0
    for name, folders in (("first", (begun, *reversed(shards))), ("last", (*shards, begun))):
        assert merge(tmp_path / name, *folders) == 0
        assert content(tmp_path / name, *words) == content(out, *words)
    # A merged table is a table as any other.
    assert main(["compare", *WORDS, str(out)]) == 0
    assert (out / "comparison.csv").read_bytes() == first["comparison.csv"]


def test_what_is_missing_is_said_and_added_later(shards, tmp_path, capsys):
    path = shards[0] / "comparison.csv"
    lines = path.read_text().splitlines(keepends=True)
    # Killed in the middle of its last line.
    path.write_text("".join(lines)[:-5])
    cases = [[row.case for row in read_rows(shard / "comparison.csv", Row).values()] for shard in shards]
    capsys.readouterr()
    assert merge(tmp_path / "out", *shards[:2]) == 1
    printed = capsys.readouterr().out
    assert f"shard 1/3 ({shards[0]}) lacks 1 cases, such as se3-geodesic:telescopic_pr:free:" in printed
    assert f"shard 3/3 (in no folder) lacks {len(set(cases[2]))} cases, such as {min(cases[2])}" in printed
    assert "shard 2/3" not in printed
    assert main(["compare", *WORDS, str(shards[0]), "--shard", "1/3"]) == 0
    # What the table holds already stays.
    assert merge(tmp_path / "out", shards[0], shards[2]) == 0
    assert len(read_rows(tmp_path / "out" / "comparison.csv", Row)) == 20


def edit(**changes):
    def change(folder):
        path = folder / "comparison.json"
        value = json.loads(path.read_text())
        for group, values in changes.items():
            value[group] |= values
        path.write_text(json.dumps(value))

    return change


def replaced(old, new):
    """Rows of other texts, as if they had been computed."""

    def change(folder):
        path = folder / "comparison.csv"
        with path.open(newline="") as stream:
            rows = [{name: text.replace(old, new) for name, text in row.items()} for row in csv.DictReader(stream)]
        write(path, rows)

    return change


def write(path, rows):
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        for row in rows:
            row.pop("checksum")
            writer.writerow({**row, "checksum": checksum(row)})


def spoil(path):
    path.write_text(path.read_text().replace(",contact: 3", ",contact: 4", 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edit(versions={"code": "0123456789ab"}), "shard2 belongs to another comparison: code 0123456789ab, in"),
        (edit(settings={"duration": 3.0}), "shard2 belongs to another comparison: duration 3.0, in"),
        (edit(part={"seeds": 4}), "shard2 belongs to another comparison: seeds 4, in"),
        (edit(part={"shards": 4}), "shard2 belongs to another comparison: shards 4, in"),
        (edit(part={"shard": 1}), "shard2 is shard 1/3, but holds the case"),
        (replaced("3 mm", "4 mm"), "begun and {0}/shard2 disagree on"),
        (replaced("yes", "perhaps"), "success is 'perhaps'"),
        (lambda folder: (folder / "comparison.json").unlink(), "cannot read"),
        (lambda folder: spoil(folder / "comparison.csv"), "line 2 was changed after it was written"),
    ],
)
def test_what_does_not_belong_together_is_refused(change, message, shards, tmp_path, capsys):
    shutil.copytree(shards[1], tmp_path / "begun")
    change(shards[1])
    assert merge(tmp_path / "out", shards[0], tmp_path / "begun", shards[1]) == 2
    assert message.format(tmp_path) in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_tables_that_are_no_shards_of_this_code_are_refused(shards, tmp_path, capsys):
    assert main(["compare", *WORDS, str(tmp_path / "whole")]) == 0
    assert merge(tmp_path / "out", tmp_path / "whole") == 2
    assert "whole holds no shard of a comparison" in capsys.readouterr().err
    for shard in shards:
        edit(versions={"numpy": "1.0"})(shard)
    assert merge(tmp_path / "out", *shards) == 2
    assert "shard1 was made with numpy 1.0, now" in capsys.readouterr().err
    # Nor does a whole comparison go on from a part, or a part from another.
    edit(versions={"numpy": json.loads((tmp_path / "whole" / "comparison.json").read_text())["versions"]["numpy"]})(
        shards[0]
    )
    for words in ([], ["--shard", "2/3"]):
        assert main(["compare", *WORDS, str(shards[0]), *words]) == 2
        assert f"comparison.csv was made with shard 1, now {2 if words else None}" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["0/3", "4/3", "1/0", "1", "a/b", "1/2/3", "\N{ARABIC-INDIC DIGIT ONE}/3"])
def test_shards_that_do_not_exist_are_refused(text):
    with pytest.raises(InputError, match="shard"):
        Shard.parse(text)
