"""Networks as C99, compiled and stepped beside the package's own."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
import pytest
from compiling import address, compiled, library

import lieednn_sim as ls
from lieednn_sim.errors import InputError
from lieednn_sim.learning.demonstrations import Demonstration, ShapedMotion, align
from lieednn_sim.network import ACTIVATIONS, Activation, LieEDNN
from lieednn_sim.network.dynamics import runge_kutta_step


class Compiled:
    """The exported network as a shared library."""

    def __init__(self, network: LieEDNN, folder) -> None:
        self.size, self.visible = network.bias.size, 6 * network.n_visible
        self.library = library(network.to_c(folder), "-O1")
        self.memory = np.zeros(6 * self.size + self.visible)
        self.call("init")

    @property
    def x(self) -> np.ndarray:
        return self.memory[: self.size]

    def call(self, name: str, *arguments) -> None:
        given = [ctypes.c_double(item) if isinstance(item, float) else address(item) for item in arguments]
        getattr(self.library, f"lieednn_{name}")(address(self.memory), *given)


def fan() -> LieEDNN:
    """A family: hidden starts depend on the visible one and, with goals kept, on the target."""
    s = np.linspace(0.0, 1.0, 60)[:, None]
    ways = [
        np.hstack([x * (1 - s), h * np.sin(np.pi * s)]) + g * s
        for x, h, g in ((0.3, 0.1, 0.0), (0.35, 0.12, 0.02), (0.25, 0.08, -0.02), (0.3, 0.11, 0.01))
    ]
    return ShapedMotion.fit(align([Demonstration.from_samples(way) for way in ways], goals="kept")).network


@cache
def networks() -> dict[str, LieEDNN]:
    rng = np.random.default_rng(0)
    plain = ls.synthesize(rng.uniform(-0.8, 0.8, (4, 6)), seed=1).unwrap()
    arm = ls.Arm.load("telescopic_pr")
    return {
        "plain": plain,
        "arctan": LieEDNN(plain.alpha, plain.rotation, plain.translation, plain.bias, 1.3, 0.9, "arctan"),
        "shaped": ls.plan(arm, "extended", planner="lieednn-shaped").network,
        "family": fan(),
    }


@compiled
@pytest.mark.parametrize(("kind", "steps"), [("plain", 2_000), ("arctan", 1_000), ("shaped", 1_000), ("family", 1_000)])
def test_the_compiled_network_steps_as_ours(kind, steps, tmp_path):
    network = networks()[kind]
    code = Compiled(network, tmp_path)
    rng = np.random.default_rng(1)
    visible = network.equilibrium().xi[: network.n_visible] + rng.normal(scale=0.3, size=(network.n_visible, 6))
    x = network.start(visible).ravel()
    code.call("start", visible)
    np.testing.assert_allclose(code.x, x, rtol=0.0, atol=1e-13)
    rate = np.empty(code.size)
    code.call("field", x, rate)
    # The sums are the same in another order; those of the encoder's 384 neurons have terms of the size of 100.
    rounding = 1e-12 * max(1.0, network.mu * np.abs(network.driven_weight).sum(axis=1).max() / 10.0)
    np.testing.assert_allclose(rate, network.flat_vector_field(x), rtol=0.0, atol=rounding)

    for step in range(steps):
        if step == steps // 2:
            network = network.retarget(visible)
            code.call("retarget", visible)
        x = runge_kutta_step(network.flat_vector_field, x, 0.05)
        code.call("step", 0.05)
        if step % (steps // 20) == 0 or step in (1, steps // 2 + 1, steps - 1):
            np.testing.assert_allclose(code.x, x, rtol=0.0, atol=rounding, err_msg=f"step {step}")
    np.testing.assert_allclose(code.x[: code.visible], visible.ravel(), atol=1e-6)
    elsewhere = visible + rng.normal(scale=0.2, size=visible.shape)
    code.call("start", elsewhere)
    np.testing.assert_allclose(code.x, network.start(elsewhere).ravel(), rtol=0.0, atol=1e-12)


def test_the_header_has_the_certificate_and_says_when_there_is_none(tmp_path):
    network = networks()["plain"]
    header = (network.to_c(tmp_path / "new" / "folder") / "lieednn_numbers.h").read_text()
    assert f"#define LIEEDNN_LAMBDA_MAX {network.certificate.lambda_max!r} " in header
    assert f"#define LIEEDNN_RATE {network.certificate.rate!r} " in header
    assert "globally stable for every bias" in header
    bare = LieEDNN(network.alpha, network.rotation, network.translation, network.bias)
    header = (bare.to_c(tmp_path) / "lieednn_numbers.h").read_text()
    assert "#define LIEEDNN_LAMBDA_MAX NAN " in header
    assert "not certified: nothing is proved" in header
    assert "certified" not in (tmp_path / "lieednn.h").read_text()


def test_what_has_no_c_code_is_refused(tmp_path, monkeypatch):
    network = networks()["plain"]
    monkeypatch.setitem(ACTIVATIONS, "own", Activation(np.tanh, lambda x: 1.0 - np.tanh(x) ** 2))
    own = LieEDNN(network.alpha, network.rotation, network.translation, network.bias, activation="own")
    with pytest.raises(InputError, match="C code is known for tanh and arctan, not for the activation 'own'"):
        own.to_c(tmp_path)
    hearing = LieEDNN(
        *(network.alpha, network.rotation, network.translation, network.bias), hidden_start=np.zeros((1, 6))
    )
    with pytest.raises(InputError, match="hear visible ones"):
        hearing.to_c(tmp_path)
