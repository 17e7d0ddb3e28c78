"""Rows that describe things that are chosen by name, and registries of rows, to which others may add.

A thing is imported when it is loaded. Decorators and the entry points of installed packages add further rows. This
module imports nothing slow.
"""

from __future__ import annotations

import importlib
import importlib.util
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from lieednn_sim.errors import InputError, LieEDNNError

TYPICAL = 0.6  # CPU time of a case of most planners [s]

_Given = TypeVar("_Given")
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_IN_FILE = re.compile(r"(?s)(.+\.py):([^:/\\]*)")


class Library(NamedTuple):
    """An optional library."""

    extra: str  # of this package, which installs it
    purpose: str = ""  # its use, in addition to the rows that name it
    distribution: str = ""  # its name on the package index, if that is not the module's


#: Optional libraries by the name of their module.
LIBRARIES: Mapping[str, Library] = {
    "ompl": Library("rivals"),
    "mjpl": Library("cbirrt"),
    "sscbirrt": Library("cbirrt"),
    "toppra": Library("timing", "the planned path in the least time, --fastest"),
    "viser": Library("view", "motions in a browser"),
    "mjviser": Library("view", "motions in a browser"),
    "gymnasium": Library("gymnasium", "Gymnasium environments"),
    "onnx": Library("onnx", "a network as a graph, network.to_onnx"),
    "rosbags": Library("ros2"),
    "pyarrow": Library("lerobot"),
    "rerun": Library("rerun", distribution="rerun-sdk"),
}


@dataclass(frozen=True)
class Entry:
    """A row of a registry."""

    place: Any = ""  # where the thing is, ``module:name`` within this package; or what another package has registered
    help: str = ""  # what it is or does, in one line
    takes: Any = ""  # class of its options, by name in the same module or itself; empty or None for no options
    library: str = ""  # module of `LIBRARIES` that it needs; empty if it needs none

    @property
    def own(self) -> bool:
        """Whether the row is one of this package, not added by another package."""
        return isinstance(self.place, str)

    def load(self) -> Any:
        """The thing itself, which is imported at the first call."""
        return self._within(self.place.partition(":")[2]) if self.own else self.place

    @property
    def options(self) -> Any:
        """Class of the thing's options; None if it has none."""
        return self._within(self.takes) if self.takes and isinstance(self.takes, str) else self.takes or None

    @property
    def install(self) -> str:
        """The command that installs the library that the thing needs; empty if it is installed, or none is needed."""
        return "" if not self.library or importlib.util.find_spec(self.library) else install_command(self.library)

    def _within(self, name: str) -> Any:
        return attrgetter(name)(importlib.import_module(f"lieednn_sim.{self.place.partition(':')[0]}"))


@dataclass(frozen=True)
class PlannerEntry(Entry):
    """A planner: a function of a `PlanningProblem`, and of its options if there are any.

    It returns a plan, or a motion if there is no network, or raises. The motion is sampled at the model's time step and
    passes `motion.check_motion`; its velocities are the derivatives of its positions, and its accelerations are
    continuous.
    """

    # CPU time of a case of a comparison [s]: planning and both default controllers, the mean over the default arms and
    # scenes. Declared, not measured, so that the choice of cases does not depend on the machine.
    cost: float = TYPICAL
    network: bool = False  # whether its plans have a certifiable network, which a run stores
    path_constraints: bool = False  # whether it takes the argument `path_constraint` of `planning.plan`


@dataclass(frozen=True)
class FormatEntry(Entry):
    """A format of another tool: a function of sources by name, a folder, and options, which writes files into it.

    A format of rollouts takes the option ``rate`` [Hz], see `exports.formats.samples`; None stands for its default.
    """

    of_comparison: bool = False  # whether it holds the table of a comparison; otherwise it holds rollouts


_Entry = TypeVar("_Entry", bound=Entry)


