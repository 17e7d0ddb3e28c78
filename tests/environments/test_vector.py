"""Many environments at once: each is what it is alone, also where episodes end or simulations fail."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from lieednn_sim.environments.expert import Expert
from lieednn_sim.environments.gymnasium import Environment, VectorEnvironment
from lieednn_sim.errors import InputError

NAME = "LieEDNN/TelescopicReach-v0"


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, tuple) or np.asarray(one).dtype == object:
        for entry, twin in zip(one, other, strict=True):
            assert_same(entry, twin)
    else:
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-12)
        assert np.asarray(one).dtype == np.asarray(other).dtype


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize(
    ("task", "arm", "goal", "flat"),
    [("reach", "telescopic_pr", "end-effector", True), ("track", "telescopic_compound", "links", False)],
)
def test_each_is_as_gymnasium_has_it_one_after_the_other(task, arm, goal, flat, mode):
    given = {"task": task, "arm": arm, "goal": goal, "flat": flat, "time_limit": 0.1}
    many = VectorEnvironment(4, threads=3, autoreset_mode=mode, **given)
    single = SyncVectorEnv([lambda: Environment(**given)] * 4, autoreset_mode=mode)
    assert many.observation_space == single.observation_space
    assert many.action_space == single.action_space
    rng = np.random.default_rng(0)
    for begun in (many.reset(seed=3), single.reset(seed=3)), (many.reset(), single.reset()):
        assert_same(*begun)
        for _ in range(8):
            actions = 3.0 * rng.uniform(-1.0, 1.0, many.action_space.shape)
            assert_same(many.step(actions), single.step(actions))
    many.close()


def test_one_that_fails_says_why_and_begins_anew():
    many, alone = VectorEnvironment(3, time_limit=0.2, threads=2), Environment(time_limit=0.2)
    many.reset(seed=[0, 1, 2])
    alone.reset(seed=1)
    actions = np.full((3, 8), 0.3)
    many.step(actions)
    alone.step(actions[1])
    seen = many.step(actions)[0]
    alone.step(actions[1])
    many._states[1, -1] = alone.task.simulation.data.qvel[-1] = np.nan
    observation, rewards, terminated, truncated, infos = many.step(actions)
    expected = alone.step(actions[1])
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert rewards[1] == 0.0 < rewards[0]
    assert infos["failure"][1] == expected[4]["failure"]
    assert infos["_failure"].tolist() == [False, True, False]
    for name, values in observation.items():
        np.testing.assert_array_equal(values[1], seen[name][1])
        np.testing.assert_array_equal(values[1], expected[0][name])
    again, rewards, terminated, _, infos = many.step(actions)
    assert not terminated.any()
    assert rewards[1] == 0.0
    assert "failure" not in infos
    np.testing.assert_array_equal(again["position"][1], alone.reset()[0]["position"])


def test_gymnasium_makes_them_and_masks_are_kept():
    many = gymnasium.make_vec(NAME, num_envs=3, vectorization_mode="vector_entry_point", time_limit=0.1)
    first, _ = many.reset(seed=0)
    moved = many.step(np.full((3, 8), 0.5))[0]
    some, infos = many.reset(seed=0, options={"reset_mask": np.array([True, False, False])})
    np.testing.assert_array_equal(some["position"][0], first["position"][0])
    np.testing.assert_array_equal(some["position"][1:], moved["position"][1:])
    assert infos["_success"].tolist() == [True, False, False]
    many.close()


def test_gymnasium_may_shorten_episodes():
    """Targets stay those of the whole episode, as with Gymnasium's time limit around a single environment."""
    name = "LieEDNN/TelescopicTrack-v0"
    alone = gymnasium.make(name, max_episode_steps=3)
    many = gymnasium.make_vec(name, num_envs=1, vectorization_mode="vector_entry_point", max_episode_steps=3)
    np.testing.assert_array_equal(many.reset(seed=4)[0]["position_error"][0], alone.reset(seed=4)[0]["position_error"])
    ends = [(many.step(np.ones((1, 8)))[3].tolist(), alone.step(np.ones(8))[3]) for _ in range(3)]
    assert ends == [([False], False), ([False], False), ([True], True)]
    many.close()


def test_bad_input():
    with pytest.raises(InputError, match="no autoreset_mode 'never'; allowed: Disabled, NextStep, SameStep"):
        VectorEnvironment(2, autoreset_mode="never")
    many = VectorEnvironment(2, time_limit=0.02, autoreset_mode="Disabled")
    with pytest.raises(InputError, match=r"environment must be an ArmTask.* got VectorEnvironment"):
        Expert(many)
    with pytest.raises(InputError, match="seed must be a number or a list of 2, got one of 1000000000000"):
        many.reset(seed=range(10**12))
    with pytest.raises(InputError, match="seed must be a number or a list of 2, got one of 3"):
        many.reset(seed=[1, 2, 3])
    with pytest.raises(InputError, match="reset_mask must be an array of 2"):
        many.reset(options={"reset_mask": np.array([False, False])})
    with pytest.raises(InputError, match=r"the episodes of environments .* are over"):
        many.step(np.zeros((2, 8)))
    many.reset(seed=0)
    with pytest.raises(InputError, match="actions must be finite"):
        many.step(np.full((2, 8), np.nan))
    assert many.step(np.zeros((2, 8)))[3].all()
    with pytest.raises(InputError, match=r"the episodes of environments \[0 1\] are over"):
        many.step(np.zeros((2, 8)))
