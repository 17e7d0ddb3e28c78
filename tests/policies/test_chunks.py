"""Chunks of targets: clean ones unchanged, faults mended or refused, limits, the proof ahead, and arrival."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import RigidTransform

import lieednn_sim as ls
from lieednn_sim._mujoco import mujoco
from lieednn_sim.errors import InputError, PlanError
from lieednn_sim.planning.chunk_motion import ChunkCurve, go_over
from lieednn_sim.planning.chunks import judge
from lieednn_sim.planning.clearance import ProofAhead, proved_clearance
from lieednn_sim.policies import ChunkOptions, ChunkPolicy, from_joint_trajectory, make_policy
from lieednn_sim.policies.bounds import braking_in_time
from lieednn_sim.simulation import follow
from lieednn_sim.synthesis.shaping.encoder import CurveEncoder

REPAIRED = ChunkOptions().repaired
HOME = np.zeros(4)


def swing(t):
    """A way of the gantry from rest, within its limits: at most 0.8, 1.4, 0.5 and 1.6 of 1, 2, 4 and 8 per second."""
    t = np.maximum(np.asarray(t), 0.0)[..., None]
    return np.array([0.4, -0.7, 0.25, 0.8]) * (1.0 - np.cos(t - 0.5 * np.sin(2.0 * t)))


def made(arm, rate=100.0, **options):
    policy = ChunkPolicy(arm, rate, feedback=None, options=ChunkOptions(**options) if options else None)
    policy.reset(HOME)
    return policy


def run(policy, steps):
    return np.array([policy.step(None, HOME) for _ in range(steps)])


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.8])
def test_clean_chunks_are_followed_as_they_are_and_the_last_to_its_end(delay, gantry):
    """Of one way, 50 targets at 50 Hz every 0.1 s, all late."""
    policy, rows = made(gantry), []
    ahead = int(delay * 50)
    for k in range(0, 100, 5):
        t = 0.02 * (k - ahead + np.arange(50))
        verdict = policy.accept(swing(t), t[0], 0.02)
        assert (verdict.accepted, verdict.findings, verdict.slower) == (True, (), 1.0)
        # Those whose time had passed.
        assert verdict.dropped == ahead
        rows.append(run(policy, 10))
    q = np.concatenate(rows)[:, 0]
    np.testing.assert_allclose(q, swing(0.01 * np.arange(1, len(q) + 1)), atol=1e-3)
    np.testing.assert_allclose(run(policy, 300)[-1], [swing(t[-1]), HOME], atol=1e-6)
    assert policy.network.certificate is CurveEncoder(2).network.certificate
    np.testing.assert_allclose(policy.network.visible(policy.network.equilibrium().xi), gantry.encode(swing(t[-1])))
    assert policy.counts == {"accepted": 20}


def test_a_chunk_that_is_over_now_is_joined_earlier_and_looked_at_to_its_end(gantry):
    """It is so far ahead that it is followed from 1.875 s before its end, of which 1.5 s are coded at once."""
    policy, end = made(gantry), np.array([0.8, 1.6, 1.5, 2.4])
    verdict = policy.accept(np.linspace(0.0, 1.0, 31)[:, None] * end, -7.5, 0.25)
    assert verdict.accepted
    assert verdict.dropped == 30
    assert policy.course.transition.base.end < 7.5
    np.testing.assert_allclose(run(policy, 600)[-1], [end, HOME], atol=1e-6)


def test_a_source_gives_chunks_while_an_arm_follows(gantry):
    policy, seen = made(gantry), []

    def source(now, measured):
        seen.append((now, measured.copy()))
        return (swing(now - 0.1 + 0.02 * np.arange(50)), now - 0.1, 0.02) if len(seen) % 30 == 1 else None

    policy.source = lambda now, q: swing(np.arange(5.0))  # type: ignore[assignment]
    with pytest.raises(InputError, match=r"a source must return None, or a chunk, t0 and dt, got an array of shape"):
        policy.step(None, HOME)
    policy.source = source
    rollout = follow(policy, HOME, 2.0).rollout
    assert (len(seen), policy.counts) == (201, {"accepted": 7})
    np.testing.assert_allclose([now for now, _ in seen], 0.01 * np.arange(201), atol=1e-9)
    np.testing.assert_allclose(rollout.q, swing(rollout.t), atol=2e-3)
    np.testing.assert_allclose([measured for _, measured in seen], swing(0.01 * np.arange(201)), atol=2e-3)


def test_what_numpy_takes_as_an_array_is_a_chunk(gantry):
    chunk = type("Chunk", (), {"__array__": lambda *_, **__: swing(0.02 * np.arange(50))})()
    assert str(made(gantry).accept(chunk, 0.0, 0.02)) == "accepted"


def test_a_long_chunk_is_coded_piece_by_piece(gantry):
    """Of 6.3 s, more than one code can hold."""
    policy = made(gantry)
    t = 0.1 * np.arange(64)
    assert str(policy.accept(swing(t), 0.0, 0.1)) == "accepted"
    q = run(policy, 700)[:, 0]
    assert policy.changes >= 4
    # At the end it slows down.
    np.testing.assert_allclose(q[:580], swing(0.01 * np.arange(1, 581)), atol=4e-4)
    np.testing.assert_allclose(q[-1], swing(t[-1]), atol=1e-6)


@pytest.mark.parametrize(
    ("chunk", "t0", "dt", "kind"),
    [
        (np.zeros((5, 3)), 0.0, 0.1, "shape"),
        (np.zeros((0, 4)), 0.0, 0.1, "shape"),
        (np.zeros((257, 4)), 0.0, 0.1, "shape"),
        (["a"], 0.0, 0.1, "shape"),
        ([[0.0] * 4, [0.0] * 3], 0.0, 0.1, "shape"),
        (np.array([[0.0, 0.0, np.nan, 0.0]] * 2), 0.0, 0.1, "nan"),
        (np.zeros((5, 4)), np.nan, 0.1, "times"),
        (np.zeros((5, 4)), 0.0, 0.0, "times"),
        (np.zeros((5, 4)), 1.8e9, 0.1, "times"),  # of the clock on the wall
        (np.zeros((5, 4)), 0.6, 40.0, "times"),  # milliseconds
        (np.array([[0.0, 60.0, 0.0, 0.0]] * 5), 0.6, 0.1, "limits"),  # degrees
        (np.zeros((5, 4)), 0.1, 0.1, "stale"),  # it is 0.6 s, and the last one is for 0.5 s
        (np.zeros((5, 4)), 0.25, 0.1, "stale"),  # before the one that came before
        (np.linspace(HOME, [0.0, 0.0, -1.5, 0.0], 30), 0.5, 0.1, "contact"),
        (np.resize(np.repeat([[0.9] * 4, [-0.8] * 4], 5, axis=0), (40, 4)), 0.5, 0.02, "motion"),
    ],
)
def test_what_cannot_be_mended_is_refused_and_the_old_chunk_goes_on(chunk, t0, dt, kind, gantry):
    policies = [made(gantry), made(gantry)]
    for policy in policies:
        run(policy, 30)
        policy.accept(swing(0.02 * np.arange(50)), 0.3, 0.02)
        run(policy, 30)
    verdict = policies[0].accept(chunk, t0, dt)
    assert not verdict.accepted
    assert [finding.kind for finding in verdict.findings if not finding.repaired] == [kind]
    assert policies[0].counts[kind] == policies[0].counts["refused"] == 1
    np.testing.assert_array_equal(*(run(policy, 30) for policy in policies))


@pytest.mark.parametrize("t0", [0.0, 0.5])
def test_a_small_ball_between_two_targets_is_found(t0, gantry, tmp_path):
    """The arm's own of 0.1 m passes it half way between targets that are half a metre from each other."""
    at = gantry.link_poses([0.75, 0.0, 0.0, 0.0])[-1].translation.tolist()
    ball = {"shape": "sphere", "name": "small", "radius": 0.02, "position": at}
    (path := tmp_path / "ball.json").write_text(json.dumps({"obstacles": [ball]}))
    arm, chunk = gantry.with_scene(path), np.linspace(HOME, [1.0, 0.0, 0.0, 0.0], 3)
    assert not any(map(arm.contacts, chunk))
    verdict = made(arm).accept(chunk, t0, 2.0)
    assert [finding.kind for finding in verdict.findings] == ["contact"]
    assert not verdict.accepted


