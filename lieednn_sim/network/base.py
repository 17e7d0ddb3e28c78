"""Base class of all networks: x_i' = -gamma x_i + mu sum_j W_ij phi(x_j) + mu b_i with blocks W_ij of size d x d."""

from __future__ import annotations

import inspect
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import Field, fields, replace
from functools import cache, cached_property
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim import io, stability
from lieednn_sim.errors import FileError, InputError, LieEDNNError, NotCertifiedError
from lieednn_sim.network.dynamics import INTEGRATORS, Equilibrium, Trajectory, find_equilibrium, integrate
from lieednn_sim.validation import as_choice, as_floats, as_positive, as_ratio
from lieednn_sim.values import Floats, StrPath, read_only


class BlockNetwork(ABC):
    """N neurons of d coordinates each, coupled by d x d blocks; subclasses are frozen dataclasses.

    The state has shape ``(..., N, d)``; the flat state is its C-order ravel. The last M neurons are hidden: only the
    visible ones, which come first, are decoded. In most networks M = 0.

    Attributes:
        bias: ``(N, d)``.
        gamma, mu: decay rate and scale of the interaction, positive.
        lyapunov_diagonal: a diagonal P that certifies `certifiable_weight`, or None. Checked by `certificate`.
        hidden_start, n_clock, start_gain, start_reference, goal_gain: as in `LieEDNN`, with d in place of 6.
    """

    bias: Floats
    gamma: float
    mu: float
    hidden_start: Floats = np.empty((0, 0))
    n_clock: int = 0
    start_gain: Floats | None = None
    start_reference: Floats | None = None
    goal_gain: Floats | None = None
    lyapunov_diagonal: Floats | None

    _kind: ClassVar[str]  # the kind of file that `save` writes
    _rows_alike: ClassVar[int] = 1  # rows of the certified matrix that share an entry of the stored diagonal
    # Cached values independent of the visible neurons' bias, which `retarget` hands over.
    _bias_free: ClassVar[list[str]] = ["blocks", "weight", "certificate", "n_driven", "driven_weight", "_undriven_rest"]

    def __repr__(self) -> str:
        n, d = self.bias.shape
        parts = f" ({self.n_visible} visible, {self.n_hidden - self.n_clock} hidden, {self.n_clock} of the clock)"
        start = "" if self.start_gain is None else ", started by the visible ones"
        neurons = f"{n} neurons{parts if self.n_hidden else ''} of {d} coordinates{start}"
        proof = "certified" if self.certified else "not certified"
        return f"<{type(self).__name__}: {neurons}, gamma {self.gamma:g}, mu {self.mu:g}, {proof}>"

    @property
    def n_neurons(self) -> int:
        """Number of neurons N."""
        return len(self.bias)

    @property
    def n_hidden(self) -> int:
        """Number of hidden neurons M, including the clock."""
        return len(self.hidden_start)

    @property
    def n_visible(self) -> int:
        """Number of visible neurons N - M."""
        return self.n_neurons - self.n_hidden

    def visible(self, xi: ArrayLike) -> Floats:
        """The states ``(..., N - M, d)`` of the visible neurons among the states ``(..., N, d)`` of all."""
        return as_floats("xi", xi, self.bias.shape, batched=True)[..., : self.n_visible, :]

    def start(self, xi: ArrayLike) -> Floats:
        """The state ``(N, d)`` at time 0 with the visible neurons at ``xi`` ``(N - M, d)``.

        The hidden neurons start at h(0) = `hidden_start` + K (xi - `start_reference`), affine in the visible start; K
        is the `start_gain`. A certificate is a statement on the weights that holds for every state of all neurons at
        time 0: hidden starts decide the path to the equilibrium, but can neither move it nor touch the proof.
        """
        visible = as_floats("xi", xi, (self.n_visible, self.bias.shape[1]))
        if not self.n_hidden:
            return visible.copy()
        hidden = self.hidden_start
        if self.start_gain is not None and self.start_reference is not None:
            hidden = hidden + (self.start_gain @ (visible - self.start_reference).ravel()).reshape(hidden.shape)
        return np.concatenate([visible, hidden])

    def goal(self, xi: ArrayLike) -> Floats:
        """The state ``(N, d)`` with the visible neurons at ``xi`` ``(N - M, d)`` and the hidden ones at rest there.

        If no hidden neuron has input from a visible one, the hidden ones rest at the same state for every ``xi``.
        `InputError` if they have no equilibrium while the visible ones are there.
        """
        state = self.start(xi)
        if self.n_hidden:
            first = self.n_visible
            driven = self.n_driven > first and self.coupled[first:, :first].any()
            state[first:] = self._rest(state) if driven else self._undriven_rest
        return state

    @cached_property
    def _undriven_rest(self) -> Floats:
        """Equilibrium ``(M, d)`` of hidden neurons without inputs from visible ones."""
        if self.n_driven <= self.n_visible:
            return read_only(self.mu / self.gamma * self.bias[self.n_visible :])
        return read_only(self._rest(self.start(np.zeros((self.n_visible, self.bias.shape[1])))))

    def _rest(self, state: Floats) -> Floats:
        """Equilibrium ``(M, d)`` of the hidden neurons while the visible ones stay as in ``state`` ``(N, d)``."""
        first, hidden = self.n_visible, state[self.n_visible :]
        still, size = state[:first].ravel(), first * self.bias.shape[1]

        def field(x: Floats) -> Floats:
            return self.flat_vector_field(np.concatenate([still, x]))[size:]

        def jacobian(x: Floats) -> Floats:
            return self.jacobian(np.concatenate([still, x]).reshape(self.bias.shape))[size:, size:]

        equilibrium = find_equilibrium(field, jacobian, hidden, rate=self.gamma)
        if not equilibrium.success:
            raise InputError(
                f"the hidden neurons do not come to rest while the visible ones are at xi ({equilibrium.message}); "
                "use a certified network"
            )
        return equilibrium.xi

    @property
    @abstractmethod
    def blocks(self) -> Floats:
        """Weight blocks W_ij ``(N, N, d, d)`` from neuron j to neuron i."""

    @cached_property
    def weight(self) -> Floats:
        """Flat weight matrix W, ``(dN, dN)``."""
        return read_only(as_floats("weight", flatten_blocks(self.blocks), ("n", "n")))

    @property
    def coupled(self) -> NDArray[np.bool_]:
        """Whether neuron i has an input from neuron j, ``(N, N)``."""
        return np.asarray(self.blocks.any(axis=(2, 3)))

    @cached_property
    def n_driven(self) -> int:
        """Number of leading neurons after which none has an input, at least 1: the visible ones of many cascades."""
        return int(np.flatnonzero(self.coupled.any(axis=1)).max(initial=0)) + 1

    @cached_property
    def driven_weight(self) -> Floats:
        """The rows of W of the `n_driven` leading neurons, ``(d n_driven, dN)``; the other rows are zero."""
        return self.weight[: self.bias.shape[1] * self.n_driven]

    def interaction(self, output: Floats) -> Floats:
        """W times flat outputs ``(..., dN)``, without its rows of zeros; unchecked."""
        driven = output @ self.driven_weight.T
        if driven.shape == output.shape:
            return driven
        whole = np.zeros_like(output)
        whole[..., : driven.shape[-1]] = driven
        return whole

    @property
    def certifiable_weight(self) -> Floats:
        """The matrix that decides stability: W, or a part of it where that is enough."""
        return self.weight

    @cached_property
    def _of_weights(self) -> dict[str, Any]:
        """Cache of what takes long to compute from the weights alone, for all networks that share them."""
        return {}

    @cached_property
    def certificate(self) -> stability.Certificate | None:
        """The stored Lyapunov diagonal, checked against this network's weights; None when there is none."""
        if self.lyapunov_diagonal is None:
            return None
        diagonal = np.repeat(self.lyapunov_diagonal, self._rows_alike)
        return stability.verify(diagonal, self.certifiable_weight, gamma=self.gamma, mu=self.mu)

    def certify(self) -> Self:
        """This network with a certificate; `NotCertifiedError` if none was found: the network may be unstable."""
        every = self._rows_alike
        result = stability.find_certificate(self.certifiable_weight, gamma=self.gamma, mu=self.mu, group_size=every)
        if not result.valid:
            raise NotCertifiedError(f"no certificate was found for the weights ({result}); scale alpha or mu down")
        # mypy cannot know that every subclass is a dataclass, here and below.
        return replace(self, lyapunov_diagonal=result.lyapunov_diagonal[::every])  # type: ignore[type-var]

    @property
    def certified(self) -> bool:
        """Whether global stability is proved."""
        return self.certificate is not None and self.certificate.valid

    @abstractmethod
    def phi(self, x: Floats) -> Floats:
        """Activation of states ``(..., N, d)``, unchecked."""

    @abstractmethod
    def _driven(self, state: Floats) -> Floats:
        """Jacobian of `driven_weight` phi, ``(..., N, d)`` to ``(..., d n_driven, dN)``."""

    def vector_field(self, xi: ArrayLike) -> Floats:
        """Right-hand side in block form, ``(..., N, d)`` to the same shape."""
        state = as_floats("xi", xi, self.bias.shape, batched=True)
        output = self.phi(state).reshape(*state.shape[:-2], -1)
        return -self.gamma * state + self.mu * (self.interaction(output).reshape(state.shape) + self.bias)

    def flat_vector_field(self, x: Floats) -> Floats:
        """Right-hand side in flat form, ``(dN,)`` to ``(dN,)``; unchecked, for integrators."""
        output = self.phi(x.reshape(self.bias.shape)).ravel()
        return -self.gamma * x + self.mu * (self.interaction(output) + self.bias.ravel())

    def jacobian(self, xi: ArrayLike) -> Floats:
        """Jacobian of the flat vector field, ``(..., N, d)`` to ``(..., dN, dN)``."""
        state = as_floats("xi", xi, self.bias.shape, batched=True)
        driven = self._driven(state)
        every = np.arange(driven.shape[-1])
        whole = np.zeros((*driven.shape[:-2], len(every), len(every)))
        whole[..., : driven.shape[-2], :] = self.mu * driven
        whole[..., every, every] -= self.gamma
        return whole

    def equilibrium(self, start: ArrayLike | None = None) -> Equilibrium:
        """Find an equilibrium by damped Newton steps, with the flow as fallback; see `dynamics.find_equilibrium`.

        A certified network has exactly one equilibrium. The search begins at ``start`` ``(N, d)``, by default at zero.
        """
        shape, driven = self.bias.shape, self.n_driven
        first = np.zeros(shape) if start is None else as_floats("start", start, shape)
        # Neurons without inputs rest where their bias says, whatever the others do.
        rest, size = self.mu / self.gamma * self.bias[driven:].ravel(), driven * shape[1]

        def whole(x: Floats) -> Floats:
            return np.concatenate([x, rest])

        result = find_equilibrium(
            lambda x: self.flat_vector_field(whole(x))[:size],
            lambda x: self.mu * self._driven(whole(x).reshape(shape))[:, :size] - self.gamma * np.eye(size),
            first[:driven],
            rate=self.gamma,
        )
        if driven == len(first):
            return result
        abscissa = max(result.spectral_abscissa, -self.gamma)
        return replace(result, xi=whole(result.xi.ravel()).reshape(shape), spectral_abscissa=abscissa)

    def trajectory(
        self,
        start: ArrayLike,
        duration: float,
        *,
        until: ArrayLike | None = None,
        distance: float = 1e-8,
        method: str = "RK45",
        rtol: float = 1e-8,
        atol: float = 1e-10,
    ) -> Trajectory:
        """Integrate the network from ``start``.

        Args:
            start: ``(N, d)`` state at time 0, see `start`.
            duration: longest time to integrate, in the network's own time.
            until: ``(N, d)`` state to stop at, usually the equilibrium.
            distance: stop when the largest coordinate of xi - until is below this; for hidden neurons, of their
                outputs' difference phi(xi) - phi(until).
            method: a name of `dynamics.INTEGRATORS`.
            rtol, atol: relative and absolute tolerance of the integrator.

        Raises:
            InputError: a value is malformed, or there is no such method.
            LieEDNNError: the integrator failed or needed too many evaluations, as for a stiff network.
            OutOfTimeError: the time budget is spent.
        """
        as_choice("method", method, INTEGRATORS)
        for name, value in (("rtol", rtol), ("atol", atol), ("distance", distance)):
            as_positive(name, value)
        shape, longest = self.bias.shape, as_positive("duration", duration)
        first = as_floats("start", start, shape).ravel()
        away: Callable[[Floats], float] | None = None  # distance of a flat state from the end, less the one asked for
        if until is not None:
            goal = self._seen(as_floats("until", until, shape).ravel())

            def away(x: Floats) -> float:
                return float(np.abs(self._seen(x) - goal).max()) - distance

            if away(first) <= 0.0:
                # Integration ends at a crossing; a start that is inside already has none, and nothing is integrated.
                away, longest = None, 1e-9 * longest
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # an overflow ends the integration, or is noticed below
            try:
                solver = INTEGRATORS[method](
                    lambda _, x: self.flat_vector_field(x), 0.0, first, longest, rtol=rtol, atol=atol
                )
                t, x, dense = integrate(solver, away)
            except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
                raise LieEDNNError(f"integration of the network failed: {error}") from None
        if not (np.isfinite(x).all() and np.isfinite(t).all()):
            raise LieEDNNError("integration of the network failed: the state left the range of double precision")
        return Trajectory(t=t, xi=x.reshape(-1, *shape), _dense=dense)

    def smallest_one_norm(self, xi: ArrayLike) -> float:
        """The smallest 1-norm of any W with which ``xi`` ``(N, d)`` is an equilibrium; above gamma/mu nearly always."""
        target = as_floats("xi", xi, self.bias.shape)
        return stability.smallest_one_norm(self.phi(target), self.gamma / self.mu * target - self.bias)

    def _seen(self, x: Floats) -> Floats:
        """Visible neurons' states and hidden ones' outputs of a flat state, flat."""
        if self.n_hidden == 0:
            return x
        state = x.reshape(self.bias.shape)
        return np.concatenate([state[: self.n_visible].ravel(), self.phi(state[self.n_visible :]).ravel()])

    def retarget(self, xi: ArrayLike) -> Self:
        """The same weights with the bias that makes ``xi`` ``(N - M, d)`` the equilibrium of the visible neurons.

        The visible neurons' bias becomes b = (gamma/mu) x - W phi(x) with x the `goal`; the hidden ones keep theirs.
        The certificate does not depend on the bias: a certified network stays certified. The `start_reference` moves
        with the equilibrium, so that hidden starts depend on the visible one as seen from the target: a cascade
        retargeted by d and started from xi + d repeats its motion from xi, shifted by d. With a `goal_gain` L the
        `hidden_start` moves by L d, so that the motion may differ from target to target.

        Raises:
            InputError: the hidden neurons have no equilibrium while the visible ones are at ``xi``; or there is a gain,
                but no equilibrium from which its reference could move.
        """
        target = self.goal(xi)
        bias = self.gamma / self.mu * target - self.interaction(self.phi(target).ravel()).reshape(target.shape)
        if self.n_hidden:
            bias[self.n_visible :] = self.bias[self.n_visible :]
        # Weights and proof are the same: hand over what was checked and computed for them, and nothing else.
        network, known = object.__new__(type(self)), vars(self)
        values = {name: known[name] for name in self._kept() if name in known}
        values |= {"_of_weights": self._of_weights, "bias": read_only(as_floats("bias", bias, bias.shape))}
        if self.start_reference is not None:
            reached = target[: self.n_visible]
            moved = reached - self._visible_target
            values["start_reference"] = read_only(self.start_reference + moved)
            if self.goal_gain is not None:
                shift = (self.goal_gain @ moved.ravel()).reshape(self.hidden_start.shape)
                values["hidden_start"] = read_only(self.hidden_start + shift)
            values["_visible_target"] = read_only(reached)
        vars(network).update(values)
        return network

    @cached_property
    def _visible_target(self) -> Floats:
        """The visible neurons' equilibrium ``(N - M, d)``."""
        result = self.equilibrium()
        if not result.success:
            raise InputError(f"hidden starts move with the equilibrium, which was not found ({result.message})")
        return result.xi[: self.n_visible]

    @classmethod
    @cache
    def _kept(cls) -> tuple[str, ...]:
        """Names of the fields, and of cached values independent of the bias."""
        return (*(field.name for field in fields(cls)), *cls._bias_free)  # type: ignore[arg-type]

    def save(self, path: StrPath) -> None:
        """Write the network to an ``.npz`` file, atomically."""
        arrays = {field.name: getattr(self, field.name) for field in self._stored("Floats", "NDArray")}
        given = {name: values for name, values in arrays.items() if values is not None}
        io.save_arrays(path, self._kind, given, self._meta())

    @classmethod
    def load(cls, path: StrPath) -> Self:
        """Read a network; `FileError` if there is none, or its certificate, verified from the weights, fails."""
        if inspect.isabstract(cls):
            raise InputError(f"a {cls.__name__} is read by its own class, such as LieEDNN.load")
        arrays, meta = io.load_arrays(path, cls._kind)
        kept = cls._stored("Floats", "NDArray")
        names = [field.name for field in kept if field.name in arrays or not field.type.endswith("None")]
        values = dict(zip(names, io.take(arrays, path, *names), strict=True))
        try:
            network = cls(**values, **cls._from_meta(meta))
            certificate = network.certificate
        except (KeyError, InputError) as error:
            raise FileError(f"{path} is not a valid network: {error}") from None
        if certificate is not None and not certificate.valid:
            raise FileError(f"{path} carries a certificate that does not hold for its weights ({certificate})")
        return network

    @classmethod
    def _stored(cls, *types: str) -> list[Field[Any]]:
        """The fields whose annotation begins with one of some types."""
        return [field for field in fields(cls) if str(field.type).startswith(types)]  # type: ignore[arg-type]

    def _meta(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in self._stored("float", "int", "str")}

    @classmethod
    def _from_meta(cls, meta: Mapping[str, Any]) -> dict[str, Any]:
        """Arguments of the constructor from metadata; raises KeyError or InputError if some are missing."""
        return {field.name: meta[field.name] for field in cls._stored("float", "int", "str")}


def as_rates(gamma: float, mu: float) -> dict[str, float]:
    """Return gamma and mu checked, by name."""
    as_ratio(gamma, mu)
    return {"gamma": as_positive("gamma", gamma), "mu": as_positive("mu", mu)}


def checked_fields(network: BlockNetwork, shape: tuple[int | str, ...], rows: int | None = None) -> dict[str, Any]:
    """Return a new network's bias of a shape, rates and Lyapunov diagonal of some rows checked, by name."""
    bias, diagonal = as_floats("bias", network.bias, shape), network.lyapunov_diagonal
    if diagonal is not None:
        diagonal = as_floats("lyapunov_diagonal", diagonal, (bias.size if rows is None else rows,))
    return {"bias": bias, **as_rates(network.gamma, network.mu), "lyapunov_diagonal": diagonal}


def flatten_blocks(blocks: Floats) -> Floats:
    """Blocks ``(M, N, d, d)`` as one read-only matrix ``(Md, Nd)``."""
    m, n, size = blocks.shape[:3]
    return read_only(np.ascontiguousarray(blocks.transpose(0, 2, 1, 3).reshape(m * size, n * size)))
