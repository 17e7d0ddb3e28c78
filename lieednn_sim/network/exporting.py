"""A network's Runge-Kutta step, that of `dynamics.runge_kutta_step`, as C99 without allocation or a graph of ONNX."""

from __future__ import annotations

import os
from pathlib import Path
from string import Template

import numpy as np

from lieednn_sim.errors import InputError, LieEDNNError
from lieednn_sim.io import atomic_path, atomic_paths, make_directory
from lieednn_sim.network.base import BlockNetwork
from lieednn_sim.values import Floats

_PHI = {"tanh": "tanh(x)", "arctan": "M_2_PI * atan(M_PI_2 * x)"}

_HEADER = Template("""\
/* A certified neural ODE, x' = -gamma x + mu (W phi(x) + b), as C99.

$proof

   A neuron's state is a twist (omega [rad], v in the network's unit of length); visible neurons come first. */
#ifndef LIEEDNN_H
#define LIEEDNN_H

#define LIEEDNN_SIZE $size /* entries of the state */
#define LIEEDNN_VISIBLE $visible /* entries of the visible neurons, which come first */
#define LIEEDNN_LAMBDA_MAX $lambda_max /* largest eigenvalue of the certificate, NAN without one */
#define LIEEDNN_BOUND $bound /* gamma/mu, which it must stay below */
#define LIEEDNN_RATE $rate /* proved rate of convergence, per unit of the network's time; 0 without a proof */

typedef struct {
    double x[LIEEDNN_SIZE]; /* state */
    double bias[LIEEDNN_SIZE]; /* mu b, which holds the target */
    double target[LIEEDNN_VISIBLE]; /* equilibrium of the visible neurons */
    double work[4][LIEEDNN_SIZE];
} lieednn;

/* The network at the target that it was exported with. Call lieednn_start next. */
void lieednn_init(lieednn *net);

/* Begin a motion with the visible neurons at the given state; hidden ones start where their law says. */
void lieednn_start(lieednn *net, const double visible[LIEEDNN_VISIBLE]);

/* Another target, under the same proof; a motion under way goes on to it. */
void lieednn_retarget(lieednn *net, const double target[LIEEDNN_VISIBLE]);

/* The rate of a state, per unit of the network's time. */
void lieednn_field(const lieednn *net, const double x[LIEEDNN_SIZE], double rate[LIEEDNN_SIZE]);

/* One step of the classical Runge-Kutta method, h in the network's time. */
void lieednn_step(lieednn *net, double h);

#endif
""")

_SOURCE = Template("""\
#include "lieednn.h"

#include <math.h>
#include <string.h>

#ifndef M_2_PI
#define M_2_PI 0.63661977236758134308
#define M_PI_2 1.57079632679489661923
#endif

#define DRIVEN $driven /* entries of the state that have inputs, which come first */
#define HIDDEN (LIEEDNN_SIZE - LIEEDNN_VISIBLE)

static const double gamma_ = $gamma;
/* mu W, by columns, so that sums over them run along memory. */
static const double weight[LIEEDNN_SIZE][DRIVEN] = $weight;
static const double bias[LIEEDNN_SIZE] = $bias_values;
/* Equilibrium at the exported target. */
static const double rest[LIEEDNN_SIZE] = $rest;
$hidden_arrays
static double phi(double x) { return $phi; }

static void add_inputs(const double x[LIEEDNN_SIZE], double sum[LIEEDNN_SIZE], double sign)
{
    for (int j = 0; j < LIEEDNN_SIZE; j++) {
        const double output = sign * phi(x[j]);
        for (int i = 0; i < DRIVEN; i++)
            sum[i] += weight[j][i] * output;
    }
}

void lieednn_field(const lieednn *net, const double x[LIEEDNN_SIZE], double rate[LIEEDNN_SIZE])
{
    for (int i = 0; i < LIEEDNN_SIZE; i++)
        rate[i] = net->bias[i] - gamma_ * x[i];
    add_inputs(x, rate, 1.0);
}

void lieednn_step(lieednn *net, double h)
{
    static const double part[4] = {0.0, 0.5, 0.5, 1.0}, share[4] = {1.0, 2.0, 2.0, 1.0};
    double *at = net->work[0], *rate = net->work[1], *sum = net->work[2], *end = net->work[3];
    memset(rate, 0, sizeof net->work[1]);
    memset(sum, 0, sizeof net->work[2]);
    for (int stage = 0; stage < 4; stage++) {
        for (int i = 0; i < LIEEDNN_SIZE; i++)
            at[i] = net->x[i] + part[stage] * h * rate[i];
        lieednn_field(net, at, rate);
        for (int i = 0; i < LIEEDNN_SIZE; i++)
            sum[i] += share[stage] * rate[i];
    }
    for (int i = 0; i < LIEEDNN_SIZE; i++)
        end[i] = net->x[i] + h / 6.0 * sum[i];
    memcpy(net->x, end, sizeof net->x);
}

void lieednn_init(lieednn *net)
{
    memset(net, 0, sizeof *net);
    memcpy(net->bias, bias, sizeof bias);
    memcpy(net->target, rest, sizeof net->target);
}

void lieednn_start(lieednn *net, const double visible[LIEEDNN_VISIBLE])
{
    memcpy(net->x, visible, sizeof net->target);
$start
}

void lieednn_retarget(lieednn *net, const double target[LIEEDNN_VISIBLE])
{
    double *goal = net->work[0], *pull = net->work[1];
    memcpy(goal, rest, sizeof rest);
    memcpy(goal, target, sizeof net->target);
    for (int i = 0; i < LIEEDNN_SIZE; i++)
        pull[i] = gamma_ * goal[i];
    add_inputs(goal, pull, -1.0);
    memcpy(net->bias, pull, sizeof net->target);
    memcpy(net->target, target, sizeof net->target);
}
""")

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


