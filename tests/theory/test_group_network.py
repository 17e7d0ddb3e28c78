"""Networks on any matrix Lie group: against the matrix equation, against each other, and the file that keeps them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from lieednn_sim import io, stability
from lieednn_sim.errors import FileError, InputError
from lieednn_sim.network import ACTIVATIONS, LieEDNN
from lieednn_sim.theory import GroupLieEDNN
from lieednn_sim.theory.groups import GROUPS, affine, group

seeds = st.integers(0, 2**32 - 1)
NAMES = [*GROUPS, "GL(2)"]


def random_network(seed: int, name: str = "SE(3)", n: int = 3, strength: float = 0.5, **settings) -> GroupLieEDNN:
    rng = np.random.default_rng(seed)
    chosen = affine(group(name[7:-1])) if name.startswith("affine(") else group(name)
    alpha = strength * rng.normal(size=(n, n))
    return GroupLieEDNN(chosen, alpha, chosen.random(rng, (n, n)), rng.normal(size=(n, chosen.dimension)), **settings)


@settings(max_examples=25)
@given(seeds, st.sampled_from([*NAMES, "affine(H^x)"]), st.sampled_from(sorted(ACTIVATIONS)))
def test_coordinates_follow_the_matrix_equation_of_the_paper(seed, name, activation):
    network = random_network(seed, name, gamma=2.0, mu=0.7, activation=activation)
    xi = np.random.default_rng(seed).normal(size=(3, network.group.dimension))
    field, outputs = network.vector_field(xi), ACTIVATIONS[activation].phi(xi)
    hat = network.group.hat
    for i in range(3):
        expected = -2.0 * hat(xi[i]) + 0.7 * hat(network.bias[i])
        for j in range(3):
            theta = network.theta[i, j]
            expected = expected + 0.7 * network.alpha[i, j] * theta @ hat(outputs[j]) @ np.linalg.inv(theta)
        np.testing.assert_allclose(hat(field[i]), expected, atol=1e-9 * (1.0 + np.abs(expected).max()))
    np.testing.assert_allclose(network.flat_vector_field(xi.ravel()), field.ravel(), rtol=1e-9, atol=1e-9)


@settings(max_examples=6)
@given(seeds)
def test_on_se3_it_is_the_network_of_the_paper(seed):
    network = random_network(seed, gamma=1.5, mu=0.4, activation="arctan")
    theta = network.theta
    known = LieEDNN(network.alpha, theta[..., :3, :3], theta[..., :3, 3], network.bias, 1.5, 0.4, "arctan")
    xi = np.random.default_rng(seed).normal(size=(2, 3, 6))
    np.testing.assert_allclose(network.weight, known.weight, atol=1e-13)
    np.testing.assert_allclose(network.vector_field(xi), known.vector_field(xi), atol=1e-12)
    np.testing.assert_allclose(network.jacobian(xi), known.jacobian(xi), atol=1e-12)
    np.testing.assert_allclose(network.retarget(xi[0]).bias, known.retarget(xi[0]).bias, atol=1e-12)
    assert network.smallest_one_norm(xi[0]) == pytest.approx(known.smallest_one_norm(xi[0]))
    ended = [each.trajectory(xi[0], 2.0, rtol=1e-10, atol=1e-12).xi[-1] for each in (network, known)]
    np.testing.assert_allclose(*ended, atol=1e-7)


@given(seeds)
def test_su2_gives_the_networks_of_so3_and_both_signs_the_same(seed):
    spin = random_network(seed, "SU(2)")
    u = spin.theta
    # U = w - i (x sigma_1 + y sigma_2 + z sigma_3)
    quaternion = np.stack([-u[..., 0, 1].imag, -u[..., 0, 1].real, -u[..., 0, 0].imag, u[..., 0, 0].real], axis=-1)
    rotation = Rotation.from_quat(quaternion.reshape(-1, 4)).as_matrix().reshape(3, 3, 3, 3)
    turning = GroupLieEDNN(group("SO(3)"), spin.alpha, rotation, spin.bias)
    np.testing.assert_allclose(spin.weight, turning.weight, atol=1e-13)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], size=(3, 3, 1, 1))
    np.testing.assert_allclose(dataclasses.replace(spin, theta=signs * u).weight, spin.weight, atol=1e-15)


@settings(max_examples=5)
@given(seeds, st.sampled_from(["SO(3)", "SU(3)", "SE(2)"]))
def test_a_certified_network_is_globally_stable_for_every_bias(seed, name):
    network = random_network(seed, name, gamma=2.0, mu=0.5)
    largest = stability.find_certificate(network.weight).lambda_max
    network = dataclasses.replace(network, alpha=network.alpha * (0.6 * 4.0 / largest)).certify()
    assert network.certified
    rng = np.random.default_rng(seed)
    target = rng.normal(size=network.bias.shape)
    aimed = network.retarget(target)
    assert aimed.certified
    ended = aimed.trajectory(rng.uniform(-5.0, 5.0, target.shape), 60.0, rtol=1e-9, atol=1e-11).xi[-1]
    np.testing.assert_allclose(ended, target, atol=1e-6)
    np.testing.assert_allclose(aimed.equilibrium().xi, target, atol=1e-9)


@pytest.mark.parametrize("name", ["SU(2)", "Sim(3)", "GL(2)", "affine(C^x)"])
def test_save_and_load_are_bit_exact(tmp_path, name):
    network = random_network(1, name, strength=0.05, gamma=0.1 + 0.2, mu=0.05, activation="arctan").certify()
    network.save(tmp_path / "n.npz")
    loaded = GroupLieEDNN.load(tmp_path / "n.npz")
    assert loaded.group.name == name
    for key in ("alpha", "theta", "bias", "lyapunov_diagonal"):
        assert getattr(loaded, key).tobytes() == getattr(network, key).tobytes()
    assert loaded.weight.tobytes() == network.weight.tobytes()
    assert (loaded.gamma, loaded.mu, loaded.activation) == (network.gamma, network.mu, "arctan")
    assert loaded.certified


def test_groups_that_a_file_cannot_name_are_refused(tmp_path):
    network = random_network(0, "SO(3)")
    foreign = dataclasses.replace(network, group=dataclasses.replace(network.group, name="mine"))
    with pytest.raises(InputError, match="'mine' is none"):
        foreign.save(tmp_path / "n.npz")
    scaled = dataclasses.replace(network, group=dataclasses.replace(network.group, basis=2.0 * network.group.basis))
    with pytest.raises(InputError, match=r"'SO\(3\)' is none"):
        scaled.save(tmp_path / "n.npz")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"group": lambda _: "SO(4)"}, r"not a valid network: no group 'SO\(4\)'"),
        ({"group": lambda _: ["SO(3)"]}, "no group"),
        ({"theta": lambda g: 1.1 * g}, r"theta must hold elements of SE\(3\), 9 of 9 are none"),
        ({"alpha": lambda a: 1e3 * a}, "certificate that does not hold for its weights"),
        ({"bias": None}, "has no array 'bias'"),
    ],
)
def test_tampered_files_are_refused(tmp_path, change, words):
    path = tmp_path / "n.npz"
    random_network(2, strength=0.01).certify().save(path)
    arrays, meta = io.load_arrays(path, "group-network")
    for name, function in change.items():
        values = arrays if name in arrays else meta
        if function is None:
            del values[name]
        else:
            values[name] = function(values[name])
    io.save_arrays(path, "group-network", arrays, meta)
    with pytest.raises(FileError, match=words):
        GroupLieEDNN.load(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"group": "SE(3)"}, "group must be a MatrixLieGroup, got 'SE.3.'; see lieednn_sim.theory.group"),
        ({"alpha": np.zeros((0, 0))}, r"\(n, n\) with n >= 1"),
        ({"theta": np.eye(4)}, r"theta must have shape \(3, 3, 4, 4\), got \(4, 4\)"),
        ({"theta": np.zeros((3, 3, 4, 4))}, "9 of 9 are none; `project_to_adjoint` of the group"),
        ({"bias": np.zeros((3, 4))}, r"bias must have shape \(3, 6\)"),
        ({"lyapunov_diagonal": np.ones(9)}, r"lyapunov_diagonal must have shape \(18,\), got \(9,\)"),
        ({"activation": "relu"}, "allowed: .*tanh"),
    ],
)
def test_wrong_parts_are_named(change, words):
    with pytest.raises(InputError, match=words):
        dataclasses.replace(random_network(0), **change)
