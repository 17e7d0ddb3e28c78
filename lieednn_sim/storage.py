"""Files: arrays as ``.npz``, everything else as JSON inside it, written atomically and never pickled.

Every ``.npz`` carries a fingerprint of its content, and those of the files that it was made from: changed files, and
files that do not belong together (`cli.run_directory.RunDirectory`), are detected.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.errors import FileError
from lieednn_sim.filesystem import atomic_path, atomic_text
from lieednn_sim.reading import LARGEST_TEXT, Archive, opened, parse_yaml
from lieednn_sim.validation import as_path

# 2: with a fingerprint.
FORMAT_VERSION = 2
_META_KEY, _FINGERPRINT, _MADE_FROM = "meta_json", "fingerprint", "made_from"
# Exceptions from reading a damaged archive, besides built-in ones.
_DAMAGE = (zipfile.BadZipFile, zlib.error, NotImplementedError)
# An archive's last record: signature, four counters, size and offset of the directory before it, length of a comment.
_ARCHIVE_END = struct.Struct("<4s4H2LH")
# Characters of the names in a message.
_LONGEST = 500


def save_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write ``value`` as indented JSON, atomically."""
    text = json.dumps(value, indent=2, allow_nan=False)
    with atomic_text(path) as stream:
        stream.write(text + "\n")


