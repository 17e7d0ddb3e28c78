"""One step of a network as a graph of ONNX, run by onnxruntime."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import lieednn_sim as ls
from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.network import LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step


@pytest.fixture(scope="module")
def network() -> LieEDNN:
    target = np.random.default_rng(0).uniform(-0.8, 0.8, (4, 6))
    return ls.synthesize(target, seed=1).unwrap()


@pytest.mark.parametrize("bias_input", [False, True])
def test_onnxruntime_steps_as_ours_and_takes_another_target_by_its_bias(network, tmp_path, capfd, bias_input):
    runtime = pytest.importorskip("onnxruntime")
    network.to_onnx(tmp_path / "step.onnx", bias_input=bias_input)
    session = runtime.InferenceSession(tmp_path / "step.onnx", providers=["CPUExecutionProvider"])
    # It warns of initialisers among the inputs.
    assert capfd.readouterr().err == ""
    assert session.get_modelmeta().custom_metadata_map == {"certificate": str(network.certificate)}
    ours = theirs = np.random.default_rng(1).normal(size=network.bias.size)
    h, other = np.array(0.05), network.retarget(0.5 * network.equilibrium().xi)
    for step in range(200):
        used = other if bias_input and step >= 100 else network
        given = {"bias": used.mu * used.bias.ravel()} if bias_input else {}
        ours = runge_kutta_step(used.flat_vector_field, ours, 0.05)
        (theirs,) = session.run(None, {"x": theirs, "h": h, **given})
        np.testing.assert_allclose(theirs, ours, rtol=0.0, atol=1e-12)


def test_an_activation_without_a_graph_and_a_missing_library_are_named(network, tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    arctan = LieEDNN(network.alpha, network.rotation, network.translation, network.bias, activation="arctan")
    with pytest.raises(InputError, match="an ONNX graph is made of tanh, not of the activation 'arctan'"):
        arctan.to_onnx(tmp_path / "step.onnx")
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(LieEDNNError, match=r"pip install 'lieednn_sim\[onnx\]'"):
        network.to_onnx(tmp_path / "step.onnx")
