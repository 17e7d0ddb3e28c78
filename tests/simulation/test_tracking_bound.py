"""The bound on tracking errors before a run: by hand for one slide, and against runs of arms."""

import numpy as np
import pytest

from lieednn_sim._mujoco import mujoco
from lieednn_sim.arm import Arm
from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.planning import plan
from lieednn_sim.simulation import Disturbances, simulate, tracking_bound
from lieednn_sim.simulation.controllers.base import NATURAL_FREQUENCY
from lieednn_sim.simulation.tracking_bound import _responses

_SLIDE = """<mujoco><option timestep="0.002"/><worldbody><body gravcomp="1"><joint name="x" type="slide" axis="{axis}"
    range="-1 1"/><geom size="0.1" mass="2" contype="0" conaffinity="0"/></body></worldbody><actuator><motor joint="x"
    ctrlrange="-500 500"/></actuator><custom><numeric name="acceleration_limit" data="50"/></custom></mujoco>"""


@pytest.fixture(scope="module")
def rising():
    return Arm.from_spec(mujoco.MjSpec.from_string(_SLIDE.format(axis="0 0 1")))


@pytest.fixture(scope="module")
def arm():
    return Arm.load("telescopic_pr")


def test_of_one_slide_by_hand(rising):
    """d = A (a + w) + g p / (m + p), A = p / (m + p): D = (|A| a + g p / (m + p)) / (1 - c |A|)."""
    motion = plan(rising, [0.5], start=[0.0], planner="minimum-jerk", duration=1.0).motion
    peak, share = 10.0 / np.sqrt(3.0) * 0.5, 0.25 / 2.25
    expected = share * (peak + 9.81) / (1.0 - 1.2707 * share) / NATURAL_FREQUENCY**2
    np.testing.assert_allclose(tracking_bound(rising, motion, payload=0.25), expected, rtol=0.03)
    # Lighter by a fifth: A = -1/4. Weight is compensated as if nothing was missing.
    expected = 0.25 * (peak + 9.81) / (1.0 - 1.2707 * 0.25) / NATURAL_FREQUENCY**2
    np.testing.assert_allclose(tracking_bound(rising, motion, mass_scale=(0.8, 1.0)), expected, rtol=0.03)
    twice = tracking_bound(rising, motion, payload=0.25, frequency=2.0 * NATURAL_FREQUENCY)
    np.testing.assert_allclose(tracking_bound(rising, motion, payload=0.25) / twice, 4.0, rtol=0.03)
    assert tracking_bound(rising, motion) == 0.0


def test_steps_of_time_are_part_of_the_bound():
    """A run with masses 0.6 times as large is 25 mm off at 10 ms; the bound without steps was 14 mm."""
    np.testing.assert_allclose(_responses(2.0, 1e-6), [1.0 / np.e, 1.0 + 2.0 * np.exp(-2.0)], rtol=2e-3)
    np.testing.assert_allclose(_responses(2.0, 0.25), [0.5, 1.5])
    coarse = Arm.from_spec(mujoco.MjSpec.from_string(_SLIDE.format(axis="0 0 1").replace("0.002", "0.01")))
    motion = plan(coarse, [0.5], start=[0.0], planner="minimum-jerk", duration=1.0)
    with pytest.raises(InputError, match=r"needs time steps of at most 0.00796 s, the model's are 0.01 s"):
        tracking_bound(coarse, motion, mass_scale=(0.6, 1.0))


def test_forces_of_the_feedback_are_within_their_limits():
    """The motion needs 5.77 of 0.95 * 6.2 N; for 0.05 kg feedback adds 2 * 1.284 * 0.0244 / 0.97 * 2.89 N."""
    weak = Arm.from_spec(mujoco.MjSpec.from_string(_SLIDE.format(axis="1 0 0").replace("500", "6.2")))
    motion = plan(weak, [0.5], start=[0.0], planner="minimum-jerk", duration=1.0)
    tracking_bound(weak, motion, payload=0.015)
    with pytest.raises(
        NotCertifiedError, match=r"may ask joint 'x' for 1\.0\d+ times 95 % of its force limit; plan a slower"
    ):
        tracking_bound(weak, motion, payload=0.05)


@pytest.mark.parametrize(("scales", "load"), [((0.85, 1.15), 0.0), ((1.0, 1.0), 0.4)])
def test_runs_stay_within(arm, scales, load):
    motion = plan(arm, draw_target(arm, 3), planner="minimum-jerk", duration=1.5)
    bound = tracking_bound(arm, motion, mass_scale=scales, payload=load)
    for scale in scales:
        changes = Disturbances(mass_scale=scale, payload=load)
        run = simulate(arm, motion, controller="computed-torque", disturbances=changes)
        error = np.abs(run.q - run.q_ref).max(axis=0)
        assert (error <= bound).all()
        # The bound is no more than a few times what is the worst of the range.
        assert error.max() > bound.max() / 4.0


def test_what_is_refused(arm, rising):
    motion = plan(rising, [0.5], start=[0.0], planner="minimum-jerk", duration=1.0).motion
    # A payload p is proved for A = p / (m + p) < 1 / 1.284, which is p < 7.04 kg here.
    with pytest.raises(NotCertifiedError, match="the feedback may ask joint 'x' for"):
        tracking_bound(rising, motion, payload=6.9)
    with pytest.raises(NotCertifiedError, match="smaller payload"):
        tracking_bound(rising, motion, payload=7.6)
    with pytest.raises(InputError, match="the smaller first"):
        tracking_bound(rising, motion, mass_scale=(1.1, 0.9))
    with pytest.raises(InputError, match="payload"):
        tracking_bound(rising, motion, payload=-1.0)
    sticky = _SLIDE.format(axis="0 0 1").replace('range="-1 1"', 'range="-1 1" frictionloss="1"')
    with pytest.raises(InputError, match="dry friction"):
        tracking_bound(Arm.from_spec(mujoco.MjSpec.from_string(sticky)), motion)
    balls = Arm.load("telescopic_compound")
    still = plan(balls, balls.keyframe("home"), planner="minimum-jerk")
    with pytest.raises(InputError, match="ball joints"):
        tracking_bound(balls, still)