def load_json(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """Read a JSON object; `FileError` says what is wrong with the file."""
    return _load_object(path, what, json.loads)


def load_description(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """Read a hand-written object, JSON by its suffix or else YAML; raises as `load_json`."""
    return load_json(path, what) if Path(path).suffix.lower() == ".json" else _load_object(path, what, parse_yaml)


def _load_object(path: str | os.PathLike[str], what: str, parse: Callable[[bytes], Any]) -> dict[str, Any]:
    try:
        with opened(as_path("path", path), LARGEST_TEXT) as stream:
            content = stream.read()
    except FileError:
        raise
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from None
    return parse_object(content, path, what, parse)


def parse_object(
    content: bytes, path: str | os.PathLike[str], what: str, parse: Callable[[bytes], Any] = parse_yaml
) -> dict[str, Any]:
    """Parse the content of a file, YAML by default; `FileError` if it is not a mapping."""
    try:
        value = parse(content)
        if not isinstance(value, dict):
            raise TypeError(f"it holds a {type(value).__name__}, not values by name")
        return value
    except (TypeError, ValueError, RecursionError) as error:
        raise FileError(f"{path} is not a valid {what} ({type(error).__name__}: {error})") from None


def fingerprint(arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> str:
    """SHA-256 of the names, types, shapes and bytes of arrays and of JSON values, independent of their order."""
    digest = hashlib.sha256(json.dumps(meta, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        digest.update(f"\n{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def save_arrays(
    path: str | os.PathLike[str],
    kind: str,
    arrays: Mapping[str, NDArray[Any]],
    meta: Mapping[str, Any],
    made_from: Mapping[str, str] | None = None,
) -> None:
    """Write arrays and JSON metadata into one ``.npz``, with a fingerprint of both.

    Args:
        path: file to write; the suffix must be ``.npz``.
        kind: what the file holds (``"network"``, ``"motion"`` ...), checked by `load_arrays`.
        arrays: named arrays; string arrays are allowed, object arrays are not.
        meta: JSON-serialisable values.
        made_from: fingerprints of the files that the content was made from, by name.
    """
    target = as_path("path", path)
    if target.suffix != ".npz":
        raise FileError(f"cannot write {target}: the file name must end in .npz")
    values = {**meta, "kind": kind, "format": FORMAT_VERSION, _MADE_FROM: dict(made_from or {})}
    values.pop(_FINGERPRINT, None)
    header = json.dumps({**values, _FINGERPRINT: fingerprint(arrays, values)}, allow_nan=False)
    with atomic_path(target) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays, **{_META_KEY: np.array(header)})


def load_arrays(path: str | os.PathLike[str], kind: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read a file of `save_arrays`.

    Returns:
        The arrays by name, and the metadata.

    Raises:
        FileError: the file is missing, invalid, of another kind or format, or was changed after it was written.
    """
    arrays, meta = _read(path, kind, header_only=False)
    if fingerprint(arrays, {name: value for name, value in meta.items() if name != _FINGERPRINT}) != meta[_FINGERPRINT]:
        raise FileError(f"{path} was changed after it was written: its content has another fingerprint than it says")
    return arrays, meta


def origin(path: str | os.PathLike[str]) -> tuple[str, dict[str, str]]:
    """The fingerprints of a file of `save_arrays` and of the files it was made from, by name; raises as `load_arrays`.

    Any kind is accepted. The arrays are not read, nor checked against the fingerprint.
    """
    _, meta = _read(path, None, header_only=True)
    made_from = meta.get(_MADE_FROM)
    if not isinstance(made_from, dict) or not all(isinstance(value, str) for value in made_from.values()):
        raise FileError(f"{path} is not a readable result file (it was made from {made_from!r})")
    return meta[_FINGERPRINT], made_from


def kind(path: str | os.PathLike[str]) -> str:
    """The kind of a file of `save_arrays`; raises as `origin`."""
    return str(_read(path, None, header_only=True)[1].get("kind"))


def short(fingerprint: object) -> str:
    """The beginning of a fingerprint, for messages; "none" for anything else."""
    return fingerprint[:12] if isinstance(fingerprint, str) else "none"


def _read(
    path: str | os.PathLike[str], kind: str | None, *, header_only: bool
) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    source = as_path("path", path)
    what = f"{kind or 'result'} file"
    try:
        with opened(source) as stream:
            _check_archive_end(stream)
            archive = Archive(stream)
            # NumPy stores four bytes a character.
            meta = json.loads(str(archive.read(_META_KEY, 4 * LARGEST_TEXT)))
            _check_meta(meta, source, kind, what)
            names = [] if header_only else [name for name in archive.names if name != _META_KEY]
            return {name: archive.read(name) for name in names}, meta
    except FileNotFoundError:
        raise FileError(f"no such file: {source}") from None
    except PermissionError:
        raise FileError(f"cannot read {source}: permission denied") from None
    except FileError:
        raise
    except (OSError, EOFError, KeyError, ValueError, TypeError, AttributeError, RecursionError, *_DAMAGE) as error:
        raise FileError(f"{source} is not a readable {what} ({type(error).__name__}: {error})") from None


def _check_meta(meta: Any, source: Path, kind: str | None, what: str) -> None:
    if not isinstance(meta, dict) or meta.get("kind") != (kind or meta.get("kind")):
        found = meta.get("kind") if isinstance(meta, dict) else None
        raise FileError(f"{source} holds {found!r}, expected {kind!r}")
    if not isinstance(meta.get("format"), int):
        raise FileError(f"{source} is not a readable {what} (its format is {meta.get('format')!r}, not a number)")
    if meta["format"] > FORMAT_VERSION:
        raise FileError(f"{source} was written by a newer version (format {meta['format']} > {FORMAT_VERSION})")
    if meta["format"] < FORMAT_VERSION or not isinstance(meta.get(_FINGERPRINT), str):
        raise FileError(
            f"{source} was written by an older version, without a fingerprint of its content; make it again"
        )


def _check_archive_end(stream: IO[bytes]) -> None:
    """Raise if there is data before or after the archive, which `zipfile` ignores."""
    size = stream.seek(0, os.SEEK_END)
    stream.seek(max(size - _ARCHIVE_END.size, 0))
    record = stream.read()
    stream.seek(0)
    if len(record) < _ARCHIVE_END.size:
        raise zipfile.BadZipFile("it is too short")
    signature, *_, length, offset, _ = _ARCHIVE_END.unpack(record)
    if signature != b"PK\5\6" or offset + length + _ARCHIVE_END.size != size:
        raise zipfile.BadZipFile("something is missing, or was added to it")


def take(arrays: Mapping[str, NDArray[Any]], source: str | os.PathLike[str], *names: str) -> list[NDArray[Any]]:
    """Return the named arrays of a loaded file, or raise `FileError` naming the first that is missing."""
    for name in names:
        if name not in arrays:
            held = ", ".join(sorted(arrays)) or "nothing"
            shown = held if len(held) < _LONGEST else f"{len(arrays)} others"
            raise FileError(f"{source} has no array {name!r}; it holds: {shown}")
    return [arrays[name] for name in names]