def test_a_contact_is_named_with_its_time_and_distance(gantry):
    """At 0.52 m/s the ball of 0.1 m is at the floor 1 m below after 1.73 s."""
    verdict = made(gantry).accept(np.linspace(HOME, [0.0, 0.0, -1.56, 0.0], 31), 0.0, 0.1)
    (contact,) = verdict.findings
    assert contact.text.startswith("'wrist' would be -") or contact.text.startswith("'world' would be -")
    assert 1.73 < float(contact.text.split(" s from now")[0].split()[-1]) < 1.93
    assert -0.1 < contact.value < 0.0


def test_faults_are_found_with_their_values_and_mended(gantry):
    """Rows of 0.1 s; limits of 1, 2, 4 and 8 per second, and of 1, 2, -2 to 3 and 3."""
    flat = np.zeros((20, 4))

    def found(changed, step=0.1):
        parts, findings = judge(gantry, changed, step, 0.0, np.minimum(changed[0], 2.0), REPAIRED)
        return parts, {finding.kind: (finding.joint, finding.row, finding.value, finding.limit) for finding in findings}

    assert found(flat)[1] == {}
    beyond, spike = flat.copy(), flat.copy()
    beyond[:, 1] = 2.5
    parts, findings = found(beyond)
    assert findings == {"limits": ("y", 0, 2.5, 2.0)}
    np.testing.assert_allclose(parts[0][1].end, [0.0, 2.0, 0.0, 0.0])
    # One that cannot be repaired is named, though a smaller one is before it.
    beyond[5, 1] = 60.0
    assert found(beyond)[1]["limits"] == ("y", 5, 60.0, 2.0)
    # Explained are 0.05 m: by half of the velocity limit over a row.
    spike[7, 0] = 0.3
    parts, findings = found(spike)
    assert findings == {"outlier": ("x", 7, 0.3, pytest.approx(0.05))}
    assert np.abs(parts[0][1](np.linspace(0.0, 1.9, 100))[0]).max() < 1e-12
    # In rows of 0.02 s, by twice the limit of acceleration over a row.
    small = flat.copy()
    small[7, 0] = 0.01
    assert found(small, 0.02)[1] == {"outlier": ("x", 7, 0.01, pytest.approx(0.004))}
    # Also of the first and of the last target alone, which are no reason to be slow for the others.
    for row in (1, 12, 19):
        jump = np.where(np.arange(20)[:, None] < row, 0.0, [0.5, 0.0, 0.0, 0.0])
        parts, findings = found(jump)
        assert findings == {"jump": ("x", row, 0.5, pytest.approx(0.1))}
        assert [(begin, curve.end[0]) for begin, curve in parts] == [
            pytest.approx(pair) for pair in ((0.0, 0.0), (0.1 * row, 0.5))
        ]
    # Twice as fast as the first joint may be.
    fast = np.outer(np.linspace(-1.0, 1.0, 11), [1.0, 0.0, 0.0, 0.0])
    _, findings = found(fast)
    assert findings == {"speed": ("x", pytest.approx(0, abs=10), pytest.approx(2.0), 1.0)}


