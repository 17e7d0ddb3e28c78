"""Directories, locks, and files that appear only when they are complete."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import IO

from lieednn_sim.errors import FileError
from lieednn_sim.validation import as_path

try:
    import fcntl
except ImportError:  # on Windows
    _LOCKS = False
else:
    _LOCKS = True

# Between the name of a file and the random end of its temporary name; nobody else's files are called so.
_UNFINISHED = ".unfinished-"


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
            if path.exists() and not path.is_file():
                raise FileError(f"cannot write {path}: it is not a regular file; choose another name")
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
        directory: an existing directory. The lock is on the directory itself (flock); no file is created. Windows and
            some network file systems cannot do that: there is no lock, and files are still written atomically.
        shared: allow other shared locks.

    Raises:
        FileError: another process is at work there.
    """
    if not _LOCKS:
        yield
        return
    handle = os.open(directory, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileError(
                f"another lieednn-sim is at work in {directory}; wait for it, or choose another directory"
            ) from None
        except OSError:
            # A network file system that cannot lock directories.
            pass
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def created(directory: str | os.PathLike[str]) -> Iterator[Path]:
    """Create a directory with its parents, and remove what was created if it is empty when the block ends."""
    wanted = as_path("the name of a directory", directory)
    absent = [path for path in (wanted, *wanted.parents) if not os.path.lexists(path)]
    try:
        yield make_directory(wanted)
    finally:
        with contextlib.suppress(OSError):
            for path in absent:
                path.rmdir()


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
def atomic_paths(
    targets: Sequence[Path],
    outdated: Iterable[Path] = (),
    prepare: Callable[[Sequence[Path]], None] = lambda temporaries: None,
) -> Iterator[list[Path]]:
    """As `atomic_path`, for files that belong together.

    When the block succeeds, the outdated files are removed first, then the new ones appear in the given order. So a
    process that is killed in between leaves fewer files, but never old ones beside new ones. The content is on the disk
    before it gets its name, so that a power failure leaves no file that is empty or cut off.

    Args:
        targets: the files to write.
        outdated: files to remove.
        prepare: called with the complete temporary files before any target is replaced or removed.
    """
    temporaries: list[Path] = []
    target = targets[0]
    try:
        for target in targets:
            handle, name = tempfile.mkstemp(
                prefix=f".{target.stem}{_UNFINISHED}", suffix=target.suffix, dir=target.parent
            )
            os.close(handle)
            temporaries.append(Path(name))
        yield temporaries
        # mkstemp makes files private; results should have the permissions of any new file.
        umask = os.umask(0)
        os.umask(umask)
        for temporary in temporaries:
            # Before a umask can forbid to open it.
            _sync(temporary)
            temporary.chmod(0o666 & ~umask)
        prepare(temporaries)
        for target in outdated:
            target.unlink(missing_ok=True)
        for target, temporary in zip(targets, temporaries, strict=True):
            temporary.replace(target)
        for folder in {target.parent for target in targets}:
            _sync(folder)
    except OSError as error:
        said = str(error) if isinstance(error, FileError) else f"cannot write {target}: {error.strerror or error}"
        raise FileError(_named_as_asked(said, targets, temporaries)) from None
    finally:
        for temporary in temporaries:
            temporary.unlink(missing_ok=True)


def unfinished(path: Path) -> Iterator[Path]:
    """Temporary files of `atomic_path` beside ``path``, which a killed process left."""
    return path.parent.glob(f".{path.stem}{_UNFINISHED}????????{path.suffix}")


def _sync(path: Path) -> None:
    """Write a file, or the names in a directory, to the disk; Windows and some file systems cannot sync directories."""
    directory = path.is_dir()
    try:
        # Windows syncs only what is open for writing.
        handle = os.open(path, os.O_RDONLY if directory else os.O_RDWR)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError:
        if not directory:
            raise


def _named_as_asked(message: str, targets: Sequence[Path], temporaries: Sequence[Path]) -> str:
    """A message about the files that were asked for, in place of their temporary names."""
    for target, temporary in zip(targets, temporaries, strict=False):
        message = message.replace(temporary.name, target.name)
    return message


@contextlib.contextmanager
def atomic_text(path: str | os.PathLike[str]) -> Iterator[IO[str]]:
    """Open ``path`` for text; the file appears only when the block succeeds."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as stream:
        yield stream
