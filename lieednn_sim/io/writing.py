"""Files that appear only when they are complete, and folders of results."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lieednn_sim.errors import FileError
from lieednn_sim.io.reading import FORMAT, META_KEY, load_json, raising_file_error
from lieednn_sim.validation import as_path
from lieednn_sim.values import StrPath

try:
    import fcntl
except ImportError:  # on Windows
    _LOCKS = False
else:
    _LOCKS = True

MARK = "lieednn_sim.json"  # marks a folder as one of this package, and says what it holds
# Stands between a file's name and the random end of its temporary name; no other program uses it.
UNFINISHED = ".unfinished-"


def make_directory(path: StrPath) -> Path:
    """Create ``path`` with its parents, or raise `FileError` that says why not."""
    directory = as_path("the name of a directory", path)
    with raising_file_error(f"cannot create directory {directory}"):
        directory.mkdir(parents=True, exist_ok=True)
    if not os.access(directory, os.W_OK):
        raise FileError(f"cannot write into {directory}: permission denied; choose another directory")
    return directory


def check_outputs(paths: Iterable[Path]) -> None:
    """Raise `FileError` if one of the files could not be written, before the work for it begins."""
    for path in paths:
        with raising_file_error(f"cannot write {path}"):
            if path.is_dir():
                raise FileError(f"cannot write {path}: it is a directory; remove it or choose another name")
            if path.exists() and not path.is_file():
                raise FileError(f"cannot write {path}: it is not a regular file; choose another name")
            if not path.parent.is_dir():
                raise FileError(f"cannot write {path}: there is no directory {path.parent}")
        if not os.access(path.parent, os.W_OK):
            raise FileError(f"cannot write {path}: {path.parent} is read-only")


@contextlib.contextmanager
def locked(directory: StrPath, *, shared: bool = False) -> Iterator[None]:
    """Lock an existing directory against other processes of the package; a shared lock admits others that share it.

    The lock is on the directory itself (flock): no file is created, and the lock ends with the process in any case.
    Windows and some network file systems have no such lock; there, files are still written atomically. `FileError` if
    another process is at work there.
    """
    if not _LOCKS:
        yield
        return
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            what = f"another lieednn-sim is at work in {directory}"
            raise FileError(f"{what}; wait for it, or choose another directory") from None
        except OSError:
            # A network file system that cannot lock directories.
            pass
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def output_folder(directory: StrPath, holds: str, *, shared: bool = False) -> Iterator[Path]:
    """A folder for results, locked while the block runs.

    The folder must be new, empty, or marked by its file `MARK` as one of this package for the same purpose; in such a
    folder the block may replace and remove its own files, whatever they hold. Unfinished files of a killed process are
    removed. If the folder is empty when the block ends, the folders that were created are removed again.

    ``holds`` is the purpose, such as "run". ``shared`` admits other shared locks, for a block that replaces nothing
    that others read. `FileError` if the folder holds anything else, cannot be written, or another process uses it.
    """
    folder = as_path("the name of a directory", directory)
    absent = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]
    make_directory(folder)
    try:
        with locked(folder, shared=shared):
            marked = _claim(folder, holds, remove_unfinished=not shared)
            try:
                yield folder
            finally:
                if marked and [path.name for path in folder.iterdir()] == [MARK]:
                    (folder / MARK).unlink()
    finally:
        with contextlib.suppress(OSError):
            for path in absent:
                path.rmdir()


def _claim(folder: Path, holds: str, *, remove_unfinished: bool) -> bool:
    """Mark a folder as one of this package, or raise `FileError`; returns whether it was not marked before."""
    with raising_file_error(f"cannot read {folder}"):
        there = list(folder.iterdir())
    unfinished = [path for path in there if path.name.startswith(".") and UNFINISHED in path.name]
    mark = folder / MARK
    if mark in there:
        result = load_json(mark, "mark of a folder of results").get("holds")
        if result != holds:
            raise FileError(f"{folder} is for another purpose ({result}, not {holds}); choose another directory")
    elif others := sorted(path.name for path in there if path not in unfinished):
        found = others[0] if len(others) == 1 else f"{others[0]} and {len(others) - 1} more"
        alien = f"files that no command of this package made ({found})"
        raise FileError(f"{folder} holds {alien}; choose a new or empty directory")
    else:
        save_json(mark, {"holds": holds})
    for path in unfinished if remove_unfinished else ():
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    return mark not in there


@contextlib.contextmanager
def atomic_path(path: StrPath) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, with its suffix; the file replaces ``path`` if the block succeeds.

    `FileError` if the directory is missing, read-only or full.
    """
    with atomic_paths([as_path("path", path)]) as (temporary,):
        yield temporary


