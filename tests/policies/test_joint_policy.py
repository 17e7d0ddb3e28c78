"""Policies in joint space: pace, pull and limits by hand."""

import numpy as np
import pytest

from lieednn_sim.errors import InputError
from lieednn_sim.policies import Feedback, JointPolicy, Policy

STILL = np.zeros(4)


class Constant(JointPolicy):
    """It always wants the same velocity."""

    def __init__(self, arm, velocity, feedback=None):
        super().__init__(arm, 50.0, feedback=feedback)
        self._velocity, self.told, self.elapsed = np.array(velocity), [], []

    def velocity(self, target, waiting):
        self.told.append(waiting)
        return self._velocity

    def elapse(self, time):
        self.elapsed.append(time)


def test_it_waits_and_yields_by_hand(gantry):
    policy = Constant(gantry, [0.1, 0.0, 0.0, 0.0], Feedback(rate=5.0, tolerance=0.01, patience=0.02))
    policy.reset(STILL)
    # The second joint is off by 0.08 of a range of 4, so that s = 1/2 and k d = 5 (1 - 1/2).
    q, qd = policy.step([0.0, 0.08, 0.0, 0.0], STILL)
    np.testing.assert_allclose(qd, [0.05, 0.2, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(q, [0.001, 0.004, 0.0, 0.0], atol=1e-15)
    assert policy.channels() == pytest.approx([0.5, 0.02])
    assert policy.told == pytest.approx([0.5])
    assert policy.elapsed == pytest.approx([0.5 * 0.02])


def test_limits_slow_it_down_with_its_time(gantry):
    policy = Constant(gantry, [0.8, 0.8, 0.0, 0.0])
    policy.reset(STILL)
    # From rest the first joint may reach 10 * 0.02 = 0.2 in a period, then 0.4; the second twice as much.
    for k, fast in enumerate((0.2, 0.4)):
        _, qd = policy.step(None, STILL)
        np.testing.assert_allclose(qd, [fast, fast, 0.0, 0.0], atol=1e-15)
        assert policy.elapsed[k] == pytest.approx(fast / 0.8 * 0.02)
    assert policy.message == "moves at 50 % of its speed, within the joints' limits"


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_rests_at_a_limit(side, gantry):
    policy = Constant(gantry, [0.1 * side, 0.1 * side, 0.0, 0.0])
    policy.reset([0.999 * side, 0.0, 0.0, 0.0])
    q, qd = policy.step(None, STILL)
    np.testing.assert_array_equal(q, [side, 0.002 * side, 0.0, 0.0])
    np.testing.assert_array_equal(qd, [0.0, 0.1 * side, 0.0, 0.0])


@pytest.mark.parametrize("wrong", [np.zeros(3), np.full(4, np.nan)])
def test_what_an_own_policy_returns_is_checked(gantry, wrong):
    class Own(JointPolicy):
        def velocity(self, target, waiting):
            return wrong

    class Bare(Policy):
        def act(self, measured, target):
            return measured

    with pytest.raises(InputError, match="the policy's velocity must"):
        Own(gantry, 100.0).step(STILL, STILL)
    with pytest.raises(InputError, match="act must return joints and rates, two arrays of shape"):
        Bare(gantry, 100.0).step(STILL, STILL)
