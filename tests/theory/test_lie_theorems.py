"""The paper's theorems on groups and projections, each under its name, with its limits where we found some."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation

from lieednn_sim import lie
from lieednn_sim.theory import MatrixLieGroup, affine, group

seeds = st.integers(0, 2**32 - 1)
GROUPS = [group(name) for name in ("SO(3)", "SE(2)", "SE(3)", "SU(2)", "SU(3)", "H^x", "Sim(3)", "GL(2)")]
GROUPS.append(affine(group("C^x")))
every_group = pytest.mark.parametrize("one", GROUPS, ids=lambda one: one.name)
few = settings(max_examples=10)

# Whole numbers q with sqrt(2) q within 1/(2 q) of a whole number and a half.
HALF_WAY = [q for q in range(1, 200_000) if abs((np.sqrt(2.0) * q) % 1.0 - 0.5) < 0.5 / q]


def distance_to_image(matrix: np.ndarray) -> np.ndarray:
    """Frobenius distance from L[Ad_SE(3)]."""
    return np.linalg.norm(lie.adjoint(*lie.project_to_adjoint_exact(matrix)) - matrix, axis=(-2, -1))


def plane(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


@few
@given(seeds)
def test_closed_subgroup_theorem_applies_to_the_adjoint_matrices_of_se3(seed):
    """Theorem "Closed Subgroup": limits of sequences in L[Ad_SE(3)] lie in it, and its complement is open."""
    rng = np.random.default_rng(seed)
    limit, towards = rng.normal(size=(2, 6))
    steps = 2.0 ** -np.arange(0, 50, 5.0)
    sequence = group("SE(3)").adjoint(group("SE(3)").exp(limit + steps[:, None] * towards))
    np.testing.assert_allclose(distance_to_image(sequence), 0.0, atol=1e-12)
    # The limit of the entries, without the group: Richardson's extrapolation of the last two.
    end = sequence[-1] + (sequence[-1] - sequence[-2]) / 31.0
    np.testing.assert_allclose(distance_to_image(end), 0.0, atol=1e-12)
    # Around a matrix outside there is a ball without any element: the distance falls no faster than one moves.
    outside, move = rng.normal(size=(2, 6, 6))
    move *= rng.uniform(0.0, 0.99) * distance_to_image(outside) / np.linalg.norm(move)
    assert distance_to_image(outside + move) >= distance_to_image(outside) - np.linalg.norm(move) - 1e-9
    assert distance_to_image(outside + move) > 0.0


def test_closed_subgroup_theorem_needs_the_subgroup_closed():
    """Theorem "Closed Subgroup": diag(R(s), R(sqrt(2) s)) is a subgroup of the torus, not closed, so not embedded."""
    line = MatrixLieGroup("irrational line", np.kron(np.diag([1.0, np.sqrt(2.0)]), plane(np.pi / 2))[None])
    far = np.kron(np.diag([1.0, -1.0]), np.eye(2))
    gaps = [np.linalg.norm(line.exp([2.0 * np.pi * q]) - far) for q in HALF_WAY]
    assert len(gaps) > 5
    assert gaps[-1] < 1e-4 < 0.5 < gaps[0]
    # The limit is no element: R(s) = I needs s = 2 pi q, and then sqrt(2) q would be rational.
    assert min(gaps) > 0.0
    # Not embedded: as near to I as one likes, elements that no small s reaches.
    back = line.exp([4.0 * np.pi * HALF_WAY[-1]])
    assert np.linalg.norm(back - np.eye(4)) < 1e-4
    assert np.linalg.norm(line.exp([np.arcsin(back[1, 0])]) - back) > 0.5 * np.linalg.norm(back - np.eye(4))


@every_group
@few
@given(seeds)
def test_adjoint_action_as_automorphism(one, seed):
    """Theorem "Adjoint Action as Automorphism": Ad_g maps g onto itself, linearly, and keeps brackets."""
    rng = np.random.default_rng(seed)
    g = one.random(rng, scale=0.5)
    x, y = rng.normal(size=(2, one.dimension))

    def act(element, algebra):
        return element @ algebra @ np.linalg.inv(element)

    # `vee` refuses what is outside of the algebra; the inverse action brings the origin back.
    moved = one.vee(act(g, one.hat(x)))
    np.testing.assert_allclose(one.vee(act(np.linalg.inv(g), one.hat(moved))), x, atol=1e-9)
    both = act(g, one.hat(x)), act(g, one.hat(y))
    left = one.vee(act(g, one.hat(x) @ one.hat(y) - one.hat(y) @ one.hat(x)))
    np.testing.assert_allclose(left, one.vee(both[0] @ both[1] - both[1] @ both[0]), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(left, one.adjoint(g) @ one.ad(x) @ y, rtol=1e-8, atol=1e-8)


@given(seeds, st.sampled_from([1e-9, 1.0, 1e3]))
def test_induced_linear_mapping_of_se3_forms_lie_group(seed, reach):
    """Theorem "Induced Linear Mapping of SE(3) Forms Lie Group" (App. B): products, inverses, limits; dimension 6."""
    rng = np.random.default_rng(seed)
    (r1, r2), (t1, t2) = Rotation.random(2, rng=rng).as_matrix(), reach * rng.normal(size=(2, 3))
    first, second = lie.adjoint(r1, t1), lie.adjoint(r2, t2)
    np.testing.assert_allclose(first @ second, lie.adjoint(r1 @ r2, t1 + r1 @ t2), atol=1e-12 * (1.0 + reach))
    np.testing.assert_allclose(np.linalg.inv(first), lie.adjoint(r1.T, -r1.T @ t1), atol=1e-12 * (1.0 + reach))
    # The proof's limit: from the entries alone, A is a rotation and C A^T skew.
    a, c = first[:3, :3], first[3:, :3]
    assert np.linalg.det(a) > 0
    np.testing.assert_allclose(a @ a.T, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(c @ a.T + a @ c.T, 0.0, atol=1e-13 * (1.0 + reach))
    tangent = group("SE(3)").ad(np.eye(6)).reshape(6, 36)
    assert np.linalg.matrix_rank(tangent) == 6


def test_induced_linear_mapping_definition_must_exclude_reflections():
    """Def. of L[Ad_SE(3)] asks for R^T = R^-1 only; the reflections it lets in are no adjoint matrices of SE(3)."""
    reflected = np.kron(np.eye(2), np.diag([1.0, 1.0, -1.0]))
    assert distance_to_image(reflected) > 1.0
    with pytest.raises(AssertionError):
        # And they do not keep brackets: (M x) x (M y) = det(M) M (x x y) for orthogonal M.
        np.testing.assert_allclose(
            group("SE(3)").ad(reflected @ np.eye(6)[0]) @ reflected @ np.eye(6)[1],
            reflected @ group("SE(3)").ad(np.eye(6)[0]) @ np.eye(6)[1],
        )


@given(seeds)
def test_linear_representation_of_adjoint_action_on_se3(seed):
    """Theorem "Linear Representation of Adjoint Action on se(3)" (App. C): P(g X g^-1) = L[Ad_g] P(X)."""
    rng = np.random.default_rng(seed)
    pose = RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))
    omega, v = rng.normal(size=(2, 3))
    moved = lie.vee(pose.as_matrix() @ lie.hat(np.concatenate([omega, v])) @ pose.inv().as_matrix())
    by_hand = np.concatenate(
        [pose.rotation.apply(omega), np.cross(pose.translation, pose.rotation.apply(omega)) + pose.rotation.apply(v)]
    )
    np.testing.assert_allclose(moved, by_hand, atol=1e-13)
    matrix = lie.adjoint(pose.rotation.as_matrix(), pose.translation)
    np.testing.assert_allclose(matrix @ np.concatenate([omega, v]), by_hand, atol=1e-13)


@given(seeds, st.floats(-1.0, 1.0))
def test_metric_projection_to_so3(seed, third):
    """Lemma "Metric Projection to SO(3)" (App. A) against Davenport's q-method, which needs no SVD."""
    rng = np.random.default_rng(seed)
    first, second = Rotation.random(2, rng=rng).as_matrix()
    # Both signs of det, down to singular; kept away from the ties where the nearest rotation is not unique.
    matrix = first @ np.diag([2.0, 1.5, third]) @ second
    z = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    davenport = np.zeros((4, 4))
    davenport[:3, :3] = matrix + matrix.T - np.trace(matrix) * np.eye(3)
    davenport[:3, 3] = davenport[3, :3] = z
    davenport[3, 3] = np.trace(matrix)
    values, vectors = np.linalg.eigh(davenport)
    rotation = lie.project_to_rotation(matrix)
    np.testing.assert_allclose(rotation, Rotation.from_quat(vectors[:, -1]).as_matrix(), atol=1e-12)
    # The bound of the proof is reached: tr(Pi^T R) = sigma_1 + sigma_2 + det(U V^T) sigma_3.
    np.testing.assert_allclose([np.trace(matrix.T @ rotation), values[-1]], 3.5 + third, atol=1e-12)


