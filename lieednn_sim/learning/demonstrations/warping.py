"""Dynamic time warping of two paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats
from lieednn_sim.values import frozen


@frozen
class Warp:
    """A match of the samples of two paths.

    Attributes:
        total: dynamic-time-warping distance: the least sum of distances over all alignments, each step of which
            advances in one path or both (Sakoe and Chiba, IEEE T-ASSP 26(1), 1978); not normalised.
        frechet: discrete Frechet distance: the least maximal distance over these alignments (Eiter and Mannila, 1994).
        pairs: ``(L, 2)`` indices of the samples matched by the alignment of least sum.
    """

    total: float
    frechet: float
    pairs: NDArray[np.intp]


def warp(path: ArrayLike, other: ArrayLike) -> Warp:
    """Match samples ``(K, D)`` and ``(L, D)`` of two paths.

    Raises:
        InputError: a path has no samples, or their dimensions differ.
    """
    first, second = (as_floats(name, samples, ("K", "D")) for name, samples in (("path", path), ("other", other)))
    n, m, backwards = len(first), len(second), second[::-1]
    if not n or not m or first.shape[1] != second.shape[1]:
        raise InputError(f"paths must have samples of the same size, got {first.shape} and {second.shape}")
    # Antidiagonals (i, k - i) in turn, each of which depends on the two before it alone. At index i + 1, the first row
    # holds the least sums, the second the least maximal distances.
    older, last = np.full((2, 2, n + 1), np.inf)
    older[:, 0] = 0.0
    came = np.zeros((n + m - 1, n), dtype=np.int8)
    for k in range(n + m - 1):
        low, high = max(0, k - m + 1), min(n - 1, k) + 1
        gap = first[low:high] - backwards[low + m - 1 - k : high + m - 1 - k]
        apart = np.sqrt(np.einsum("ij,ij->i", gap, gap))
        before = np.stack([older[:, low:high], last[:, low:high], last[:, low + 1 : high + 1]])
        came[k, low:high] = np.argmin(before[:, 0], axis=0)
        sums, largest = before.min(axis=0)
        older, last = last, np.full((2, n + 1), np.inf)
        last[0, low + 1 : high + 1] = apart + sums
        last[1, low + 1 : high + 1] = np.maximum(apart, largest)
    i, j = n - 1, m - 1
    pairs = [(i, j)]
    while i or j:
        step = came[i + j, i]
        i, j = i - (step != 2), j - (step != 1)
        pairs.append((i, j))
    return Warp(float(last[0, n]), float(last[1, n]), np.array(pairs[::-1]))
