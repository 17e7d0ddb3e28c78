"""Reading of files that may hold anything, with limits on size, memory and time."""

from __future__ import annotations

import contextlib
import json
import math
import re
import stat
import textwrap
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.errors import FileError
from lieednn_sim.validation import as_path
from lieednn_sim.values import StrPath

LARGEST_FILE = LARGEST_ARRAYS = 2**30  # most bytes of a file, and of all arrays in one file after unpacking
LARGEST_TEXT = 1_000_000  # most bytes of a JSON or YAML file, and of the metadata of arrays
# Most values in a YAML or JSON file, each counted as often as aliases repeat it, and the deepest nesting.
_MOST_VALUES, _DEEPEST = 1_000_000, 100
_MOST_ARRAYS = 1000
# Versions of the npy format that describe plain arrays of numbers and texts.
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
# Format of the files of `save_arrays`, and the array that holds their metadata as JSON.
FORMAT, META_KEY = 3, "meta_json"


@contextlib.contextmanager
def raising_file_error(what: str) -> Iterator[None]:
    """Turn an `OSError` of the system into a `FileError` whose message begins with ``what``."""
    try:
        yield
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"{what}: {error.strerror or error}") from None


def is_file(path: Path) -> bool:
    """Whether ``path`` is a file; `FileError` if the system does not permit the check."""
    with raising_file_error(f"cannot look for {path}"):
        return path.is_file()


@contextlib.contextmanager
def opened(path: StrPath, largest: int = LARGEST_FILE) -> Iterator[IO[bytes]]:
    """Open a regular file of at most ``largest`` bytes for reading; `FileError` says what is wrong with it."""
    with raising_file_error(f"cannot read {path}"):
        try:
            result = Path(path).stat()
        except FileNotFoundError:
            raise FileError(f"no such file: {path}") from None
        if stat.S_ISDIR(result.st_mode):
            raise FileError(f"{path} is a directory, not a file")
        if not stat.S_ISREG(result.st_mode):
            raise FileError(f"{path} is not a regular file")
        if result.st_size > largest:
            raise FileError(f"{path} has {result.st_size} bytes; at most {largest} are read")
        with Path(path).open("rb") as stream:
            yield stream


def parse_yaml(content: bytes) -> Any:
    """Parse YAML; `ValueError` says what is wrong, or that it holds too much."""
    import yaml

    depth, loader, too_deep = 0, _loader(), f"it is nested more than {_DEEPEST} deep"
    try:
        # Checked before loading: the loader recurses, and its compiled form crashes if the nesting is too deep.
        for event in yaml.parse(content, Loader=loader):
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST:
                raise ValueError(too_deep)
        value = yaml.load(content, Loader=loader)
    except yaml.YAMLError as error:
        # Newer scanners read ahead and have their own limit of depth.
        raise ValueError(too_deep if "nesting depth" in str(error) else " ".join(str(error).split())) from None
    if _count(value, {}) > _MOST_VALUES:
        raise ValueError(f"it holds more than {_MOST_VALUES} values, repeated ones counted as often as they occur")
    return value


@cache
def _loader() -> Any:
    import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # one of two classes
        """Reads 1e-3 as a number, as YAML 1.2 does, not as a text; refuses duplicate keys."""

        def __init__(self, stream: Any) -> None:
            super().__init__(stream)
            self._seen = set[int]()

        def flatten_mapping(self, node: Any) -> None:
            # Checked on the first call, before merged entries are among the node's own.
            if id(node) not in self._seen:
                self._seen.add(id(node))
                names = Counter((key.tag, key.value) for key, _ in node.value if isinstance(key, yaml.ScalarNode))
                for (tag, name), count in names.items():
                    if count > 1 and not tag.endswith(":merge"):
                        raise ValueError(f"{name!r} occurs twice in the mapping at line {node.start_mark.line + 1}")
            super().flatten_mapping(node)

    number = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)[eE][-+]?\d+")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+.0123456789"))
    return Loader


def _count(value: Any, known: dict[int, float]) -> float:
    """Number of values, infinite if one contains itself; ``known`` holds the numbers of lists and mappings by id."""
    if not isinstance(value, list | dict):
        return 1.0
    if id(value) not in known:
        known[id(value)] = math.inf
        inside = value if isinstance(value, list) else value.values()
        known[id(value)] = 1.0 + sum(_count(item, known) for item in inside)
    return known[id(value)]