def test_a_fast_chunk_takes_longer_on_the_same_way(gantry):
    policy = made(gantry)
    t = 0.02 * np.arange(80)
    verdict = policy.accept(swing(2.0 * t), 0.0, 0.02)
    rates = np.diff(swing(np.linspace(0.0, 2.0 * t[-1], 5000)), axis=0) * 5000.0 / t[-1]
    assert verdict.slower == pytest.approx((np.abs(rates) / gantry.velocity_limits).max(), rel=5e-3)
    assert verdict.slower > 1.5
    assert {finding.kind for finding in verdict.findings} == {"speed"}
    rows = run(policy, 400)
    assert (np.abs(rows[:, 1]) <= gantry.velocity_limits).all()
    way = swing(np.linspace(0.0, 2.0 * t[-1], 5000))
    assert np.abs(way[:, None] - rows[None, ::5, 0]).max(axis=2).min(axis=0).max() < 1e-3


def test_the_curve_by_hand(gantry):
    """It has a parabola exactly, halves noise at least, and stays within the limits."""
    t, u, rng = 0.1 * np.arange(20), np.linspace(0.0, 1.9, 77), np.random.default_rng(0)
    q, qd, qdd = ChunkCurve.through(gantry, np.stack([0.2 * t, t**2 - t, 0.1 + 0.0 * t, t], axis=1), 0.1)(u)
    np.testing.assert_allclose(q, np.stack([0.2 * u, u**2 - u, 0.1 + 0.0 * u, u], axis=1), atol=1e-9)
    np.testing.assert_allclose(qd, np.stack([0.2 + 0.0 * u, 2.0 * u - 1.0, 0.0 * u, 1.0 + 0.0 * u], axis=1), atol=1e-8)
    np.testing.assert_allclose(qdd, np.tile([0.0, 2.0, 0.0, 0.0], (77, 1)), atol=1e-7)
    t = 0.02 * np.arange(60)
    noisy = swing(t) + 5e-3 * rng.standard_normal((60, 4))
    left = (ChunkCurve.through(gantry, noisy, 0.02)(t)[0] - swing(t))[3:-3]
    assert np.sqrt(np.mean(left**2)) < 2.5e-3
    wild = np.clip(5.0 * rng.standard_normal((30, 4)), *gantry.position_limits.T)
    q = ChunkCurve.through(gantry, wild, 0.1)(np.linspace(0.0, 2.9, 3000))[0]
    assert (gantry.limit_excess(q) < 1e-12).all()
    # Along its limits, where a spline would swing beyond.
    steps = np.repeat(gantry.position_limits.T[[0, 1, 1, 0]], 10, axis=0)
    q = ChunkCurve.through(gantry, steps, 0.1)(np.linspace(0.0, 3.9, 3000))[0]
    assert (gantry.limit_excess(q) < 1e-12).all()


