"""Files that are made to take memory, time or the process: refused before they do, with the bound."""

from __future__ import annotations

import json
import os
import pickle
import zipfile
from io import BytesIO

import numpy as np
import pytest
import yaml

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.arm.obstacles import load_obstacles
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.io import reading
from lieednn_sim.learning.demonstrations import Demonstration, align, load_demonstrations
from lieednn_sim.learning.demonstrations.alignment import Demonstrations
from lieednn_sim.studies.problems.motion_bench_maker import ProblemSets

META = {"kind": "thing", "format": reading.FORMAT}
ARRAYS = {"x": np.array([0.5, -0.0, np.nan]), "names": np.array(["Gelenk ä", "b"])}


def npy(shape, content=b"", dtype="<f8"):
    stream = BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"shape": shape, "fortran_order": False, "descr": dtype})
    return stream.getvalue() + content


def archive(path, members, meta=META):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in {"meta_json": np_text(json.dumps(meta)), **members}.items():
            made.writestr(f"{name}.npy", content)


def np_text(text):
    stream = BytesIO()
    np.save(stream, np.array(text))
    return stream.getvalue()


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "x.npz"
    io.save_arrays(path, "thing", ARRAYS, {})
    return path


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04", b"\x93NUMPY garbage", b"\x00" * 1000])
def test_what_is_no_archive_is_refused(tmp_path, content):
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"x\.npz is not a readable thing file"):
        io.load_arrays(path, "thing")


def test_truncated_files_are_refused(saved):
    content = saved.read_bytes()
    for length in range(0, len(content), 53):
        saved.write_bytes(content[:length])
        with pytest.raises(FileError, match="is not a readable thing file"):
            io.load_arrays(saved, "thing")


def test_flipped_bytes_are_refused_or_harmless(saved):
    content = saved.read_bytes()
    refused = 0
    for position in range(0, len(content), 3):
        flipped = bytearray(content)
        flipped[position] ^= 0x55
        saved.write_bytes(flipped)
        try:
            arrays, meta = io.load_arrays(saved, "thing")
        except FileError:
            refused += 1
        else:  # time stamps and the like
            assert meta == META
            assert {name: array.tobytes() for name, array in arrays.items()} == {
                name: array.tobytes() for name, array in ARRAYS.items()
            }
    assert refused > len(content) / 6


def test_pickles_are_never_opened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "exploded"),)

    pickled, inside = tmp_path / "pickle.npz", tmp_path / "inside.npz"
    pickled.write_bytes(pickle.dumps(Bomb()))
    np.savez(inside, meta_json=np.array(json.dumps(META)), x=np.array([Bomb()]))
    for path in (pickled, inside):
        with pytest.raises(FileError, match="is not a readable thing file"):
            io.load_arrays(path, "thing")
    assert not (tmp_path / "exploded").exists()


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ('{"kind": "motion", "format": 1}', "holds 'motion', expected 'thing'"),
        ("[1]", "holds None, expected 'thing'"),
        ("{", "not a readable thing file"),
        ("[" * 100_000, "not a readable thing file"),
        *((f'{{"kind": "thing", "format": {other}}}', "by another version") for other in ("2", "4", '"two"', "null")),
        (None, "meta_json"),
    ],
)
def test_foreign_headers_are_refused(tmp_path, header, words):
    np.savez(tmp_path / "x.npz", x=np.zeros(3), **({} if header is None else {"meta_json": np.array(header)}))
    with pytest.raises(FileError, match=words):
        io.load_arrays(tmp_path / "x.npz", "thing")


def test_missing_file_and_directory_and_array_are_named(tmp_path):
    with pytest.raises(FileError, match=r"no such file: .*nowhere\.npz"):
        io.load_arrays(tmp_path / "nowhere.npz", "thing")
    with pytest.raises(FileError, match="is a directory, not a file"):
        io.load_arrays(tmp_path, "thing")
    np.save(tmp_path / "x.npy", np.zeros(3))
    with pytest.raises(FileError, match="is not a readable thing file"):
        io.load_arrays(tmp_path / "x.npy", "thing")
    arrays = {"a": np.zeros(1), "b": np.ones(1)}
    assert io.take(arrays, "f.npz", "b", "a") == [arrays["b"], arrays["a"]]
    with pytest.raises(FileError, match=r"f\.npz has no array 'c'; it holds: a, b"):
        io.take(arrays, "f.npz", "a", "c")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"[1]", "it is a list at the top, and not entries as `name: value`"),
        (b"[" * 100_000, "RecursionError"),
        (b'{"a": ' + b"9" * 5000 + b"}", "ValueError"),
        (b'{"a": "' + b"x" * 1_000_000 + b'"}', "at most 1000000 are read"),
        (b"\xff\xfe\x00", "not a valid thing"),
    ],
)
def test_broken_json_is_named(tmp_path, content, words):
    (tmp_path / "x.json").write_bytes(content)
    with pytest.raises(FileError, match=words):
        io.load_json(tmp_path / "x.json", "thing")


