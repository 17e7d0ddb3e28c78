"""What others add by name, planners and controllers: by a decorator, or by the entry points of an installed package."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from lieednn_sim.errors import InputError
from lieednn_sim.validation import quoted

T = TypeVar("T")
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


class Registry(Generic[T]):
    """Everything of one kind by name.

    Args:
        kind: what one is called; packages name theirs in the entry points ``lieednn_sim.<kind>s``.
        known: the package's own, to which others are added.
        make: what is kept of an object of others, and of what else is said of it.
    """

    def __init__(self, kind: str, known: dict[str, T], make: Callable[..., T]) -> None:
        self.kind, self.known, self._make = kind, known, make
        # Objects of others as they were given, by name.
        self.given: dict[str, Any] = {}
        self._loaded = False

    def add(self, name: str, given: Any, *more: Any) -> None:
        """Add an object under a name in small letters, digits and hyphens; else, or when taken, `InputError`."""
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise InputError(f"a {self.kind}'s name must be small letters, digits and hyphens, got {quoted(name)}")
        if name in self.known:
            raise InputError(f"{self.kind} {name!r} is registered already; choose another name")
        self.known[name] = self._make(name, given, *more)
        self.given[name] = given

    def all(self) -> Mapping[str, T]:
        """All by name, with those of installed packages.

        Of one that cannot be loaded a warning names the package, and it is left out.
        """
        if not self._loaded:
            self._loaded = True
            self._load_entry_points()
        return MappingProxyType(self.known)

    def forget(self, given: Mapping[str, Any]) -> None:
        """Go back to what was given by others at an earlier time; entry points are looked for again."""
        for name in self.given.keys() - given.keys():
            del self.known[name], self.given[name]
        self._loaded = False

    def found(self, names: Iterable[str]) -> list[str]:
        """Where those of others come from, a line for each."""
        own = [(name, self.given[name]) for name in names if name in self.given]
        return [f"{self.kind} {name}: {one.__module__}.{getattr(one, '__qualname__', name)}" for name, one in own]

    def _load_entry_points(self) -> None:
        for point in metadata.entry_points(group=f"lieednn_sim.{self.kind}s"):
            package = "unknown" if point.dist is None else point.dist.name
            try:
                given = point.load()
                # What is decorated has registered itself when it was loaded.
                if self.given.get(point.name) is not given:
                    self.add(point.name, given)
            except Exception as error:
                text = f"{self.kind} {point.name!r} of package {package!r} ({point.value}) is left out: {error}"
                warnings.warn(text, RuntimeWarning, stacklevel=4)
