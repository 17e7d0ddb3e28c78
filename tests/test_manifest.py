"""Nothing is replaced or removed that this package did not make, whatever the command and the name of the file."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lieednn_sim import storage
from lieednn_sim.cli import main
from lieednn_sim.cli.run_directory import PLOT_KINDS, RunDirectory
from lieednn_sim.errors import FileError
from lieednn_sim.manifest import Manifest
from lieednn_sim.studies import Comparison, Settings

RUN = sorted({path.name for kind in PLOT_KINDS for path in RunDirectory(".", kind).files})
TABLE = ["comparison.csv", "comparison.json", "comparison.md", "comparison.html"]
PLAN = ["--target", "random:3", "--planner", "linear-attractor", "--duration", "3"]
# Each command with the names of what it makes.
COMMANDS = {
    "plan": (["plan", *PLAN], RUN),
    "demo": (["demo", "--no-page", "--no-video", *PLAN], RUN),
    "train": (["train", "--target", "extended"], RUN),
    "learn --arm": (["learn", "joints.csv", "--arm", "telescopic_pr"], RUN),
    "learn": (["learn", "way.csv"], ["network.npz", "report.json", "paths.png", "field.png"]),
    "compare": (["compare", "--planners", "minimum-jerk", "--seeds", "1", "--reactive", "1"], [*TABLE, "reactions.md"]),
    "merge": (["compare", "--merge", "shard"], TABLE),
}
CASES = [(command, name) for command, (_, names) in COMMANDS.items() for name in [*names, "made.json"]]


@pytest.fixture
def no_work(monkeypatch, tmp_path):
    """The work itself fails, with another message than that of a command that is refused at the door."""

    def work(*_, **__):
        raise FileError("the work began")

    monkeypatch.chdir(tmp_path)
    for name in (
        "lieednn_sim.cli.planning.plan",
        "lieednn_sim.cli.training._train",
        "lieednn_sim.cli.joint_demonstrations.JointMotion.fit",
        "lieednn_sim.cli.demonstrations.ShapedMotion.fit",
        "lieednn_sim.cli.comparison.merge_shards",
        "lieednn_sim.cli.comparison.compute",
    ):
        monkeypatch.setattr(name, work)
    t = np.linspace(0.0, 1.0, 50)
    np.savetxt("way.csv", np.column_stack([t, 0.3 * (1.0 - t), 0.1 * np.sin(np.pi * t)]), delimiter=",")
    joints = np.zeros((50, 8))
    joints[:, 0] = 0.3 * t * t * (3.0 - 2.0 * t)
    np.savetxt("joints.csv", np.column_stack([t, joints]), delimiter=",")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.sampled_from(CASES), st.sampled_from([b"mine", b"", b"{}", b"PK\x05\x06"]))
def test_files_of_others_survive_every_command(no_work, tmp_path, capsys, case, content):
    command, name = case
    words, _ = COMMANDS[command]
    output = tempfile.mkdtemp(dir=tmp_path)
    mine = Path(output) / name
    mine.write_bytes(content)
    assert main([*words, "--output", output]) == 2
    assert mine.read_bytes() == content
    assert [path for path in Path(output).rglob("*") if path.is_file()] == [mine]
    # The table's own file is read by the work.
    if name.rpartition(".")[0] != "comparison" or name.endswith((".md", ".html")):
        assert mine.name in capsys.readouterr().err


def test_a_table_removes_no_videos_and_replaces_no_files(tmp_path):
    mine = tmp_path / "videos" / "holiday.mp4"
    mine.parent.mkdir()
    mine.write_bytes(b"mine")
    Comparison(common=Settings()).open(tmp_path / "other")
    for name in ("comparison.csv", "comparison.json"):
        (tmp_path / name).write_bytes(b"mine")
        with pytest.raises(FileError, match="comparison"):
            Comparison(common=Settings()).open(tmp_path)
        assert (tmp_path / name).read_bytes() == b"mine"
        (tmp_path / name).unlink()
    Comparison(common=Settings()).open(tmp_path)
    assert mine.read_bytes() == b"mine"


def test_what_was_edited_since_is_not_replaced(tmp_path):
    manifest, path, other = Manifest(tmp_path), tmp_path / "a" / "b.txt", tmp_path / "other.txt"
    path.parent.mkdir()
    for text in ("one", "two"):
        with manifest.writing(path, made_from=text) as temporary:
            temporary.write_text(text)
    assert (manifest.made_from(path), manifest.made_from(other)) == ("two", "")
    path.write_text("mine")
    for refused in (manifest.check, manifest.remove):
        with pytest.raises(FileError, match=r"b\.txt was changed after this package made it"):
            refused([path])
    # What came while the work went on is not replaced; nor is what belongs together with it.
    path.write_text("two")
    both = manifest.replacing([path, other])
    for temporary in both.__enter__():
        temporary.write_text("three")
    other.write_text("mine")
    with pytest.raises(FileError, match=r"other\.txt was not made by a command"):
        both.__exit__(None, None, None)
    assert (path.read_text(), other.read_text()) == ("two", "mine")
    # The same content may take its place.
    with manifest.writing(other) as temporary:
        temporary.write_text("mine")
    manifest.remove([path, other])
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("content", ["[]", "{}", '{"kind": "made files", "format": 1, "files": {"a": 1}}', "\0"])
def test_a_list_that_is_none_is_refused(tmp_path, content):
    manifest = Manifest(tmp_path)
    manifest.path.write_text(content)
    with pytest.raises(FileError, match=r"made\.json"):
        manifest.check([tmp_path / "a"])
    assert manifest.path.read_text() == content


def test_a_file_of_a_kind_may_be_rewritten(tmp_path):
    manifest, path = Manifest(tmp_path), tmp_path / "checkpoint.npz"
    manifest.expect(path, "training")
    for number in range(2):
        storage.save_arrays(path, "training", {"x": np.full(3, number)}, {})
        manifest.check([path])
    storage.save_arrays(path, "network", {"x": np.zeros(3)}, {})
    with pytest.raises(FileError, match="was changed after"):
        manifest.remove([path])


def test_a_process_that_is_killed_anywhere_leaves_only_files_that_are_ours(tmp_path, monkeypatch):
    class Killed(BaseException):
        pass

    real = {name: getattr(type(tmp_path), name) for name in ("unlink", "replace")}
    for deadly in range(20):
        manifest = Manifest(tmp_path / str(deadly))
        manifest.directory.mkdir()
        paths = [manifest.directory / name for name in ("a", "b")]
        with manifest.replacing(paths) as made:
            for temporary in made:
                temporary.write_text("old")
        steps = iter(range(deadly))

        def mortal(name, steps=steps):
            def call(self, *arguments, **options):
                if next(steps, None) is None:
                    raise Killed
                return real[name](self, *arguments, **options)

            return call

        finished = False
        with monkeypatch.context() as patch:
            for name in real:
                patch.setattr(type(tmp_path), name, mortal(name))
            try:
                with manifest.replacing([paths[0]], [paths[1]]) as (temporary,):
                    temporary.write_text("new")
                finished = True
            except Killed:
                pass
        manifest.check(paths)
        if finished:
            break
    assert finished
    assert deadly > 3
