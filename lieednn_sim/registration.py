"""Registries of planners, policies and controllers, to which decorators and entry points of packages add."""

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
D = TypeVar("D")
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")


class Registry(Generic[T]):
    """All objects of one kind by name.

    Args:
        kind: name of the kind.
        known: this package's own objects, to which others are added.
        make: makes the entry of an added object from its name, the object and further arguments.
        group: packages declare theirs as entry points of this group; by default ``lieednn_sim.<kind>s``.
    """

    def __init__(self, kind: str, known: dict[str, T], make: Callable[..., T], group: str = "") -> None:
        self.kind, self.known, self._make = kind, known, make
        self._group = group or f"lieednn_sim.{kind}s"
        # Added objects by name.
        self.given: dict[str, Any] = {}
        self._loaded = False

    def add(self, name: str, given: Any, *more: Any) -> None:
        """Add an object; `InputError` if its name is taken, or not of lower-case letters, digits and hyphens."""
        if not _NAME.fullmatch(name):
            raise InputError(f"a {self.kind}'s name must be lower-case letters, digits and hyphens, got {quoted(name)}")
        if name in self.known:
            raise InputError(f"{self.kind} {name!r} is already registered; choose another name")
        self.known[name] = self._make(name, given, *more)
        self.given[name] = given

    def register(self, name: str, *more: Any) -> Callable[[D], D]:
        """Decorator that adds the decorated object; arguments and errors as of `add`."""

        def decorate(given: D) -> D:
            self.add(name, given, *more)
            return given

        return decorate

    def all(self) -> Mapping[str, T]:
        """All objects by name, including those of installed packages.

        One that cannot be loaded is left out, with a warning that names its package.
        """
        if not self._loaded:
            self._loaded = True
            self._load_entry_points()
        return MappingProxyType(self.known)

    def forget(self, given: Mapping[str, Any]) -> None:
        """Restore the added objects of an earlier time; entry points are searched again."""
        for name in self.given.keys() - given.keys():
            del self.known[name], self.given[name]
        self._loaded = False

    def found(self, names: Iterable[str]) -> list[str]:
        """Where added objects come from, a line for each."""
        own = [(name, self.given[name]) for name in names if name in self.given]
        return [f"{self.kind} {name}: {one.__module__}.{getattr(one, '__qualname__', name)}" for name, one in own]

    def _load_entry_points(self) -> None:
        for point in metadata.entry_points(group=self._group):
            package = "unknown" if point.dist is None else point.dist.name
            try:
                given = point.load()
                # A decorated object has registered itself on loading.
                if self.given.get(point.name) is not given:
                    self.add(point.name, given)
            except Exception as error:
                text = f"{self.kind} {point.name!r} of package {package!r} ({point.value}) is left out: {error}"
                warnings.warn(text, RuntimeWarning, stacklevel=4)
