"""Networks whose activation acts on each coordinate alone, as in the paper."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from lieednn_sim import stability
from lieednn_sim.errors import InputError, NotCertifiedError
from lieednn_sim.network.base import BlockNetwork, checked_fields
from lieednn_sim.network.exporting import write_c, write_onnx
from lieednn_sim.stability.robustness import flat_coordinates
from lieednn_sim.validation import as_choice, as_floats, as_positive
from lieednn_sim.values import Floats, StrPath, frozen, read_only, set_fields

# Points at which an activation is checked, and how far its slope may be from the differences of its values.
_SAMPLES, _DIFFERENCE, _TOLERANCE = np.linspace(-8.0, 8.0, 161), 1e-5, 1e-6
_FAR = np.array([1e3, 1e6, 1e9])  # points at which it is near its bound, if it has one


@frozen
class Activation:
    """An odd, bounded function with slopes in (0, 1], as the certificates of `stability` assume.

    A network takes it by its name in `ACTIVATIONS`, to which others may be added.

    Attributes:
        phi: the function, entry by entry, of arrays of any shape.
        slope: its derivative phi', likewise.
        slope_of_output: phi' as a function of phi, where that is cheaper; learning and shaping use it.
        bound: least upper bound of |phi|.

    Raises:
        InputError: at one of many points the function is not odd, the slope is not that of the function, or not in
            (0, 1], or the function exceeds its bound.
    """

    phi: Callable[[Floats], Floats]
    slope: Callable[[Floats], Floats]
    slope_of_output: Callable[[Floats], Floats] | None = None
    bound: float = 1.0

    def __post_init__(self) -> None:
        x, h = _SAMPLES, _DIFFERENCE
        value, slope = _values("phi", self.phi, x), _values("slope", self.slope, x)
        measured = (_values("phi", self.phi, x + h) - _values("phi", self.phi, x - h)) / (2.0 * h)
        fits = [np.abs(value + _values("phi", self.phi, -x)), np.abs(slope - measured)]
        if self.slope_of_output is not None:
            fits.append(np.abs(slope - _values("slope_of_output", self.slope_of_output, value)))
        if not all((fit < _TOLERANCE).all() for fit in fits):
            raise InputError("an activation must be odd, and its slopes must be those of its values")
        if not ((slope > 0.0) & (slope <= 1.0)).all():
            raise InputError(f"slopes of an activation must be in (0, 1], got {slope.min():.3g} to {slope.max():.3g}")
        largest = float(np.abs(_values("phi", self.phi, np.append(x, _FAR))).max())
        if not largest <= (1.0 + _TOLERANCE) * as_positive("bound", self.bound):
            raise InputError(f"an activation must not exceed its bound of {self.bound:g}, got {largest:.3g}")

    def slope_at(self, x: Floats, output: Floats) -> Floats:
        """The slope at ``x``, where the function has the value ``output``; unchecked."""
        return self.slope(x) if self.slope_of_output is None else self.slope_of_output(output)

    def bend(self, x: Floats) -> Floats:
        """Second derivative at ``x``, by differences of the slope; unchecked."""
        return (self.slope(x + _DIFFERENCE) - self.slope(x - _DIFFERENCE)) / (2.0 * _DIFFERENCE)


def _values(name: str, function: Callable[[Floats], Floats], x: Floats) -> Floats:
    """The result of a user's function for an array; `InputError` if that is no array of the same shape."""
    try:
        with np.errstate(all="ignore"):
            return as_floats(f"{name} of an array", function(x), x.shape)
    except InputError:
        raise
    except Exception as error:
        why = f"{type(error).__name__}: {error}"
        raise InputError(f"{name} must be a function of an array, which raised {why}") from None


#: Activation functions by name: ``tanh``, and others that are added, ``ACTIVATIONS["name"] = Activation(...)``.
ACTIVATIONS: dict[str, Activation] = {
    "tanh": Activation(np.tanh, lambda x: 1.0 / np.cosh(np.clip(x, -350.0, 350.0)) ** 2, lambda y: 1.0 - y * y),
    "arctan": Activation(
        lambda x: 2.0 / np.pi * np.arctan(0.5 * np.pi * x),
        lambda x: 1.0 / (1.0 + (0.5 * np.pi * x) ** 2),
        lambda y: np.cos(0.5 * np.pi * y) ** 2,
    ),
}

#: Name of the activation function that networks have unless another is given.
DEFAULT_ACTIVATION = "tanh"


def as_activation(name: str) -> str:
    """Return a name of `ACTIVATIONS`, or raise `InputError` that lists them."""
    return as_choice("activation", name, ACTIVATIONS)


