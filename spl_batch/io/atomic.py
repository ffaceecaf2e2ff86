"""Files that are either whole or not there: temporary name, fsync, rename."""

import errno
import hashlib
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from spl_batch.errors import StoppedError, WorkflowError

_CONCERNS_EVERYTHING = {errno.ENOSPC: "disk full", errno.EDQUOT: "disk quota used up"}


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary name beside ``path``; rename it into place when the block succeeds.

    Parameters
    ----------
    path : Path
        Final name, of a file or a directory; its folder is made where missing.

    Yields
    ------
    Path
        The name to write to.

    Raises
    ------
    StoppedError
        If the disk is full.
    WorkflowError
        If the place cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove(temporary)
        yield temporary
        _sync(temporary)
        if temporary.is_dir():
            _remove(path)
        temporary.replace(path)
    except OSError as error:
        if error.errno in _CONCERNS_EVERYTHING:
            what = _CONCERNS_EVERYTHING[error.errno]
            raise StoppedError(f"{path}: {what}; free some space and run again") from error
        if error.errno in {errno.EACCES, errno.EROFS, errno.EPERM, errno.ENOTDIR, errno.EEXIST}:
            raise WorkflowError(f"{path}: cannot be written: {error.strerror}") from error
        raise
    finally:
        _remove(temporary)


def write_bytes(path: Path, content: bytes) -> None:
    """Write a small file atomically."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def sync_folder(path: Path) -> None:
    """Force a folder's entries to disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def checksum(path: Path) -> str:
    """BLAKE2 hash of a file's bytes, or of a directory's names and bytes.

    Parameters
    ----------
    path : Path
        File or directory.

    Returns
    -------
    str
        32 hexadecimal digits.
    """
    digest = hashlib.blake2b(digest_size=16)
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for file in files:
        if path.is_dir():
            digest.update(file.relative_to(path).as_posix().encode())
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _sync(path: Path) -> None:
    for file in path.rglob("*") if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        # Where a file stands in place of the folder there is nothing to remove either.
        with suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()
