"""One Runge-Kutta step of a network as a graph of ONNX."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.io import atomic_path

if TYPE_CHECKING:
    from lieednn_sim.network.base import BlockNetwork

# The field at one stage's state, in ONNX's own notation.
_STAGE = """
    output{k} = Tanh(x{k})
    product{k} = MatMul(output{k}, weight)
    driven{k} = Add(product{k}, bias)
    decay{k} = Mul(gamma, x{k})
    rate{k} = Sub(driven{k}, decay{k})
"""
# Doubles of MatMul, Add and Tanh need operators of 17; every runtime of the last years has them.
_MODEL = f"""<ir_version: 8, opset_import: ["": 17]>
lieednn_step (double[{{size}}] x, double h, double[{{size}}] bias) => (double[{{size}}] x_next) {{{{
    x1 = Identity(x)
    half_h = Mul(half, h)
    {_STAGE.format(k=1)}
    way1 = Mul(half_h, rate1)
    x2 = Add(x, way1)
    {_STAGE.format(k=2)}
    way2 = Mul(half_h, rate2)
    x3 = Add(x, way2)
    {_STAGE.format(k=3)}
    way3 = Mul(h, rate3)
    x4 = Add(x, way3)
    {_STAGE.format(k=4)}
    inner = Add(rate2, rate3)
    twice = Mul(two, inner)
    sum = Sum(rate1, twice, rate4)
    sixth_h = Div(h, six)
    way = Mul(sixth_h, sum)
    x_next = Add(x, way)
}}}}"""


def write_onnx(network: BlockNetwork, activation: str, path: str | os.PathLike[str]) -> None:
    """Write the graph to a file; see `ComponentwiseNetwork.to_onnx`."""
    try:
        import onnx
        import onnx.parser
    except ImportError:
        raise LieEDNNError("to_onnx needs the library onnx: pip install 'lieednn_sim[onnx]'") from None
    if activation != "tanh":
        raise InputError(f"an ONNX graph is made of tanh, not of the activation {activation!r}")
    size, driven = network.bias.size, len(network.driven_weight)
    constants = {
        # Rows of zeros let every stage be a sum of vectors of one size.
        "weight": np.vstack([network.mu * network.driven_weight, np.zeros((size - driven, size))]).T,
        "gamma": np.array(network.gamma),
        "half": np.array(0.5),
        "two": np.array(2.0),
        "six": np.array(6.0),
        # An input with an initialiser may be left out by the caller.
        "bias": network.mu * network.bias.ravel(),
    }
    model = onnx.parser.parse_model(_MODEL.format(size=size))
    model.graph.initializer.extend(onnx.numpy_helper.from_array(value, name) for name, value in constants.items())
    proof = str(network.certificate) if network.certificate is not None else "not certified"
    onnx.helper.set_model_props(model, {"certificate": proof})
    onnx.checker.check_model(model)
    with atomic_path(path) as temporary:
        temporary.write_bytes(model.SerializeToString())
