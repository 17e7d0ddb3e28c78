"""Shards of a comparison: cases are dealt for good, and what is merged is what one machine would have made."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from lieednn_sim.cli import main
from lieednn_sim.errors import InputError
from lieednn_sim.studies import Case, Comparison, Row
from lieednn_sim.studies.comparison.study import Shard, merge

WORDS = ["--arms", "telescopic_pr", "--scenes", "free", "--planners", "minimum-jerk,lieednn-trained", "--seeds", "5"]
WORDS += ["--slow-seeds", "2", "--controllers", "mocap,computed-torque", "--jobs", "1", "--output"]


@pytest.fixture(autouse=True)
def invented(monkeypatch):
    """Rows whose numbers follow from the case, but for a planning time that is another each time."""
    clock = itertools.count()

    def run(case, controllers, settings):
        where = case.arm, case.scene, case.planner
        spent, reason = float(next(clock)), "" if case.seed % 3 else "contact: 3 mm deep"
        return [
            Row(*where, name, case.seed, 1.0, reason, planning_s=spent, gap_mm=1.0 / (1 + case.seed))
            for name in controllers
        ]

    monkeypatch.setattr(Comparison, "run", staticmethod(run))


@pytest.fixture
def shards(tmp_path):
    folders = [tmp_path / f"shard{number}" for number in (1, 2, 3)]
    for number, folder in enumerate(folders, start=1):
        assert main(["compare", *WORDS, str(folder), "--shard", f"{number}/3"]) == 0
        assert {path.name for path in folder.iterdir()} == {"comparison.sqlite", "lieednn_sim.json"}
    return folders


def untimed(folder):
    return [replace(row, planning_s=None) for row in Comparison.read(folder).rows.values()]


def test_which_shard_has_a_case_depends_on_its_name_alone():
    # The first 8 bytes of its SHA-256 are 0x825e7b6ff1eb909f, 2 modulo 5.
    case = Case("telescopic_pr", "free", "minimum-jerk", 0)
    assert [number for number in range(1, 6) if Shard(number, 5).holds(case)] == [3]


def test_shards_merge_to_the_table_of_one_machine(shards, tmp_path, capsys, undrawn):
    one, out = tmp_path / "one", tmp_path / "out"
    assert main(["compare", *WORDS, str(one), "--views", "0"]) == 0
    assert main(["compare", "--merge", *map(str, shards), "--output", str(out)]) == 0
    assert f"wrote in {out}: comparison.sqlite" in capsys.readouterr().out
    assert untimed(one) == untimed(out)
    assert len(untimed(out)) == 14
    # Fewer seeds are told; and what is merged again, or was made in another order, is the same.
    text = (out / "comparison.md").read_text(encoding="utf-8")
    assert "Planners have 5 seeds; these have fewer, so their rows say less: lieednn-trained 2." in text
    assert "| lieednn-trained | mocap | 1 of 2 |" in text
    page = (out / "comparison.html").read_text(encoding="utf-8")
    assert "2 to 5 seeds: 14 attempts" in page
    assert merge(out, [*reversed(shards), one, out]).rows == Comparison.read(out).rows
    assert untimed(one) == untimed(out)
    # A merged table is a table as any other: nothing of it is computed again.
    before = Comparison.read(out).rows
    assert main(["compare", *WORDS, str(out), "--views", "0"]) == 0
    assert Comparison.read(out).rows == before


def test_shards_grow_one_table_and_what_one_lacks_is_added_later(shards, tmp_path, undrawn):
    out = tmp_path / "out"
    for number in (1, 3):
        assert main(["compare", *WORDS, str(out), "--shard", f"{number}/3"]) == 0
    assert len(merge(out, shards[:1]).rows) == len(untimed(shards[0])) + len(untimed(shards[2]))
    assert main(["compare", *WORDS, str(out), "--views", "0"]) == 0
    assert len(untimed(out)) == 14


def test_what_does_not_belong_together_is_refused(shards, tmp_path, capsys, undrawn):
    words = ["compare", "--output", str(tmp_path / "out"), "--merge"]
    assert main([*words, str(tmp_path)]) == 2
    assert f"no such file: {tmp_path / 'comparison.sqlite'}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main([*words, str(shards[0]), "--shard", "1/3"]) == 2
    assert "--shard makes only a part of the table" in capsys.readouterr().err
    with pytest.raises(InputError, match="nothing to merge"):
        merge(tmp_path / "none", [])


@pytest.mark.parametrize("text", ["0/3", "4/3", "1/0", "1", "a/b", "1/2/3", "\N{ARABIC-INDIC DIGIT ONE}/3"])
def test_shards_that_do_not_exist_are_refused(text):
    with pytest.raises(InputError, match="shard"):
        Shard.parse(text)
