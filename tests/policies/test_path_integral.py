"""Path integral control: weights by hand, rollouts against kinematics, the same bits for the same seed."""

import numpy as np
import pytest

from lieednn_sim.policies.path_integral import PathIntegral, VelocityRollouts, weights


def test_weights_by_hand():
    # The median is 1 above the least, so the temperature is 0.3.
    expected = np.exp([0.0, -1.0 / 0.3, -4.0 / 0.3])
    np.testing.assert_allclose(weights(np.array([5.0, 6.0, 9.0]), 0.3), expected / expected.sum(), rtol=1e-12)
    np.testing.assert_allclose(weights(np.full(4, 7.0), 0.3), 0.25)


@pytest.mark.parametrize("limited", [False, True])
def test_rollouts_go_where_velocities_lead_and_see_what_is_near(gantry, limited):
    """Limits of force, as the efforts of a URDF, do not count in the policy's own model."""
    if limited:
        spec = gantry.copied_spec()
        for joint in spec.joints:
            joint.actfrclimited, joint.actfrcrange = True, (-10.0, 10.0)
        gantry = gantry.recompiled(spec)
    rng = np.random.default_rng(0)
    start, velocities = np.array([0.2, -0.3, -0.6, 0.5]), rng.normal(size=(3, 5, 4))
    velocities[:, :, 2] = -0.9
    configurations, clearance = VelocityRollouts(gantry, 0.1, 0.25)(start, velocities)
    np.testing.assert_allclose(configurations, start + 0.1 * np.cumsum(velocities, axis=1), atol=2e-3)
    # The ball, 0.1 m in radius, is 0.3 m above the floor, which is seen from 0.25 m on, and goes through it.
    expected = 0.3 - 0.09 * np.arange(5.0)
    assert (clearance[:, 0] == np.inf).all()
    np.testing.assert_allclose(clearance[:, 1:], np.tile(expected[1:], (3, 1)), atol=2e-3)


@pytest.fixture
def policy(gantry):
    def make(seed):
        made = PathIntegral(gantry, 50.0, seed=seed)
        made.reset(gantry.keyframe("home"))
        return made

    return make


def test_the_same_seed_gives_the_same_bits(policy):
    target = np.array([0.3, -0.4, 0.5, 0.6])
    first, again, other = (np.array([made.velocity(target, 1.0) for _ in range(3)]) for made in map(policy, (1, 1, 2)))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_the_mean_of_samples_is_the_linear_law_where_nothing_is_near(policy):
    # The cost's minimum is u = c e with c = 2; many updates on the spot converge to it but for noise.
    made, target = policy(0), np.array([0.3, -0.4, 0.5, 0.6])
    found = np.mean([made.velocity(target, 1.0) for _ in range(60)][30:], axis=0)
    np.testing.assert_allclose(found, 2.0 * target, atol=0.15)


def test_costs_by_hand(policy):
    # At rest with the ball 15 mm in the floor, half of the 30 mm that are kept: 0.6 s of a near cost of 2 x 1.5^2, of
    # touching, and of the distance from the target, which counts for another 1 / (2/s) at the end.
    made, target = policy(0), np.zeros(4)
    made.y = np.array([0.0, 0.0, -0.915, 0.0])
    off = (0.915 / 5.0) ** 2
    np.testing.assert_allclose(
        made._costs(target, np.zeros((2, 10, 4))), 0.6 * (off + 4.5 + 1e3) + off / 2.0, rtol=1e-3
    )
    # From the target at a quarter of the range a second: its square over (2/s)^2, and the distance gone.
    made.y, way = target, np.zeros((1, 10, 4))
    way[:, :, 0] = 0.25
    aside = 0.6 * 0.25**2 / 4.0 + 0.06 * sum((0.015 * k) ** 2 for k in range(1, 11)) + 0.15**2 / 2.0
    np.testing.assert_allclose(made._costs(target, way), aside, rtol=2e-3)
