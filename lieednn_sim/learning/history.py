"""What happened during a training, epoch by epoch."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from lieednn_sim import storage
from lieednn_sim.errors import InputError
from lieednn_sim.validation import as_floats

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class History:
    """One row for the weights at the beginning of each epoch; K rows.

    Attributes:
        epoch: ``(K,)`` epochs done before the row; trials taken back leave gaps.
        error: ``(K,)`` E = ||xi* - xi_d||_2, the printed loss.
        accuracy: ``(K,)`` fraction of coordinates within the tolerance of the target.
        rate: ``(K,)`` learning rate of the epoch.
        one_norm: ``(K,)`` ||W||_1.
        infinity_norm: ``(K,)`` ||W||_inf.
        equilibrium: ``(K, N, d)`` xi*.
    """

    epoch: Floats
    error: Floats
    accuracy: Floats
    rate: Floats
    one_norm: Floats
    infinity_norm: Floats
    equilibrium: Floats

    def __len__(self) -> int:
        return len(self.error)

    def arrays(self) -> dict[str, Floats]:
        """The columns by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an ``.npz`` file, atomically."""
        storage.save_arrays(path, "training-history", self.arrays(), {})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> History:
        """Read a file of `save`; `FileError` says what is wrong with it."""
        arrays, _ = storage.load_arrays(path, "training-history")
        names = [field.name for field in fields(cls)]
        return cls(*storage.take(arrays, path, *names))


class Recorder:
    """Collects the rows of a `History`; may be cut back to an earlier length."""

    def __init__(self, neurons: int, dimension: int) -> None:
        self._shape = (neurons, dimension)
        self._scalars: list[tuple[float, ...]] = []
        self._equilibria: list[Floats] = []

    def __len__(self) -> int:
        return len(self._scalars)

    def add(self, epoch: int, x: Floats, goal: Floats, tolerance: float, rate: float, weight: Floats) -> None:
        """Append a row for flat weights with the flat equilibrium ``x``, which is kept, not copied."""
        size, delta = np.abs(weight), x - goal
        accuracy = np.count_nonzero(np.abs(delta) < tolerance) / delta.size
        error = float(np.sqrt(delta @ delta))
        self._scalars.append((epoch, error, accuracy, rate, float(size.sum(0).max()), float(size.sum(1).max())))
        self._equilibria.append(x)

    def cut(self, length: int) -> None:
        """Forget all rows from ``length`` on."""
        del self._scalars[length:], self._equilibria[length:]

    def history(self) -> History:
        """The rows so far, as arrays."""
        scalars = np.array(self._scalars, dtype=np.float64).reshape(-1, 6)
        equilibria = np.array(self._equilibria, dtype=np.float64).reshape(-1, *self._shape)
        epoch, error, accuracy, rate, one_norm, infinity_norm = (column.copy() for column in scalars.T)
        return History(epoch, error, accuracy, rate, one_norm, infinity_norm, equilibria)

    def arrays(self) -> dict[str, Floats]:
        """The rows as named arrays, for a checkpoint."""
        return self.history().arrays()

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Floats]) -> Recorder:
        """Inverse of `arrays`."""
        names = [field.name for field in fields(History)]
        columns = {name: as_floats(name, arrays[name], ("K",)) for name in names[:-1]}
        equilibrium = as_floats("equilibrium", arrays["equilibrium"], ("K", "N", "d"))
        if {len(column) for column in columns.values()} != {len(equilibrium)}:
            raise InputError("the columns of the history differ in length")
        history = History(**columns, equilibrium=equilibrium)
        recorder = cls(*history.equilibrium.shape[1:])
        recorder._scalars = list(zip(*(column.tolist() for column in columns.values()), strict=True))
        recorder._equilibria = [row.ravel() for row in history.equilibrium]
        return recorder
