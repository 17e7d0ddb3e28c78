"""Many networks integrated side by side: what NumPy does to all at once costs little more than for one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import RK45

from lieednn_sim.budget import check_time
from lieednn_sim.errors import InputError
from lieednn_sim.network.componentwise import ComponentwiseNetwork
from lieednn_sim.values import Floats

# Steps tried at most; a usual trajectory takes some twenty. What needs more is left to `BlockNetwork.trajectory`, which
# also says why where it fails.
_MOST_STEPS = 500
# SciPy's control of the step: its next length is the last one times a factor from least to most, a little below the
# one at which the error would be just as large as allowed. The error of a step is of fifth order in it.
_STEP_SAFETY, _LEAST_STEP_FACTOR, _LARGEST_STEP_FACTOR, _ORDER = 0.9, 0.2, 10.0, 5

_Field = Callable[[Floats], Floats]  # flat rates of change of states ``(B, dN)``, those of each network in a row


def integrate_batch(
    networks: Sequence[ComponentwiseNetwork], start: Floats, duration: float, *, rtol: float, atol: float
) -> list[Floats]:
    """States ``(K, N, d)`` of each network at the steps that `trajectory` takes with ``RK45``, up to rounding.

    Each network has its own step sizes. Two dozen networks of four neurons take an eighth of the time of single ones.
    Arguments and errors are as of `BlockNetwork.trajectory`; `InputError` if networks differ in size or activation.
    """
    kinds = {(network.bias.shape, network.activation) for network in networks}
    if kinds != {(np.shape(start), networks[0].activation)}:
        raise InputError(f"networks side by side must have the start's shape and one activation, got {kinds}")
    weight = np.array([network.mu * network.weight for network in networks])
    bias = np.array([network.mu * network.bias.ravel() for network in networks])
    decay, phi = np.array([[network.gamma] for network in networks]), networks[0].phi

    def field(x: Floats) -> Floats:
        return (weight @ phi(x)[..., None])[..., 0] + bias - decay * x

    with np.errstate(all="ignore"):
        # What overflows takes no more steps, and is left.
        x = np.tile(start.ravel(), (len(networks), 1))
        rate = field(x)
        step = _first_steps(field, x, rate, duration, rtol, atol)
        now, stack = np.zeros(len(networks)), np.arange(len(networks))
        retried = np.zeros(len(networks), bool)
        results = [[item] for item in x]
        for _ in range(_MOST_STEPS):
            check_time()
            after = np.minimum(now + step, duration)
            step = after - now
            there, stages = _trial(field, x, rate, step)
            allowed = atol + rtol * np.maximum(np.abs(x), np.abs(there))
            error = _norm((RK45.E @ stages) * step[:, None] / allowed)
            good = error < 1.0
            factor = np.clip(_STEP_SAFETY * error ** (-1.0 / _ORDER), _LEAST_STEP_FACTOR, _LARGEST_STEP_FACTOR)
            step = step * np.where(good & retried, np.minimum(factor, 1.0), factor)
            retried = ~good
            now = np.where(good, after, now)
            x, rate = np.where(good[:, None], there, x), np.where(good[:, None], stages[:, -1], rate)
            for k, state in zip(stack[good].tolist(), x[good], strict=True):
                results[k].append(state)
            left = (now < duration).nonzero()[0]
            if len(left) < len(stack):
                weight, bias, decay, x, rate = weight[left], bias[left], decay[left], x[left], rate[left]
                now, step, retried, stack = now[left], step[left], retried[left], stack[left]
            if not len(stack):
                break
    states: list[Floats] = [np.array(item).reshape(-1, *start.shape) for item in results]
    for k in stack.tolist():
        states[k] = networks[k].trajectory(start, duration, rtol=rtol, atol=atol).xi
    return states


def _trial(field: _Field, x: Floats, rate: Floats, step: Floats) -> tuple[Floats, Floats]:
    """States ``(B, n)`` after a step of each, and the rates at its stages, ``(B, 7, n)``."""
    stages = np.empty((len(x), RK45.n_stages + 1, x.shape[-1]))
    stages[:, 0] = rate
    for s in range(1, RK45.n_stages):
        stages[:, s] = field(x + (RK45.A[s, :s] @ stages[:, :s]) * step[:, None])
    there = x + step[:, None] * (RK45.B @ stages[:, :-1])
    stages[:, -1] = field(there)
    return there, stages


def _first_steps(field: _Field, x: Floats, rate: Floats, duration: float, rtol: float, atol: float) -> Floats:
    """Lengths ``(B,)`` of the first steps (Hairer, Norsett and Wanner, section II.4), as SciPy chooses them."""
    allowed = atol + rtol * np.abs(x)
    size, speed = _norm(x / allowed), _norm(rate / allowed)
    small = np.minimum(np.where((size < 1e-5) | (speed < 1e-5), 1e-6, 0.01 * size / speed), duration)
    bend = _norm((field(x + small[:, None] * rate) - rate) / allowed) / small
    fastest = np.maximum(speed, bend)
    step = np.where(fastest <= 1e-15, np.maximum(1e-6, 1e-3 * small), (0.01 / fastest) ** (1.0 / _ORDER))
    return np.minimum(np.minimum(100.0 * small, step), duration)


def _norm(array: Floats) -> Floats:
    """Root mean square of each row."""
    return np.sqrt((array * array).mean(axis=-1))