class Registry(Mapping[str, _Entry], Generic[_Entry]):
    """All things of one kind by name, including those of installed packages, which are searched once.

    An entry point that cannot be loaded is left out, with a warning that names its package. If others may add things of
    the kind, `find` also takes ``file.py:thing``, and runs that file.

    The attribute ``entries`` holds this package's own rows and those that decorators have added; reading it starts no
    search. The places of the given rows begin with ``within``. If others may add things, ``make(place, takes=...)``
    makes the row of a thing and its options, ``wanted`` says what it must be, and ``lieednn_sim.`` with ``plural`` is
    the group of entry points. ``further`` ends messages.
    """

    def __init__(
        self,
        kind: str,
        entries: dict[str, _Entry],
        within: str = "",
        *,
        make: Callable[..., _Entry] | None = None,
        wanted: str = "",
        further: str = "",
    ) -> None:
        self.kind, self.plural = kind, f"{kind}s".replace("ys", "ies")
        placed = {name: replace(row, place=within + row.place) for name, row in entries.items() if within and row.place}
        self.entries = entries | placed
        self._further = further if make is None else "or one of your own as file.py:name"
        self._make, self._wanted = make, wanted
        self._searched = make is None

    def __getitem__(self, name: str) -> _Entry:
        return self._all()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def find(self, name: str) -> _Entry:
        """The row of a name; an `InputError` lists the names if there is none, or says what a file lacks."""
        from lieednn_sim.validation import as_choice  # NumPy is slow to import

        if self._make and isinstance(name, str) and name not in self.entries and (parts := _IN_FILE.fullmatch(name)):
            given = _of_file(f"{self.kind} {name!r}", *parts.groups())
            registered = (entry for entry in self.entries.values() if entry.place is given)
            self.entries[name] = next(registered, None) or self._row(name, given)
        return self[as_choice(self.kind, name, self, self._further)]

    def register(self, name: str, options: type | None = None) -> Callable[[_Given], _Given]:
        """Decorator that adds a thing; `InputError` if its name is malformed or another's, or it is not callable."""

        def decorate(given: _Given) -> _Given:
            if not _NAME.fullmatch(name):
                raise InputError(f"a {self.kind}'s name must be of a to z, digits and hyphens, got {name[:80]!r}")
            known = self.entries.get(name)
            # A cell of a notebook that is run again, or a module that is reloaded, defines the same thing again.
            if known and (known.own or _origin(known.place) != _origin(given)):
                raise InputError(f"{self.kind} {name!r} is already registered; choose another name")
            self.entries[name] = self._row(name, given, options)
            return given

        return decorate

    def _row(self, name: str, given: Any, options: type | None = None) -> _Entry:
        assert self._make is not None, f"others add no {self.kind}"
        if not callable(given):
            raise InputError(f"{self.kind} {name!r} must be {self._wanted}, got {type(given).__name__}")
        return self._make(given, takes=options)

    def missing(self) -> dict[str, str]:
        """Names of things whose library is not installed, with the commands that install it."""
        return {name: entry.install for name, entry in self.entries.items() if entry.install}

    def require(self, name: str) -> _Entry:
        """As `find`; if the library that the thing needs is not installed, a `LieEDNNError` says what to do.

        No other thing is taken instead, since results must not depend on what is installed.
        """
        entry = self.find(name)
        if command := entry.install:
            others = ", ".join(other for other, row in self.entries.items() if not row.library)
            raise LieEDNNError(f"{self.kind} {name!r} is not installed: {command}; or name one without extra: {others}")
        return entry

    def origins(self, names: Iterable[str]) -> list[str]:
        """The origins of the named things that others have added, a line for each."""
        return [f"{self.kind} {n}: {_origin(self[n].place)}" for n in names if n in self and not self[n].own]

    def _all(self) -> dict[str, _Entry]:
        if self._searched:
            return self.entries
        self._searched = True
        from importlib import metadata  # slow to import

        for point in metadata.entry_points(group=f"lieednn_sim.{self.plural}"):
            package = "unknown" if point.dist is None else point.dist.name
            try:
                given = point.load()
                # A decorated object has registered itself on loading.
                if point.name not in self.entries or self.entries[point.name].place is not given:
                    self.register(point.name)(given)
            except Exception as error:
                text = f"{self.kind} {point.name!r} of package {package!r} ({point.value}) is left out: {error}"
                warnings.warn(text, RuntimeWarning, stacklevel=4)
        return self.entries


def _origin(given: Any) -> str:
    """Where a thing is defined: module and name."""
    return f"{getattr(given, '__module__', '')}.{getattr(given, '__qualname__', repr(given))}"


def _of_file(what: str, path: str, name: str) -> Any:
    """A thing of a Python file, whose folder is appended to the import path."""
    file = Path(path).resolve()
    folder, module = str(file.parent), file.stem
    if not file.is_file():
        raise InputError(f"{what}: there is no file {path}")
    if folder not in sys.path:
        sys.path.append(folder)
    try:
        importlib.invalidate_caches()
        found = importlib.import_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(f"{what}: running {path} fails: {type(error).__name__}: {error}") from error
    if Path(getattr(found, "__file__", None) or "").resolve() != file:
        raise InputError(f"{what}: there is another module named {module!r}: give the file another name")
    if not hasattr(found, name):
        own = [each for each, value in vars(found).items() if getattr(value, "__module__", None) == module]
        raise InputError(f"{what}: {path} has no {name!r}; it has {', '.join(own) or 'nothing of its own'}")
    return getattr(found, name)


def install_command(library: str) -> str:
    """The command that installs an optional library, with others of its extra."""
    return f"pip install 'lieednn_sim[{LIBRARIES[library].extra}]'"