def write_c(network: BlockNetwork, activation: str, folder: str | os.PathLike[str]) -> Path:
    """Write ``lieednn.h`` and ``lieednn.c`` into a folder; see `ComponentwiseNetwork.to_c`."""
    if activation not in _PHI:
        raise InputError(f"C code is known for {' and '.join(_PHI)}, not for the activation {activation!r}")
    first, d = network.n_visible, network.bias.shape[1]
    if network.coupled[first:, :first].any():
        raise InputError("hidden neurons hear visible ones in this network, which the C code cannot retarget")
    result = network.equilibrium()
    if not result.success:
        raise InputError(f"the network has no equilibrium that its target could be ({result.message})")
    proof = network.certificate if network.certified else None
    values = {
        "proof": f"   {proof}." if proof else "   It is not certified: nothing is proved about where it goes.",
        "size": d * network.n_neurons,
        "visible": d * first,
        "driven": d * network.n_driven,
        "lambda_max": _number(proof.lambda_max) if proof else "NAN",
        "bound": _number(network.gamma / network.mu),
        "rate": _number(proof.rate if proof else 0.0),
        "gamma": _number(network.gamma),
        "weight": _array(network.mu * network.driven_weight.T),
        "bias_values": _array(network.mu * network.bias.ravel()),
        "rest": _array(result.xi.ravel()),
        "phi": _PHI[activation],
        **_hidden(network),
    }
    directory = make_directory(folder)
    targets = [directory / "lieednn.h", directory / "lieednn.c"]
    with atomic_paths(targets) as paths:
        for path, template in zip(paths, (_HEADER, _SOURCE), strict=True):
            path.write_text(template.substitute(values), encoding="utf-8")
    return directory


def _hidden(network: BlockNetwork) -> dict[str, str]:
    """The hidden neurons' starts as C."""
    if not network.n_hidden:
        return {"hidden_arrays": "", "start": ""}
    gain, reference, goal_gain = network.start_gain, network.start_reference, network.goal_gain
    start = ["    memcpy(net->x + LIEEDNN_VISIBLE, hidden_start, sizeof hidden_start);"]
    gains, law = "", ""
    if gain is not None and reference is not None:
        law = " + start_gain (visible - start_reference - moved)"
        gains += f"static const double start_gain[HIDDEN][LIEEDNN_VISIBLE] = {_array(gain)};\n"
        gains += f"static const double start_reference[LIEEDNN_VISIBLE] = {_array(reference.ravel())};\n"
        term = "start_gain[i][j] * (visible[j] - start_reference[j] - moved)"
        if goal_gain is not None:
            law += " + goal_gain moved"
            gains += f"static const double goal_gain[HIDDEN][LIEEDNN_VISIBLE] = {_array(goal_gain)};\n"
            term += " + goal_gain[i][j] * moved"
        law += ", with moved the way of the target since the export"
        start += [
            "    for (int j = 0; j < LIEEDNN_VISIBLE; j++) {",
            "        const double moved = net->target[j] - rest[j];",
            "        for (int i = 0; i < HIDDEN; i++)",
            f"            net->x[LIEEDNN_VISIBLE + i] += {term};",
            "    }",
        ]
    hidden = f"/* Hidden neurons start at hidden_start{law}. */\n"
    hidden += f"static const double hidden_start[HIDDEN] = {_array(network.hidden_start.ravel())};\n{gains}"
    return {"hidden_arrays": hidden, "start": "\n".join(start)}


def _number(value: float) -> str:
    """The shortest decimal that C reads as the same double."""
    return repr(float(value))


def _array(values: Floats) -> str:
    """A brace-enclosed initialiser."""
    if np.ndim(values) == 1:
        return "{" + ", ".join(map(_number, values)) + "}"
    return "{\n" + ",\n".join(map(_array, values)) + "}"


def write_onnx(network: BlockNetwork, activation: str, path: str | os.PathLike[str], bias_input: bool) -> None:
    """Write the graph to a file; see `ComponentwiseNetwork.to_onnx`."""
    try:
        import onnx
        import onnx.parser
    except ImportError:
        raise LieEDNNError("to_onnx needs the library onnx: pip install 'lieednn_sim[onnx]'") from None
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
