"""Files that are either whole or not there: temporary name, fsync, rename, fsync."""

import errno
import hashlib
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from spl_batch.errors import StoppedError, WorkflowError

SCRATCH: Final = ".spl-part"
"""How names of files and folders end that are not finished."""

_CONCERNS_EVERYTHING = {errno.ENOSPC: "disk full", errno.EDQUOT: "disk quota used up"}


def scratch_name(path: Path) -> Path:
    """A name beside ``path`` for something that is not finished; no two calls give the same."""
    # Long names of inputs must not become too long.
    return path.with_name(f".{path.name[:128]}.{secrets.token_hex(8)}{SCRATCH}")


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
    temporary = scratch_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        _sync(temporary)
        if temporary.is_dir():
            remove(path)
        temporary.replace(path)
    except OSError as error:
        if error.errno in _CONCERNS_EVERYTHING:
            what = _CONCERNS_EVERYTHING[error.errno]
            raise StoppedError(f"{path}: {what}; free some space and run again") from error
        if error.errno in {errno.EACCES, errno.EROFS, errno.EPERM, errno.ENOTDIR, errno.EEXIST}:
            raise WorkflowError(f"{path}: cannot be written: {error.strerror}") from error
        raise
    finally:
        remove(temporary)


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
    for file in _files(path):
        if file != path:
            digest.update(file.relative_to(path).as_posix().encode())
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def size(path: Path) -> int:
    """Size of a file, or of all files of a directory [byte]; -1 where there is neither."""
    try:
        return sum(file.stat().st_size for file in _files(path))
    except FileNotFoundError:
        return -1


def remove(path: Path) -> None:
    """Remove a file, or a directory with all that is in it; nothing is fine too."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        # Where a file stands in place of the folder there is nothing to remove either.
        with suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()


def _files(path: Path) -> list[Path]:
    """Files of a directory in order, or the file itself."""
    return sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]


def _sync(path: Path) -> None:
    for file in path.rglob("*") if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as stream:
                os.fsync(stream.fileno())