def test_metric_projection_to_so3_is_not_always_unique():
    """The "if and only if" of the proof needs distinct singular values: around -I every half turn is as near."""
    turns = Rotation.from_rotvec(np.pi * np.array([[1.0, 0, 0], [0, 0.6, 0.8]])).as_matrix()
    nearest = np.linalg.norm(lie.project_to_rotation(-np.eye(3)) + np.eye(3))
    np.testing.assert_allclose(np.linalg.norm(turns + np.eye(3), axis=(-2, -1)), nearest, atol=1e-14)


@given(seeds)
def test_block_wise_metric_projection_to_l(seed):
    """Theorem "Metric Projection to Manifold L Block-wisely" (App. F): the formula, with the average of A and D."""
    matrix = np.random.default_rng(seed).normal(size=(6, 6))
    a, b, c, d = matrix[:3, :3], matrix[:3, 3:], matrix[3:, :3], matrix[3:, 3:]
    rotation, translation = lie.project_to_adjoint(matrix)
    np.testing.assert_array_equal(rotation, lie.project_to_rotation((a + d) / 2.0))
    np.testing.assert_allclose(lie.hat(translation), (c @ rotation.T - rotation @ c.T) / 2.0, atol=1e-14)

    def squared(turned):
        return np.linalg.norm(a - turned) ** 2 + np.linalg.norm(d - turned) ** 2

    # One rotation for both diagonal blocks: theirs is the best, that of A and B (the paper's text) is not.
    assert squared(rotation) < squared(lie.project_to_rotation((a + b) / 2.0))


