"""Tables in SQLite files: rows that stay, other settings and files that are refused, several processes at once."""

from __future__ import annotations

import csv
import sqlite3
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field, replace

import pytest

from lieednn_sim.errors import FileError, InputError
from lieednn_sim.studies import Table
from lieednn_sim.studies.rows import TableRow, column
from lieednn_sim.studies.user_files import UserFile
from lieednn_sim.versions import commit, versions

SETTINGS = {"duration": 1.5, "names": ["a", "b"]}


@dataclass(frozen=True, slots=True)
class Measured(TableRow):
    """A row with each type of column, and names that are words of SQL."""

    _key = ("set", "number")

    set: str
    number: int
    success: bool = field(default=True, init=False)
    reason: str = ""
    group: float | None = column("group [m]", "a length")
    count: int | None = column("count", "a number")
    spent: float | None = column("spent [s]", "a time", timed=True)


ROWS = [Measured("b", 2, group=1.0 / 3.0, count=3, spent=1.0), Measured("a", 10, "plan: 'no'\nway"), Measured("b", 1)]


def begin(folder, settings=SETTINGS, files=()):
    return Table.begin(folder / "table.sqlite", Measured, settings, files)


@pytest.fixture
def table(tmp_path):
    made = begin(tmp_path)
    made.add(ROWS)
    return made


def change(table, *statements):
    with closing(sqlite3.connect(table.path)) as base, base:
        for statement in statements:
            base.execute(statement)


def test_rows_are_read_as_they_were_added_in_the_order_of_their_keys(table, tmp_path):
    again = begin(tmp_path)
    assert list(again.rows.values()) == list(Table(table.path, Measured).rows.values()) == [ROWS[1], ROWS[2], ROWS[0]]
    assert again.rows["b", 2] == ROWS[0]
    # A row is a line, and failed where there is a reason.
    assert (again.rows["a", 10].reason, again.rows["a", 10].success) == ("plan: 'no' way", False)
    assert all(type(row.success) is bool for row in again.rows.values())
    assert (again.settings, again.versions) == (SETTINGS, versions())
    assert again.commits == ([commit()] if commit() else [])
    # One with the same key takes the place of the other.
    again.add([replace(ROWS[0], count=4)])
    assert begin(tmp_path).rows["b", 2].count == 4
    assert {path.name for path in tmp_path.iterdir()} == {"table.sqlite"}


def test_rows_of_a_table_are_a_csv_file(table, tmp_path):
    table.write_csv(tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["reason"] for row in rows] == ["plan: 'no' way", "", ""]
    assert rows[2] == {
        **{"set": "b", "number": "2", "success": "True", "reason": ""},
        **{"group": "0.3333333333333333", "count": "3", "spent": "1.0"},
    }


def test_other_settings_and_versions_are_refused(table, tmp_path):
    with pytest.raises(FileError, match=r"made with duration 1.5, now 2; choose another --output"):
        begin(tmp_path, {**SETTINGS, "duration": 2})
    change(table, """UPDATE about SET value = '{"numpy": "1.0"}' WHERE name = 'versions'""")
    with pytest.raises(FileError, match=r"made with numpy 1.0, now .*; lieednn_sim None, now|lieednn_sim None, now"):
        begin(tmp_path)
    with pytest.raises(InputError, match="must hold values that JSON can hold"):
        begin(tmp_path, {"a": object()})


def test_files_of_another_arm_by_the_same_name_are_refused(tmp_path):
    one = UserFile("arm", "crane", "/here/crane.xml", "0" * 64)
    begin(tmp_path, files=[one])
    moved = one._replace(source="/there/crane.xml")
    other = UserFile("scene", "crane", "scene.json", "1" * 64)
    assert begin(tmp_path, files=[moved, other]).user_files == (moved, other)
    with pytest.raises(FileError, match=r"belong to another arm 'crane' \(fingerprint 000000000000, that of /there"):
        begin(tmp_path, files=[moved._replace(fingerprint="2" * 64)])
    assert Table(tmp_path / "table.sqlite", Measured).user_files == (moved, other)


