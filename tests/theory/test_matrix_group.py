"""Every group of the catalogue keeps the same laws; each has its own kernel; closed forms agree with the search."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform

from lieednn_sim import lie
from lieednn_sim.errors import InputError
from lieednn_sim.theory import GROUPS, MatrixLieGroup, affine, group

seeds = st.integers(0, 2**32 - 1)
CATALOGUE = [group(name) for name in [*GROUPS, "GL(1)", "GL(2)", "GL(3)"]]
CATALOGUE += [affine(group(name)) for name in ("C^x", "H^x", "GL(2)")]
CLOSED_FORMS = [one for one in CATALOGUE if one.projection is not None]

every_group = pytest.mark.parametrize("one", CATALOGUE, ids=lambda one: one.name)
few = settings(max_examples=5)


def coordinates(one: MatrixLieGroup, rng: np.random.Generator, shape=(), size=1.0):
    """Of length ``size``: up to 3, every principal logarithm exists."""
    x = rng.normal(size=(*shape, one.dimension))
    return size * x / np.linalg.norm(x, axis=-1, keepdims=True)


def commutator(a, b):
    return a @ b - b @ a


@every_group
@few
@given(seeds)
def test_coordinates_and_brackets(one, seed):
    x, y, z = np.random.default_rng(seed).normal(size=(3, one.dimension))
    np.testing.assert_allclose(one.vee(one.hat(x)), x, atol=1e-13)
    assert one.hat(x).shape == (one.size, one.size)
    np.testing.assert_allclose(one.hat(one.ad(x) @ y), commutator(one.hat(x), one.hat(y)), atol=1e-12)
    # Jacobi: ad is a homomorphism of algebras, on any z.
    np.testing.assert_allclose(commutator(one.ad(x), one.ad(y)) @ z, one.ad(one.ad(x) @ y) @ z, atol=1e-11)


@every_group
@few
@given(seeds, st.sampled_from([0.0, 1e-12, 1e-6, 1e-3, 0.5, 2.0, 3.0]))
def test_exp_is_in_the_group(one, seed, size):
    x = coordinates(one, np.random.default_rng(seed), size=size)
    g = one.exp(x)
    assert one.contains(g).all()
    assert replace(one, membership=None).contains(g).all()


@every_group
@few
@given(seeds)
def test_adjoint_is_conjugation_and_a_homomorphism(one, seed):
    rng = np.random.default_rng(seed)
    g, h = one.random(rng, (2,), 0.7)
    x = coordinates(one, rng)
    np.testing.assert_allclose(one.hat(one.adjoint(g) @ x), g @ one.hat(x) @ np.linalg.inv(g), rtol=1e-8, atol=1e-9)
    product = one.adjoint(g) @ one.adjoint(h)
    np.testing.assert_allclose(one.adjoint(g @ h), product, rtol=1e-8, atol=1e-9 * np.linalg.norm(product))
    np.testing.assert_allclose(one.adjoint(one.exp(x)), expm(one.ad(x)), rtol=1e-10, atol=1e-10)


@every_group
def test_membership_sees_small_defects(one):
    rng = np.random.default_rng(4)
    g = one.random(rng, (5,), 0.5)
    if one.name.startswith("GL"):
        g[:, 0] = 2.0 * g[:, -1] if one.size > 1 else 0.0
    else:
        g += 1e-6 * rng.normal(size=g.shape)
    assert not one.contains(g).any()


def test_reflections_are_not_in_the_groups_of_motions():
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    assert not group("SO(2)").contains(mirror[:2, :2])
    assert not group("SE(2)").contains(mirror[:3, :3])
    assert not group("SO(3)").contains(mirror[:3, :3])
    assert not group("Sim(3)").contains(mirror)
    assert not group("Sim(3)").contains(np.diag([-2.0, -2.0, -2.0, 1.0]))


@every_group
def test_batches_equal_one_by_one(one):
    rng = np.random.default_rng(3)
    theta = one.adjoint(one.random(rng, (2, 2), 0.5)) + 0.2 * rng.normal(size=(2, 2, one.dimension, one.dimension))
    batch = one.adjoint(one.project_to_adjoint(theta))
    for index in np.ndindex(2, 2):
        np.testing.assert_allclose(one.adjoint(one.project_to_adjoint(theta[index])), batch[index], atol=1e-9)


@every_group
@settings(max_examples=5)
@given(seeds)
def test_projection_keeps_the_image_and_is_nearest_around(one, seed):
    rng = np.random.default_rng(seed)
    on_image = one.adjoint(one.random(rng, scale=0.5))
    g = one.project_to_adjoint(on_image)
    assert one.contains(g, 1e-8).all()
    np.testing.assert_allclose(one.adjoint(g), on_image, atol=1e-9)
    theta = on_image + 0.3 * rng.normal(size=on_image.shape)
    nearest = one.project_to_adjoint(theta)
    others = one.adjoint(nearest @ one.exp(coordinates(one, rng, (100,)) * 10.0 ** rng.uniform(-4, 0.3, (100, 1))))
    others = np.concatenate([others, one.adjoint(one.random(rng, (100,)))])
    distances = np.linalg.norm(others - theta, axis=(-2, -1))
    assert np.linalg.norm(one.adjoint(nearest) - theta) <= distances.min() + 1e-9


@pytest.mark.parametrize("one", CLOSED_FORMS, ids=lambda one: one.name)
@few
@given(seeds)
def test_closed_forms_and_search_agree(one, seed):
    """Far from the image too; g itself may differ by the kernel, the adjoint matrix may not."""
    theta = 2.0 * np.random.default_rng(seed).normal(size=(3, one.dimension, one.dimension))
    closed = np.linalg.norm(one.adjoint(one.project_to_adjoint(theta)) - theta, axis=(-2, -1))
    searched = replace(one, projection=None)
    found = np.linalg.norm(one.adjoint(searched.project_to_adjoint(theta)) - theta, axis=(-2, -1))
    assert (closed <= found + 1e-9).all()
    # The few starts of the search may miss the nearest element of SE(3), which has several local minima.
    if one.name != "SE(3)":
        np.testing.assert_allclose(found, closed, atol=1e-9)


@few
@given(seeds)
def test_se3_is_the_one_of_the_package(seed):
    rng = np.random.default_rng(seed)
    twist = rng.normal(size=(4, 6))
    one, pose = group("SE(3)"), lie.exp(twist)
    np.testing.assert_allclose(one.exp(twist), pose.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(one.hat(twist), lie.hat(twist), atol=0)
    expected = lie.adjoint(pose.rotation.as_matrix(), pose.translation)
    np.testing.assert_allclose(one.adjoint(pose.as_matrix()), expected, atol=1e-12)
    theta = rng.normal(size=(6, 6))
    g = RigidTransform.from_matrix(one.project_to_adjoint(theta))
    np.testing.assert_allclose(g.rotation.as_matrix(), lie.project_to_adjoint_exact(theta)[0], atol=1e-12)


def test_kernels():
    def silent(name, g):
        one = group(name)
        return (np.abs(one.adjoint(g) - np.eye(one.dimension)) < 1e-9).all(axis=(-2, -1)).tolist()

    assert silent("SU(2)", [np.eye(2), -np.eye(2), 1j * np.diag([1.0, -1.0])]) == [True, True, False]
    roots = np.exp(2j * np.pi * np.arange(6) / 6)[:, None, None] * np.eye(3)
    assert group("SU(3)").contains(roots).tolist() == [True, False] * 3
    assert all(silent("SU(3)", roots[::2]))
    assert silent("GL(3)", [-2.5 * np.eye(3), np.diag([1.0, 1.0, 1.0 + 1e-6])]) == [True, False]
    for name in ("SO(2)", "C^x"):
        assert all(silent(name, group(name).random(0, (20,), 3.0)))
    assert silent("H^x", -3.0 * np.eye(4))
    for name in ("SO(3)", "SE(2)", "SE(3)", "Sim(3)"):
        assert not any(silent(name, group(name).exp(1e-6 * np.eye(group(name).dimension))))


def test_without_a_closed_form_membership_asks_what_an_element_does_to_the_algebra():
    own = replace(group("SE(3)"), membership=None)
    stretched, motion = np.diag([1.0, 2.0, 3.0, 1.0]), own.random(0)
    assert own.contains([motion, np.zeros((4, 4)), stretched]).tolist() == [True, False, False]


def test_random_elements_repeat_with_the_seed():
    for one in CATALOGUE:
        assert one.random(7, (2, 3)).shape == (2, 3, one.size, one.size)
        np.testing.assert_array_equal(one.random(7, (2,)), one.random(np.random.default_rng(7), (2,)))
        assert pickle.loads(pickle.dumps(one)).name == one.name


def test_search_finds_elements_far_from_the_identity():
    """From the identity alone it ends in a local minimum for about a quarter of these."""
    searched = replace(group("SE(3)"), projection=None)
    theta = searched.adjoint(searched.random(6, (60,), 2.0))
    np.testing.assert_allclose(searched.adjoint(searched.project_to_adjoint(theta)), theta, atol=1e-9)


def test_search_repeats_itself():
    theta = np.random.default_rng(5).normal(size=(8, 8))
    np.testing.assert_array_equal(group("SU(3)").project_to_adjoint(theta), group("SU(3)").project_to_adjoint(theta))


@pytest.mark.parametrize(
    ("name", "basis", "message"),
    [
        ("flat", np.zeros((3, 3)), r"basis must have shape \(d, m, m\), got \(3, 3\)"),
        ("empty", np.zeros((0, 2, 2)), "basis of empty must not be empty"),
        ("twice", [np.eye(2), 2.0 * np.eye(2)], "basis of twice must be linearly independent over the real numbers"),
        ("open", lie.hat(np.eye(3))[:2], "spans no Lie algebra: the commutator of E_1 and E_2 lies outside"),
        ("nan", np.full((1, 2, 2), np.nan), "basis must be finite"),
    ],
)
def test_what_is_no_basis_is_refused(name, basis, message):
    with pytest.raises(InputError, match=message):
        MatrixLieGroup(name, basis)


def test_independence_is_over_the_reals():
    assert MatrixLieGroup("C^x as C", np.array([[[1.0]], [[1.0j]]])).dimension == 2


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: group("SO(4)"), r"no group 'SO\(4\)'; allowed: SO\(2\), SO\(3\), .*Sim\(3\), GL\(n\)"),
        (lambda: group("GL(9)"), r"n must be at most 8 for GL\(n\), got 9"),
        (lambda: affine(group("SU(2)")), r"affine needs a real matrix group, got SU\(2\)"),
        (lambda: group("SO(3)").hat(np.zeros(4)), r"x must have shape \(\.\.\., 3\), got \(4,\)"),
        (lambda: group("SO(3)").vee(np.eye(3)), r"Lie algebra of SO\(3\), got one off by"),
        (lambda: group("SO(3)").vee(1j * np.eye(3)), "complex numbers are not allowed"),
        (lambda: group("GL(2)").adjoint(np.zeros((2, 2))), r"must be in GL\(2\), got a singular matrix"),
        (lambda: group("SO(3)").adjoint(np.diag([1.0, 2, 3])), r"must be in SO\(3\): g E_k g\^-1 leaves"),
        (lambda: group("SO(3)").project_to_adjoint(np.eye(4)), r"theta must have shape \(\.\.\., 3, 3\), got \(4, 4\)"),
        (lambda: group("SU(2)").contains(np.eye(3)), r"g must have shape \(\.\.\., 2, 2\)"),
        (lambda: group("SU(2)").random(-1), "rng must be a whole number"),
    ],
)
def test_wrong_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()


@pytest.mark.parametrize(("share", "inside"), [(-0.99, True), (0.99, True), (1.01, False), (-1.01, False)])
def test_adjoint_lets_in_what_is_off_by_the_tolerance_and_no_more(share, inside):
    """diag(1 + e, 1, 1) takes E_z out of so(3) by sqrt(2) e, and 1e-8 (1 + sqrt 2) is let in."""
    stretched = np.diag([1.0 + share * 1e-8 * (1.0 + np.sqrt(2.0)) / np.sqrt(2.0), 1.0, 1.0])
    if inside:
        np.testing.assert_allclose(group("SO(3)").adjoint(stretched), np.eye(3), atol=1e-7)
        return
    with pytest.raises(InputError, match="leaves its Lie algebra"):
        group("SO(3)").adjoint(stretched)


def test_search_runs_from_the_start_alone_when_there_is_one():
    """So it finds the minimum next to that; the best from many starts is what it finds without any."""
    searched = replace(group("SE(3)"), projection=None)
    theta = np.random.default_rng(3).normal(size=(6, 6))
    best = np.linalg.norm(searched.adjoint(searched.project_to_adjoint(theta)) - theta)
    starts = searched.random(1, (20,))
    found = searched.project_to_adjoint(np.broadcast_to(theta, (20, 6, 6)), starts)
    distances = np.linalg.norm(searched.adjoint(found) - theta, axis=(1, 2))
    assert distances.min() == pytest.approx(best, rel=1e-9)
    assert distances.max() > best + 0.1
    again = searched.project_to_adjoint(np.broadcast_to(theta, (20, 6, 6)), found)
    np.testing.assert_allclose(again, found, atol=1e-6)
