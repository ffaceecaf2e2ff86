"""Files that are whole or not there: temporary name, rename; fsync of what is delivered.

A file of the working store does not wait for the disk: after a loss of power its checksum
shows that it is not what was written, and it is made again.
"""

import errno
import hashlib
import json
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path, PurePosixPath
from typing import Final

from spl_batch.errors import StoppedError, WorkflowError, reason_of
from spl_batch.formats.files.remote import (
    files_below,
    is_remote,
    read_object,
    remove_remote,
    uploading,
)

SCRATCH: Final = ".spl-part"
"""How names of files and folders end that are not finished."""

_WINDOWS: Final = os.name == "nt"
"""There no folder can be opened, and a file is forced to disk only where it may be written."""

_SCRATCH_NAME: Final = re.compile(rf"\..+\.[0-9a-f]{{16}}{re.escape(SCRATCH)}")
_CONCERNS_EVERYTHING: Final = {
    errno.ENOSPC: "disk full; free some space and run again",
    errno.EDQUOT: "disk quota used up; free some space and run again",
    errno.EFBIG: "too large for the file system or the shell's limit (ulimit -f); run again "
    "where it fits",
}
_OWNER: Final[ContextVar[tuple[str, str] | None]] = ContextVar("owner", default=None)
_NOT_ALLOWED: Final = {
    *(errno.EACCES, errno.EROFS, errno.EPERM),
    *(errno.ENOTDIR, errno.EISDIR, errno.EEXIST),
}


def scratch_name(path: Path) -> Path:
    """A name beside ``path`` for something that is not finished; no two calls give the same."""
    # A name may have 255 bytes, of which one letter takes up to four.
    name = path.name.encode(errors="surrogateescape")[:128].decode(errors="ignore")
    return path.with_name(f".{name}.{secrets.token_hex(8)}{SCRATCH}")


@contextmanager
def owned_by(mark: str, content: str) -> Iterator[None]:
    """Put nothing in place in this context, in this thread, once somebody else works there.

    A task goes on when its run is killed elsewhere. It must not replace what the next run makes
    with other settings.

    Parameters
    ----------
    mark : str
        Path of a file that names who works there.
    content : str
        What it holds for the run of this context.
    """
    token = _OWNER.set((mark, content))
    try:
        yield
    finally:
        _OWNER.reset(token)


def _stop_if_disowned() -> None:
    mark, content = _OWNER.get() or ("", "")
    with suppress(OSError):
        if mark and Path(mark).read_text(encoding="utf-8") != content:
            raise StoppedError(f"{mark}: another run has begun here; this one is over")


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Give a temporary name beside ``path``; rename it into place when the body succeeds.

    Parameters
    ----------
    path : Path
        Final name, of a file or a directory; its folder is made where missing.
    durable : bool
        Whether it outlives a loss of power: content is on disk before the rename, the rename
        before this returns. That takes milliseconds a file, or many where disks are busy.

    Yields
    ------
    Path
        The name to write to.

    Raises
    ------
    StoppedError
        If the disk is full, or another run has taken the temporary file away.
    WorkflowError
        If the path cannot be written.
    """
    if is_remote(path):
        try:
            with uploading(path) as temporary:
                yield temporary
                _stop_if_disowned()
        except OSError as error:
            stop_if_full(error, path)
            raise
        return
    temporary = scratch_name(path)
    try:
        _make_folder(path.parent, durable=durable)
        yield temporary
        _stop_if_disowned()
        _put_in_place(temporary, path, durable=durable)
    except BaseException as error:
        remove(temporary)
        if isinstance(error, OSError):
            stop_if_full(error, path)
            if error.errno in _NOT_ALLOWED:
                raise WorkflowError(f"{path}: cannot be written: {reason_of(error)}") from error
        raise


@contextmanager
def scratch_folder(path: Path) -> Iterator[Path]:
    """A folder beside ``path`` for by-products; gone when the body ends."""
    folder = scratch_name(path)
    _make_folder(folder, durable=False)
    try:
        yield folder
    finally:
        remove(folder)


def stop_if_full(error: BaseException, target: object) -> None:
    """Raise :class:`StoppedError` where a full disk is behind an error, however it is wrapped.

    Parameters
    ----------
    error : BaseException
        What was raised; its causes are looked at too.
    target : object
        What could not be written, for the message.
    """
    behind: BaseException | None = error
    while behind is not None:
        if isinstance(behind, OSError) and behind.errno in _CONCERNS_EVERYTHING:
            raise StoppedError(f"{target}: {_CONCERNS_EVERYTHING[behind.errno]}") from error
        behind = behind.__cause__ or behind.__context__


def sweep(folder: Path) -> tuple[int, int]:
    """Remove what killed runs have left unfinished below an output folder.

    Nothing else is touched, nor is what belongs to an output of its own further down.

    Returns
    -------
    count, bytes : int
        What was removed.
    """
    count = total = 0
    tops = [folder, *(p for p in folder.iterdir() if p.is_symlink() and p.is_dir())]
    for top in tops:
        for parent, folders, files in os.walk(top):
            if parent != str(top) and Path(parent, "store", "lock").exists():
                folders.clear()
                continue
            for name in filter(_SCRATCH_NAME.fullmatch, [*folders, *files]):
                path = Path(parent, name)
                total += max(size(path), 0)
                count += 1
                remove(path)
            folders[:] = [name for name in folders if not _SCRATCH_NAME.fullmatch(name)]
    return count, total


def write_bytes(path: Path, content: bytes, *, durable: bool = True) -> None:
    """Write a small file atomically; see :func:`replacing`."""
    with replacing(path, durable=durable) as temporary:
        temporary.write_bytes(content)


def read_bytes(path: Path) -> bytes:
    """Content of a small file."""
    return read_object(path) if is_remote(path) else path.read_bytes()


def real_path(path: str | Path) -> Path:
    """Where a path leads; a loop of links leads to itself, and cannot be used later."""
    return Path(os.path.realpath(path))  # Path.resolve raises RuntimeError on a loop


def sync_folder(path: Path) -> None:
    """Force a folder's entries to disk; Windows does so itself."""
    if is_remote(path) or _WINDOWS:
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def checksum(path: Path) -> str:
    """BLAKE2 hash of a file's bytes, or of a directory's names and bytes: 32 hexadecimal digits.

    ``path``: file or directory.
    """
    digest = hashlib.blake2b(digest_size=16)
    for name in sorted(_sizes(path), key=PurePosixPath):
        file = path / name if name else path
        digest.update(name.encode())
        if is_remote(path):
            digest.update(read_object(file))
            continue
        with file.open("rb") as stream:
            while part := stream.read(1 << 20):
                digest.update(part)
    return digest.hexdigest()