@pytest.mark.parametrize(
    ("statements", "message"),
    [
        (["DROP TABLE rows"], "holds no table of Measured rows"),
        (["CREATE TRIGGER more AFTER INSERT ON rows BEGIN DELETE FROM rows; END"], "holds no table of Measured rows"),
        (["DROP TABLE rows", "CREATE VIEW rows AS SELECT * FROM about"], "holds no table of Measured rows"),
        (["DELETE FROM about"], "does not tell how it was made"),
        (["UPDATE about SET value = '[3]'"], "does not tell how it was made"),
        (["UPDATE about SET value = '3'"], "does not tell how it was made"),
        (["INSERT INTO about VALUES ('much', printf('%.*c', 2000000, 'x'))"], "at most 1000000 bytes per value"),
    ],
)
def test_tables_of_others_are_refused(table, tmp_path, statements, message):
    change(table, *statements)
    before = table.path.read_bytes()
    with pytest.raises(FileError, match=message):
        begin(tmp_path)
    assert table.path.read_bytes() == before


def test_what_is_no_table_is_refused_and_stays(table, tmp_path):
    whole = table.path.read_bytes()
    damaged = bytearray(whole)
    damaged[len(whole) - 40 :] = bytes(40)
    for content in (b"a,b\n1,2\n" * 100, whole[: len(whole) // 2], bytes(damaged)):
        table.path.write_bytes(content)
        with pytest.raises(FileError, match=r"table\.sqlite"):
            begin(tmp_path)
        assert table.path.read_bytes() == content
    with pytest.raises(FileError, match="no such file"):
        Table(tmp_path / "gone.sqlite", Measured)
    assert not (tmp_path / "gone.sqlite").exists()
    (tmp_path / "folder.sqlite").mkdir()
    with pytest.raises(FileError, match="is a directory"):
        Table.begin(tmp_path / "folder.sqlite", Measured, {})


def test_a_column_of_another_type_is_refused(tmp_path):
    @dataclass(frozen=True, slots=True)
    class Other(TableRow):
        _key = ("name",)
        name: str
        success: bool = field(default=True, init=False)
        reason: str = ""
        values: list[float] | None = None

    with pytest.raises(InputError, match=r"must be one of str, bool, int, float, or None; values is list\[float\]"):
        Table.begin(tmp_path / "t.sqlite", Other, {})


def test_rows_are_all_added_or_none(table):
    with pytest.raises(FileError, match="cannot use the table"):
        table.add([Measured("c", 1), Measured("c", 2, count="many")])
    assert len(table.rows) == 3


def test_several_at_once_begin_and_fill_a_table(tmp_path):
    together = threading.Barrier(3)

    def fill(name):
        together.wait()
        table = begin(tmp_path)
        for number in range(10):
            table.add([Measured(name, number, count=number)])

    with ThreadPoolExecutor(3) as pool:
        list(pool.map(fill, ("a", "b", "c")))
    assert set(begin(tmp_path).rows) == {(name, number) for name in ("a", "b", "c") for number in range(10)}


def test_tables_are_merged_unless_they_disagree(table, tmp_path):
    (tmp_path / "part").mkdir()
    file = UserFile("arm", "crane", "crane.xml", "0" * 64)
    part = begin(tmp_path / "part", files=[file])
    # The time of one that was measured twice is another.
    part.add([Measured("c", 1, count=7), replace(ROWS[0], spent=9.0)])
    table.merge(part)
    assert table.rows == {row.key: row for row in [*ROWS, Measured("c", 1, count=7)]}
    assert Table(table.path, Measured).user_files == (file,)
    before = dict(table.rows)
    part = begin(tmp_path / "part", files=[UserFile("arm", "other", "other.xml", "1" * 64)])
    part.add([Measured("d", 1), replace(ROWS[0], group=None)])
    with pytest.raises(FileError, match=r"table.sqlite and .*part.*table.sqlite disagree on b, 2; remove one"):
        table.merge(part)
    assert table.rows == before
    assert Table(table.path, Measured).user_files == (file,), "nor is the other arm a name of this table's"
    (tmp_path / "other").mkdir()
    with pytest.raises(FileError, match=r"other.* was made with duration 9, in .*table.sqlite 1.5"):
        table.merge(begin(tmp_path / "other", {**SETTINGS, "duration": 9}))
    # A table holds its own rows.
    table.merge(Table(table.path, Measured))
    assert table.rows == before
