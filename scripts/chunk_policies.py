"""The policies of the study `chunks.py`, an expert and its clone, and the references made of their chunks."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import numpy as np
from common import perceptron

import lieednn_sim as ls
from lieednn_sim import io
from lieednn_sim.environments.tasks import band_limited
from lieednn_sim.policies import ChunkPolicy
from lieednn_sim.values import Floats

PERIOD, H, DT = 0.01, 16, 0.1  # control period [s]; targets of a chunk, and time between two [s]
REFERENCES = ("raw", "low-pass", "linear blending", "Ruckig", "lieednn-chunks")
TIME_CONSTANT, BLEND, JERK = 0.1, 0.4, 20.0  # of filter and blending [s]; of Ruckig, over the acceleration [1/s]
EPISODES, EPOCHS = 800, {"reach": 300, "track": 30}  # that the clone sees


class Reference:
    """The joint reference of an arm, made of chunks in one of the ways of `REFERENCES`.

    ``raw`` is the newest chunk with straight lines between its targets; all others but the last one smooth it.
    """

    def __init__(self, arm: ls.Arm, way: str) -> None:
        self._way, self.now, self._came, self.refused = way, 0.0, 0.0, 0
        self._home = self._q = arm.keyframe("home")
        self._chunks, self._most = [(0.0, self._q[None])] * 2, 0.9 * arm.velocity_limits
        self._policy = ChunkPolicy(arm, 1.0 / PERIOD)
        self._policy.reset(self._q)
        if way == "Ruckig":
            ruckig, n, a = import_module("ruckig"), arm.n_joints, arm.acceleration_limits
            self._otg, self._made, self._error = ruckig.Ruckig(n, PERIOD), ruckig.OutputParameter(n), ruckig.RuckigError
            self._given = given = ruckig.InputParameter(n)
            given.current_position = given.target_position = self._q
            given.max_velocity, given.max_acceleration, given.max_jerk = arm.velocity_limits, a, JERK * a

    def accept(self, chunk: Floats, begin: float) -> None:
        """Take a chunk ``(H, n)`` whose first target is for a time."""
        if self._way == "lieednn-chunks":
            self.refused += not self._policy.accept(chunk, begin, DT).accepted
        self._chunks, self._came = [self._chunks[-1], (begin, chunk)], self.now

    def _wanted(self, which: int = -1) -> Floats:
        begin, chunk = self._chunks[which]
        at = min(max((self.now - begin) / DT, 0.0), len(chunk) - 1.0)
        row = min(int(at), max(len(chunk) - 2, 0))
        return chunk[row] + (at - row) * (chunk[min(row + 1, len(chunk) - 1)] - chunk[row])

    def step(self, measured: Floats) -> Floats:
        """The reference ``(n,)`` at the end of the period that begins now."""
        if self._way == "lieednn-chunks":
            return self._policy.step(measured, self._home)[0]
        self.now += PERIOD
        q = self._wanted()
        if self._way == "low-pass":
            q = self._q + (1.0 - np.exp(-PERIOD / TIME_CONSTANT)) * (q - self._q)
        elif self._way == "linear blending":
            q = q + (1.0 - min((self.now - self._came) / BLEND, 1.0)) * (self._wanted(-2) - q)
        elif self._way == "Ruckig":
            velocity = (q - np.array(self._given.target_position)) / PERIOD
            self._given.target_position, self._given.target_velocity = q, np.clip(velocity, -self._most, self._most)
            with suppress(self._error):  # it may fail next to rest, and stays there
                self._otg.update(self._given, self._made)
                self._made.pass_to_input(self._given)
            q = np.array(self._made.new_position)
        self._q = q
        return q


def reached(arm: ls.Arm, target: Floats, period: float, count: int) -> Floats:
    """The expert's motion from home to a target: joints ``(count, n)``, one row for each period."""
    expert = ls.make_policy("lieednn-certified", arm, target, rate=1.0 / period)
    return np.array([arm.keyframe("home"), *(expert.step(None, target)[0] for _ in range(count - 1))])


def _root(arm: ls.Arm, way: Floats, times: Floats | float = DT) -> Floats:
    """Signed roots of joint differences ``(..., n)`` over the largest in given times, as the tasks' actions."""
    return np.sign(way) * np.sqrt(np.abs(way) / (np.asarray(times)[..., None] * arm.velocity_limits))


def _seen(arm: ls.Arm, command: Floats, targets: Floats) -> Floats:
    """The clone's observations, of commanded joints ``(K, n)`` and targets ``(K, P, n)`` of the next P times."""
    ways = _root(arm, targets - command[:, None], DT * np.arange(1.0, targets.shape[1] + 1.0))
    return np.concatenate([command / arm.ranges, ways.reshape(len(command), -1)], axis=1)


def _demonstrations(task: str, arm: ls.Arm) -> tuple[Floats, Floats]:
    """Observations, and the steps of the chunks that follow; half of these begin off the path and come back to it."""
    count, pairs, back = round(6.0 / DT), [], np.exp(-DT * np.arange(H) / 0.3)[:, None]
    for episode in range(EPISODES):
        rng, total = np.random.default_rng(episode), count + H
        if task == "reach":
            goal = ls.draw_target(arm, episode)
            way, targets = reached(arm, goal, DT, total), np.broadcast_to(goal, (count, 1, len(goal)))
        else:
            way = band_limited(arm, rng, total * DT)(DT * np.arange(total + 1))
            targets = np.array([way[k + 1 : k + 1 + H] for k in range(count)])
        size = 0.03 * arm.ranges * 10.0 ** rng.uniform(-3.0, 0.0, (count, 1)) * (rng.random((count, 1)) < 0.5)
        off = size * rng.standard_normal((count, arm.n_joints))
        chunks = np.array([way[k : k + H] for k in range(count)]) + off[:, None] * back
        pairs.append((_seen(arm, chunks[:, 0], targets), _root(arm, np.diff(chunks, axis=1)).reshape(count, -1)))
    return np.concatenate([x for x, _ in pairs]), np.concatenate([y for _, y in pairs])


def fit(task: str, path: Path) -> None:
    """Fit a network with two layers of 256 to demonstrations of a task, by least squares, and keep its weights."""
    seen, steps = _demonstrations(task, ls.Arm.load("telescopic_pr"))
    mean, deviation = seen.mean(axis=0), seen.std(axis=0) + 1e-6
    *_, network = perceptron((seen - mean) / deviation, steps, 2e-3, EPOCHS[task], 0)
    weights = {key: value.double().numpy() for key, value in network.state_dict().items()}
    with io.atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez(stream, mean=mean, deviation=deviation, **weights)


def clone(arm: ls.Arm, path: Path) -> Callable[[Floats, Floats], Floats]:
    """The fitted policy: a chunk ``(H, n)`` from the commanded joints on, and from the next targets ``(P, n)``."""
    with np.load(path) as stored:
        mean, deviation, *weights = (stored[key] for key in stored.files)

    def chunk(command: Floats, targets: Floats) -> Floats:
        x = ((_seen(arm, command[None], targets[None]) - mean) / deviation)[0]
        for weight, bias in zip(weights[:-2:2], weights[1:-2:2], strict=True):
            x = np.maximum(weight @ x + bias, 0.0)
        x = weights[-2] @ x + weights[-1]
        steps = DT * arm.velocity_limits * (np.abs(x) * x).reshape(H - 1, -1)
        return command + np.concatenate([np.zeros((1, arm.n_joints)), np.cumsum(steps, axis=0)])

    return chunk
