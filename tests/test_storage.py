"""Files: what is written comes back bit by bit, what is broken says so, and nothing is ever half there."""

from __future__ import annotations

import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from lieednn_sim.errors import FileError, InputError
from lieednn_sim.filesystem import atomic_path, atomic_paths, atomic_text, check_outputs, locked, make_directory
from lieednn_sim.storage import load_arrays, load_json, origin, save_arrays, save_json, take
from lieednn_sim.validation import as_path

ARRAYS = {
    "x": np.random.default_rng(0).normal(size=(7, 4, 6)),
    "edge": np.array([0.0, -0.0, 5e-324, np.finfo(float).max, np.nan, np.inf]),
    "names": np.array(["Gelenk ä", "b"]),
    "empty": np.zeros((0, 6)),
}
META = {"gamma": 0.1 + 0.2, "text": "ü", "list": [1, None, True]}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "x.npz"
    save_arrays(path, "thing", ARRAYS, META)
    return path


def write_archive(path, header, **arrays):
    np.savez(path, meta_json=np.array(header), **arrays)


def test_round_trip_is_bit_exact(saved):
    arrays, meta = load_arrays(saved, "thing")
    assert arrays.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        assert arrays[name].shape == array.shape
        assert arrays[name].tobytes() == array.tobytes()
    assert {key: meta[key] for key in META} == META


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04", b"\x93NUMPY garbage", b"\x00" * 1000])
def test_what_is_no_archive_is_refused(tmp_path, content):
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"x\.npz is not a readable thing file"):
        load_arrays(path, "thing")


def test_truncated_files_are_refused(saved):
    content = saved.read_bytes()
    for length in range(0, len(content), 53):
        saved.write_bytes(content[:length])
        with pytest.raises(FileError, match="is not a readable thing file"):
            load_arrays(saved, "thing")


def test_any_flipped_byte_is_refused_or_harmless(saved):
    content = saved.read_bytes()
    refused = 0
    for position in range(len(content)):
        flipped = bytearray(content)
        flipped[position] ^= 0x55
        saved.write_bytes(flipped)
        try:
            arrays, meta = load_arrays(saved, "thing")
        except FileError:
            refused += 1
        else:  # time stamps and the like
            assert meta["gamma"] == META["gamma"]
            assert {name: array.tobytes() for name, array in arrays.items()} == {
                name: array.tobytes() for name, array in ARRAYS.items()
            }
    assert refused > len(content) / 2


@pytest.mark.parametrize("around", [(b"", b"x"), (b"", b"\0" * 30), (b"PK\x03\x04", b""), (b"x" * 100, b"")])
def test_garbage_around_an_archive_is_refused(saved, around):
    saved.write_bytes(around[0] + saved.read_bytes() + around[1])
    with pytest.raises(FileError, match="something is missing, or was added"):
        load_arrays(saved, "thing")
    with pytest.raises(FileError, match="something is missing, or was added"):
        origin(saved)


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays | {"x": np.nextafter(arrays["x"], 9.0)},
        lambda arrays: arrays | {"x": arrays["x"].reshape(4, 7, 6)},
        lambda arrays: arrays | {"edge": arrays["edge"].astype(">f8")},
        lambda arrays: arrays | {"more": np.zeros(1)},
        lambda arrays: {name: array for name, array in arrays.items() if name != "x"},
        lambda arrays: arrays | {"meta_json": np.array(str(arrays["meta_json"]).replace("0.30000000000000004", "0.3"))},
    ],
)
def test_what_was_changed_after_it_was_written_is_refused(saved, change):
    with np.load(saved) as archive:
        arrays = dict(archive)
    np.savez(saved, **arrays)
    load_arrays(saved, "thing")
    np.savez(saved, **change(arrays))
    with pytest.raises(FileError, match=r"x\.npz was changed after it was written"):
        load_arrays(saved, "thing")


def test_a_file_knows_what_it_was_made_from(saved, tmp_path):
    first, nothing = origin(saved)
    assert nothing == {}
    save_arrays(tmp_path / "y.npz", "child", ARRAYS, META, {"thing": first})
    second, made_from = origin(tmp_path / "y.npz")
    assert made_from == {"thing": first}
    assert second != first
    # The same content, the same fingerprint, whatever the order.
    backwards = [dict(reversed(values.items())) for values in (ARRAYS, META)]
    save_arrays(tmp_path / "z.npz", "child", *backwards, {"thing": first})
    assert origin(tmp_path / "z.npz") == (second, made_from)
    save_arrays(tmp_path / "z.npz", "child", ARRAYS, META, {"thing": second})
    assert origin(tmp_path / "z.npz")[0] != second


def test_pickles_are_never_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "exploded"),)

    pickled, inside = tmp_path / "pickle.npz", tmp_path / "inside.npz"
    pickled.write_bytes(pickle.dumps(Bomb()))
    np.savez(
        inside,
        meta_json=np.array(json.dumps({"kind": "thing", "format": 2, "fingerprint": "none"})),
        x=np.array([Bomb()]),
    )
    for path in (pickled, inside):
        with pytest.raises(FileError, match="is not a readable thing file"):
            load_arrays(path, "thing")
    assert not (tmp_path / "exploded").exists()