def test_random_streams_keep_limits_without_a_jump_and_end_where_the_last_chunk_does(gantry):
    rng, end = np.random.default_rng(0), None
    low, high = gantry.position_limits.T
    low = np.maximum(low, [-1.0, -2.0, -0.85, -3.0])
    policy = made(gantry, newest=0.7)
    rows = [run(policy, 1)]
    for _ in range(24):
        step, count = rng.choice([0.02, 0.1]), rng.integers(1, 40)
        walk = (
            policy.q
            + rng.choice([0.0, 0.1])
            + np.cumsum(rng.uniform(0.0, 2.0) * step * rng.standard_normal((count, 4)), 0)
        )
        verdict = policy.accept(np.clip(walk, low, high), policy.now - rng.uniform(0.0, 0.5), step)
        end = policy._wanted if verdict.accepted else end
        rows.append(run(policy, rng.integers(1, 60)))
    assert policy.counts["accepted"] >= 12
    q, qd = np.moveaxis(np.concatenate([*rows, run(policy, 800)]), 1, 0)
    acceleration = 100.0 * np.diff(qd, axis=0) / gantry.acceleration_limits
    assert np.abs(qd / gantry.velocity_limits).max() < 1.0 + 1e-9
    assert np.abs(acceleration).max() < 1.0 + 1e-9
    # None of the limit within one period, as a jump of velocities would.
    assert np.abs(np.diff(acceleration, axis=0)).max() < 0.95
    np.testing.assert_allclose(np.diff(q, axis=0), 0.005 * (qd[1:] + qd[:-1]), atol=1e-12)
    np.testing.assert_allclose(q[-1], end, atol=1e-5)


def test_limits_hold_while_an_arm_is_pushed_about(gantry):
    """It pulls the network along, and its pace changes."""
    rng, policy = np.random.default_rng(0), ChunkPolicy(gantry, 100.0)
    policy.reset(HOME)
    rates, off = [policy.qd], np.zeros(4)
    for k in range(400):
        if k % 40 == 0:
            policy.accept(swing(policy.now + 0.02 * np.arange(60)), policy.now, 0.02)
            off = rng.choice([0.0, 0.05, 0.3]) * gantry.ranges * rng.uniform(-1.0, 1.0, 4)
        low, high = gantry.position_limits.T
        rates.append(policy.step(np.clip(policy.q + off, low, high), HOME)[1])
    acceleration = 100.0 * np.diff(rates, axis=0) / gantry.acceleration_limits
    assert 0.9 < np.abs(acceleration).max() < 1.0 + 1e-9
    assert np.abs(rates / gantry.velocity_limits).max() < 1.0 + 1e-9


def test_at_limits_positions_and_rates_agree():
    """The network goes beyond by what its code lacks; the reference brakes before."""
    arm, rng, rows = ls.Arm.load("telescopic_rrp"), np.random.default_rng(0), []
    policy, home, x = ChunkPolicy(arm, feedback=None), arm.keyframe("home"), np.minimum(np.arange(30) / 16.0, 1.0)
    policy.reset(home)
    for _ in range(12):
        end = arm.position_limits[np.arange(arm.n_joints), rng.integers(0, 2, arm.n_joints)]
        end = np.where(rng.random(arm.n_joints) < 0.4, end, policy.q)
        policy.accept(policy.q + np.outer(x, end - policy.q), policy.now - rng.uniform(0.0, 0.3), 0.05)
        rows += [policy.step(None, home) for _ in range(rng.integers(10, 80))]
    q, qd = np.moveaxis(np.array(rows), 1, 0)
    np.testing.assert_allclose(np.diff(q, axis=0), 0.005 * (qd[1:] + qd[:-1]), atol=1e-12)
    assert (np.abs(q[:, :, None] - arm.position_limits) < 1e-6).any()


