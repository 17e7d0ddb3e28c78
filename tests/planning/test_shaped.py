"""The planner `lieednn-shaped`: a certified network that moves as its guide does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from lieednn_sim.arm.targets import draw_target
from lieednn_sim.errors import PlanError
from lieednn_sim.evaluation.metrics import motion_metrics
from lieednn_sim.planning import PLANNERS, GuideOptions, ShapedOptions, plan, shaped
from lieednn_sim.planning.baselines.sampling import RrtConnectOptions
from lieednn_sim.planning.motion import check_motion, travelled
from lieednn_sim.planning.network_path import NetworkPath
from lieednn_sim.planning.shaped import lever_units
from lieednn_sim.planning.time_laws import law_of

from .arms import coarse

FREE = coarse(timestep=0.005)
UNPOLISHED = GuideOptions(optimised=False)
needs_ompl = pytest.mark.skipif("rrt-connect" in PLANNERS.missing(), reason="RRT-Connect needs OMPL")


def planned(arm, target, **options):
    return plan(arm, target, planner="lieednn-shaped", options=ShapedOptions(**options))


@pytest.mark.parametrize(
    ("scene", "seed", "planner", "asked"),
    [
        ("free", 0, "minimum-jerk", 7e-4),
        ("shelf", 2, "minimum-jerk, optimised", 7e-4),
        ("poles", 0, "rrt-connect, optimised", 3e-3),
    ],
)
def test_the_motion_is_the_guides_and_the_network_is_certified(scene, seed, planner, asked):
    arm = FREE.with_scene(scene, seed)
    target = draw_target(arm, seed)
    made = plan(arm, target, planner="lieednn-shaped", seed=seed, options=ShapedOptions(deviation=asked))
    motion, guide = made.motion, made.guide.motion
    assert (made.planner, made.guide.planner) == ("lieednn-shaped", planner)
    assert made.network.certified
    assert made.network.n_visible == arm.n_links
    check_motion(arm, motion)
    measured, given = motion_metrics(arm, motion), motion_metrics(arm, guide)
    assert measured.jerk_joints < 1.1 * given.jerk_joints
    assert measured.gap_mm < 1.0
    assert measured.path_ranges == pytest.approx(given.path_ranges, rel=0.01)
    # Place and time are the guide's: what is off along the path is off by the same little as what is across.
    np.testing.assert_allclose(motion.q, guide.q, atol=5e-3)
    tips = [arm.link_poses(one.q[::20]).translation[:, -1] for one in (motion, guide)]
    nearest = np.linalg.norm(tips[0][:, None] - tips[1][None], axis=2).min(axis=1)
    assert 0.0 < made.details.deviation < 1.5 * asked
    spacing = np.linalg.norm(np.diff(tips[1], axis=0), axis=1).max()
    assert nearest.max() <= made.details.deviation + 0.5 * spacing


def test_a_path_too_long_for_a_code_has_a_network_of_its_own(monkeypatch):
    arm = FREE.with_scene("shelf", 2)
    target = draw_target(arm, 2)
    usual = planned(arm, target)
    monkeypatch.setattr(shaped, "_STRENGTHS", (0.1,))
    made = planned(arm, target)
    assert made.network.certified
    assert made.network.n_neurons < usual.network.n_neurons
    assert made.details.deviation < 5e-3
    np.testing.assert_allclose(made.motion.q, made.guide.motion.q, atol=0.02)


def test_the_universal_network_is_integrated_to_the_same_motion():
    """What the planner has in closed form, the equation itself has too; and the network is the same for all targets."""
    made = [planned(FREE, draw_target(FREE, seed)) for seed in (2, 4)]
    assert made[0].network.certificate is made[1].network.certificate
    one, guide = made[0], made[0].guide.motion
    units = lever_units(FREE, guide.q)
    path = NetworkPath.integrate(FREE, one.network, FREE.keyframe("home"), units)
    again = path.timed(one.motion.t[-1], one.motion.timestep, law_of(guide, units))
    np.testing.assert_allclose(again.q, one.motion.q, atol=2e-5)
    np.testing.assert_allclose(again.qd, one.motion.qd, atol=2e-3)
    # In another time the same shares of the way are behind it at the same shares of the time.
    slower = path.timed(2.0 * one.motion.t[-1], one.motion.timestep, law_of(guide, units))
    np.testing.assert_allclose(slower.q[::2], again.q, atol=2e-6)
    early = one.motion.tau < 5.0
    np.testing.assert_allclose(again.tau[early], one.motion.tau[early], atol=2e-3)
    known, tau = NetworkPath.encoded(FREE, one.network, guide, units), path.states.t
    np.testing.assert_allclose(known.states(1.0 - np.exp(-tau)), one.network.visible(path.states.xi), atol=1e-6)


def test_lever_arms_by_hand():
    arm = FREE
    q = arm.keyframe("extended")[None]
    frames = arm.link_poses(q[0]).translation
    units = lever_units(arm, q)
    np.testing.assert_allclose(units[:, 3:], arm.length_scale)
    np.testing.assert_allclose(units[0, :3], np.linalg.norm(frames[-1] - arm.base.translation))
    np.testing.assert_allclose(units[3, :3], np.linalg.norm(frames[3] - frames[2]))


def test_with_a_slow_clock_the_network_has_one():
    target = draw_target(FREE, 1)
    made = planned(FREE, target, rate=0.3)
    assert made.network.n_clock == 2
    assert made.network.certified
    assert made.details.deviation < 2e-3


def test_who_stays_where_it_is_has_a_network_without_hidden_neurons():
    home = FREE.keyframe("home")
    made = planned(FREE, home)
    assert made.network.n_hidden == 0
    assert made.details.deviation == 0.0
    np.testing.assert_allclose(made.motion.q, np.broadcast_to(home, made.motion.q.shape), atol=1e-9)


def test_what_is_too_far_off_is_refused():
    with pytest.raises(PlanError, match=r"follows; minimum-jerk: the end effector would be .* mm off its path"):
        planned(FREE, draw_target(FREE, 0), deviation=1e-9)


@needs_ompl
def test_where_no_network_follows_another_path_is_asked_for(monkeypatch):
    """Where the first path is refused, the next guide's is taken, at last that of another seed."""
    arm = FREE.with_scene("poles", 0)
    guides_taken = []

    def picky(_problem, _options, guide):
        guides_taken.append(guide)
        if len(guides_taken) < 2:
            raise PlanError("not this one")
        return replace(guide, guide=guide)

    monkeypatch.setattr(shaped, "followed_guide", picky)
    made = planned(arm, draw_target(arm, 0), guides=2, guide=UNPOLISHED)
    first, second = (guide.motion for guide in guides_taken)
    assert made.guide is guides_taken[1]
    assert first.q.shape != second.q.shape or not np.array_equal(first.q, second.q)
    guides_taken.clear()
    with pytest.raises(PlanError, match="not this one"):
        planned(arm, draw_target(arm, 0), guides=1, guide=UNPOLISHED)
    assert len(guides_taken) == 1
    guides_taken.clear()
    planned(FREE, draw_target(FREE, 0), guides=1, guide=UNPOLISHED)
    assert [guide.planner for guide in guides_taken] == ["minimum-jerk", "rrt-connect"]


