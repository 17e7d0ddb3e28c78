"""A library of motions: one proof, many codes."""

from __future__ import annotations

import numpy as np
import pytest

from lieednn_sim import io
from lieednn_sim.arm import Arm
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.planning import MotionLibrary, plan
from lieednn_sim.synthesis import CurveEncoder

S = np.linspace(0.0, 1.0, 200)[:, None, None]


def curve_of(seed):
    rng = np.random.default_rng(seed)
    ends = rng.uniform(-0.5, 0.5, (2, 2, 6))
    return ends[0] + S * (ends[1] - ends[0]) + np.sin(2.0 * np.pi * S) * rng.normal(scale=0.2, size=(2, 6))


@pytest.fixture
def library():
    made = MotionLibrary(2)
    made.add("wave", curve_of(1))
    made.add("reach", curve_of(2))
    return made


def states(network, start, t=12.0):
    run = network.trajectory(start, t, rtol=1e-9, atol=1e-11)
    return network.visible(run(np.linspace(0.0, t, 60)))


def test_motions_are_those_that_were_added(library):
    assert library.names == ("wave", "reach")
    for seed, name in ((1, "wave"), (2, "reach")):
        network = library.network(name)
        assert network.certificate is library.universal.certificate
        np.testing.assert_array_equal(network.hidden_start, CurveEncoder(2).encode(curve_of(seed)).hidden_start)
        np.testing.assert_array_equal(library.start(name), network.start(curve_of(seed)[0]))
        np.testing.assert_allclose(states(network, library.start(name), 18.0)[-1], curve_of(seed)[-1], atol=1e-6)


def test_the_path_of_a_blend_is_the_blend_of_the_paths(library):
    ways = [states(library.network(name), library.start(name)) for name in library.names]
    network, start = library.blend("wave", "reach", 0.3)
    assert network.certified
    np.testing.assert_allclose(states(network, start), 0.7 * ways[0] + 0.3 * ways[1], atol=1e-4)
    for fraction, way in ((0.0, ways[0]), (1.0, ways[1])):
        np.testing.assert_allclose(states(*library.blend("wave", "reach", fraction)), way, atol=1e-7)


def test_a_switch_in_flight_keeps_the_visible_state_and_arrives(library):
    before = library.network("wave").trajectory(library.start("wave"), 0.7, rtol=1e-9, atol=1e-11).xi[-1]
    network, after = library.switch(before, "reach")
    np.testing.assert_array_equal(after[:2], before[:2])
    np.testing.assert_allclose(network.bias[:2], curve_of(2)[-1], atol=1e-12)
    # As if that motion had begun 0.7 ago, with a deviation that decays as e^-t.
    beside = states(library.network("reach"), library.start("reach"), 18.7)
    run = network.trajectory(after, 18.0, rtol=1e-9, atol=1e-11)
    other = network.trajectory(library.start("reach"), 18.7, rtol=1e-9, atol=1e-11)
    t = np.linspace(0.0, 18.0, 40)
    gap = network.visible(run(t)) - network.visible(other(0.7 + t))
    np.testing.assert_allclose(gap, np.exp(-t)[:, None, None] * gap[0], atol=1e-6)
    np.testing.assert_allclose(beside[-1], curve_of(2)[-1], atol=1e-6)
    # Switching to the motion that runs changes nothing.
    _, same = library.switch(before, "wave")
    np.testing.assert_allclose(same, before, atol=1e-7)


def test_a_library_is_kept_in_one_file_and_its_proof_is_verified(library, tmp_path):
    path = tmp_path / "library.npz"
    library.save(path)
    assert path.stat().st_size < 100_000
    loaded = MotionLibrary.load(path)
    assert loaded.names == library.names
    assert loaded.network("reach") == library.network("reach")
    loaded.add("wave", curve_of(3))
    assert loaded.names == library.names
    assert not np.array_equal(loaded.start("wave"), library.start("wave"))
    MotionLibrary(1).save(path)
    assert MotionLibrary.load(path).names == ()
    arrays, meta = io.load_arrays(path, "motion library")
    for change, message in (
        ({"alpha": 3.0 * np.eye(len(arrays["alpha"]))}, "carries a certificate that does not hold"),
        ({"codes": np.zeros((1, 2, 6))}, "is not a valid motion library"),
    ):
        io.save_arrays(path, "motion library", {**arrays, **change}, meta)
        with pytest.raises(FileError, match=message):
            MotionLibrary.load(path)


def test_what_a_library_refuses(library):
    with pytest.raises(InputError, match=r"no name .dance.; allowed: reach, wave"):
        library.start("dance")
    with pytest.raises(InputError, match=r"fraction must be from 0 to 1, got 1\.5"):
        library.blend("wave", "reach", 1.5)
    with pytest.raises(InputError, match="name must be a text of 1 to 100 characters"):
        library.add("", curve_of(1))
    with pytest.raises(InputError, match=r"curve must have shape \(K, 2, 6\)"):
        library.add("short", np.zeros((4, 1, 6)))


def test_an_arm_repeats_a_planned_motion_from_the_library():
    arm = Arm.load("telescopic_pr")
    made = plan(arm, "extended", planner="minimum-jerk")
    library = MotionLibrary(arm.n_links)
    library.add("extend", made.motion)
    network = library.network("extend")
    way = states(network, library.start("extend"))
    line = made.motion.xi
    off = np.linalg.norm((way[:, None] - line[::5]).reshape(len(way), -1, way[0].size), axis=2).min(axis=1)
    assert off.max() < 5e-3