@pytest.mark.parametrize("shape", [(10**12,), (10**6, 10**6), (2**62, 4), (-1,), (3, 5)])
def test_a_shape_that_the_content_has_not(tmp_path, shape):
    alone, packed = tmp_path / "x.npy", tmp_path / "x.npz"
    alone.write_bytes(npy(shape, bytes(80)))
    archive(packed, {"x": npy(shape, bytes(80))})
    for read in (
        lambda: load_demonstrations([alone]),
        lambda: load_demonstrations([packed]),
        lambda: io.load_arrays(packed, "thing"),
    ):
        with pytest.raises(FileError, match="claims the shape"):
            read()


def test_what_unpacks_to_more_than_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(reading, "LARGEST_ARRAYS", 10**6)
    path = tmp_path / "x.npz"
    archive(path, {"x": npy((2 * 10**5,), bytes(16 * 10**5))})
    assert path.stat().st_size < 10**4
    with pytest.raises(FileError, match=r"unpacks to \d+ bytes; at most 1000000 are read"):
        io.load_arrays(path, "thing")
    monkeypatch.undo()
    archive(path, {}, {**META, "text": "x" * 2 * 10**6})
    with pytest.raises(FileError, match=r"meta_json unpacks to \d+ bytes; at most 4000000 are read"):
        io.load_arrays(path, "thing")


def test_an_archive_of_another_kind_is_not_unpacked(tmp_path, monkeypatch):
    path, read = tmp_path / "x.npz", []
    io.save_arrays(path, "thing", {"x": np.zeros(1000)}, {})
    monkeypatch.setattr(
        reading, "read_array", lambda *given, real=reading.read_array: (read.append(1), real(*given))[1]
    )
    with pytest.raises(FileError, match="holds 'thing', expected 'network'"):
        io.load_arrays(path, "network")
    assert len(read) == 1


@pytest.mark.parametrize("name", ["x.npz", "x.json", "x.yaml", "x.csv", "x.xml"])
def test_devices_and_pipes_are_not_opened(tmp_path, name):
    read = {
        "x.npz": lambda path: io.load_arrays(path, "thing"),
        "x.json": lambda path: io.load_json(path, "task"),
        "x.csv": lambda path: load_demonstrations([path]),
    }.get(name, load_obstacles)
    path = tmp_path / name
    os.mkfifo(path)
    for target in (path, "/dev/zero"):
        if target != path:
            path.unlink()
            path.symlink_to(target)
        with pytest.raises(FileError, match=r"not a regular file|no such file"):
            read(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
            f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
        ) + "obstacles: [{shape: box, name: *i}]", "more than 1000000 values"),
        ("a: &a [*a]", "more than 1000000 values"),
        ("[" * 100_000, "nested more than 100 deep"),
        ("obstacles: [" + "{}, " * 10_001 + "{}]", "at most 10000 obstacles"),
        ("obstacles: [{shape: box, name: \"a\\0b\", size: [1, 1, 1], position: [9, 9, 9]}]", "printable"),
        ("obstacles: [{shape: box, size: [true, 1, 1], position: [9, 9, 9]}]", "size must be an array of numbers"),
        ("obstacles: [{shape: box, size: ['1', 1, 1], position: [9, 9, 9]}]", "size must be an array of numbers"),
    ],
    ids=lambda value: value if len(value) < 50 else "",
)  # fmt: skip
def test_scenes_that_hold_too_much_or_no_numbers(tmp_path, text, message):
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises((FileError, InputError), match=message) as caught:
        load_obstacles(path)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("text", ["obstacles: [1]\ngoals: []\nobstacles: [2]", "a: {b: 1, 'b': 2}"])
def test_what_is_in_yaml_twice_is_refused(text):
    with pytest.raises(ValueError, match=r"'(obstacles|b)' occurs twice in the mapping at line 1"):
        reading.parse_yaml(text.encode())
    merged = b"defs: [&y {b: 1}, &x {<<: *y, b: 2}]\nz: {<<: *x, c: 3}\n1: a\n'1': b"
    assert reading.parse_yaml(merged) == yaml.safe_load(merged)