@needs_ompl
def test_the_fastest_motion_is_timed_once_along_the_first_curve_that_can_be_followed(monkeypatch):
    """Curves of RRT-Connect's path, each closer to it, are tried before another path is searched for."""
    pytest.importorskip("toppra")
    arm, taken, timed = FREE.with_scene("poles", 0), [], []
    true_retime, true_follow = shaped.retime, shaped.followed_guide

    def picky(problem, options, guide):
        taken.append(guide)
        if len(taken) < 3:
            raise PlanError("not this one")
        return true_follow(problem, options, guide)

    monkeypatch.setattr(shaped, "followed_guide", picky)
    monkeypatch.setattr(shaped, "retime", lambda *given: timed.append(1) or true_retime(*given))
    search = RrtConnectOptions(balanced=True, fastest=True)
    made = planned(arm, draw_target(arm, 0), guide=GuideOptions(optimised=False, search=search))
    assert made.guide is taken[-1]
    assert [guide.planner for guide in taken] == ["rrt-connect"] * 3
    assert timed == [1]
    assert travelled(taken[1].motion.q)[-1] < travelled(taken[2].motion.q)[-1]
    motion = made.motion
    check_motion(arm, motion)
    assert made.proved
    assert motion.t[-1] < 0.8 * plan(arm, motion.q[-1], planner="lieednn-shaped").t[-1]
    # Wherever the tip is, the guide's is near.
    tips = [arm.tip(one.q[::stride]) for one, stride in ((motion, 10), (made.guide.motion, 1))]
    assert cKDTree(tips[1]).query(tips[0])[0].max() < made.details.deviation + 2e-3


def test_the_motion_is_proved_whatever_was_seen_of_its_guide(monkeypatch):
    """Guides are looked at for contact at some samples; one that touches something is refused without that, too."""
    arm = FREE.with_scene("poles", 0)
    target = draw_target(arm, 0)
    usual = planned(arm, target)
    monkeypatch.setattr("lieednn_sim.planning.joint_space.check_contact", lambda *_: None)
    made = planned(arm, target)
    assert made.proved
    np.testing.assert_array_equal(made.motion.q, usual.motion.q)


@pytest.mark.parametrize("steps", [2, 3, 7])
def test_a_motion_of_a_few_steps_arrives(steps):
    home = FREE.keyframe("home")
    motion = plan(FREE, home + 1e-6, planner="lieednn-shaped", duration=0.005 * steps).motion
    np.testing.assert_allclose(motion.q[[0, -1]], [home, home + 1e-6], atol=1e-9)
