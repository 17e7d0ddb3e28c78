"""A network's Runge-Kutta step, that of `dynamics.runge_kutta_step`, as C99 without allocation or a graph of ONNX."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.errors import InputError
from lieednn_sim.io import atomic_path, atomic_paths, make_directory
from lieednn_sim.network.base import BlockNetwork
from lieednn_sim.registry import optional_module
from lieednn_sim.values import StrPath

_PHI = {"tanh": "tanh(x)", "arctan": "(0.63661977236758134308 * atan(1.57079632679489661923 * (x)))"}

# The field at one stage's state, in ONNX's own notation.
_STAGE = """
    output{k} = Tanh(x{k})
    product{k} = MatMul(output{k}, weight)
    driven{k} = Add(product{k}, bias)
    decay{k} = Mul(gamma, x{k})
    rate{k} = Sub(driven{k}, decay{k})
"""
# MatMul, Add and Tanh of doubles need operator set 17, which every runtime of recent years has.
_MODEL = f"""<ir_version: 8, opset_import: ["": 17]>
lieednn_step (double[{{size}}] x, double h{{bias}}) => (double[{{size}}] x_next) {{{{
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


def write_c(network: BlockNetwork, activation: str, folder: StrPath) -> Path:
    """Write ``lieednn.h``, ``lieednn.c`` and their numbers into a folder; see `ComponentwiseNetwork.to_c`."""
    if activation not in _PHI:
        raise InputError(f"C code is known for {' and '.join(_PHI)}, not for the activation {activation!r}")
    first, d = network.n_visible, network.bias.shape[1]
    if network.coupled[first:, :first].any():
        raise InputError("hidden neurons hear visible ones in this network, which the C code cannot retarget")
    result = network.equilibrium()
    if not result.success:
        raise InputError(f"the network has no equilibrium that its target could be ({result.message})")
    proof = network.certificate if network.certified else None
    gain, reference, goal_gain = network.start_gain, network.start_reference, network.goal_gain
    numbers = {
        "SIZE": (d * network.n_neurons, "entries of the state"),
        "VISIBLE": (d * first, "entries of the visible neurons, which come first"),
        "HIDDEN": (d * network.n_hidden, "entries of the others"),
        "DRIVEN": (d * network.n_driven, "entries that have inputs, which come first"),
        "LAMBDA_MAX": (proof.lambda_max if proof else math.nan, "largest eigenvalue of the certificate, NAN without"),
        "BOUND": (network.gamma / network.mu, "gamma/mu, which it must stay below"),
        "RATE": (proof.rate if proof else 0.0, "proved rate of convergence, per unit of the network's time, or 0"),
        "GAMMA": (float(network.gamma), "decay rate"),
        "PHI(x)": (_PHI[activation], "activation"),
        "START_LAW": (int(gain is not None), "whether hidden starts depend on the visible one"),
    }
    arrays = {
        "weight": (network.mu * network.driven_weight.T, "mu W, by columns, so that sums over them run along memory"),
        "bias": (network.mu * network.bias.ravel(), "mu b"),
        "rest": (result.xi.ravel(), "equilibrium at the exported target"),
    }
    if network.n_hidden:
        arrays["hidden_start"] = network.hidden_start.ravel(), "where hidden neurons start"
    if gain is not None and reference is not None:
        arrays["start_gain"] = gain, "and how that depends on the visible start"
        arrays["start_reference"] = reference.ravel(), "as seen from here, moved as far as the target"
        arrays["goal_gain"] = np.zeros_like(gain) if goal_gain is None else goal_gain, "and on the target"
    about = str(proof) if proof else "It is not certified: nothing is proved about where it goes"
    header = c_header("lieednn_numbers", f"{about}.", "LIEEDNN", numbers, arrays)
    return write_sources(folder, Path(__file__).parent / "c", {"lieednn_numbers.h": header})


def write_sources(folder: StrPath, sources: Path, made: Mapping[str, str]) -> Path:
    """Write the C files of a folder of this package, and texts by their names, into a folder, which is returned."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in sorted(sources.glob("*.[ch]"))} | dict(made)
    directory = make_directory(folder)
    with atomic_paths([directory / name for name in texts]) as paths:
        for path, text in zip(paths, texts.values(), strict=True):
            path.write_text(text, encoding="utf-8")
    return directory


def c_header(
    name: str,
    about: str,
    prefix: str,
    numbers: Mapping[str, tuple[object, str]],
    arrays: Mapping[str, tuple[NDArray[Any], str]],
) -> str:
    """A C header: a comment, macros of numbers, and arrays, for the source that defines ``prefix_ARRAYS``.

    Numbers and arrays are given by name, each with a description.
    """
    guard = f"{name.upper()}_H"
    lines = [f"/* {_comment(about)} */", f"#ifndef {guard}", f"#define {guard}", ""]
    lines += [
        f"#define {prefix}_{key} {_number(value)} /* {_comment(what)} */" for key, (value, what) in numbers.items()
    ]
    lines += ["", f"#ifdef {prefix}_ARRAYS"]
    for key, (array, what) in arrays.items():
        kind, sizes = "int" if array.dtype.kind == "i" else "double", "".join(f"[{size}]" for size in array.shape)
        lines += [f"/* {_comment(what)} */", f"static const {kind} {key}{sizes} = {_array(array)};"]
    return "\n".join([*lines, "#endif", "", "#endif", ""])


def _comment(text: str) -> str:
    """A text that neither ends the comment that it is in nor seems to begin another, which compilers warn of."""
    return " ".join(text.replace("*/", "* /").replace("/*", "/ *").split())


def _number(value: object) -> str:
    """A number in C, the shortest decimal that is read as the same double; a text as it is."""
    if isinstance(value, float) and not math.isfinite(value):
        return "NAN" if math.isnan(value) else "INFINITY" if value > 0.0 else "-INFINITY"
    return str(value)


def _array(values: NDArray[Any]) -> str:
    if values.ndim == 1:
        return "{" + ", ".join(map(_number, values.tolist())) + "}"
    return "{\n" + ",\n".join(map(_array, values)) + "}"


def write_onnx(network: BlockNetwork, activation: str, path: StrPath, bias_input: bool) -> None:
    """Write the graph to a file; see `ComponentwiseNetwork.to_onnx`."""
    onnx = optional_module("onnx")
    optional_module("onnx.parser")
    if activation != "tanh":
        raise InputError(f"an ONNX graph is made of tanh, not of the activation {activation!r}")
    size, driven = network.bias.size, len(network.driven_weight)
    scalars = {"gamma": network.gamma, "half": 0.5, "two": 2.0, "six": 6.0}
    # Rows of zeros let every stage be a sum of vectors of one size.
    weight = np.vstack([network.mu * network.driven_weight, np.zeros((size - driven, size))]).T
    constants = {"weight": weight, **{name: np.array(value) for name, value in scalars.items()}}
    if not bias_input:
        constants["bias"] = network.mu * network.bias.ravel()
    model = onnx.parser.parse_model(_MODEL.format(size=size, bias=f", double[{size}] bias" if bias_input else ""))
    model.graph.initializer.extend(onnx.numpy_helper.from_array(value, name) for name, value in constants.items())
    proof = str(network.certificate) if network.certificate is not None else "not certified"
    onnx.helper.set_model_props(model, {"certificate": proof})
    onnx.checker.check_model(model)
    with atomic_path(path) as temporary:
        temporary.write_bytes(model.SerializeToString())
