"""Places on an object store: paths that look like pathlib's, and whole objects only.

An object is written to a local temporary file and then put in one request: it is there as a whole
or not at all. Failures of the store concern everything: they stop the run.
"""

import glob
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from spl_batch.errors import StoppedError, WorkflowError

_OBJECTS = {".json", ".npz", ".parquet", ".zip"}
"""Ends of names that are objects, never folders: it takes a request to find out."""


def remote_path(url: str) -> Path:
    """Path on an object store: a ``UPath``, which has what this project uses of a path.

    ``url``: e.g. ``s3://bucket/survey``; options of the file system come from the environment.

    Raises
    ------
    WorkflowError
        If the libraries for this kind of store are not installed, or the URL is none.
    """
    try:
        from upath import UPath  # noqa: PLC0415 - needed for object stores only

        # Listings that fsspec remembers would hide what other workers write.
        path = UPath(url, use_listings_cache=False)
        path.fs  # noqa: B018 - looks for the library
    except ImportError as error:
        reason = " ".join(str(error).split())
        raise WorkflowError(
            f"outputs.store: {url}: {reason}; pip install 'spl-batch[cluster]', and gcsfs or adlfs "
            "for Google's or Microsoft's"
        ) from None
    except ValueError as error:
        raise WorkflowError(f"outputs.store: {url}: {error}") from None
    return cast("Path", path)


def file_system(path: Path) -> tuple[Any, str]:
    """File system of fsspec, and the path's name there."""
    remote: Any = path
    return remote.fs, remote.path


def is_remote(path: Path) -> bool:
    """Whether a path lies on an object store."""
    return not isinstance(path, Path)


@contextmanager
def reaching(path: Path) -> Iterator[None]:
    """Let "not found" through, and stop the run for any other error of a store."""
    try:
        yield
    except (FileNotFoundError, StoppedError):
        raise
    except Exception as error:
        reason = " ".join(str(error).split())
        raise StoppedError(
            f"{path}: the store cannot be used ({type(error).__name__}: {reason}); run again to "
            "continue"
        ) from error


@contextmanager
def uploading(path: Path) -> Iterator[Path]:
    """Give a local temporary name; put the file in place when the block succeeds."""
    with TemporaryDirectory(prefix="spl_batch.upload.") as folder:
        temporary = Path(folder, path.name)
        yield temporary
        with reaching(path):
            _put(temporary, path)


def remove_remote(path: Path) -> None:
    """Remove an object, or all objects below a name; nothing is fine too."""
    with reaching(path):
        fs, name = file_system(path)
        with suppress(FileNotFoundError):
            if path.suffix in _OBJECTS:
                fs.rm_file(name)
            elif glob.has_magic(name):  # fsspec would take it for a pattern
                for inside in fs.find(name):
                    fs.rm_file(inside)
            else:
                fs.rm(name, recursive=True)


def files_below(path: Path) -> dict[str, int]:
    """Objects at a name and below it: relative name, empty for itself, and size [byte]."""
    with reaching(path):
        fs, top = file_system(path)
        if path.suffix in _OBJECTS:
            return {"": int(fs.info(top)["size"])}
        found = fs.find(top, detail=True)
        if not found:
            raise FileNotFoundError(str(path))
        return {name[len(top) :].lstrip("/"): int(info["size"]) for name, info in found.items()}


def read_object(path: Path) -> bytes:
    """Content of an object."""
    with reaching(path):
        fs, name = file_system(path)
        content: bytes = fs.cat_file(name)
        return content


def copy_object(path: Path, target: Path) -> None:
    """Copy an object within one store."""
    with reaching(target):
        fs, name = file_system(path)
        # Unlike cp_file, copy takes a name with brackets for a pattern.
        fs.cp_file(name, file_system(target)[1])


def _put(file: Path, path: Path) -> None:
    fs, name = file_system(path)
    try:
        fs.put_file(str(file), name)
    except FileNotFoundError as error:
        raise StoppedError(
            f"{path}: no such bucket ({error}); make it, or change outputs.store, and run again"
        ) from error


def by_ranges(path: Path) -> Any:
    """An object as a file of which no more is fetched than is read, for pyarrow."""
    from fsspec.spec import AbstractBufferedFile  # noqa: PLC0415 - needed for object stores only

    class Ranges(AbstractBufferedFile):  # type: ignore[misc]
        def _fetch_range(self, start: int, end: int) -> bytes:
            with reaching(path):
                content: bytes = self.fs.cat_file(self.path, start=start, end=end)
                return content

    with reaching(path):
        return Ranges(*file_system(path), cache_type="none")
