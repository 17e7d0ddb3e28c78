import importlib
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_array_equal

from lieednn_sim.environments.expert import Expert
from lieednn_sim.environments.gymnasium import ENVIRONMENTS
from lieednn_sim.errors import InputError, LieEDNNError

REACH = "LieEDNN/TelescopicReach-v0"
TRACK = "LieEDNN/TelescopicTrack-v0"


@pytest.mark.parametrize(("name", "flat"), [(REACH, True), (TRACK, False)])
def test_the_checker_of_gymnasium_has_nothing_to_say(name, flat):
    environment = gymnasium.make(name, time_limit=0.2, flat=flat)
    check_env(environment.unwrapped, skip_render_check=True)
    environment.close()


@pytest.mark.rendering
def test_the_checker_has_nothing_to_say_about_frames():
    environment = gymnasium.make(REACH, render_mode="rgb_array", size=(32, 24), time_limit=0.2)
    check_env(environment.unwrapped)
    environment.close()


@pytest.mark.rendering
def test_frames_show_arm_and_target():
    environment = gymnasium.make(TRACK, render_mode="rgb_array", size=(80, 60))
    environment.reset(seed=0)
    still = environment.render()
    assert still.shape == (60, 80, 3)
    assert still.dtype == np.uint8
    assert still.std() > 5.0
    assert_array_equal(environment.render(), still)
    for _ in range(3):
        environment.step(np.ones(8))
    moved = environment.render()
    assert (moved != still).any()
    environment.close()
    assert_array_equal(environment.render(), moved)
    environment.close()


def test_frames_that_cannot_be_rendered_are_refused_at_once():
    with pytest.raises(InputError, match="size must be even and at most 3840x2160, got 65x48"):
        gymnasium.make(REACH, render_mode="rgb_array", size=(65, 48))
    with pytest.raises(InputError, match="no preset 'ugly'; allowed: draft, nice"):
        gymnasium.make(REACH, preset="ugly")


def test_the_expert_reaches_a_chosen_target_through_wrappers():
    environment = gymnasium.make(REACH, time_limit=4.0)
    environment = gymnasium.wrappers.RecordEpisodeStatistics(environment)
    target = environment.unwrapped.task.arm.keyframe("extended")
    observation, info = environment.reset(seed=0, options={"target": target})
    assert not info["success"]
    expert = Expert(environment)
    truncated = False
    while not truncated:
        observation, _, _, truncated, info = environment.step(expert.act())
    assert info["success"]
    np.testing.assert_allclose(observation["position"], target, atol=1e-4)


@pytest.fixture
def unloaded(monkeypatch):
    """As before this package's module was imported."""
    for name in ENVIRONMENTS:
        monkeypatch.delitem(gymnasium.registry, name)
    monkeypatch.delitem(sys.modules, "lieednn_sim.environments.gymnasium")


@pytest.mark.usefixtures("unloaded")
def test_gymnasium_finds_the_environments_by_module():
    environment = gymnasium.make(f"lieednn_sim.environments.gymnasium:{TRACK}", control_timestep=0.01)
    environment.reset(seed=0)
    assert (environment.spec.id, environment.unwrapped.metadata["render_fps"]) == (TRACK, 100)


@pytest.mark.usefixtures("unloaded")
def test_without_gymnasium_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    with pytest.raises(LieEDNNError, match=r"gymnasium.*: pip install 'lieednn_sim\[gymnasium\]'"):
        importlib.import_module("lieednn_sim.environments.gymnasium")


def test_malformed_arguments():
    with pytest.raises(InputError, match="render_mode must be 'rgb_array' or None, got 'human'"):
        gymnasium.make(f"lieednn_sim.environments.gymnasium:{REACH}").unwrapped.__class__(render_mode="human")
    with pytest.raises(InputError, match="no arm 'unknown'"):
        gymnasium.make(REACH, arm="unknown")
    environment = gymnasium.make(REACH)
    environment.reset(seed=0)
    with pytest.raises(InputError, match="action must be finite"):
        environment.unwrapped.step(np.full(8, np.nan))