def json_digest(content: object, *, finite: bool = True) -> str:
    """BLAKE2 hash of plain JSON values, whatever the order of keys: 32 hexadecimal digits.

    ``finite``: whether to raise ValueError over a number that is not.
    """
    text = json.dumps(content, sort_keys=True, allow_nan=not finite)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def size(path: Path) -> int:
    """Size of a file, or of all files of a directory [byte]; -1 where there is neither."""
    try:
        return sum(_sizes(path).values())
    except (FileNotFoundError, NotADirectoryError):
        return -1


def _sizes(path: Path) -> dict[str, int]:
    """Files at a path and below it: relative name, empty for itself, and size [byte]."""
    if is_remote(path):
        return files_below(path)
    if not path.is_dir():
        return {"": path.stat().st_size}
    files = (file for file in path.rglob("*") if file.is_file())
    return {file.relative_to(path).as_posix(): file.stat().st_size for file in files}


def is_as_written(path: Path, bytes_: int, written_ns: int | None, content: str) -> bool:
    """Whether a file or directory has its size, and its time of writing or else its checksum.

    One without a time is known by its size. One that is not there, that has no known size
    (``bytes_`` is negative) or that cannot be read is not as written.
    """
    try:
        if bytes_ < 0 or size(path) != bytes_:
            return False
        if written_ns is None or written_ns == path.stat().st_mtime_ns:
            return True
        return checksum(path) == content
    except OSError:
        return False


def names_in(folder: Path, suffix: str) -> list[str]:
    """Names of the files of a folder that end so, in order, without their ends."""
    try:
        names = files_below(folder) if is_remote(folder) else os.listdir(folder)  # noqa: PTH208
    except (FileNotFoundError, NotADirectoryError):
        return []
    return sorted(n.removesuffix(suffix) for n in names if n.endswith(suffix) and n[0] != ".")


def remove(path: Path) -> None:
    """Remove a file, or a directory with all that is in it; nothing is fine too."""
    if is_remote(path):
        remove_remote(path)
    elif path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        # Where a file is in place of the folder there is nothing to remove either.
        with suppress(FileNotFoundError, NotADirectoryError):
            path.unlink()


def _make_folder(path: Path, *, durable: bool) -> None:
    """Make a folder, and those above it, durably so that they outlive a loss of power."""
    if path.is_dir():
        return
    missing = [p for p in (path, *path.parents) if not p.exists()]
    path.mkdir(parents=True, exist_ok=True)
    for folder in missing if durable else ():
        sync_folder(folder.parent)


def _put_in_place(temporary: Path, path: Path, *, durable: bool) -> None:
    try:
        if durable:
            _sync(temporary)
        if temporary.is_dir():
            remove(path)
        temporary.replace(path)
    except FileNotFoundError as error:
        raise StoppedError(
            f"{path}: its temporary file is gone; another run has taken over this output"
        ) from error
    if durable:
        sync_folder(path.parent)


def _sync(path: Path) -> None:
    """Force a file, or all files and entries of a directory, to disk."""
    if not path.is_dir():
        with path.open("r+b" if _WINDOWS else "rb") as stream:
            os.fsync(stream.fileno())
        return
    for parent, _, files in os.walk(path):
        for name in files:
            _sync(Path(parent, name))
        sync_folder(Path(parent))