def load_json(path: StrPath, what: str) -> dict[str, Any]:
    """Read a JSON object; `FileError` says what is wrong with the file."""
    return _load_object(path, what, partial(json.loads, object_pairs_hook=_entries))


def _entries(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) < len(pairs):
        name, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"{name!r} occurs twice in one object")
    return result


def load_description(path: StrPath, what: str) -> dict[str, Any]:
    """Read a hand-written object, JSON by its suffix or else YAML; raises as `load_json`."""
    return load_json(path, what) if Path(path).suffix.lower() == ".json" else _load_object(path, what, parse_yaml)


def _load_object(path: StrPath, what: str, parse: Callable[[bytes], Any]) -> dict[str, Any]:
    with opened(as_path("path", path), LARGEST_TEXT) as stream:
        content = stream.read()
    try:
        value = parse(content)
        if not isinstance(value, dict):
            raise TypeError(f"it is a {type(value).__name__} at the top, and not entries as `name: value`")
        return value
    except (TypeError, ValueError, RecursionError) as error:
        raise FileError(f"{path} is not a valid {what} ({type(error).__name__}: {error})") from None


class Archive:
    """The arrays of an open ``.npz`` file, each checked before memory is taken for it.

    Raises `ValueError` if they would take too much memory, and `zipfile.BadZipFile` if it is no archive.
    """

    def __init__(self, stream: IO[bytes]) -> None:
        self._archive = zipfile.ZipFile(stream)
        self._members = {item.filename.removesuffix(".npy"): item for item in self._archive.infolist()}
        if len(self._members) > _MOST_ARRAYS:
            raise ValueError(f"it holds {len(self._members)} arrays; at most {_MOST_ARRAYS} are read")
        if (total := sum(item.file_size for item in self._archive.infolist())) > LARGEST_ARRAYS:
            raise ValueError(f"it unpacks to {total} bytes; at most {LARGEST_ARRAYS} are read")

    @property
    def names(self) -> list[str]:
        """Names of the arrays."""
        return list(self._members)

    def read(self, name: str, largest: int = LARGEST_ARRAYS) -> NDArray[Any]:
        """One array of at most ``largest`` bytes; `KeyError` if it is missing, `ValueError` if it is invalid."""
        member = self._members[name]
        if member.file_size > largest:
            raise ValueError(f"{name} unpacks to {member.file_size} bytes; at most {largest} are read")
        with self._archive.open(member) as stream:
            return read_array(stream, member.file_size)


def read_array(stream: IO[bytes], size: int) -> NDArray[Any]:
    """Read an ``.npy`` file of ``size`` bytes; `ValueError` for objects, other versions and wrong shapes."""
    version = np.lib.format.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"arrays of version {version} are not read")
    shape, _, dtype = _HEADERS[version](stream)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not read")
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != size - stream.tell():
        raise ValueError(f"it claims the shape {shape}, which its content does not have")
    stream.seek(0)
    array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    return array


def load_arrays(path: StrPath, *kinds: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read arrays by name, and metadata with the ``kind``, from a file of `save_arrays`; `FileError` for any other."""
    source = as_path("path", path)
    with opened(source) as stream:
        try:
            archive = Archive(stream)
            # NumPy stores four bytes per character.
            meta = json.loads(str(archive.read(META_KEY, 4 * LARGEST_TEXT)))
            kind = meta.get("kind") if isinstance(meta, dict) else None
            if kind not in kinds:
                raise FileError(f"{source} holds {kind!r}, expected {kinds[0]!r}")
            if meta.get("format") != FORMAT:
                other = f"another version of this package (format {meta.get('format')!r}, not {FORMAT})"
                raise FileError(f"{source} was written by {other}; make it again")
            return {name: archive.read(name) for name in archive.names if name != META_KEY}, meta
        except FileError:
            raise
        # All exceptions that reading a damaged archive may raise.
        except (
            *(OSError, EOFError, LookupError, ValueError, TypeError, AttributeError, RuntimeError),
            *(zipfile.BadZipFile, zlib.error),
        ) as error:
            raise FileError(f"{source} is not a readable {kinds[0]} file ({type(error).__name__}: {error})") from None


def take(arrays: Mapping[str, NDArray[Any]], source: StrPath, *names: str) -> list[NDArray[Any]]:
    """Return the named arrays of a loaded file, or raise `FileError` naming the first that is missing."""
    for name in names:
        if name not in arrays:
            held = textwrap.shorten(", ".join(sorted(arrays)) or "nothing", 500)
            raise FileError(f"{source} has no array {name!r}; it holds: {held}")
    return [arrays[name] for name in names]
