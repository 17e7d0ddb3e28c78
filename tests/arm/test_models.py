"""What an arm is called and where it comes from: names, model files with their links, descriptions."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lieednn_sim.arm import Arm
from lieednn_sim.arm.models import is_arm_file
from lieednn_sim.errors import FileError, InputError


@pytest.fixture
def folder(tmp_path, monkeypatch, two_hinges):
    (tmp_path / "two.xml").write_text(two_hinges)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def described(**entries):
    return json.dumps({"model": "two.xml", **entries})


def test_links_follow_the_file_and_are_part_of_the_name(folder):
    arm, whole = Arm.load("two.xml:one,tool"), Arm.load(folder / "two.xml")
    assert (arm.name, arm.import_report.links, arm.n_links) == ("two(one,tool)", ("one", "tool"), 2)
    assert arm.fingerprint == Arm.load("two.xml", links=["one", "tool"]).fingerprint
    assert (whole.name, Arm.load("two.xml:tool").n_links) == ("two", 1)
    assert [is_arm_file(text) for text in ("two.xml", "a/b.URDF:x", "c.yml", "two", "two:one")] == [True] * 3 + [
        False
    ] * 2
    with pytest.raises(InputError, match=r"the links of two.xml:tool are given twice"):
        Arm.load("two.xml:tool", links=["tool"])
    with pytest.raises(FileError, match=r"no such file: gone.xml"):
        Arm.load("gone.xml:tool")


def test_a_description_says_how_a_model_is_imported(folder, monkeypatch):
    (folder / "mine.json").write_text(described(links=["tool"], home={"a": 0.3}))
    monkeypatch.chdir("/")
    arm = Arm.load(folder / "mine.json")
    assert (arm.name, arm.import_report.links, arm.source.name) == ("mine", ("tool",), "two.xml")
    np.testing.assert_allclose(arm.keyframe("home"), [0.3, 0.0], atol=1e-12)
    # What is given beside it goes before it.
    other = Arm.load(folder / "mine.json", home={"b": -0.2})
    np.testing.assert_allclose(other.keyframe("home"), [0.0, -0.2], atol=1e-12)
    assert other.import_report.links == ("tool",)


def test_limits_of_a_description_go_before_those_of_the_model(folder):
    wanted = {"a": {"velocity": 2, "jerk": 500.0}, "b": {"acceleration": 7.0}}
    (folder / "mine.json").write_text(described(limits=wanted))
    arm, bare = Arm.load(folder / "mine.json"), Arm.load("two.xml")
    np.testing.assert_array_equal(arm.velocity_limits, [2.0, bare.velocity_limits[1]])
    np.testing.assert_array_equal(arm.acceleration_limits, [bare.acceleration_limits[0], 7.0])
    np.testing.assert_array_equal(arm.jerk_limits, [500.0, np.inf])
    # A limit of jerk designs a new one arm; one that has none is what it was before there were any.
    rest = {"a": {"velocity": 2}, "b": {"acceleration": 7.0}}
    assert Arm.load("two.xml", limits=rest).fingerprint not in (arm.fingerprint, bare.fingerprint)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("[1]", FileError, "mine.json is not a valid description of an arm"),
        ('{"links": ["tool"]}', FileError, "names no model: it needs an entry such as `model: robot.urdf`"),
        ('{"model": "other.json"}', FileError, "got 'other.json'"),
        (described(link=["tool"]), FileError, "has no link; allowed: model, base, floor, home"),
        (described(links="tool"), InputError, "links must be a list, each item a string, got 'tool'"),
        (described(home={"a": "x"}), InputError, r"home\['a'\] must be a number, got 'x'"),
        (described(limits=[2.0]), InputError, "limits must be a dictionary, got a list of 1"),
        (described(limits={"a": {"speed": 2.0}}), InputError, "no limit 'speed'; allowed: acceleration, jerk"),
        (described(limits={"a": {"jerk": 0.0}}), InputError, "limit of jerk of a must be positive, got 0"),
        (described(limits={"c": {"jerk": 9.0}}), InputError, "coordinate 'c'.*a, b"),
    ],
)
def test_what_a_description_says_wrongly_is_named(folder, text, error, message):
    (folder / "mine.json").write_text(text)
    with pytest.raises(error, match=message):
        Arm.load("mine.json")