class ComponentwiseNetwork(BlockNetwork):
    """A network whose activation acts on each coordinate alone, as in the paper.

    Attributes:
        activation: a name of `ACTIVATIONS`.
    """

    activation: str

    def try_certify(self) -> Self:
        """This network with a certificate if one is found; else the network itself."""
        try:
            return self.certify()
        except NotCertifiedError:
            return self

    def assess(self, start: ArrayLike | None = None) -> stability.Verdict:
        """All stability conditions with the rates they prove; the local one at the equilibrium found from ``start``."""
        result = self.equilibrium(start)
        known = self._of_weights
        if "verdict" not in known:
            known["verdict"] = stability.assess(self.weight, **self._proved_on)
        return known["verdict"].locally(self.jacobian(result.xi)) if result.success else known["verdict"]

    @property
    def _proved_on(self) -> dict[str, Any]:
        """What functions of `stability` take besides W."""
        core = None if self.certifiable_weight is self.weight else self.certifiable_weight
        proof = {"rotational_weight": core, "lyapunov_diagonal": self.lyapunov_diagonal}
        return {"gamma": self.gamma, "mu": self.mu, **proof}

    def robustness(self, pushed: ArrayLike | None = None) -> stability.Robustness:
        """Bounds on the effect of pushes and its duration, on the lag behind a moving target, and on time steps.

        Args:
            pushed: flat coordinates that pushes and targets move, those of all visible neurons by default.

        Raises:
            NotCertifiedError: the neurons that the pushes affect are not certified.
        """
        visible = np.arange(self.n_visible * self.bias.shape[1])
        moved = visible if pushed is None else flat_coordinates("pushed", pushed, self.bias.size)
        known, key = self._of_weights, f"robustness to {moved.tolist()}"
        if key not in known:
            known[key] = stability.robustness(self.weight, pushed=moved, **self._proved_on)
        return known[key]

    def to_c(self, folder: StrPath) -> Path:
        """Write the network as C99, for a controller: ``lieednn.h`` and ``lieednn.c``, without allocation.

        The header says what each function does; the numbers, ``lieednn_numbers.h``, begin with the certificate. A step
        is that of `policies` and of `dynamics.runge_kutta_step`, of order 4. The target can be moved as by `retarget`.

        Args:
            folder: where to write them, made if it is missing, and returned. Files of these names are replaced.

        Raises:
            InputError: the activation is the user's own, visible neurons act on hidden ones, or no equilibrium exists.
            FileError: the files cannot be written.
        """
        return write_c(self, self.activation, folder)

    def to_onnx(self, path: StrPath, *, bias_input: bool = False) -> None:
        """Write one Runge-Kutta step as a graph of ONNX, in double precision; needs the extra ``onnx``.

        Inputs are the flat state ``x`` and the step ``h`` in the network's time. The output is ``x_next``. The metadata
        has the certificate in words.

        Args:
            path: the file, which is replaced if it exists.
            bias_input: whether there is a third input ``bias``, mu b flat, to move the target as `retarget` does.

        Raises:
            InputError: the activation is not tanh.
            LieEDNNError: the library onnx is not installed.
            FileError: the file cannot be written.
        """
        write_onnx(self, self.activation, path, bias_input)

    def phi(self, x: Floats) -> Floats:
        """Activation, entry by entry, of an array of any shape; unchecked."""
        return ACTIVATIONS[self.activation].phi(x)

    def flat_vector_field(self, x: Floats) -> Floats:
        """Right-hand side in flat form, ``(..., dN)`` to the same shape; unchecked, for integrators."""
        weight, bias = self._scaled
        rate = bias - self.gamma * x
        # For a single state, `dot` is quicker.
        driven = weight.dot(self.phi(x)) if x.ndim == 1 else self.phi(x) @ weight.T
        if len(weight) == len(bias):
            rate += driven
        else:
            rate[..., : len(weight)] += driven
        return rate

    @cached_property
    def _scaled(self) -> tuple[Floats, Floats]:
        """Mu times `driven_weight`, and mu b, flat."""
        return self.mu * self.driven_weight, self.mu * self.bias.ravel()

    def _driven(self, state: Floats) -> Floats:
        slope = ACTIVATIONS[self.activation].slope(state).reshape(*state.shape[:-2], 1, -1)
        return self.driven_weight * slope


@frozen
class HopfieldNetwork(ComponentwiseNetwork):
    """A network with any weight matrix W, of N neurons with d coordinates (Hopfield, PNAS 81, 1984).

    It is x' = -gamma x + mu (W phi(x) + b), with fields as in `LieEDNN`, except that P ``(dN,)`` certifies W itself.
    """

    matrix: Floats
    bias: Floats
    gamma: float = 1.0
    mu: float = 1.0
    activation: str = DEFAULT_ACTIVATION
    lyapunov_diagonal: Floats | None = None

    _kind: ClassVar[str] = "hopfield-network"

    def __post_init__(self) -> None:
        shared = checked_fields(self, ("N", "d"))
        matrix = as_floats("matrix", self.matrix, (shared["bias"].size,) * 2)
        set_fields(self, matrix=matrix, **shared, activation=as_activation(self.activation))

    @cached_property
    def blocks(self) -> Floats:
        """W as blocks ``(N, N, d, d)``."""
        n, d = self.bias.shape
        return read_only(np.ascontiguousarray(self.matrix.reshape(n, d, n, d).transpose(0, 2, 1, 3)))
