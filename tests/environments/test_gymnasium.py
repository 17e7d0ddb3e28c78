import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_array_equal

from lieednn_sim.environments.expert import Expert
from lieednn_sim.environments.gymnasium import ENVIRONMENTS, register
from lieednn_sim.errors import InputError

REACH = "LieEDNN/TelescopicReach-v0"
TRACK = "LieEDNN/TelescopicTrack-v0"


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_checker_of_gymnasium_has_nothing_to_say(name, flat):
    environment = gymnasium.make(name, arm="telescopic_compound", time_limit=1.0, flat=flat)
    check_env(environment.unwrapped, skip_render_check=True)
    environment.close()


@pytest.mark.rendering
def test_the_checker_has_nothing_to_say_about_frames():
    environment = gymnasium.make(REACH, render_mode="rgb_array", size=(64, 48))
    check_env(environment.unwrapped)
    environment.close()


@pytest.mark.rendering
def test_frames_show_arm_and_target():
    environment = gymnasium.make(TRACK, arm="telescopic_compound", render_mode="rgb_array", size=(160, 120))
    environment.reset(seed=0)
    still = environment.render()
    assert still.shape == (120, 160, 3)
    assert still.dtype == np.uint8
    assert still.std() > 5.0
    assert_array_equal(environment.render(), still)
    for _ in range(20):
        environment.step(np.ones(24))
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


def test_episodes_depend_on_the_seed_alone():
    one, other = (gymnasium.make(REACH, time_limit=0.2) for _ in range(2))
    first = play(one, seed=4)
    play(one, seed=None)
    for again in (play(one, seed=4), play(other, seed=4)):
        for a, b in zip(first, again, strict=True):
            assert_array_equal(a, b)
    assert (play(other, seed=None)[0] != first[0]).any()


def play(environment, seed):
    observation, _ = environment.reset(seed=seed)
    seen, truncated = [observation["pose_error"]], False
    while not truncated:
        observation, reward, terminated, truncated, info = environment.step(np.full(8, 0.3))
        assert not terminated
        seen += [observation["position"], np.array([reward, info["distance"]])]
    return seen


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


def test_gymnasium_finds_the_environments_by_module_and_registration_repeats():
    register()
    code = (
        "import gymnasium\n"
        f"name = 'lieednn_sim.environments.gymnasium:{TRACK}'\n"
        "environment = gymnasium.make(name, control_timestep=0.01)\n"
        "environment.reset(seed=0)\n"
        "print(environment.spec.id, environment.unwrapped.metadata['render_fps'])\n"
    )
    assert python(code) == f"{TRACK} 100"


def test_without_gymnasium_the_extra_is_named():
    code = (
        "import sys\n"
        "sys.modules['gymnasium'] = None\n"
        "from lieednn_sim.environments import tasks\n"
        "from lieednn_sim.errors import LieEDNNError\n"
        "try:\n"
        "    import lieednn_sim.environments.gymnasium\n"
        "except LieEDNNError as error:\n"
        "    print(error)\n"
    )
    assert python(code) == "this module needs gymnasium: pip install 'lieednn_sim[gymnasium]'"


def python(code):
    command = [sys.executable, "-W", "error", "-c", code]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def test_malformed_arguments():
    with pytest.raises(InputError, match="render_mode must be 'rgb_array' or None, got 'human'"):
        gymnasium.make(f"lieednn_sim.environments.gymnasium:{REACH}").unwrapped.__class__(render_mode="human")
    with pytest.raises(InputError, match="no arm 'unknown'"):
        gymnasium.make(REACH, arm="unknown")
    environment = gymnasium.make(REACH)
    environment.reset(seed=0)
    with pytest.raises(InputError, match="action must be finite"):
        environment.unwrapped.step(np.full(8, np.nan))
