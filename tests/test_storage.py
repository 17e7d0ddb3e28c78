"""Files: what is written comes back bit by bit, what is broken says so, and nothing is ever half there."""

from __future__ import annotations

import json
import os
import pickle

import numpy as np
import pytest

from lieednn_sim.errors import FileError
from lieednn_sim.storage import atomic_path, atomic_text, load_arrays, make_directory, save_arrays, save_json, take

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
        else:  # time stamps and the like; an altered member name is a missing array
            assert meta["gamma"] == META["gamma"]
            assert all(arrays[name].tobytes() == ARRAYS[name].tobytes() for name in arrays.keys() & ARRAYS.keys())
    assert refused > len(content) / 2


def test_pickles_are_never_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "exploded"),)

    pickled, inside = tmp_path / "pickle.npz", tmp_path / "inside.npz"
    pickled.write_bytes(pickle.dumps(Bomb()))
    np.savez(inside, meta_json=np.array(json.dumps({"kind": "thing", "format": 1})), x=np.array([Bomb()]))
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
        ('{"kind": "thing", "format": 2}', r"newer version \(format 2 > 1\)"),
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
    with pytest.raises(FileError, match="is a directory, not a thing file"):
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
