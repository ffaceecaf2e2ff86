"""Files that GDAL opens: such as hold their own content, and none that sends it elsewhere.

GDAL tells formats by their first bytes, whatever a file is called. Some formats hold no content but
the names of other files, of services, or of commands that make it: a file of a stranger could lead
a run to read what nobody has named, and to ask the network.
"""

import sqlite3
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import shapely

from spl_batch.errors import InputError
from spl_batch.formats.las.header import open_input

_REFERRING: Final = (b"<ogr", b"<vrtdataset", b"wfs_capabilities", b"gdal_streamed_alg", b"<gdal")
"""Words at the start of a file whose content lies elsewhere, in lower case."""

_HEAD_BYTES: Final = 1 << 16
"""Start of a file that is looked at; GDAL looks at no more to tell such formats [byte]."""


def refuse_referring(path: Path, *, raster: bool = False) -> None:
    """Refuse a file that names others in place of content; folders are none.

    ``raster``: whether it is to hold cells, which no XML or JSON does.

    Raises
    ------
    InputError
        If it is one, or cannot be opened.
    """
    if path.is_dir():
        return
    with open_input(path) as file:
        head = file.read(_HEAD_BYTES).lower()
    text = raster and head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in {b"<", b"{"}
    if text or any(word in head for word in _REFERRING):
        what, remedy = ("cells", "GeoTIFF (gdal_translate)") if raster else (
            "shapes", "GeoPackage (ogr2ogr)"
        )  # fmt: skip
        raise InputError(
            str(path),
            f"holds no {what} but says where GDAL finds some, in another file, a service or a"
            f" pipeline: write what it stands for to a {remedy}",
        )


@contextmanager
def read_as(what: str, path: Path) -> Iterator[None]:
    """Turn what GDAL, SQLite and shapely say of a damaged file into one line.

    Their warnings are no lines for a screen: who reads looks at each shape. Names and texts of a
    file may be no UTF-8.

    Raises
    ------
    InputError
        In place of their errors; ``what`` the file was to be read as: ``shapes``, ``points``.
    """
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        try:
            yield
        except (
            sqlite3.Error,
            UnicodeDecodeError,
            pyogrio.errors.DataSourceError,
            pyogrio.errors.DataLayerError,
            shapely.errors.GEOSException,
        ) as error:
            said = " ".join(str(error).split())
            text = f"cannot be read as {what}: {said}: copy it again"
            raise InputError(str(path), text) from None
