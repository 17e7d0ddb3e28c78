"""What the paper says of its learning rules (Sec. 3.3): the projection against the Riemannian gradient; and App. L."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper.checks.learning import tangent
from scipy.spatial.transform import Rotation

from lieednn_sim import lie
from lieednn_sim.network import LieEDNN

seeds = st.integers(0, 2**32 - 1)


def sets_out(project, block, slope, step=1e-6):
    """Derivative of Proj(block + step slope) in the step."""
    ahead, behind = (lie.adjoint(*project(block + sign * step * slope)) for sign in (1.0, -1.0))
    return (ahead - behind) / (2.0 * step)


def one_block(rotation, translation):
    return LieEDNN([[1.0]], rotation[None, None], np.asarray(translation, float)[None, None], np.ones((1, 6)))


@settings(max_examples=10)
@given(seeds)
def test_periodic_projection_is_first_order_riemannian_only_without_translation(seed):
    """At t = 0 the block-wise projection sets out along the Riemannian gradient; the nearest point does at every t."""
    rng = np.random.default_rng(seed)
    rotation, slope = Rotation.random(rng=rng).as_matrix(), rng.normal(size=(6, 6))
    block = lie.adjoint(rotation, np.zeros(3))
    wanted = tangent(one_block(rotation, np.zeros(3)), slope[None, None])[0, 0]
    np.testing.assert_allclose(sets_out(lie.project_to_adjoint, block, slope), wanted, atol=1e-7)
    far = rng.normal(size=3)
    block = lie.adjoint(rotation, far)
    wanted = tangent(one_block(rotation, far), slope[None, None])[0, 0]
    np.testing.assert_allclose(sets_out(lie.project_to_adjoint_exact, block, slope, 1e-5), wanted, atol=1e-6)
    assert np.abs(sets_out(lie.project_to_adjoint, block, slope) - wanted).max() > 1e-3


@pytest.mark.parametrize(("reach", "turn"), [(0.0, 1.0), (2.0, 1.0), (10.0, 1.0)])
def test_periodic_projection_can_set_out_against_the_gradient(reach, turn):
    """By hand: R = I, t = s e_z, and G with A = D = -b hat(e_x), C = e_x e_z^T + e_z e_x^T, B = 0.

    The block-wise direction turns by -b e_x and keeps only the symmetric part of hat(t) Omega below, -(b s/2) C, so
    that <direction, G> = 4 b^2 - b s: negative, the loss rises, as soon as s > 4 b. The tangent with the best turn
    a e_x has -4 a b + 2 (s a/2) for its product with G over its square 4 a^2 + 2 (s a/2)^2.
    """
    spin = lie.hat(np.array([1.0, 0.0, 0.0]))
    slope = np.zeros((6, 6))
    slope[:3, :3] = slope[3:, 3:] = -turn * spin
    slope[3, 2] = slope[5, 0] = 1.0
    block = lie.adjoint(np.eye(3), np.array([0.0, 0.0, reach]))
    direction = sets_out(lie.project_to_adjoint, block, slope)
    assert (direction * slope).sum() == pytest.approx(4.0 * turn**2 - turn * reach, abs=1e-6)
    best = tangent(one_block(np.eye(3), [0.0, 0.0, reach]), slope[None, None])[0, 0]
    assert best[2, 1] == pytest.approx((reach - 4.0 * turn) / (4.0 + 0.5 * reach**2), abs=1e-12)
    assert (best * slope).sum() == pytest.approx((reach - 4.0 * turn) ** 2 / (4.0 + 0.5 * reach**2), abs=1e-12)
