"""The universal network: one certificate for all curves, each encoded as the hidden neurons' start."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lieednn_sim.errors import InputError
from lieednn_sim.network import ACTIVATIONS, LieEDNN
from lieednn_sim.stability import verify
from lieednn_sim.synthesis import CurveEncoder
from lieednn_sim.synthesis.shaping import encoder as module
from lieednn_sim.synthesis.shaping.cascade import switches

EXACT = {"rtol": 1e-9, "atol": 1e-11}


def curve_of(seed: int, n: int = 2, count: int = 200) -> np.ndarray:
    """A curve with a few bends."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, 1.0, count)[:, None, None]
    ends = rng.uniform(-0.8, 0.8, (2, n, 6))
    bends = sum(np.sin(k * np.pi * s) * rng.normal(scale=0.15, size=(n, 6)) for k in (1, 2, 3))
    return ends[0] + s * (ends[1] - ends[0]) + bends


def off_the_curve(points: np.ndarray, curve: np.ndarray) -> float:
    """Largest distance of points from the nearest sample of a curve."""
    return float(np.linalg.norm((points[:, None] - curve).reshape(len(points), len(curve), -1), axis=2).min(1).max())


@pytest.fixture(scope="module", params=ACTIVATIONS)
def encoder(request):
    return CurveEncoder(2, request.param)


def test_the_true_network_follows_the_curve_and_its_closed_form(encoder):
    curve = curve_of(1)
    network = encoder.encode(curve)
    t = np.linspace(0.0, 15.0, 150)
    flow = solve_ivp(
        lambda _, x: network.flat_vector_field(x), (0.0, 15.0), network.start(curve[0]).ravel(), "DOP853", t, **EXACT
    )
    states = network.visible(flow.y.T.reshape(len(t), *network.bias.shape))
    path = encoder.path(network, curve[0])
    w = 1.0 - np.exp(-t)
    np.testing.assert_allclose(path(w), states, rtol=0.0, atol=1e-7)
    field = network.visible(network.vector_field(flow.y.T.reshape(len(t), *network.bias.shape)))
    np.testing.assert_allclose(path(w, 1) * np.exp(-t)[:, None, None], field, rtol=0.0, atol=5e-5)
    np.testing.assert_allclose(path(path.x[-1]), curve[-1], rtol=0.0, atol=1e-8)
    assert off_the_curve(states, curve_of(1, count=2000)) < 2e-3 * np.linalg.norm(curve[-1] - curve[0])


def test_an_activation_that_is_defined_anew_has_codes_of_its_own(monkeypatch):
    """As in a cell of a notebook that runs again."""
    curve, codes = curve_of(1, 1), []
    for name in ("tanh", "arctan"):
        monkeypatch.setitem(ACTIVATIONS, "soft", ACTIVATIONS[name])
        codes.append(CurveEncoder(1, "soft").code(curve))
        np.testing.assert_array_equal(codes[-1], CurveEncoder(1, name).code(curve))
    assert np.abs(codes[0] - codes[1]).max() > 1e-6


def test_codes_are_the_least_squares_solution(encoder):
    """The bumps by integrating single pairs, the code by a solver of its own."""
    basis, network = module._basis(ACTIVATIONS[encoder.network.activation], 80.0), encoder.network
    g = basis.fitted
    a, c = switches(module.CODE_PAIRS)
    slope = ACTIVATIONS[network.activation].slope
    # x' = u - x with u = 2 D g phi'(a + c g), for each pair.
    flow = solve_ivp(
        lambda t, x: 160.0 * np.exp(-t) * slope(a + c * np.exp(-t)) - x,
        (0.0, -np.log(g[-1])),
        np.zeros(len(a)),
        "DOP853",
        -np.log(g),
        **EXACT,
    )
    bumps, line = flow.y.T, curve_of(2)[[0, -1]]
    wanted = np.sin(np.pi * g) ** 2
    rows = [bumps, module._RIPPLE**3 * np.apply_along_axis(thirds, 0, bumps, 1.0 - g)]
    rows += [2.0 * 0.05 * 80.0 * slope(a)[None], 1e-3 * 80.0 * np.eye(len(a))]
    right = [wanted, module._RIPPLE**3 * thirds(wanted, 1.0 - g), np.zeros(1 + len(a))]
    code = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
    # At these instants exactly, with only coordinate 4 of the second neuron off the straight line.
    assert np.abs(code).max() < 0.05
    np.testing.assert_allclose(basis.solution @ wanted, code, atol=2e-6)
    straight = line[0] + np.linspace(0.0, 1.0, 30)[:, None, None] * (line[1] - line[0])
    np.testing.assert_allclose(encoder.code(straight), network.hidden_start, atol=1e-6)


