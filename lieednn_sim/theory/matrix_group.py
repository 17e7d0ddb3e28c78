"""Matrix Lie groups by a basis of their Lie algebra: exponential, adjoint representation, projection onto its image."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from lieednn_sim.errors import InputError
from lieednn_sim.lie.projection import descend
from lieednn_sim.validation import MOST_ENTRIES, as_finite, as_floats, as_generator, as_positive, quoted
from lieednn_sim.values import Floats, set_fields

Booleans = NDArray[np.bool_]
Matrices = NDArray[Any]  # real or complex group elements and algebra matrices

# How far, relative to 1 + its norm, a matrix may lie outside the algebra and still be read as rounding in it.
_TOLERANCE = 1e-8


@dataclass(frozen=True, eq=False)
class MatrixLieGroup:
    """A connected matrix Lie group G, given by a basis of its Lie algebra (paper, appendix D).

    The basis consists of the matrices E_1 to E_d. Every method takes leading batch axes. The product is ``@``, the
    inverse `numpy.linalg.inv`. Coordinates x stand for hat(x) = sum_k x_k E_k; they are real also where the matrices
    are complex. L[Ad_g] is the real ``(d, d)`` matrix with g hat(x) g^-1 = hat(L[Ad_g] x).

    Attributes:
        name: name in messages.
        basis: ``(d, m, m)``, real or complex, linearly independent over the reals and closed under the commutator.
        projection: closed form of `project_to_adjoint`, ``(..., d, d)`` to ``(..., m, m)``; None to search.
        membership: closed form of `contains`, ``(..., m, m)`` and a tolerance to booleans; None without one.

    Raises:
        InputError: the basis has another shape, is dependent, or spans no Lie algebra.
    """

    name: str
    basis: Matrices = field(repr=False)
    projection: Callable[[Floats], Matrices] | None = field(default=None, repr=False)
    membership: Callable[[Matrices, float], Booleans] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        basis = as_numbers("basis", self.basis, ("d", "m", "m"))
        if 0 in basis.shape:
            raise InputError(f"the basis of {self.name} must not be empty, got shape {basis.shape}")
        set_fields(self, basis=basis)
        singular = np.linalg.svd(_real_parts(basis), compute_uv=False)
        if self.dimension > _real_parts(basis).shape[1] or singular[-1] <= 1e-9 * singular[0]:
            raise InputError(f"the basis of {self.name} must be linearly independent over the real numbers")
        commutators = self._basis_commutators()
        outside = np.linalg.norm(commutators - self.hat(self._coordinates(commutators)), axis=(-2, -1))
        worst = np.unravel_index(np.argmax(outside), outside.shape)
        if outside[worst] > _TOLERANCE * (1.0 + np.linalg.norm(commutators[worst])):
            pair = " and ".join(f"E_{k + 1}" for k in worst)
            raise InputError(f"the basis of {self.name} spans no Lie algebra: the commutator of {pair} lies outside")

    @property
    def dimension(self) -> int:
        """Number d of coordinates."""
        return len(self.basis)

    @property
    def size(self) -> int:
        """Number m of rows of the matrices."""
        return self.basis.shape[1]

    @cached_property
    def structure_constants(self) -> Floats:
        """``(d, d, d)``: [E_i, E_j] = sum_k c[i, j, k] E_k."""
        return self._coordinates(self._basis_commutators())

    def hat(self, x: ArrayLike) -> Matrices:
        """Algebra matrices ``(..., m, m)`` of coordinates ``(..., d)``."""
        coordinates = as_floats("x", x, (self.dimension,), batched=True)
        return np.tensordot(coordinates, self.basis, axes=1)

    def vee(self, matrix: ArrayLike) -> Floats:
        """Inverse of `hat`, ``(..., m, m)`` to ``(..., d)``; `InputError` if it is off by 1e-8 of 1 + its norm."""
        array = self._matrices("matrix", matrix)
        coordinates = self._coordinates(array)
        outside = self._outside(array, coordinates)
        if (outside > 1.0).any():
            off = outside.max() * _TOLERANCE
            raise InputError(f"matrix must lie in the Lie algebra of {self.name}, got one off by {off:.1e}")
        return coordinates

    def exp(self, x: ArrayLike) -> Matrices:
        """Group elements ``(..., m, m)`` of coordinates ``(..., d)``, exponentials; `InputError` on overflow."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # overflow is reported by `as_finite`
            return as_finite(f"the exponential in {self.name}", expm(self.hat(x)))

    def adjoint(self, g: ArrayLike) -> Floats:
        """Matrices L[Ad_g], ``(..., d, d)``, of g ``(..., m, m)``: column k holds the coordinates of g E_k g^-1.

        Raises:
            InputError: g is singular or out of range, or g E_k g^-1 leaves the Lie algebra, so g is not in the group.
        """
        array = self._matrices("g", g)
        with np.errstate(all="ignore"):  # overflow is reported by `as_finite`, and below
            try:
                moved = self._conjugated(array)
            except np.linalg.LinAlgError:
                raise InputError(f"g must be in {self.name}, got a singular matrix") from None
            columns = as_finite(f"the adjoint matrix in {self.name}", self._coordinates(moved))
            size, outside = np.linalg.norm(moved), self._outside(moved, columns)
        if not np.isfinite(size):
            raise InputError(f"g is too large, or too nearly singular, for its adjoint matrix in {self.name}")
        if not (outside <= 1.0).all():
            raise InputError(f"g must be in {self.name}: g E_k g^-1 leaves its Lie algebra")
        return np.swapaxes(columns, -1, -2)

    def ad(self, x: ArrayLike) -> Floats:
        """Matrices ``(..., d, d)`` with hat(ad(x) y) = [hat(x), hat(y)]; `adjoint` of exp(x) is their exponential."""
        coordinates = as_floats("x", x, (self.dimension,), batched=True)
        return np.swapaxes(np.tensordot(coordinates, self.structure_constants, axes=1), -1, -2)

    def contains(self, g: ArrayLike, tolerance: float = 1e-9) -> Booleans:
        """Whether g ``(..., m, m)`` are in the group, up to about ``tolerance`` in each entry.

        Without a closed form only a necessary condition is checked, up to 1e-8: that g E_k g^-1 is in the algebra.
        """
        array, tolerance = self._matrices("g", g), as_positive("tolerance", tolerance)
        with np.errstate(all="ignore"):  # overflow and division by zero compare as outside
            if self.membership is not None:
                return self.membership(array, tolerance)
            regular = np.asarray(np.linalg.matrix_rank(array) == self.size)
            moved = self._conjugated(np.where(regular[..., None, None], array, np.eye(self.size)))
            return regular & (self._outside(moved, self._coordinates(moved)) <= 1.0).all(axis=-1)

    def random(self, rng: int | np.random.Generator, shape: tuple[int, ...] = (), scale: float = 1.0) -> Matrices:
        """Elements ``(*shape, m, m)``: exponentials of normal coordinates of standard deviation ``scale``."""
        generator, scale = as_generator("rng", rng), as_positive("scale", scale)
        if len(shape) > 32 or min(shape, default=0) < 0 or math.prod(map(int, shape)) * self.size**2 > MOST_ENTRIES:
            raise InputError(f"shape must have at most 32 axes and {MOST_ENTRIES} numbers in all, got {quoted(shape)}")
        return self.exp(scale * generator.normal(size=(*shape, self.dimension)))

    def project_to_adjoint(self, theta: ArrayLike, start: ArrayLike | None = None) -> Matrices:
        """Elements g ``(..., m, m)`` whose adjoint matrix is Frobenius-nearest to theta ``(..., d, d)``.

        g is unique only up to the kernel. Without a closed form a damped Newton search on the group, with
        Ad(g exp(x)) = Ad(g) exp(ad x), runs from the identity and a few random elements (always the same ones) and
        returns the best result: a local minimum, not always the global one. In a group that is not compact, theta far
        from the image of Ad may have no nearest element; the search then stops on its way to infinity.

        Args:
            theta: matrices to project.
            start: elements ``(..., m, m)`` known to be near: the search runs from these alone, which is much faster.
        """
        array = as_floats("theta", theta, (self.dimension, self.dimension), batched=True)
        if self.projection is not None:
            return self.projection(array)
        if start is None:
            everywhere = np.concatenate([np.eye(self.size)[None], self.random(0, (5,))])
            return self._search(array, np.broadcast_to(everywhere, (*array.shape[:-2], *everywhere.shape)))
        near = self._matrices("start", start)
        if near.shape[:-2] != array.shape[:-2]:
            raise InputError(f"start must have the leading axes of theta {array.shape[:-2]}, got {near.shape[:-2]}")
        return self._search(array, near[..., None, :, :])

    def _search(self, theta: Floats, starts: Matrices) -> Matrices:
        """Best of the searches from ``starts`` ``(..., S, m, m)``."""
        d, m, count = self.dimension, self.size, starts.shape[-3]
        flat = theta.reshape(-1, d, d)
        generators = self.ad(np.eye(d))

        def evaluate(g: Matrices, index: NDArray[np.intp]) -> tuple[Floats, Floats, Floats]:
            adjoint = np.swapaxes(self._coordinates(self._conjugated(g)), -1, -2)
            residual = adjoint - flat[index // count]
            # First order in x: Ad ad(e_i). Second order: Ad (ad(e_i) ad(e_j) + ad(e_j) ad(e_i)) / 2.
            first = (adjoint[:, None] @ generators).reshape(-1, d, d * d)
            pulled = np.swapaxes(adjoint, -1, -2) @ residual
            second = (np.swapaxes(generators, -1, -2) @ pulled[:, None]).reshape(-1, d, d * d)
            curvature = second @ generators.reshape(d, -1).T
            hessian = first @ np.swapaxes(first, -1, -2) + 0.5 * (curvature + np.swapaxes(curvature, -1, -2))
            gradient = (first @ residual.reshape(-1, d * d, 1))[..., 0]
            return 0.5 * (residual**2).sum(axis=(-2, -1)), gradient, hessian

        points, values = descend(starts.reshape(-1, m, m), evaluate, lambda g, x: g @ self.exp(x))
        best = values.reshape(len(flat), count).argmin(axis=1)
        nearest = points.reshape(len(flat), count, m, m)[np.arange(len(flat)), best]
        return nearest.reshape(*theta.shape[:-2], m, m)

    def _conjugated(self, g: Matrices) -> Matrices:
        """The matrices g E_k g^-1, ``(..., d, m, m)``."""
        return g[..., None, :, :] @ self.basis @ np.linalg.inv(g)[..., None, :, :]

    @cached_property
    def _pseudo_inverse(self) -> Floats:
        return np.asarray(np.linalg.pinv(_real_parts(self.basis)), np.float64)

    def _coordinates(self, matrix: Matrices) -> Floats:
        return _real_parts(matrix) @ self._pseudo_inverse

    def _outside(self, matrix: Matrices, coordinates: Floats) -> Floats:
        """Distance from the algebra in units of the tolerance."""
        rest = matrix - np.tensordot(coordinates, self.basis, axes=1)
        size, off = (np.linalg.norm(array, axis=(-2, -1)) for array in (matrix, rest))
        return np.asarray(off, np.float64) / (_TOLERANCE * (1.0 + size))

    def _basis_commutators(self) -> Matrices:
        products = self.basis[:, None] @ self.basis
        return products - np.swapaxes(products, 0, 1)

    def _matrices(self, name: str, value: ArrayLike) -> Matrices:
        if np.iscomplexobj(self.basis):
            return as_numbers(name, value, (self.size, self.size), batched=True).astype(np.complex128)
        return as_floats(name, value, (self.size, self.size), batched=True)


def as_numbers(name: str, value: ArrayLike, shape: tuple[int | str, ...], *, batched: bool = False) -> Matrices:
    """A checked copy, complex where ``value`` is."""
    try:
        array = np.empty(0) if isinstance(value, range) else np.asarray(value)  # a long range would fill the memory
        is_complex = np.iscomplexobj(array)
    except (TypeError, ValueError):
        is_complex = False
    if not is_complex:
        # `as_floats` also reports values that are no arrays of numbers.
        return as_floats(name, value, shape, batched=batched).copy()
    real, imaginary = (as_floats(name, part, shape, batched=batched) for part in (array.real, array.imag))
    return real + 1j * imaginary


def _real_parts(matrix: Matrices) -> Floats:
    """Matrices ``(..., m, m)`` as real vectors: first the real parts, then the imaginary parts."""
    flat = matrix.reshape(*matrix.shape[:-2], -1)
    return np.concatenate([flat.real, flat.imag], axis=-1) if np.iscomplexobj(flat) else flat
