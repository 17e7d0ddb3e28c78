"""Directories, locks, and files that appear only when they are complete."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from lieednn_sim.errors import FileError
from lieednn_sim.validation import as_path


def make_directory(path: str | os.PathLike[str]) -> Path:
    """Create ``path`` with its parents, or raise `FileError` that says why not."""
    directory = as_path("the name of a directory", path)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"cannot create directory {directory}: {error.strerror or error}") from None
    if not os.access(directory, os.W_OK):
        raise FileError(f"cannot write into {directory}: permission denied; choose another --output")
    return directory


def is_file(path: Path) -> bool:
    """Whether ``path`` is a file; `FileError` if the system does not permit the check."""
    try:
        return path.is_file()
    except OSError as error:
        raise FileError(f"cannot look for {path}: {error.strerror or error}") from None


def check_outputs(paths: Iterable[Path]) -> None:
    """Raise `FileError` if one of the files could not be written, before the work for it begins."""
    for path in paths:
        try:
            if path.is_dir():
                raise FileError(f"cannot write {path}: it is a directory; remove it or choose another name")
            if not path.parent.is_dir():
                raise FileError(f"cannot write {path}: there is no directory {path.parent}")
        except OSError as error:
            if isinstance(error, FileError):
                raise
            raise FileError(f"cannot write {path}: {error.strerror or error}") from None
        if not os.access(path.parent, os.W_OK):
            raise FileError(f"cannot write {path}: {path.parent} is read-only")


@contextlib.contextmanager
def locked(directory: str | os.PathLike[str], *, shared: bool = False) -> Iterator[None]:
    """Lock a directory against other processes of the package; the lock ends with the process, however that ends.

    Args:
        directory: an existing directory. The lock is on the directory itself (flock); no file is created.
        shared: allow other shared locks.

    Raises:
        FileError: another process is at work there.
    """
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileError(
                f"another lieednn-sim is at work in {directory}; wait for it, or choose another directory"
            ) from None
        except OSError:
            # Some network file systems cannot lock directories; files are still written atomically and checked.
            pass
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, which replaces ``path`` only when the block succeeds.

    The temporary name keeps the suffix of ``path``, by which encoders choose the format.

    Raises:
        FileError: the directory is missing, read-only or full.
    """
    with atomic_paths([as_path("path", path)]) as (temporary,):
        yield temporary


@contextlib.contextmanager
def atomic_paths(targets: Sequence[Path], outdated: Iterable[Path] = ()) -> Iterator[list[Path]]:
    """As `atomic_path`, for files that belong together.

    When the block succeeds, the outdated files are removed first, then the new ones appear in the given order. So a
    process that is killed in between leaves fewer files, but never old ones beside new ones.
    """
    temporaries: list[Path] = []
    target = targets[0]
    try:
        for target in targets:
            handle, name = tempfile.mkstemp(prefix=f".{target.stem}.", suffix=target.suffix, dir=target.parent)
            os.close(handle)
            temporaries.append(Path(name))
        yield temporaries
        for target in outdated:
            target.unlink(missing_ok=True)
        # mkstemp makes files private; results should have the permissions of any new file.
        umask = os.umask(0)
        os.umask(umask)
        for target, temporary in zip(targets, temporaries, strict=True):
            temporary.chmod(0o666 & ~umask)
            temporary.replace(target)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"cannot write {target}: {error.strerror or error}") from None
    finally:
        for temporary in temporaries:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_text(path: str | os.PathLike[str]) -> Iterator[IO[str]]:
    """Open ``path`` for text; the file appears only when the block succeeds."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        yield stream
