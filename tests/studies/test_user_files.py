"""Arms and scenes of files in a comparison: named, told what was found, loaded by workers, never mixed with others."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from lieednn_sim import io
from lieednn_sim.arm import Arm, targets
from lieednn_sim.cli import main
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import load_description
from lieednn_sim.studies import Case, Comparison, Settings, compute, replay
from lieednn_sim.studies import study as workers
from lieednn_sim.studies.comparison import case
from lieednn_sim.studies.comparison.study import Shard, merge
from lieednn_sim.studies.rows import grouped
from lieednn_sim.studies.study import worker_pool
from lieednn_sim.studies.user_files import SCENE, load, resolve

POST = {"shape": "box", "name": "post", "size": [0.1, 0.1, 2.0], "position": [0.0, 0.0, 1.2]}
QUICK = Settings(duration=1.5, hold=0.2)
WORDS = "--planners minimum-jerk --controllers position-servo --seeds 1 --duration 1.5 --hold 0.2 --jobs 2"
PLAIN, LINKED = "two", "two(one,tool)"


@pytest.fixture
def folder(tmp_path, monkeypatch, two_hinges):
    (tmp_path / "two.xml").write_text(two_hinges)
    (tmp_path / "post.json").write_text(json.dumps({"obstacles": [POST]}))
    monkeypatch.chdir(tmp_path)
    # A planner's network that is made ahead for each arm, and that nobody needs here.
    monkeypatch.setattr(case, "reference_network", lambda arm: None)
    return tmp_path


def chosen(*arms, scenes=("free",)):
    return Comparison(("minimum-jerk",), arms, scenes, ("position-servo",), seeds=1)


def test_files_go_the_whole_way_through_workers_into_table_and_page(folder, capsys, undrawn, monkeypatch):
    # One is enough, though another number asks for workers.
    monkeypatch.setattr(workers, "worker_pool", lambda _: worker_pool(1))
    # The arm's home is at the height of its base, where targets in the scene are hard to find above a floor.
    (folder / "post.json").write_text(json.dumps({"floor": "none", "obstacles": [POST]}))
    words = "compare --arms two.xml,two.xml:one,tool --scenes free,post.json --output out"
    assert main([*words.split(), *WORDS.split()]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"arm {LINKED}: 2 links, 2 joints, from {folder}/two.xml:one,tool" in printed
    assert f"{LINKED}, imported from two.xml" in printed
    assert f"scene post: 1 box; targets anywhere, from {folder}/post.json" in printed
    table = Comparison.read("out")
    reasons = {group.key: group.rows[0].reason for group in grouped(table.rows.values(), ("arm", "scene"))}
    assert reasons == {(arm, scene): "" for arm in (PLAIN, LINKED) for scene in ("free", "post")}
    assert (folder / "out" / "comparison.html").read_text().count(f'data-arm="{LINKED}" data-scene="post"') == 1
    assert f"| {LINKED} | post | minimum-jerk | 1 of 1 |" in (folder / "out" / "comparison.md").read_text()
    # A case is made again from what the directory says.
    case = Case(LINKED, "post", "minimum-jerk", 0)
    rollout = replay(case, "position-servo", QUICK, user_files=table.user_files)
    assert (rollout.arm.name, rollout.arm.scene) == (LINKED, "post")
    assert rollout.arm.fingerprint == Arm.load("two.xml:one,tool", scene="post.json").fingerprint


def test_an_arm_that_finds_no_target_in_a_scene_is_a_row(folder, monkeypatch):
    monkeypatch.setattr(targets, "_ATTEMPTS", 10)  # in vain with 400 as well
    selection = chosen("two.xml", scenes=("free", "shelf"))
    rows = compute(replace(selection, common=QUICK), "out").rows.values()
    assert {row.scene: row.reason[:8] for row in rows} == {"free": "", "shelf": "problem:"}


def test_the_file_of_a_scene_is_read_once_for_its_arm(folder, monkeypatch):
    (folder / "post.json").write_text(json.dumps({"obstacles": [{**POST, "position": [2.0, 2.0, 1.2]}]}))
    _, (file,) = resolve(SCENE, ["post.json"], ())
    expected, read = Arm.load("telescopic_pr", "post.json"), []
    monkeypatch.setattr(io, "load_description", lambda *given: read.append(given) or load_description(*given))
    arm = load("telescopic_pr", "post", 0, (file,))
    assert (arm.fingerprint, arm.scene, len(read)) == (expected.fingerprint, "post", 1)
    (folder / "post.json").write_text(json.dumps({"obstacles": [POST]}))
    with pytest.raises(InputError, match=r"obstacle 'post' of scene 'post' is within 2 mm of .* at home"):
        load("telescopic_pr", "post", 0, resolve(SCENE, ["post.json"], ())[1])


def test_a_table_goes_on_with_the_same_files_and_refuses_others(folder, two_hinges):
    before = compute(replace(chosen("two.xml"), common=QUICK), "out").rows
    # Elsewhere, the same arm; and another beside it.
    (folder / "moved").mkdir()
    (folder / "two.xml").rename(folder / "moved" / "two.xml")
    selection = chosen("moved/two.xml", "moved/two.xml:tool", scenes=("free", "post.json"))
    table = compute(replace(selection, common=QUICK), "out")
    assert {key: table.rows[key] for key in before} == before
    assert len(table.rows) == 4
    (folder / "post.json").write_text(json.dumps({"obstacles": [{**POST, "position": [0.0, 0.1, 1.2]}]}))
    with pytest.raises(FileError, match=r"rows in out.* belong to another scene 'post' \(.* choose another"):
        compute(replace(chosen("moved/two.xml", scenes=("post.json",)), common=QUICK), "out")
    (folder / "two.xml").write_text(two_hinges.replace('pos="0.3 0 0"', 'pos="0.31 0 0"'))
    with pytest.raises(FileError, match=r"belong to another arm 'two' .* that of .*two.xml is"):
        compute(replace(chosen("two.xml"), common=QUICK), "out")
    # One that changes between the choice and the work is no other arm by the same name.
    late = chosen("two.xml")
    object.__setattr__(late, "user_files", tuple(file._replace(fingerprint="0" * 64) for file in late.user_files))
    (row,) = compute(replace(late, common=QUICK), "late").rows.values()
    assert "two.xml has changed since the comparison began" in row.reason
    late = chosen("two.xml", scenes=("post.json",))
    (folder / "post.json").write_text(json.dumps({"obstacles": [POST]}))
    (row,) = compute(replace(late, common=QUICK), "later").rows.values()
    assert "post.json has changed since the comparison began" in row.reason
    assert [file[:2] for file in Comparison.read("out").user_files] == [
        ("arm", "two"),
        ("arm", "two(tool)"),
        ("scene", "post"),
    ]


def test_shards_of_files_that_lie_elsewhere_merge_unless_they_make_another_arm(folder, two_hinges):
    for place, model in (
        ("here", two_hinges),
        ("there", two_hinges),
        ("other", two_hinges.replace("-90 90", "-80 90")),
    ):
        (folder / place).mkdir()
        (folder / place / "two.xml").write_text(model)
    for number, place in ((1, "here"), (2, "there"), (2, "other")):
        compute(
            replace(chosen(f"{place}/two.xml"), seeds=2, common=QUICK, shard=Shard(number, 2)),
            f"{place}/out",
        )
    merged = merge("merged", ["here/out", "there/out"])
    assert len(merged.rows) == 2
    assert [file.name for file in merged.user_files] == ["two"]
    with pytest.raises(FileError, match=r"mixed.* belong to another arm 'two' .* that of .*other/two.xml is"):
        merge("mixed", ["here/out", "other/out"])


@pytest.mark.parametrize(
    ("arms", "scenes", "error", "message"),
    [
        (["gone.xml"], ["free"], FileError, "no such file: .*gone.xml"),
        (["two.xml"], ["gone.json"], FileError, "no such file: .*gone.json"),
        (["two.xml:one,nothing"], ["free"], InputError, "nothing"),
        (["two.xml", "other/two.xml"], ["free"], InputError, "there is another arm 'two'; rename other/two.xml"),
        (["telescopic_pr.json"], ["free"], InputError, "another arm 'telescopic_pr'; rename telescopic_pr.json"),
        (["a:b.json"], ["free"], InputError, "no arm in a table can be called 'a:b'"),
        (["two.xml", "crane"], ["free"], InputError, "no arm 'crane'; allowed: telescopic_compound, .*, two"),
        ([3], ["free"], InputError, r"arms\[0\] must be a string, got 3"),
    ],
)
def test_files_that_cannot_enter_are_refused_before_the_work(folder, arms, scenes, error, message, two_hinges):
    (folder / "other").mkdir()
    (folder / "other" / "two.xml").write_text(two_hinges.replace("0.3", "0.4"))
    for name in ("telescopic_pr.json", "a:b.json"):
        (folder / name).write_text('{"model": "two.xml"}')
    with pytest.raises(error, match=message):
        chosen(*arms, scenes=scenes)