@pytest.mark.parametrize(("step", "speed"), [(0.02, 1.0), (0.05, 1.0), (0.1, 0.6)])
def test_positions_and_rates_agree_along_the_limit_of_a_ball_joint(step, speed):
    """It goes out to its largest angle, which the chunk exceeds, while it turns about, and on along that."""
    arm = ls.Arm.load("telescopic_compound")
    policy, home, ball, t = ChunkPolicy(arm, feedback=None), arm.keyframe("home"), arm.space.balls[-1], np.arange(60.0)
    policy.reset(home)
    chunk, angle = np.tile(home, (60, 1)), step * speed * t
    out = 1.02 * arm.position_limits[ball[0], 1] * np.minimum(t / 20.0, 1.0)
    chunk[:, ball] = np.stack([out * np.cos(angle), out * np.sin(angle), 0.0 * t], axis=1)
    assert policy.accept(chunk, 0.0, step).accepted
    q, qd = np.moveaxis([policy.step(None, home) for _ in range(700)], 1, 0)
    np.testing.assert_allclose(np.diff(q, axis=0), 0.005 * (qd[1:] + qd[:-1]), atol=1e-11)
    assert -1e-4 < arm.limit_excess(q)[:, ball].max() < 1e-12


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=3)
def test_joints_brake_before_their_limits_whatever_is_wished_for(seed):
    """Another velocity in every 40th of 400 steps, up to the limits; ball joints turn along their largest angles."""
    arm, rng, h = ls.Arm.load("telescopic_compound"), np.random.default_rng(seed), 0.01
    v, most, balls = arm.velocity_limits, h * arm.acceleration_limits, arm.space.balls.ravel()
    q, qd, beyond = arm.keyframe("home"), np.zeros(arm.n_joints), []
    for wish in rng.uniform(-v, v, (10, arm.n_joints)).repeat(40, axis=0):
        middle, old = q + 0.5 * h * qd, qd
        qd = braking_in_time(arm, middle, np.clip(wish, old - most, old + most), old, h)
        assert (np.abs(qd - old) <= most + 1e-9).all()
        q = middle + 0.5 * h * qd
        beyond.append(arm.limit_excess(q))
    worst = np.max(beyond, axis=0)
    assert np.delete(worst, balls).max() <= 1e-9
    assert -0.02 < worst.max() < 5e-4


def test_earlier_chunks_have_their_weight_until_they_end(gantry):
    """At 0.1 for 2 s, then at 0.3 with a weight of 0.75: 0.25 from 0.3 on at first, and 0.3 where the first ends."""
    policy = made(gantry, newest=0.75)
    policy.accept(np.full((21, 4), 0.1), 0.0, 0.1)
    run(policy, 100)
    policy.accept(np.full((21, 4), 0.3), 1.0, 0.1)
    begin, curve = policy._curve
    u = np.array([0.0, 0.5, 1.0, 1.5])
    weight = 0.25 * np.array([1.0, 0.5, 0.0, 0.0])[:, None]
    assert begin == 1.0
    np.testing.assert_allclose(curve(u)[0], 0.3 - 0.2 * weight + np.zeros(4), atol=2e-3)


@pytest.mark.parametrize("newest", [1.0, 0.5])
def test_a_policy_that_is_late_makes_the_arm_go_on_and_not_back_and_forth(newest, gantry):
    """Chunks of 1 s from where the arm was 0.8 s ago towards a goal, every 0.3 s, with noise of 2 mm."""
    policy, rng, goal = made(gantry, newest=newest), np.random.default_rng(0), np.array([0.6, 1.0, 0.3, 1.5])
    way = [HOME]
    for k in range(20):
        if k >= 3:
            seen = way[max(round(100 * (policy.now - 0.8)), 0)]
            chunk = goal + (seen - goal) * np.exp(-1.5 * 0.02 * np.arange(50)[:, None])
            assert policy.accept(chunk + 2e-3 * rng.standard_normal((50, 4)), policy.now - 0.8, 0.02).accepted
        way += list(run(policy, 30)[:, 0])
    left = np.linalg.norm(np.array(way) - goal, axis=1)
    assert left[-1] < 5e-3
    assert (left - np.minimum.accumulate(left)).max() < 1e-2


def test_a_chunk_that_is_nearly_over_is_followed_from_an_earlier_time_on(gantry):
    """Chunks of 1 s from where the arm was 0.8 s ago to the goal, every 0.4 s, too fast to catch up with."""
    policy, goal, way = made(gantry), np.array([0.9, 1.5, 0.3, 2.5]), [HOME]
    part = np.minimum(0.02 * np.arange(60), 1.0)[:, None]
    for k in range(20):
        if k >= 2:
            seen = way[max(round(100 * (policy.now - 0.8)), 0)]
            chunk = seen + part**3 * (10.0 - part * (15.0 - 6.0 * part)) * (goal - seen)
            assert policy.accept(chunk, policy.now - 0.8, 0.02).accepted
        way += list(run(policy, 40)[:, 0])
    left = np.linalg.norm(np.array(way) - goal, axis=1)
    assert left[-1] < 1e-4
    assert (left - np.minimum.accumulate(left)).max() < 1e-3