def test_block_wise_metric_projection_is_not_the_frobenius_nearest():
    """By hand: A = D = I, C = diag(4, 4, 0). Turned by phi about z the rest is 8 (1 - cos phi) + 32 cos^2 phi."""
    matrix = np.eye(6)
    matrix[3:, :3] = np.diag([4.0, 4.0, 0.0])
    block_wise = lie.adjoint(*lie.project_to_adjoint(matrix))
    np.testing.assert_allclose(block_wise, np.eye(6), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(block_wise - matrix) ** 2, 32.0)
    rotation, _ = lie.project_to_adjoint_exact(matrix)
    np.testing.assert_allclose(distance_to_image(matrix) ** 2, 7.5, atol=1e-12)
    np.testing.assert_allclose([rotation[0, 0], rotation[2, 2]], [0.125, 1.0], atol=1e-9)


@every_group
@few
@given(seeds)
def test_general_linear_representation_of_adjoint_action(one, seed):
    """Theorem "General Linear Representation of Adjoint Action" (App. D): exists, is unique, a smooth homomorphism.

    The paper states it for closed subgroups of GL(n, R); the complex SU(n) obey it with real coordinates.
    """
    rng = np.random.default_rng(seed)
    g, h = one.random(rng, (2,), 0.5)
    x = rng.normal(size=(one.dimension + 3, one.dimension))
    moved = one.vee(g @ one.hat(x) @ np.linalg.inv(g))
    solution, _, rank, _ = np.linalg.lstsq(x, moved, rcond=None)
    assert rank == one.dimension
    np.testing.assert_allclose(one.adjoint(g), solution.T, rtol=1e-7, atol=1e-7)
    assert abs(np.linalg.det(one.adjoint(g))) > 0.0
    np.testing.assert_allclose(one.adjoint(g @ h), one.adjoint(g) @ one.adjoint(h), rtol=1e-8, atol=1e-8)
    direction = x[0] / np.linalg.norm(x[0])
    slope = (one.adjoint(g @ one.exp(1e-5 * direction)) - one.adjoint(g @ one.exp(-1e-5 * direction))) / 2e-5
    expected = one.adjoint(g) @ one.ad(direction)
    np.testing.assert_allclose(slope, expected, atol=1e-6 * (1.0 + np.linalg.norm(expected)))


