"""One Runge-Kutta step of a network as a graph of ONNX."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.io import atomic_path
from lieednn_sim.network.dynamics import runge_kutta_step
from lieednn_sim.values import Floats

if TYPE_CHECKING:
    from lieednn_sim.network.base import BlockNetwork

# Doubles of MatMul, Add and Tanh; every runtime of the last years has it.
_OPSET, _IR = 17, 8


def write_onnx(network: BlockNetwork, activation: str, path: str | os.PathLike[str]) -> None:
    """Write the graph to a file; see `ComponentwiseNetwork.to_onnx`."""
    try:
        import onnx
    except ImportError:
        raise LieEDNNError("to_onnx needs the library onnx: pip install 'lieednn_sim[onnx]'") from None
    if activation != "tanh":
        raise InputError(f"an ONNX graph is made of tanh, not of the activation {activation!r}")
    size, driven = network.bias.size, len(network.driven_weight)
    # Rows of zeros let every stage be a sum of vectors of one size.
    weight = np.vstack([network.mu * network.driven_weight, np.zeros((size - driven, size))])
    graph = _Graph(onnx)
    transposed = graph.constant(weight.T)
    decay = graph.constant(np.array(network.gamma))

    def field(x: _Node, _: float) -> _Node:
        return graph("MatMul", graph("Tanh", x), transposed) + graph.named("bias") - decay * x

    # The classical method itself, whose sums and products build the graph.
    end: Any = runge_kutta_step(field, graph.named("x"), graph.named("h"))  # type: ignore[arg-type]
    proof = str(network.certificate) if network.certificate is not None else "not certified"
    model = graph.model(end, size, mu_bias=network.mu * network.bias.ravel(), proof=proof)
    with atomic_path(path) as temporary:
        temporary.write_bytes(model.SerializeToString())


class _Node:
    """A value of the graph, whose arithmetic adds operators to it."""

    def __init__(self, graph: _Graph, name: str) -> None:
        self.graph, self.name = graph, name

    def _with(self, kind: str, one: Any, other: Any) -> _Node:
        return self.graph(
            kind, *(item if isinstance(item, _Node) else self.graph.constant(item) for item in (one, other))
        )

    def __add__(self, other: Any) -> _Node:
        return self._with("Add", self, other)

    def __sub__(self, other: Any) -> _Node:
        return self._with("Sub", self, other)

    def __mul__(self, other: Any) -> _Node:
        return self._with("Mul", self, other)

    def __rmul__(self, other: Any) -> _Node:
        return self._with("Mul", other, self)

    def __truediv__(self, other: Any) -> _Node:
        return self._with("Div", self, other)


class _Graph:
    """Operators and constants in the order in which they were made."""

    def __init__(self, onnx: Any) -> None:
        self._onnx = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def named(self, name: str) -> _Node:
        return _Node(self, name)

    def constant(self, value: Any) -> _Node:
        name = f"constant_{len(self._constants)}"
        array = np.asarray(value, dtype=np.float64)
        self._constants.append(self._onnx.numpy_helper.from_array(array, name))
        return _Node(self, name)

    def __call__(self, kind: str, *inputs: _Node) -> _Node:
        name = f"{kind.lower()}_{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(kind, [item.name for item in inputs], [name]))
        return _Node(self, name)

    def model(self, end: _Node, size: int, *, mu_bias: Floats, proof: str) -> Any:
        helper, double = self._onnx.helper, self._onnx.TensorProto.DOUBLE
        self._nodes.append(helper.make_node("Identity", [end.name], ["x_next"]))
        inputs = [helper.make_tensor_value_info(name, double, shape) for name, shape in (("x", [size]), ("h", []))]
        # An input with an initialiser may be left out by the caller.
        inputs.append(helper.make_tensor_value_info("bias", double, [size]))
        default = self._onnx.numpy_helper.from_array(mu_bias, "bias")
        outputs = [helper.make_tensor_value_info("x_next", double, [size])]
        graph = helper.make_graph(self._nodes, "lieednn_step", inputs, outputs, [*self._constants, default])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=_IR)
        helper.set_model_props(model, {"certificate": proof})
        self._onnx.checker.check_model(model)
        return model