def test_poses_become_the_joint_targets_next_to_each_other():
    arm = ls.Arm.load("telescopic_pr")
    policy = make_policy("lieednn-chunks", arm, "home", feedback=None)
    t = np.linspace(0.0, 1.0, 11)[:, None]
    way = arm.keyframe("home") + (3.0 * t**2 - 2.0 * t**3) * 0.3 * (arm.keyframe("extended") - arm.keyframe("home"))
    poses = RigidTransform.from_matrix(np.stack([arm.link_poses(q)[-1].as_matrix() for q in way]))
    verdict = policy.accept(poses, 0.0, 0.1)
    assert verdict.accepted, verdict
    for _ in range(200):
        policy.step(None, arm.keyframe("home"))
    off = poses[-1].inv() * arm.link_poses(policy.q)[-1]
    assert max(np.abs(off.translation).max(), off.rotation.magnitude()) < 1e-4
    far = RigidTransform.from_translation([[9.0, 0.0, 0.0]])
    assert [finding.kind for finding in policy.accept(far, policy.now, 0.1).findings] == ["reach"]


def test_a_chunk_for_later_begins_then_and_a_new_target_is_newer(gantry):
    policy = made(gantry)
    assert policy.accept(0.3 + swing(0.02 * np.arange(50)), 0.2, 0.02).accepted
    q = run(policy, 30)[:, 0]
    assert np.abs(q[:20]).max() < 1e-9 < 1e-4 < np.abs(q[29]).min()
    # What the verdict says is of the new chunk, and not of the one that goes on until then.
    later = policy.accept(0.3 + swing(0.02 * np.arange(50)), policy.now + 0.5, 0.02)
    assert (later.accepted, later.slower, later.fade) == (True, 1.0, 0.0)
    for _ in range(300):
        policy.step(None, np.full(4, 0.2))
    np.testing.assert_allclose(policy.q, 0.2, atol=1e-4)


def test_what_comes_in_the_way_of_a_later_part_is_told(gantry):
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="ball", pos=[1.0, 5.0, 0.1])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0.0, 0.0])
    policy = made(dataclasses.replace(gantry.with_obstacles(spec, "ball"), scene="free"))
    chunk = np.outer(np.linspace(0.0, 1.0, 21) ** 2, [0.0, 1.7, 0.0, 0.0])
    chunk[:8], chunk[8:, 1] = 0.0, 0.7 * chunk[8:, 1] + 0.6
    assert [finding.kind for finding in policy.accept(chunk, 0.0, 0.1).findings] == ["jump"]
    policy.see({"obstacle_ball": [1.0, 1.5, 0.1]})
    assert np.abs(run(policy, 300)).max() < 0.02
    assert [finding.kind for finding in policy.verdict.findings] == ["jump", "contact"]
    found = policy.verdict.findings[-1]
    assert (found.repaired, policy.counts["contact"]) == (False, 1)
    assert found.value < found.limit == policy.arm.clearance
    # Where the reference rests, and with it what else the chunk holds.
    assert policy.chunk_time == pytest.approx(0.7)


def test_turns_of_a_continuous_joint_that_end_at_half_a_turn_go_on():
    """Of a chunk, and of an encoder, in `step` and in the loop."""
    link = '<body name="{0}" pos="{1} 0 0"><joint name="{0}" axis="{2}" {3}/><geom type="capsule" size=".02" \
fromto=".05 0 0 .3 0 0"/>'
    bodies = link.format("turn", 0.0, "0 0 1", "") + link.format("lift", 0.4, "0 1 0", 'range="-90 90"')
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</body></body></worldbody></mujoco>")
    arm = ls.Arm.of(model, mujoco.MjData(model), ["turn", "lift"])
    chunk = np.array([3.0, 0.0]) + np.outer(np.linspace(0.0, 1.0, 50) ** 2, [0.5, 0.3])

    def within(q):
        return np.array([(q[0] + np.pi) % (2.0 * np.pi) - np.pi, q[1]])

    policy, robot = ChunkPolicy(arm), {"q": chunk[0]}
    policy.source = lambda now, q: (list(map(within, chunk)), 0.1, 0.02) if now == pytest.approx(0.1) else None
    policy.reset(chunk[0])
    for _ in range(150):
        q, _ = policy.step(within(policy.q), chunk[0])
    assert str(policy.verdict) == "accepted"
    np.testing.assert_allclose(q, chunk[-1], atol=1e-6)
    # Half-way between two points of a message it is at half a turn, and not at 0.
    duration = [SimpleNamespace(sec=0, nanosec=100_000_000 * k) for k in (0, 1, 3)]
    points = [
        SimpleNamespace(positions=[0.0, q], velocities=[], time_from_start=since)
        for q, since in zip((3.0, 3.1, -3.1), duration, strict=True)
    ]
    q, *_ = from_joint_trajectory(arm, SimpleNamespace(joint_names=["lift", "turn"], points=points))
    np.testing.assert_allclose(q[:, 0], [3.0, 3.1, np.pi, 2.0 * np.pi - 3.1])
    report = ls.control_loop(
        policy, lambda: within(robot["q"]), lambda q, _: robot.update(q=q), within(chunk[0]), duration=1.5
    )
    assert not any(report.faults.values())
    np.testing.assert_allclose(robot["q"], chunk[-1], atol=1e-6)