@every_group
@few
@given(seeds)
def test_adjoint_image_is_isomorphic_to_the_group_modulo_the_kernel(one, seed):
    """App. E: L[Ad_G] = G / ker L. Equal adjoint matrices differ by the kernel, and that is the centre of G."""
    rng = np.random.default_rng(seed)
    g, other = one.random(rng, (2,), 0.5)
    twin = one.project_to_adjoint(one.adjoint(g))
    central = np.linalg.inv(twin) @ g
    np.testing.assert_allclose(one.adjoint(central), np.eye(one.dimension), atol=1e-7)
    np.testing.assert_allclose(central @ other, other @ central, atol=1e-7 * np.linalg.norm(other))
    # Well defined: a kernel element changes nothing. And injective: what is not in the kernel changes something.
    np.testing.assert_allclose(one.adjoint(other @ central), one.adjoint(other), rtol=1e-6, atol=1e-6)
    assert np.abs(one.adjoint(np.linalg.inv(twin) @ other) - np.eye(one.dimension)).max() > 1e-7


def test_adjoint_image_of_su2_is_so3():
    """App. E: SU(2) / {I, -I} = SO(3), two elements for each rotation."""
    g = group("SU(2)").random(0, (50,), 2.0)
    rotation = group("SU(2)").adjoint(g)
    assert group("SO(3)").contains(rotation).all()
    np.testing.assert_allclose(group("SU(2)").adjoint(-g), rotation, atol=1e-13)
    back = group("SU(2)").project_to_adjoint(rotation)
    sign = np.sign((back * g.conj()).real.sum(axis=(-2, -1)))
    assert set(sign) == {-1.0, 1.0}
    np.testing.assert_allclose(sign[:, None, None] * back, g, atol=1e-13)


@pytest.mark.parametrize("name", ["SO(2)", "SO(3)", "SU(2)", "SU(3)"])
def test_compactness_as_sufficient_condition(name):
    """Theorem "Compactness as Sufficient Condition" (App. E): a compact group has a bounded, closed adjoint image."""
    one = group(name)
    adjoint = one.adjoint(one.random(1, (100,), 10.0))
    np.testing.assert_allclose(adjoint @ np.swapaxes(adjoint, -1, -2) - np.eye(one.dimension), 0.0, atol=1e-12)
    # Powers of one element come back as near as one likes: their limits are elements again.
    powers = np.stack([np.linalg.matrix_power(adjoint[0], k) for k in range(1, 40)])
    nearest = one.adjoint(one.project_to_adjoint(powers))
    np.testing.assert_allclose(nearest, powers, atol=1e-9)


def test_compactness_is_not_necessary():
    """App. E: SE(3) is not compact and its adjoint image not bounded, but closed (tested above)."""
    norms = np.linalg.norm(
        lie.adjoint(np.broadcast_to(np.eye(3), (4, 3, 3)), 10.0 ** np.arange(4)[:, None] * np.eye(3)[0])
    )
    assert norms > 1e3
    assert distance_to_image(lie.adjoint(np.eye(3), [1e3, 0.0, 0.0])) < 1e-9


def test_a_closed_group_can_have_an_adjoint_image_that_is_not_closed():
    """App. E rightly asks for closedness "in addition": here G is closed in GL(6, R), but L[Ad_G] is not.

    R acts on the plane twice, with angles s and sqrt(2) s; a last entry e^(s / 10^5) keeps G closed, and the adjoint
    action does not see it.
    """
    basis = np.zeros((5, 6, 6))
    basis[0, :4, :4] = np.kron(np.diag([1.0, np.sqrt(2.0)]), plane(np.pi / 2))
    basis[0, 5, 5] = 1e-5
    for k in range(4):
        basis[1 + k, k, 4] = 1.0
    one = MatrixLieGroup("two planes", basis)
    limit = np.diag([1.0, 1.0, 1.0, -1.0, -1.0])
    turns = [one.exp([2.0 * np.pi * q, 0, 0, 0, 0]) for q in HALF_WAY]
    gaps = [np.linalg.norm(one.adjoint(g) - limit) for g in turns]
    assert gaps[-1] < 1e-4 < 0.5 < gaps[0]
    # No g has this adjoint matrix: its first plane needs s = 2 pi q, and then sqrt(2) q would be a whole number and a
    # half. In G itself the sequence has no limit: the last entry runs away.
    assert [g[5, 5] for g in turns] == sorted(g[5, 5] for g in turns)
    assert turns[-1][5, 5] > 1.5
    np.testing.assert_allclose(expm(one.ad(np.eye(5)[0] * np.pi))[1:3, 1:3], -np.eye(2), atol=1e-12)