def test_a_single_array_is_not_an_archive(tmp_path):
    np.save(tmp_path / "x.npy", np.zeros(3))
    with pytest.raises(FileError, match="is not a readable thing file"):
        load_arrays(tmp_path / "x.npy", "thing")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ('{"kind": "motion", "format": 1}', "holds 'motion', expected 'thing'"),
        ("[1]", "holds None, expected 'thing'"),
        ("{}", "holds None, expected 'thing'"),
        ("{", "not a readable thing file"),
        ('{"kind": "thing", "format": 3}', r"newer version \(format 3 > 2\)"),
        ('{"kind": "thing", "format": 1}', "written by an older version, without a fingerprint"),
        ('{"kind": "thing", "format": 2}', "without a fingerprint"),
        ('{"kind": "thing", "format": 2, "fingerprint": "0"}', "was changed after it was written"),
        ("[" * 100_000, "not a readable thing file"),
        ('{"kind": "thing", "format": "two"}', "format"),
        ('{"kind": "thing", "format": null}', "format"),
    ],
)
def test_foreign_headers_are_refused(tmp_path, header, words):
    write_archive(tmp_path / "x.npz", header, x=np.zeros(3))
    with pytest.raises(FileError, match=words):
        load_arrays(tmp_path / "x.npz", "thing")


def test_archive_without_header_is_refused(tmp_path):
    np.savez(tmp_path / "x.npz", x=np.zeros(3))
    with pytest.raises(FileError, match="meta_json"):
        load_arrays(tmp_path / "x.npz", "thing")


def test_missing_file_and_directory_are_named(tmp_path):
    with pytest.raises(FileError, match=r"no such file: .*nowhere\.npz"):
        load_arrays(tmp_path / "nowhere.npz", "thing")
    with pytest.raises(FileError, match="is a directory, not a file"):
        load_arrays(tmp_path, "thing")


def test_take_names_what_is_missing_and_what_is_there():
    arrays = {"a": np.zeros(1), "b": np.ones(1)}
    assert take(arrays, "f.npz", "b", "a") == [arrays["b"], arrays["a"]]
    with pytest.raises(FileError, match=r"f\.npz has no array 'c'; it holds: a, b"):
        take(arrays, "f.npz", "a", "c")


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt, OSError])
def test_failing_write_keeps_the_old_file_and_leaves_no_other(tmp_path, failure):
    path = tmp_path / "x.txt"
    path.write_text("old")
    expected = FileError if failure is OSError else failure

    def write():
        with atomic_text(path) as stream:
            stream.write("half of the new")
            stream.flush()
            raise failure("disk on fire")

    with pytest.raises(expected, match="disk"):
        write()
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.txt"]
    assert path.read_text() == "old"


def test_values_that_cannot_be_stored_leave_the_old_file(saved):
    content = saved.read_bytes()
    with pytest.raises(ValueError, match="Object arrays"):
        save_arrays(saved, "thing", {"x": np.array([object()])}, {})
    with pytest.raises(ValueError, match="JSON"):
        save_arrays(saved, "thing", {}, {"gamma": float("nan")})
    assert [entry.name for entry in saved.parent.iterdir()] == ["x.npz"]
    assert saved.read_bytes() == content


def test_temporary_file_is_beside_the_target_with_its_suffix_and_ordinary_permissions(tmp_path):
    (tmp_path / "ordinary").touch()
    with atomic_path(tmp_path / "film.mp4") as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".mp4"
        temporary.write_bytes(b"film")
        assert not (tmp_path / "film.mp4").exists()
    assert (tmp_path / "film.mp4").read_bytes() == b"film"
    assert (tmp_path / "film.mp4").stat().st_mode == (tmp_path / "ordinary").stat().st_mode
    assert not temporary.exists()


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


def test_json_round_trip_keeps_every_digit(tmp_path):
    save_json(tmp_path / "x.json", META)
    assert json.loads((tmp_path / "x.json").read_text(encoding="utf-8")) == META


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"[1]", "it holds a list, not values by name"),
        (b"[" * 100_000, "RecursionError"),
        (b'{"a": ' + b"9" * 5000 + b"}", "ValueError"),
        (b'{"a": "' + b"x" * 1_000_000 + b'"}', "at most 1000000 are read"),
        (b"\xff\xfe\x00", "not a valid thing"),
    ],
)
def test_broken_json_is_named(tmp_path, content, words):
    (tmp_path / "x.json").write_bytes(content)
    with pytest.raises(FileError, match=words):
        load_json(tmp_path / "x.json", "thing")


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
    assert list(tmp_path.iterdir()) == []


def test_files_that_belong_together_appear_in_order_after_what_they_outdate_is_gone(tmp_path, monkeypatch):
    """Whenever the process dies, new and old are never there side by side."""
    names = [tmp_path / name for name in ("old", "a", "b")]
    real = {name: getattr(type(tmp_path), name) for name in ("unlink", "replace")}
    for deadly in range(4):
        for path in names:
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
            with atomic_paths(names[1:], outdated=names[:1]) as temporaries:
                for path in temporaries:
                    path.write_text("new")
        except KeyboardInterrupt:
            pass
        monkeypatch.undo()
        found = {path.name: path.read_text() for path in names if path.exists()}
        assert (
            found
            == [
                {"old": "old", "a": "old", "b": "old"},
                {"a": "old", "b": "old"},
                {"a": "new", "b": "old"},
                {"a": "new", "b": "new"},
            ][deadly]
        )