@pytest.mark.parametrize("gap", [-1e-5, 5e-4])
def test_no_contact_where_samples_see_none(gap, gantry):
    """A ball beside the way, which the arm's ball of 0.1 m touches for 3 mm between two samples; it rests before it.

    It may be 1 mm off the way, so that nothing is proved where it is to pass by half as much.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="ball", pos=[1.0, 0.923, 0.101 + gap])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.001, 0.0, 0.0])
    arm = dataclasses.replace(gantry.with_obstacles(spec, "ball"), scene="free")
    thin = dataclasses.replace(arm, clearance=0.0)
    policy = made(thin)
    t = np.linspace(0.0, 1.0, 21)
    q = np.outer(3.0 * t**2 - 2.0 * t**3, [0.0, 1.7, 0.0, 0.0])
    assert policy.accept(q, 0.0, 0.1).accepted
    states, beyond = [], []
    for _ in range(400):
        states.append(policy.step(None, HOME))
        beyond.append(policy.time - policy._proof.time)
    rows, rates = np.moveaxis(np.array(states), 1, 0)
    assert not any(thin.contacts(row) for row in rows)
    # It brakes neither too late nor gently: here with 0.8 of the limit, at less than the motion's greatest speed.
    assert -1e-3 < max(beyond) <= 0.0
    braking = -100.0 * np.diff(rates, axis=0).min(axis=0) / thin.acceleration_limits
    assert 0.5 < braking[1] < 0.7
    (finding,) = policy.verdict.findings
    assert finding.text.endswith(" s, before 'a geom of obstacle_ball' may touch 'ball'")
    assert policy.message == "rests before 'a geom of obstacle_ball' may touch 'ball', which is not proved"
    assert np.abs(policy.qd).max() < 1e-3 < 0.5 < policy.q[1]


def test_the_proof_ahead_is_that_of_the_whole_motion(gantry):
    t = np.linspace(0.0, 1.0, 33)
    for depth in (0.8, 1.2):
        q = np.outer(3.0 * t**2 - 2.0 * t**3, [0.0, 1.0, -depth, 0.0])
        qd = np.outer(6.0 * t - 6.0 * t**2, [0.0, 1.0, -depth, 0.0])
        ahead, times = ProofAhead(gantry, t, q, qd, 0.0 * q), []
        while np.isfinite(ahead.time) and not ahead.pair:
            times.append(ahead.time)
            ahead.advance()
        whole = proved_clearance(gantry, t, q, qd)
        assert whole.proved == (not ahead.pair) == (depth == 0.8)
        assert (np.diff(times) >= 0.0).all()
        if depth == 1.2:
            assert ahead.time == pytest.approx(whole.unproved[0, 0], abs=6e-4)
            assert "floor" in ahead.pair


def test_what_is_misused_is_said(gantry):
    with pytest.raises(InputError, match=r"call reset\(q\), or step with measured joints, before accept"):
        ChunkPolicy(gantry).accept(np.zeros((2, 4)), 0.0, 0.1)
    with pytest.raises(InputError, match="repaired"):
        ChunkOptions(repaired=("nan",))
    with pytest.raises(InputError, match="newest must be from 0 to 1, got 2"):
        ChunkOptions(newest=2.0)
    policy = make_policy("lieednn-chunks", gantry, np.full(4, 0.1), start=HOME)
    assert (policy.certified, str(policy.accept(np.zeros((3, 4)), 0.0, 0.1))) == (True, "accepted")


def test_around_a_pole_if_asked(gantry):
    """The chunk goes through the pole to a place behind it."""
    pytest.importorskip("ompl")
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="pole", pos=[1.0, 0.8, 0.0])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.05, 4.0, 0.0])
    arm = dataclasses.replace(gantry.with_obstacles(spec, "pole"), scene="free")
    t = np.linspace(0.0, 1.0, 31)
    chunk = np.outer(3.0 * t**2 - 2.0 * t**3, [0.0, 1.6, 0.0, 0.0])
    verdict = made(arm).accept(chunk, 0.0, 0.1)
    assert [(finding.kind, finding.repaired) for finding in verdict.findings] == [("contact", False)]
    policy = made(arm, repaired=(*REPAIRED, "contact"))
    verdict = policy.accept(chunk, 0.0, 0.1)
    assert [(finding.kind, finding.repaired) for finding in verdict.findings] == [("contact", True)]
    q = run(policy, 900)[:, 0]
    np.testing.assert_allclose(q[-1], chunk[-1], atol=1e-5)
    assert not any(arm.contacts(row) for row in q)


def test_a_motion_along_a_curve_has_the_derivatives_of_its_positions_and_its_state_at_the_beginning(gantry):
    curve, v, a = ChunkCurve.through(gantry, swing(0.05 * np.arange(30)), 0.05), *map(np.array, ([0.1] * 4, [0.5] * 4))
    now = np.stack([curve(np.array([0.3]))[0, 0] + 0.01, v, a])
    motion = go_over(gantry, now, curve, 0.3, 0.9, 0.2)
    require_derivatives(motion, now)
    np.testing.assert_allclose(motion(np.array([motion.duration, 9.0]))[0], curve(np.array([1.2] * 2))[0], atol=1e-9)


def test_a_curve_that_ends_while_it_moves_is_joined_at_rest(gantry):
    """Of which the last target is for now; from there it takes the arm's speed back."""
    curve, now = ChunkCurve.through(gantry, swing(0.05 * np.arange(20)), 0.05), np.zeros((3, 4))
    now[0], now[1] = curve.end, 0.1
    motion = go_over(gantry, now, curve, curve.duration, 1.5, 0.2)
    require_derivatives(motion, now)
    assert np.abs(motion.even[1]).max() == pytest.approx(0.1)


