"""Start of the descent: switches where the curve bends, readouts by linear least squares, the rest at random."""

from __future__ import annotations

import numpy as np

from lieednn_sim.synthesis.shaping.cascade import Cascade, Parameters
from lieednn_sim.synthesis.shaping.curve import Curve
from lieednn_sim.values import Floats

# Pieces over which the bend of the curve is computed.
_PIECES = 128
# Initial slopes of switches, per fraction of the path. From steeper ones the fit ends in worse minima, and with many
# times the jerk; for a sharp corner it makes them steeper by itself.
_LEAST_SLOPE, _LARGEST_SLOPE = 1.5, 12.0
# Spread of the random slopes: relative for the leading switches, absolute for the others.
_LEADING_SPREAD, _OTHER_SPREAD = 0.2, 1.0
# Least strength of a block: at zero its derivative in the quaternion would vanish.
_LEAST_STRENGTH = 0.02
# Weight of the squared readouts in the linear problems.
_RIDGE, _SHIFT_RIDGE = 1e-6, 1e-4
# Largest distance of rotations from a line that still counts as on it [rad].
_LINE = 1e-9


def starting_point(cascade: Cascade, curve: Curve, n_switches: int, rng: np.random.Generator) -> Parameters:
    """Parameters of a cascade whose path is roughly the curve.

    The first rotational and the first translational coordinate of each hidden neuron lead: they switch where the curve
    bends most, sharply at a corner. The others start at random. Where all rotations stay on lines through zero, as
    those of hinges do, the other rotational coordinates start at zero, so that every rotation starts on its line.
    """
    n, m = len(cascade.target), n_switches
    a, c = np.zeros((m, 6)), rng.normal(scale=_OTHER_SPREAD, size=(m, 6))
    a[:] = -c * rng.uniform(size=(m, 6))
    turning = [np.linalg.svd(curve.points[::16, i, :3], compute_uv=False) for i in range(n)]
    turns, on_lines = (bool(part) for part in (max(s[0] for s in turning) > _LINE, all(s[1] < _LINE for s in turning)))
    if on_lines:
        a[:, :3], c[:, :3] = 0.0, 0.0
    for part, used in ((slice(0, 3), turns), (slice(3, 6), True)):
        if used:
            place, slope = _switches(curve, part, m)
            slope *= np.exp(_LEADING_SPREAD * rng.normal(size=m))
            c[:, part.start], a[:, part.start] = slope, -slope * (1.0 - place)
    outputs = cascade.switched(a, c)[0][:-1]
    goal, _ = curve.at(1.0 - cascade.clock.g)
    missing = goal - cascade.free[:-1]
    lead = slice(0, 3) if turns else slice(3, 6)
    wanted = _ridge(outputs[:, :, lead.start], missing[..., lead].reshape(len(goal), -1), _RIDGE)
    q = towards(wanted.reshape(m, n, 3).transpose(1, 0, 2), rng.uniform(-np.pi, np.pi, (n, m)), _LEAST_STRENGTH)
    parameters = Parameters(a, c, q, np.zeros((n, m, 3)))
    if not turns:
        return parameters
    blocks, _ = parameters.blocks()
    turned = np.einsum("nmab,kmb->nkam", blocks[..., :3, :3], outputs[..., :3])
    left = missing[..., 3:] - np.einsum("nmab,kmb->kna", blocks[..., :3, :3], outputs[..., 3:])
    columns = _crossing(turned)
    tau = [_ridge(columns[i], left[:, i].ravel(), _SHIFT_RIDGE).reshape(m, 3) for i in range(n)]
    return Parameters(a, c, q, np.array(tau))


def _switches(curve: Curve, part: slice, count: int) -> tuple[Floats, Floats]:
    """Positions, as fractions ``(count,)`` of the length, and slopes: density and slope follow the root of the bend."""
    tangents = (curve.tangents * curve.units)[:: len(curve.points) // _PIECES, :, part] / curve.length
    tangents = tangents.reshape(len(tangents), -1)
    density = np.sqrt(len(tangents) * np.linalg.norm(np.gradient(tangents, axis=0), axis=1))
    # A little everywhere, for long stretches that bend gently.
    density += 0.1 * density.mean() + 0.1
    mass = np.append(0.0, np.cumsum(0.5 * (density[1:] + density[:-1])))
    edges = np.interp(np.linspace(0.0, mass[-1], 2 * count + 1), mass, np.linspace(0.0, 1.0, len(tangents)))
    return edges[1::2], np.clip(2.0 / np.maximum(edges[2::2] - edges[:-2:2], 1e-9), _LEAST_SLOPE, _LARGEST_SLOPE)


def _ridge(columns: Floats, wanted: Floats, weight: float) -> Floats:
    """Ridge regression; similar columns share the work."""
    square = columns.T @ columns
    return np.asarray(np.linalg.solve(square + weight * np.eye(len(square)), columns.T @ wanted))


def _crossing(turned: Floats) -> Floats:
    """Matrix ``(N, 3 K, 3 M)`` from translations ``(M, 3)`` to their input, for rotational inputs ``(N, K, 3, M)``."""
    n, k, _, m = turned.shape
    columns = np.zeros((n, k, 3, m, 3))
    for row in range(3):
        after, before = (row + 1) % 3, (row + 2) % 3
        # (tau x d)_row = tau_after d_before - tau_before d_after
        columns[:, :, row, :, after], columns[:, :, row, :, before] = turned[:, :, before], -turned[:, :, after]
    return columns.reshape(n, 3 * k, 3 * m)


def towards(wanted: Floats, spin: Floats | float = 0.0, least: float = 0.0) -> Floats:
    """Quaternions ``(..., 4)`` with |q|^2 R(q) e_x = ``wanted`` ``(..., 3)``, turned about it by ``spin`` ``(...)``.

    Where ``wanted`` is shorter than ``least``, |q|^2 is ``least``.
    """
    size = np.linalg.norm(wanted, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(np.where(size > 1e-12, wanted / np.maximum(size, 1e-300), np.eye(3)[0]), -1, 0)
    # The halfway rotation from e_x; about the third axis where the direction is opposite.
    none = np.zeros_like(x)
    half = np.stack([1.0 + x, none, -z, y], axis=-1)
    half[x < -1.0 + 1e-9] = np.eye(4)[3]
    w, _, j, k = np.moveaxis(half / np.linalg.norm(half, axis=-1, keepdims=True), -1, 0)
    cosine, sine = np.cos(0.5 * spin), np.sin(0.5 * spin)
    turned = np.stack([w * cosine, w * sine, j * cosine + k * sine, k * cosine - j * sine], axis=-1)
    return np.asarray(turned * np.sqrt(np.maximum(size, least)))