def thirds(values: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Third derivatives by Newton's divided differences, one window of four instants after the other."""
    out = []
    for k in range(int((w < 0.99).sum()) - 3):
        x = w[k : k + 4]
        out.append(6.0 * sum(values[k + i] / np.prod([x[i] - x[j] for j in range(4) if j != i]) for i in range(4)))
    return np.array(out)


def test_every_code_keeps_the_proof_and_arrives(encoder):
    rng, network = np.random.default_rng(3), encoder.network
    certificate = verify(network.lyapunov_diagonal, network.rotational_weight)
    assert certificate.valid
    target = rng.uniform(-1.0, 1.0, (2, 6))
    code = network.hidden_start + rng.uniform(-0.05, 0.05, network.hidden_start.shape)
    coded = encoder.with_code(code, target)
    assert coded.certificate is network.certificate
    assert np.shares_memory(coded.alpha, network.alpha)
    np.testing.assert_allclose(coded.equilibrium().xi, network.retarget(target).equilibrium().xi, atol=1e-12)
    np.testing.assert_allclose(coded.visible(coded.equilibrium().xi), target, atol=1e-12)
    # A hundred starts of all neurons, hidden ones included, at once.
    starts = rng.uniform(-3.0, 3.0, (100, *network.bias.shape))
    x, h = starts.copy(), 0.2
    for _ in range(100):
        x = x + h * coded.vector_field(x + 0.5 * h * coded.vector_field(x))
    np.testing.assert_allclose(coded.visible(x), np.broadcast_to(target, (100, 2, 6)), atol=1e-4)


def test_where_a_curve_is_matters_not_when_its_samples_are(encoder):
    assert CurveEncoder(2, encoder.network.activation).network is encoder.network
    curve = curve_of(4)
    late = curve_of(4, count=400)[np.sort(np.random.default_rng(0).permutation(400)[:390])]
    late[[0, -1]] = curve[[0, -1]]
    ways = [encoder.path(encoder.encode(one), one[0])(np.linspace(0.0, 0.99, 50)) for one in (late, curve)]
    np.testing.assert_allclose(ways[0], ways[1], atol=1e-3)


def test_the_path_of_a_code_between_two_codes_is_between_their_paths(encoder):
    curves, w = [curve_of(1), curve_of(2)], np.linspace(0.0, 1.0 - 1e-6, 60)
    paths = [encoder.path(encoder.encode(curve), curve[0])(w) for curve in curves]
    mixed = 0.7 * curves[0] + 0.3 * curves[1]
    codes = [encoder.code(curve) for curve in curves]
    network = encoder.with_code(0.7 * codes[0] + 0.3 * codes[1], mixed[-1])
    assert network.certified
    np.testing.assert_allclose(encoder.path(network, mixed[0])(w), 0.7 * paths[0] + 0.3 * paths[1], atol=1e-4)


def test_with_more_strength_longer_curves_have_codes(encoder):
    """Fifty times as strong, an encoder has codes a fiftieth as large, for the same way; its network is proved, too."""
    strong = CurveEncoder(2, encoder.network.activation, 4000.0)
    assert verify(strong.network.lyapunov_diagonal, strong.network.rotational_weight).valid
    curve, w = curve_of(1), np.linspace(0.0, 1.0 - 1e-6, 60)
    weak, same = encoder.encode(curve), strong.encode(curve)
    codes = [one.hidden_start - each.network.hidden_start for one, each in ((weak, encoder), (same, strong))]
    np.testing.assert_allclose(50.0 * codes[1], codes[0], atol=1e-6)
    paths = [each.path(network, curve[0])(w) for each, network in ((encoder, weak), (strong, same))]
    np.testing.assert_allclose(*paths, atol=1e-3 * np.linalg.norm(curve[-1] - curve[0]))
    far = 40.0 * curve
    flow = strong.path(strong.encode(far), far[0])
    assert off_the_curve(flow(w), 40.0 * curve_of(1, count=2000)) < 2e-3 * np.linalg.norm(far[-1] - far[0])


def test_what_cannot_be_encoded_is_refused(encoder, tmp_path):
    with pytest.raises(InputError, match=r"the curve's code must stay below 0\.05, .* would reach 0\.\d+"):
        encoder.encode(curve_of(1) * 40.0)
    with pytest.raises(InputError, match=r"curve must have shape \(K, 2, 6\), got \(5, 3, 6\)"):
        encoder.encode(np.zeros((5, 3, 6)))
    with pytest.raises(InputError, match="n_visible must be at most 16, got 17"):
        CurveEncoder(17)
    with pytest.raises(InputError, match="at least two samples, got 1"):
        encoder.encode(np.zeros((1, 2, 6)))
    with pytest.raises(InputError, match="the network must be one of this encoder"):
        encoder.path(CurveEncoder(1).network, np.zeros((2, 6)))
    resting = encoder.encode(np.ones((4, 2, 6)))
    np.testing.assert_array_equal(resting.hidden_start, encoder.network.hidden_start)
    network = encoder.encode(curve_of(1))
    network.save(tmp_path / "network.npz")
    assert (tmp_path / "network.npz").stat().st_size < 30_000
    loaded = LieEDNN.load(tmp_path / "network.npz")
    assert loaded.certified
    assert loaded == network