def test_what_is_in_json_twice_is_refused(tmp_path):
    (path := tmp_path / "scene.json").write_text('{"obstacles": [], "goals": [], "obstacles": [1]}')
    with pytest.raises(FileError, match="'obstacles' occurs twice in one object"):
        reading.load_description(path, "scene")


def test_powers_of_ten_are_numbers_in_yaml(tmp_path):
    """As in YAML 1.2; PyYAML takes them for texts."""
    path = tmp_path / "scene.yaml"
    path.write_text("obstacles: [{shape: sphere, radius: 5e-2, position: [1e0, -2E+0, 0]}]")
    (geom,) = load_obstacles(path).geoms
    assert geom.size[0] == 0.05
    np.testing.assert_array_equal(load_obstacles(path).bodies[1].pos, [1.0, -2.0, 0.0])


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<asset><hfield name="a" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>', "has 1e.10 entries"),
        (
            '<asset><texture name="a" type="2d" builtin="flat" width="100000" height="100000"/></asset>',
            "has 1e.10 entries",
        ),
        ('<worldbody><replicate count="1000000"><geom size="1"/></replicate></worldbody>', "asks for 1e.06 copies"),
        (
            '<worldbody><replicate count="1000"><replicate count="1000"><geom size="1"/></replicate></replicate>'
            "</worldbody>",
            "asks for 1e.06 copies",
        ),
        ('<include file="b.xml"/>', "b.xml: <hfield> has"),
        ('<asset><hfield name="a" nrow="99" ncol="99" size="1 1 1 -1"/></asset>', "MuJoCo cannot"),
    ],
)
def test_models_that_ask_for_too_much(tmp_path, inside, message):
    path = tmp_path / "a.xml"
    path.write_text(f"<mujoco>{inside}</mujoco>")
    (tmp_path / "b.xml").write_text('<mujoco><asset><hfield name="a" nrow="99999" ncol="99999"/></asset></mujoco>')
    for read in (load_obstacles, Arm.load):
        with pytest.raises(FileError, match=message):
            read(path)


def test_problems_that_are_too_large(tmp_path):
    (tmp_path / "a.urdf").write_text("<robot name='a'/>")
    for kind in ("scene", "request"):
        (tmp_path / f"{kind}0001.yaml").write_bytes(bytes(3 * 10**6))
    with pytest.raises(FileError, match=r"request0001.yaml has 3000000 bytes; at most 1000000 are read"):
        ProblemSets(tmp_path).problem(tmp_path.name, 1)


WAY = np.column_stack([np.linspace(0.3, 0.0, 5), np.zeros(5)])


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -1.0, 0.0])
def test_demonstrations_in_lengths_and_rates_that_are_none(wrong):
    for option in ("length", "rate"):
        with pytest.raises(InputError, match=f"{option} must be"):
            Demonstration.from_samples(WAY, **{option: wrong})
    with pytest.raises(InputError, match="no order of quaternions"):
        Demonstration.from_samples(WAY, quaternion="zyxw")


def test_demonstrations_are_checked_however_they_are_made():
    one = Demonstration.from_samples(WAY)
    several = align([one], samples=7)
    broken = one.position.copy()
    broken[2, 1] = np.nan
    for make, message in (
        (lambda: Demonstration(one.t, broken, one.rotation, 2), "position must be finite"),
        (lambda: Demonstration(one.t[::-1], one.position, one.rotation, 2), "increasing times"),
        (lambda: Demonstration(one.t, one.position, one.rotation[:3], 2), "rotation must have shape"),
        (lambda: Demonstration(one.t, one.position, one.rotation, 4), "dof must be 2, 3 or 6"),
        (lambda: Demonstrations(several.goal, several.t[::-1], several.twists, 2), "increasing times"),
        (lambda: Demonstrations(several.goal, several.t, several.twists * np.nan, 2), "twists must be finite"),
        (lambda: Demonstrations(several.goal, several.t, several.twists, 2, -1.0), "lever must be positive"),
    ):
        with pytest.raises(InputError, match=message):
            make()


def test_a_scanner_that_refuses_deep_nesting_by_itself_says_the_same(monkeypatch):
    def parse(*_, **__):
        raise yaml.scanner.ScannerError(problem="exceeded maximum nesting depth")

    monkeypatch.setattr("yaml.parse", parse)
    with pytest.raises(ValueError, match="nested more than 100 deep"):
        reading.parse_yaml(b"[]")