def test_a_curve_that_cannot_be_caught_up_with_is_joined_as_late_as_needed(gantry):
    """From rest where it begins, 0.8 s behind on a curve of 1 s at half the largest speed."""
    curve = ChunkCurve.through(gantry, np.outer(0.025 * np.arange(21), [1.0, 0.0, 0.0, 0.0]), 0.05)
    motion = go_over(gantry, np.zeros((3, 4)), curve, 0.8, 1.5, 0.2)
    assert motion.base.begin == pytest.approx(0.4)
    assert 0.5 < motion.fade < motion.base.x[-1]


def require_derivatives(motion, now):
    t, h = np.linspace(0.01, motion.duration - 0.01, 99), 1e-5
    before, at, after = motion(t - h), motion(t), motion(t + h)
    for order in (0, 1):
        np.testing.assert_allclose((after[order] - before[order]) / (2.0 * h), at[order + 1], atol=2e-3)
        # Between these instants, too.
        means = 0.5 * (at[order + 1][1:] + at[order + 1][:-1])
        np.testing.assert_allclose(np.diff(at[order], axis=0), np.diff(t)[:, None] * means, atol=2e-2)
    np.testing.assert_allclose(np.stack(motion(np.zeros(1)))[:, 0], now, atol=1e-9)


def test_a_state_beyond_a_limit_by_what_a_code_lacks_comes_back(gantry):
    curve, now = ChunkCurve.through(gantry, np.zeros((20, 4)), 0.05), np.zeros((3, 4))
    now[0, 0] = gantry.position_limits[0, 1] + 1e-4
    motion = go_over(gantry, now, curve, 0.0, 1.5, 0.2)
    np.testing.assert_allclose(motion(np.array([motion.duration]))[0], 0.0, atol=1e-12)
    now[1, 0] = 0.2
    with pytest.raises(PlanError, match="keeps the limits"):
        go_over(gantry, now, curve, 0.0, 1.5, 0.2)


@pytest.mark.parametrize("speed", [0.0, 0.3])
def test_a_short_fast_chunk_is_slowed_down_for_an_arm_at_rest_and_does_not_send_it_back(speed, gantry):
    """At 3.6 of 4 m/s for 0.4 s: what the velocity lacks could not be made up for at 40 m/s^2 before that is over."""
    t, now = 0.05 * np.arange(9), np.zeros((3, 4))
    curve = ChunkCurve.through(gantry, np.outer(3.6 * t - 0.72, [0.0, 0.0, 1.0, 0.0]), 0.05)
    now[0], now[1, 2] = curve(np.zeros(1))[0], speed
    motion = go_over(gantry, now, curve, 0.0, 1.5, 0.2)
    require_derivatives(motion, now)
    assert motion.fade <= motion.base.x[-1] < 1.3
    _, rates, accelerations = motion(np.linspace(0.0, motion.duration, 500))
    assert rates.min() > -0.05
    assert (np.abs(rates) <= 1.01 * gantry.velocity_limits).all()
    assert (np.abs(accelerations) <= 1.01 * gantry.acceleration_limits).all()


def test_a_wait_for_a_joint_that_lags_begins_gently(gantry):
    policy = ChunkPolicy(gantry, 100.0)
    policy.reset(HOME)
    policy.accept(swing(0.02 * np.arange(60)), 0.0, 0.02)
    paces = []
    for k in range(120):
        policy.step(policy.q - (k >= 60) * np.array([0.0, 0.05, 0.0, 0.0]), HOME)
        paces.append(policy.pace)
    falls = -np.diff(paces) / (0.01 * policy._braking)
    assert paces[59] > 0.999
    assert paces[-1] < 0.1
    assert 0.9 < falls.max() < 1.0 + 1e-9
