"""Files: arrays as ``.npz``, everything else as JSON inside it, written atomically and never pickled."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.errors import FileError

FORMAT_VERSION = 1
_META_KEY = "meta_json"
# What the readers of a damaged archive raise, beside the built-in errors.
_DAMAGE = (zipfile.BadZipFile, zlib.error, NotImplementedError)


def make_directory(path: str | os.PathLike[str]) -> Path:
    """Create ``path`` with its parents, or raise `FileError` that says why not."""
    directory = Path(path)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot create directory {directory}: {error.strerror or error}") from None
    if not os.access(directory, os.W_OK):
        raise FileError(f"cannot write into {directory}: permission denied; choose another --output")
    return directory


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path``; it replaces ``path`` only when the block ends well.

    The temporary name keeps the suffix of ``path``, because encoders choose the format by it.

    Raises:
        FileError: the directory is missing, read-only or full.
    """
    target = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent)
        os.close(handle)
    except OSError as error:
        raise FileError(f"cannot write {target}: {error.strerror or error}") from None
    temporary = Path(name)
    try:
        yield temporary
        # mkstemp makes files private; results should have the permissions any new file gets.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(target)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"cannot write {target}: {error.strerror or error}") from None
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_text(path: str | os.PathLike[str]) -> Iterator[IO[str]]:
    """Open ``path`` for text; the file appears only when the block ends well."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        yield stream


def save_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write ``value`` as indented JSON, atomically."""
    text = json.dumps(value, indent=2, allow_nan=False)
    with atomic_text(path) as stream:
        stream.write(text + "\n")


def save_arrays(
    path: str | os.PathLike[str], kind: str, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]
) -> None:
    """Write arrays and JSON metadata into one ``.npz``.

    Args:
        path: file to write; the suffix must be ``.npz``.
        kind: what the file holds (``"network"``, ``"motion"`` ...), checked by `load_arrays`.
        arrays: named arrays; string arrays are allowed, object arrays are not.
        meta: JSON-serialisable values.
    """
    target = Path(path)
    if target.suffix != ".npz":
        raise FileError(f"cannot write {target}: the file name must end in .npz")
    header = json.dumps({"kind": kind, "format": FORMAT_VERSION, **meta}, allow_nan=False)
    with atomic_path(target) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays, **{_META_KEY: np.array(header)})


def load_arrays(path: str | os.PathLike[str], kind: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Read a file of `save_arrays`.

    Returns:
        The arrays by name, and the metadata.

    Raises:
        FileError: missing, not such a file, of another kind, or of a newer format.
    """
    source = Path(path)
    try:
        with source.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        meta = json.loads(str(arrays.pop(_META_KEY)))
    except FileNotFoundError:
        raise FileError(f"no such file: {source}") from None
    except IsADirectoryError:
        raise FileError(f"{source} is a directory, not a {kind} file") from None
    except PermissionError:
        raise FileError(f"cannot read {source}: permission denied") from None
    except (OSError, EOFError, KeyError, ValueError, TypeError, AttributeError, *_DAMAGE) as error:
        raise FileError(f"{source} is not a readable {kind} file ({type(error).__name__}: {error})") from None
    if not isinstance(meta, dict) or meta.get("kind") != kind:
        found = meta.get("kind") if isinstance(meta, dict) else None
        raise FileError(f"{source} holds {found!r}, expected {kind!r}")
    if not isinstance(meta.get("format"), int):
        raise FileError(f"{source} is not a readable {kind} file (its format is {meta.get('format')!r}, not a number)")
    if meta["format"] > FORMAT_VERSION:
        raise FileError(f"{source} was written by a newer version (format {meta['format']} > {FORMAT_VERSION})")
    return arrays, meta


def take(arrays: Mapping[str, NDArray[Any]], source: str | os.PathLike[str], *names: str) -> list[NDArray[Any]]:
    """Return the named arrays of a loaded file, or raise `FileError` naming the first that is missing."""
    for name in names:
        if name not in arrays:
            raise FileError(f"{source} has no array {name!r}; it holds: {', '.join(sorted(arrays)) or 'nothing'}")
    return [arrays[name] for name in names]
