"""Files and folders of results: whole or not there, and nothing is replaced or removed that is not ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lieednn_sim.cli import main
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import (
    atomic_path,
    atomic_paths,
    check_outputs,
    fingerprint,
    load_arrays,
    load_json,
    locked,
    make_directory,
    output_folder,
    save_arrays,
    save_json,
)
from lieednn_sim.io.writing import MARK
from lieednn_sim.validation import as_path

ARRAYS = {
    "x": np.random.default_rng(0).normal(size=(3, 2)),
    "edge": np.array([0.0, -0.0, 5e-324, np.finfo(float).max, np.nan, np.inf]),
    "names": np.array(["Gelenk ä", "b"]),
    "empty": np.zeros((0, 6)),
}
META = {"gamma": 0.1 + 0.2, "text": "ü", "list": [1, None, True]}


def names(directory):
    return sorted(path.name for path in directory.iterdir())


def test_round_trip_is_bit_exact(tmp_path):
    save_arrays(tmp_path / "x.npz", "thing", ARRAYS, META)
    arrays, meta = load_arrays(tmp_path / "x.npz", "other", "thing")
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert (arrays[name].dtype, arrays[name].shape) == (array.dtype, array.shape)
        assert arrays[name].tobytes() == array.tobytes()
    assert {key: meta[key] for key in META} == META
    save_json(tmp_path / "x.json", META)
    assert load_json(tmp_path / "x.json", "thing") == META


def test_a_fingerprint_is_of_the_content_and_not_of_its_order():
    whole = fingerprint(ARRAYS, META)
    assert fingerprint(dict(reversed(ARRAYS.items())), dict(reversed(META.items()))) == whole
    for change in (np.nextafter(ARRAYS["x"], 9.0), ARRAYS["x"].reshape(2, 3), ARRAYS["x"].astype(">f8")):
        assert fingerprint({**ARRAYS, "x": change}, META) != whole
    assert fingerprint(ARRAYS, {**META, "gamma": 0.3}) != whole


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, OSError])
def test_failing_write_keeps_the_old_file_and_leaves_no_other(tmp_path, failure):
    path = tmp_path / "x.txt"
    path.write_text("old")

    def write():
        with atomic_path(path) as temporary, temporary.open("w") as stream:
            stream.write("half of the new")
            stream.flush()
            raise failure("disk on fire")

    with pytest.raises(FileError if failure is OSError else failure, match="disk"):
        write()
    for arrays, meta in (({"x": np.array([object()])}, {}), ({}, {"gamma": float("nan")})):
        with pytest.raises(ValueError, match=r"Object arrays|JSON"):
            save_arrays(tmp_path / "x.npz", "thing", arrays, meta)
    assert names(tmp_path) == ["x.txt"]
    assert path.read_text() == "old"


def test_temporary_file_is_beside_the_target_with_its_suffix_and_ordinary_permissions(tmp_path):
    (tmp_path / "ordinary").touch()
    with atomic_path(tmp_path / "film.mp4") as temporary:
        assert (temporary.parent, temporary.suffix) == (tmp_path, ".mp4")
        temporary.write_bytes(b"film")
        assert not (tmp_path / "film.mp4").exists()
    assert (tmp_path / "film.mp4").read_bytes() == b"film"
    assert (tmp_path / "film.mp4").stat().st_mode == (tmp_path / "ordinary").stat().st_mode
    assert not temporary.exists()
    longest = tmp_path / ("x" * 251 + ".npz")
    with atomic_path(longest):
        pass
    assert longest.exists()


def test_unwritable_places_are_named(tmp_path):
    with pytest.raises(FileError, match=r"cannot write .*x\.npz: No such file or directory"):
        save_arrays(tmp_path / "missing" / "x.npz", "thing", ARRAYS, {})
    with pytest.raises(FileError, match=r"x\.txt: the file name must end in \.npz"):
        save_arrays(tmp_path / "x.txt", "thing", ARRAYS, {})
    (tmp_path / "file").touch()
    with pytest.raises(FileError, match=r"cannot create directory .*file"):
        make_directory(tmp_path / "file")
    with pytest.raises(FileError, match="cannot write"):
        save_json(tmp_path / "file" / "x.json", {})
    assert make_directory(tmp_path / "a" / "b") == make_directory(tmp_path / "a" / "b")


@pytest.mark.parametrize(
    "name",
    ["", b"", "a\0b", "\ud800", b"bytes", 3, "x" * 256, "é" * 128, "/".join(["x" * 200] * 21), "x/" * 2047 + "xy"],
)
def test_names_that_are_no_paths_are_refused(name):
    with pytest.raises(InputError, match="the name of a directory"):
        make_directory(name)


@pytest.mark.parametrize(
    "name", [".", "x" * 255, "é" * 127, "x/" * 2047 + "x", Path("a") / "b", "\udcff"], ids=range(6)
)
def test_names_that_are_paths_pass(name):
    assert as_path("path", name) == Path(name)


def test_outputs_are_checked_before_the_work(tmp_path):
    (tmp_path / "plot.png").mkdir()
    check_outputs([tmp_path / "other.png"])
    for path, words in (
        (tmp_path / "plot.png", "is a directory"),
        (Path("/dev/null"), "is not a regular file"),
        (tmp_path / "missing" / "x.png", "there is no directory"),
        (tmp_path / ("x" * 300), "name too long"),
    ):
        with pytest.raises(FileError, match=f"(?i)cannot write .*{words}"):
            check_outputs([tmp_path / "other.png", path])


def test_one_process_at_a_time_is_at_work_in_a_directory(tmp_path):
    # Locks belong to the opened directory: the same process stands for two.
    with locked(tmp_path):
        for shared in (False, True):
            with pytest.raises(FileError, match="another lieednn-sim is at work in"), locked(tmp_path, shared=shared):
                pass
    with (
        locked(tmp_path, shared=True),
        locked(tmp_path, shared=True),
        pytest.raises(FileError, match="at work"),
        locked(tmp_path),
    ):
        pass
    assert names(tmp_path) == []


def test_files_that_belong_together_appear_in_order_after_what_they_outdate_is_gone(tmp_path, monkeypatch):
    """Whenever the process dies, new and old are never there side by side."""
    paths = [tmp_path / name for name in ("old", "a", "b")]
    real = {name: getattr(type(tmp_path), name) for name in ("unlink", "replace")}
    for deadly in range(4):
        for path in paths:
            path.write_text("old")
        left = [deadly]

        def mortal(name, left=left):
            def call(self, *arguments, **options):
                if left[0] == 0:
                    raise KeyboardInterrupt
                left[0] -= 1
                return real[name](self, *arguments, **options)

            return call

        for name in real:
            monkeypatch.setattr(type(tmp_path), name, mortal(name))
        try:
            with atomic_paths(paths[1:], outdated=paths[:1]) as temporaries:
                for path in temporaries:
                    path.write_text("new")
        except KeyboardInterrupt:
            pass
        monkeypatch.undo()
        found = {path.name: path.read_text() for path in paths if path.exists()}
        assert (
            found
            == [
                {"old": "old", "a": "old", "b": "old"},
                {"a": "old", "b": "old"},
                {"a": "new", "b": "old"},
                {"a": "new", "b": "new"},
            ][deadly]
        )


def test_a_folder_is_new_or_empty_or_ours_for_the_same_purpose(tmp_path):
    folder = tmp_path / "a" / "b"
    for number in range(2):
        with output_folder(folder, "run") as path:
            assert path == folder
            (folder / "x").write_text(str(number))
        # What somebody else put there meanwhile stays.
        (folder / "notes.txt").write_text("mine")
    assert names(folder) == [MARK, "notes.txt", "x"]
    assert load_json(folder / MARK, "mark") == {"holds": "run"}
    with (
        pytest.raises(FileError, match=r"b is for another purpose \(run, not table\); choose another directory"),
        output_folder(folder, "table"),
    ):
        pass
    (tmp_path / "mine").mkdir()
    for name in ("x", ".hidden"):
        (tmp_path / "mine" / name).write_text("mine")
    with (
        pytest.raises(FileError, match=r"mine holds files that no command of this package made \(\.hidden and 1 more"),
        output_folder(tmp_path / "mine", "run"),
    ):
        pass
    assert names(tmp_path / "mine") == [".hidden", "x"]
    for content in ("[]", "\0", '{"holds": ["run"]}', "{}"):
        (folder / MARK).write_text(content)
        with pytest.raises(FileError, match=f"{MARK} is not a valid|another purpose"), output_folder(folder, "run"):
            pass
        assert (folder / MARK).read_text() == content


@pytest.mark.parametrize("there", [False, True])
def test_work_that_fails_before_it_made_a_file_leaves_no_folder_of_its_own(tmp_path, there):
    if there:
        (tmp_path / "a" / "b").mkdir(parents=True)

    def work(*made):
        with output_folder(tmp_path / "a" / "b", "run") as folder:
            for name in made:
                (folder / name).touch()
            raise ValueError("no luck")

    with pytest.raises(ValueError, match="no luck"):
        work()
    assert [path.name for path in tmp_path.rglob("*")] == (["a", "b"] if there else [])
    for made in (["x"], []):
        with pytest.raises(ValueError, match="no luck"):
            work(*made)
        assert names(tmp_path / "a" / "b") == [MARK, "x"]


def test_what_a_killed_command_left_half_written_is_removed_by_the_next(tmp_path):
    """Even where it was killed before the folder was marked; but not while others may be writing it."""
    left, mine = [".x.unfinished-a1b2c3d4.npz", f".{MARK}.unfinished-a1b2c3d4"], [".mine.npz", "y.unfinished-a1b2c3d4"]
    for name in left:
        (tmp_path / name).touch()
    left.append(".export.unfinished-a1b2c3d4")
    (tmp_path / left[-1] / "data").mkdir(parents=True)
    with output_folder(tmp_path, "run", shared=True):
        assert names(tmp_path) == sorted([*left, MARK])
    for name in mine:
        (tmp_path / name).touch()
    with output_folder(tmp_path, "run"):
        assert names(tmp_path) == sorted([*mine, MARK])


PLAN = ["--target", "random:3", "--planner", "linear-attractor", "--duration", "3"]


@pytest.mark.parametrize(
    "words",
    [
        ["plan", *PLAN],
        ["demo", "--no-page", "--no-video", *PLAN],
        ["train", "--target", "extended"],
        ["learn", "joints.csv", "--arm", "telescopic_pr"],
        ["learn", "way.csv"],
        ["compare", "--planners", "minimum-jerk", "--seeds", "1", "--reactive", "1"],
    ],
    ids=" ".join,
)
def test_a_folder_of_others_survives_every_command(tmp_path, monkeypatch, capsys, words):
    """Which is refused before any work."""
    monkeypatch.chdir(tmp_path)
    t = np.linspace(0.0, 1.0, 50)
    np.savetxt("way.csv", np.column_stack([t, 0.3 * (1.0 - t), 0.1 * np.sin(np.pi * t)]), delimiter=",")
    np.savetxt("joints.csv", np.column_stack([t, 0.3 * t * t * (3.0 - 2.0 * t), np.zeros((50, 7))]), delimiter=",")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "network.npz").write_bytes(b"mine")
    for name in ("planning.plan_motion", "training._train", "comparison.compute"):
        monkeypatch.setattr(f"lieednn_sim.cli.{name}", lambda *_, **__: pytest.fail("the work began"))
    assert main([*words, "--output", "out"]) == 2
    assert "out holds files that no command of this package made (network.npz)" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == {"network.npz": b"mine"}
