"""The study of action chunks, without the libraries that its clone and one of its references need."""

from __future__ import annotations

import chunk_policies
import chunks
import numpy as np
import pytest

from lieednn_sim.arm import Arm


@pytest.mark.parametrize("kind", chunks.FAULTS)
def test_a_fault_is_what_its_name_says(kind, gantry):
    t, dt = np.arange(30)[:, None], 0.05
    clean = gantry.keyframe("home") + 1e-3 * t * np.array([1.0, -1.0, 0.5, 1.0])
    before = clean.copy()
    chunk = chunks.faulty(gantry, kind, clean, dt, 10, np.random.default_rng(0))
    assert (clean == before).all()
    (low, high), limits = gantry.position_limits.T, gantry.velocity_limits
    if kind == "wrong shape":
        assert chunk.shape != clean.shape
    elif kind == "stale":
        assert (chunk == clean).all()
    elif kind == "not a number":
        assert np.isfinite(chunk).sum() == chunk.size - 1
    elif kind == "limits":
        assert ((chunk > high) | (chunk < low)).any()
    elif kind == "contact":
        assert gantry.contacts(chunk[-1])
        assert not gantry.contacts(chunk[10])
    elif kind == "speed":
        assert (np.abs(np.diff(chunk, axis=0)) / dt / limits).max() > 1.5 - 1e-9
    elif kind == "acceleration":
        assert (np.abs(np.diff(chunk, n=2, axis=0)) / dt**2 / gantry.acceleration_limits).max() > 1.0
    else:
        # Off in one target, in all later ones, in all, or in each by another way.
        off = np.abs(chunk - clean).max(axis=1) > 1e-6
        first, count = int(off.argmax()), int(off.sum())
        assert {"outlier": count == 1, "jump inside": first > 10 and count == 30 - first}.get(kind, count == 30)
        if kind != "jump at the seam":
            assert first > 10 or kind == "noise"


def test_a_clean_chunk_is_followed_and_a_wrong_one_is_refused():
    clean, wrong = (chunks.judged(kind, 1) for kind in ("clean", "wrong shape"))
    assert (clean["found"], clean["refused"], clean["safe"]) == (0, False, True)
    assert 0.0 < clean["off"] < 1.0
    assert (wrong["found"], wrong["refused"], wrong["safe"]) == (1, True, True)


def test_an_episode_of_the_expert_through_two_references(tmp_path):
    raw, ours = (chunks.episode("track", "expert", 0.0, way, 0, tmp_path) for way in ("raw", "lieednn-chunks"))
    # With jumps of its own the one leaps, the other keeps the limit of acceleration.
    assert raw["jump"] > 50.0
    assert ours["jump"] < 1.001
    assert ours["jerk"] < 0.1 * raw["jerk"]
    assert (raw["touched"], ours["touched"]) == (False, False)


def test_references_by_hand():
    arm = Arm.load("telescopic_pr")
    home = arm.keyframe("home")
    chunk = home + 0.1 * np.arange(4.0)[:, None] * arm.ranges
    raw, low, blend = (chunk_policies.Reference(arm, way) for way in ("raw", "low-pass", "linear blending"))
    # Half way to the second target; of this, a part of 1 - e^-0.1, and 0.01 s of 0.4 s.
    for reference, part in ((raw, 1.0), (low, 1.0 - np.exp(-0.1)), (blend, 0.025)):
        reference.accept(chunk, -0.04)
        np.testing.assert_allclose((reference.step(home) - home) / arm.ranges, part * 0.05, rtol=1e-9)


def test_tables_by_hand():
    one = {"found": 1.0, "refused": 0.0, "safe": 1.0, "off": 2.0}
    found = {("clean",): [one, {**one, "found": 0.0, "off": 4.0}, {**one, "refused": 1.0, "off": -1.0}]}
    found[("stale",)] = [one]
    run = {"success": 1.0, "touched": False, "jump": 2.0, "jerk": 4.0, "lag": 30.0, "back": 5.0, "refused": 1}
    run |= {"True": 2.0, "False": 0.1}
    found[("track", "clone", 0.8, "raw")] = [run, {**run, "success": 0.5, "jump": 8.0, "jerk": 6.0}]
    found[("reach", "clone", 0.2, "lieednn-chunks")] = [run, {**run, "back": 7.0, "touched": True}]
    lines = [line for line in chunks.report(found) if line.startswith("| ")]
    assert lines[2:4] == ["| clean | 3 | 2 | 1 | 3 | 3 | 4 |", "| stale | 1 | 1 | 0 | 1 |  |  |"]
    assert lines[6:] == [
        "| track, clone | 800 | raw | 75 | 0 | 8 | 5 | 30 ms |  | 2 / 0.1 |",
        "| reach, clone | 200 | lieednn-chunks | 100 | 1 | 2 | 4 | 7 % | 2 | 2 / 0.1 |",
    ]


def test_large_numbers_of_the_report_are_written_out():
    row = {"success": 1.0, "touched": False, "jump": 4402.3, "jerk": 19520.0, "lag": 0.0, "back": 204.3, "refused": 0}
    rows = [{**row, "True": 0.0074, "False": 0.0054}]
    small = [{**rows[0], "back": 8.64}]
    lines = chunks.report({("reach", "expert", 0.0, "raw"): rows, ("reach", "expert", 0.2, "raw"): small})
    assert [line.split(" | ")[5:8] for line in lines[-2:]] == [["4402", "19520", "204 %"], ["4402", "19520", "8.6 %"]]
