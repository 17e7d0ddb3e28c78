"""Files of demonstrations: every format gives the same motion, and what is none says why."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.io import savemat

from lieednn_sim.errors import FileError, InputError
from lieednn_sim.learning.demonstrations import load_demonstrations

PLANE = np.array([[[3.0, 4.0], [3.0, 0.0], [0.0, 0.0]], [[6.0, 1.0], [2.0, 1.0], [0.0, 1.0]]])
# Of a quarter turn about z, about x, and none.
HALF = np.sqrt(0.5)
QUATERNIONS = np.array([[HALF, 0.0, 0.0, HALF], [HALF, HALF, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
POSES = np.concatenate([[[1.0, 2.0, 3.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], QUATERNIONS], axis=1)


def test_formats_of_several_in_a_plane_agree(tmp_path):
    times = np.array([[0.0, 0.1, 0.3], [0.5, 0.6, 0.9]])
    np.save(tmp_path / "all.npy", PLANE)
    np.savez(tmp_path / "all.npz", positions=PLANE, t=times)
    demos = np.empty(2, dtype=object)
    demos[:] = [{"pos": one.T, "t": t[None]} for one, t in zip(PLANE, times, strict=True)]
    savemat(tmp_path / "all.mat", {"demos": demos, "dt": 1.0})
    for one, name in zip(PLANE, "ab", strict=True):
        np.savetxt(tmp_path / f"{name}.csv", one, delimiter=",")
    for files in (["all.npy"], ["all.npz"], ["all.mat"], ["a.csv", "b.csv"]):
        found = load_demonstrations([tmp_path / name for name in files], unit="mm", rate=4.0)
        for one, shown, t in zip(found, PLANE, times - times[:, :1], strict=True):
            np.testing.assert_allclose(one.position, np.pad(1e-3 * shown, ((0, 0), (0, 1))), atol=1e-15)
            np.testing.assert_array_equal(one.t, t if files[0] in ("all.npz", "all.mat") else [0.0, 0.25, 0.5])
            assert one.dof == 2
            np.testing.assert_array_equal(one.twists[:, :3], 0.0)
            np.testing.assert_allclose(one.twists[:, 3:5], 1e-3 * (shown - shown[-1]), atol=1e-15)


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("cm", 0.01), ("mm", 0.001)])
def test_units_and_the_array_by_its_name(tmp_path, unit, metres):
    np.savez(tmp_path / "one.npz", forces=np.zeros((3, 3)), positions=PLANE[0])
    (one,) = load_demonstrations([tmp_path / "one.npz"], unit=unit)
    np.testing.assert_allclose(one.position[:, :2], metres * PLANE[0])


def test_quaternions_in_either_order_apart_and_named(tmp_path):
    np.save(tmp_path / "first.npy", POSES)
    np.save(tmp_path / "last.npy", POSES[:, [0, 1, 2, 4, 5, 6, 3]])
    np.savez(tmp_path / "apart.npz", positions=POSES[:, :3], quaternions=QUATERNIONS)
    # A header decides, in any order, and strange columns are passed over; the sign of a quaternion says nothing.
    header = "t,qz,gripper,z,y,x,qx,qy,qw"
    columns = [POSES[:, 6], [0, 1, 0], POSES[:, 2], POSES[:, 1], POSES[:, 0], *POSES[:, 4:6].T, POSES[:, 3]]
    table = np.column_stack([[0.0, 0.5, 1.5], *columns])
    table[1, [1, 6, 7, 8]] *= -1.0
    np.savetxt(tmp_path / "named.csv", table, delimiter=",", header=header, comments="")
    for name, order in (("first.npy", "wxyz"), ("last.npy", "xyzw"), ("apart.npz", "wxyz"), ("named.csv", "xyzw")):
        (one,) = load_demonstrations([tmp_path / name], quaternion=order)
        assert one.dof == 6
        # Columns are the frame's axes in the world: x to y, then y to z.
        np.testing.assert_allclose(one.rotation[0], [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
        np.testing.assert_allclose(one.rotation[1], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-15)
        assert one.t.tolist() == ([0.0, 0.5, 1.5] if name == "named.csv" else [0.0, 0.01, 0.02])


NAMED_TIMES = ("t,x,y", "time,x,y", "timestamp,x,y", "time_s,x,y", "time [s],x,y", "stamp,x,y", "secs,x,y")


@pytest.mark.parametrize("header", [*NAMED_TIMES, "# t,x,y", "#Time (s),x,y", '"t","x","y"', "# by hand\n# t, x, y"])
def test_the_column_of_times_by_its_name(tmp_path, header):
    (tmp_path / "a.csv").write_text(f"{header}\n0,1,2\n0.3,4,5\n0.4,6,7\n")
    (one,) = load_demonstrations([tmp_path / "a.csv"])
    assert one.t.tolist() == [0.0, 0.3, 0.4]
    np.testing.assert_array_equal(one.position[:, :2], [[1, 2], [4, 5], [6, 7]])


@pytest.mark.parametrize("rows", ["x;y;t\n1;2;0\n4;5;0.3\n", "x;y;t\n1,0;2,0;0,0\n4,0;5,0;0,3\n"])
def test_semicolons_allow_points_and_commas_in_numbers(tmp_path, rows):
    (tmp_path / "a.csv").write_text(rows)
    (one,) = load_demonstrations([tmp_path / "a.csv"])
    assert one.t.tolist() == [0.0, 0.3]
    np.testing.assert_array_equal(one.position[:, :2], [[1, 2], [4, 5]])


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time [min],x,y", r"'time \[min\]' may be the time, but is not named so; name it t,"),
        ("elapsed,x,y", "'elapsed' may be the time"),
        ("tick,x,y", "'tick' may be the time"),
        ("t,x,y,stamp", "only one column of times, it has: t, stamp"),
        ("secs,x,y,nsecs", "only one column of times, it has: secs, nsecs"),  # whole seconds alone are no times
        ("t,x", "names 2 columns, and its rows have 3"),
        ("frame,x,y", ""),
        (",x,y", ""),
    ],
)
def test_what_may_be_the_time_is_not_passed_over(tmp_path, header, message):
    columns = [0.04 * np.arange(5) if message else np.arange(5.0), np.arange(5) ** 2, np.ones(5), np.arange(5)]
    rows = np.column_stack(columns[: max(3, len(header.split(",")))])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=header, comments="")
    if not message:  # numbers of rows are no times
        with pytest.warns(UserWarning, match="positions span 16 m, read in m; units: m, cm, mm"):
            assert load_demonstrations([tmp_path / "a.csv"])[0].t[1] == 0.01
        assert load_demonstrations([tmp_path / "a.csv"], unit="cm")[0].position[-1, 0] == 0.16
        return
    with pytest.raises(InputError, match=message):
        load_demonstrations([tmp_path / "a.csv"])


@pytest.mark.parametrize("columns", [3, 7])
@pytest.mark.parametrize("begin", [0.0, 1764145800.0])
def test_without_names_the_first_column_is_the_time_if_it_increases_evenly(tmp_path, columns, begin):
    # Stamps with jitter, by a good third of a step.
    t = np.array([0.0, 0.1, 0.24, 0.3, 0.44, 0.5, *np.arange(0.6, 2.05, 0.1)])
    samples = np.outer(t, POSES[1, :columns])
    samples[:, 3:] = POSES[1, 3:columns]
    np.save(tmp_path / "a.npy", np.column_stack([begin + t, samples]))
    (one,) = load_demonstrations([tmp_path / "a.npy"])
    np.testing.assert_allclose(one.t, t, atol=1e-6)
    np.testing.assert_array_equal(one.position, samples[:, :3])
    assert one.dof == {3: 3, 7: 6}[columns]


@pytest.mark.parametrize(
    ("name", "unit", "given"), [("t", "ms", "ms"), ("t", "us", "us"), ("time [ns]", "ns", "s"), ("stamp_s", "s", "ns")]
)
def test_times_in_their_unit_since_any_epoch(tmp_path, name, unit, given):
    t = 1764145800.0 + np.array([0.0, 0.01, 0.02, 0.04])
    scale = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}[unit]
    columns = np.column_stack([scale * t, np.arange(4) ** 2, np.ones(4)])
    np.savetxt(tmp_path / "a.csv", columns, delimiter=",", header=f"{name},x,y", comments="", fmt="%.9f")
    (one,) = load_demonstrations([tmp_path / "a.csv"], time_unit=given)
    np.testing.assert_allclose(one.t, [0.0, 0.01, 0.02, 0.04], atol=1e-6)
    if unit == "ms":
        with pytest.warns(UserWarning, match="times of a.csv step by 10 s, read in s; for another unit see time_unit"):
            assert load_demonstrations([tmp_path / "a.csv"])[0].t[-1] == pytest.approx(40.0)
    # A rate below 1 Hz is meant.
    np.save(tmp_path / "slow.npy", PLANE)
    assert load_demonstrations([tmp_path / "slow.npy"], rate=0.1)[0].t[1] == 10.0


@pytest.mark.parametrize("separator", [" ", "\t", ","])
@pytest.mark.parametrize(
    ("name", "header"), [("a.csv", "t,x,y,z,qw,qx,qy,qz"), ("a.txt", "timestamp,tx,ty,tz,qw,qx,qy,qz"), ("a.tum", "")]
)
def test_text_separated_by_anything_and_tum(tmp_path, name, header, separator):
    table = np.column_stack([1764145800.0 + np.array([0.0, 0.25, 0.5]), POSES])
    table = table if header else table[:, [0, 1, 2, 3, 5, 6, 7, 4]]
    text = {"delimiter": separator, "header": header.replace(",", separator), "fmt": "%.9f"}
    for comments in ("# from a bag\n# ", ""):
        np.savetxt(tmp_path / name, table, **text, comments=comments)
        (one,) = load_demonstrations([tmp_path / name])
        np.testing.assert_allclose(one.t, [0.0, 0.25, 0.5], atol=1e-6)
        np.testing.assert_allclose(one.position, POSES[:, :3])
        np.testing.assert_allclose(one.rotation[1], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-8)


@pytest.mark.parametrize(
    ("t", "given"),
    [([0.0, 0.1, 0.1, 0.3], "0.1 after 0.1 in row 2"), ([0.0, 0.2, 0.1, 0.3], "0.1 after 0.2 in row 2")],
)
def test_a_time_that_does_not_increase_is_named_with_its_row(tmp_path, t, given):
    np.savez(tmp_path / "a.npz", positions=POSES[[0, 0, 1, 2], :3], t=t)
    with pytest.raises(InputError, match=f"increasing times, got {given}; drop the row, or leave out the times"):
        load_demonstrations([tmp_path / "a.npz"])


def test_times_of_an_archive_by_their_name(tmp_path):
    np.savez(tmp_path / "a.npz", positions=PLANE[0], timestamps=[0.0, 0.3, 0.4])
    assert load_demonstrations([tmp_path / "a.npz"])[0].t.tolist() == [0.0, 0.3, 0.4]
    np.savez(tmp_path / "a.npz", positions=PLANE[0], minutes=[0.0, 0.1, 0.2])
    with pytest.raises(InputError, match="'minutes' may be the time"):
        load_demonstrations([tmp_path / "a.npz"])
    # What has not one number for each sample is no time.
    np.savez(tmp_path / "a.npz", positions=PLANE[0], joint_names=["a", "b", "c"], none=[], limits=[-1.0, 1.5])
    assert len(load_demonstrations([tmp_path / "a.npz"])[0].t) == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (np.zeros(3), "shape (K, D) or (n, K, D), got (3,)"),
        (np.ones((5, 5)), "2, 3 or 7 columns"),
        (np.ones((5, 4)), "the first is no time, which would increase evenly: row 1 has 1 after 1; leave out"),
        (np.ones((1, 2)), "at least two samples, got 1"),
        (np.ones((5, 2)), "does not move"),
        (np.array([[0.0, np.nan], [1.0, 1.0]]), "1 NaN or infinite entries, the first in row 0"),
        (np.array([[0.0] * 6 + [1.0], [1.0] * 7]), "must have norm 1, got 2 in row 1"),
        (np.array([["a", "b"], ["c", "d"]]), "array of numbers"),
    ],
)
def test_what_is_no_demonstration_says_why(tmp_path, content, message):
    np.save(tmp_path / "wrong.npy", content)
    with pytest.raises(InputError, match="wrong") as raised:
        load_demonstrations([tmp_path / "wrong.npy"])
    assert message in str(raised.value)


def test_files_that_do_not_fit(tmp_path):
    np.save(tmp_path / "plane.npy", PLANE)
    np.save(tmp_path / "poses.npy", POSES)
    with pytest.raises(InputError, match=r"plane.npy\[0\] has positions in a plane, poses.npy poses"):
        load_demonstrations([tmp_path / "plane.npy", tmp_path / "poses.npy"])
    np.savez(tmp_path / "two.npz", a=PLANE, b=PLANE)
    with pytest.raises(InputError, match="it holds: a, b"):
        load_demonstrations([tmp_path / "two.npz"])
    np.savez(tmp_path / "times.npz", positions=PLANE, t=np.arange(4.0))
    with pytest.raises(InputError, match="one for each sample"):
        load_demonstrations([tmp_path / "times.npz"])
    (tmp_path / "named.csv").write_text("x,y,z,qw,qx\n" + "1,2,3,1,0\n" * 2)
    with pytest.raises(InputError, match="must have columns x, y, z and qw"):
        load_demonstrations([tmp_path / "named.csv"])
    np.save(tmp_path / "pickled.npy", np.array([{}], dtype=object), allow_pickle=True)
    for name in ("damaged.mat", "damaged.npz", "damaged.npy", "damaged.csv"):
        (tmp_path / name).write_bytes(b"no such thing")
    for name in ("damaged.mat", "damaged.npz", "damaged.npy", "damaged.csv", "pickled.npy", "plane.dat", "absent.npy"):
        with pytest.raises(FileError, match=name):
            load_demonstrations([tmp_path / name])
    (tmp_path / "sheet.csv").write_text("0,1\t0,2\n" * 2)
    with pytest.raises(FileError, match=r"sheet.csv must be separated by commas, blanks or tabs, with points in"):
        load_demonstrations([tmp_path / "sheet.csv"])
    for text, why in (
        ("# t x y\n% none\n", "has no rows, only comments"),
        ("", "has no rows"),
        ("x y\n", "there are no rows"),
    ):
        (tmp_path / "bare.csv").write_text(text)
        with pytest.raises(FileError, match=rf"bare.csv .*{why}$"):
            load_demonstrations([tmp_path / "bare.csv"])
    np.savetxt(tmp_path / "epoch.csv", np.add([1764145800.0, 0.0, 0.0], np.outer(np.arange(3), [0.1, 1.0, 2.0])))
    with pytest.raises(InputError, match=r"got 1764145800.2 in row 2, column 0; if it is the time, name the columns"):
        load_demonstrations([tmp_path / "epoch.csv"])
    with pytest.raises(InputError, match="allowed: cm, m, mm"):
        load_demonstrations([tmp_path / "plane.npy"], unit="inch")
    with pytest.raises(InputError, match="no time_unit 'min'; allowed: ms, ns, s, us"):
        load_demonstrations([tmp_path / "plane.npy"], time_unit="min")
    with pytest.raises(InputError, match="name at least one file"):
        load_demonstrations([])