@contextlib.contextmanager
def atomic_paths(targets: Sequence[Path], outdated: Iterable[Path] = ()) -> Iterator[list[Path]]:
    """As `atomic_path`, for files that belong together.

    When the block succeeds, the outdated files are removed first, then the new ones appear in the given order. So a
    process that is killed in between leaves fewer files, but never old ones beside new ones. The content is on the disk
    before the file gets its name, so that a power failure leaves no empty or truncated file.
    """
    temporaries: list[Path] = []
    target = targets[0]
    try:
        for target in targets:
            handle, name = tempfile.mkstemp(target.suffix, f".{target.stem[:40]}{UNFINISHED}", target.parent)
            os.close(handle)
            temporaries.append(Path(name))
        yield temporaries
        # mkstemp makes files private; results should have the permissions of any new file.
        umask = os.umask(0)
        os.umask(umask)
        for temporary in temporaries:
            # Synced before the new permissions, which may forbid opening the file.
            _sync(temporary)
            temporary.chmod(0o666 & ~umask)
        for target in outdated:
            target.unlink(missing_ok=True)
        for target, temporary in zip(targets, temporaries, strict=True):
            temporary.replace(target)
        for folder in {target.parent for target in targets}:
            _sync(folder)
    except OSError as error:
        said = str(error) if isinstance(error, FileError) else f"cannot write {target}: {error.strerror or error}"
        # The message names the requested files, not their temporary names.
        for asked, temporary in zip(targets, temporaries, strict=False):
            said = said.replace(temporary.name, asked.name)
        raise FileError(said) from None
    finally:
        for temporary in temporaries:
            temporary.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Write a file, or the names in a directory, to the disk; Windows and some file systems cannot sync directories."""
    directory = path.is_dir()
    try:
        # Windows syncs only files that are open for writing.
        handle = os.open(path, os.O_RDONLY if directory else os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError:
        if not directory:
            raise


def save_text(path: StrPath, text: str) -> None:
    """Write a text, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="")


def save_csv(path: StrPath, rows: Iterable[Iterable[Any]]) -> None:
    """Write rows as CSV, atomically; the first row holds the names of the columns, and numbers are exact."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(rows)


def save_json(path: StrPath, value: Any) -> None:
    """Write ``value`` as indented JSON, atomically."""
    save_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def save_arrays(path: StrPath, kind: str, arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> None:
    """Write named arrays, also of strings but not of objects, and JSON metadata into one ``.npz``.

    Its ``kind`` says what it holds (``"network"``, ``"motion"`` ...), and is checked by `load_arrays`.
    """
    target = as_path("path", path)
    if target.suffix != ".npz":
        raise FileError(f"cannot write {target}: the file name must end in .npz")
    header = json.dumps({**meta, "kind": kind, "format": FORMAT}, allow_nan=False)
    with atomic_path(target) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays, **{META_KEY: np.array(header)})


def fingerprint(arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> str:
    """SHA-256 of the names, types, shapes and bytes of arrays and of JSON values, independent of their order."""
    digest = hashlib.sha256(json.dumps(meta, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.asarray(arrays[name])
        digest.update(f"\n{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def short(fingerprint: object) -> str:
    """The beginning of a fingerprint, for messages; "none" for anything else."""
    return fingerprint[:12] if isinstance(fingerprint, str) else "none"
