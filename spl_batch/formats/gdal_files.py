"""Files that GDAL opens: such as hold their own content, and none that sends it elsewhere.

GDAL tells formats by their first bytes, whatever a file is called. Some formats hold no content but
the names of other files, of services, or of commands that make it: a file of a stranger could lead
a run to read what nobody has named, and to ask the network.
"""

import sqlite3
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager
from glob import escape
from pathlib import Path
from typing import Final

import shapely

from spl_batch.errors import InputError
from spl_batch.formats.las.header import open_input

_REFERRING: Final = (b"<ogr", b"<vrtdataset", b"wfs_capabilities", b"gdal_streamed_alg", b"<gdal")
"""Words at the start of a file whose content lies elsewhere, in lower case."""

_DATABASE: Final = b"sqlite format 3\0"
"""Start of a GeoPackage, in lower case."""

_HEAD_BYTES: Final = 1 << 16
"""Start of a file that is looked at; GDAL looks at no more to tell such formats [byte]."""


def refuse_referring(path: Path, *, raster: bool = False) -> None:
    """Refuse a file that names others in place of content; folders are none.

    ``raster``: whether it is to hold cells, which no XML or JSON does.

    Raises
    ------
    InputError
        If it is one, or cannot be opened, or what lies beside it cannot be read as a file.
    """
    _refuse_pipes(path)
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
    if head.startswith(_DATABASE) and not raster:
        _refuse_computed(path)


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


def _refuse_pipes(path: Path) -> None:
    """Refuse what GDAL would wait for: it opens journals, tables and headers beside a file."""
    inside = path.is_dir()
    for beside in path.iterdir() if inside else path.parent.glob(f"{escape(path.stem)}*"):
        if beside.exists() and not (beside.is_file() or beside.is_dir()):
            where = "in it" if inside else "beside it"
            text = f"{beside.name} {where} is a pipe or a device, and no file: remove it"
            raise InputError(str(path), text)


_COMPUTED: Final = """
SELECT name, 'view' FROM sqlite_master WHERE type = 'view'
UNION ALL SELECT name, 'virtual table' FROM sqlite_master
    WHERE sql LIKE 'CREATE VIRTUAL TABLE%' AND sql NOT LIKE '%USING%rtree%'
UNION ALL SELECT of.name, 'table with generated columns' FROM sqlite_master AS of
    JOIN pragma_table_xinfo(of.name) AS held
    WHERE of.type = 'table' AND of.sql NOT LIKE 'CREATE VIRTUAL%' AND held.hidden IN (2, 3)
"""
"""Query for what has values that are not in the file but made when it is read."""


def _refuse_computed(path: Path) -> None:
    """Refuse a database whose shapes a query makes: it may never end, or fill the memory."""
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
    with read_as("shapes", path):
        with closing(sqlite3.connect(uri, uri=True)) as database:
            found = {str(name): what for name, what in database.execute(_COMPUTED)}
        if not found:
            return
        own = {name for name in found if name.lower().startswith("gpkg_")}
        layers = [] if own else pyogrio.list_layers(path)
    computed = own or found.keys() & {name for name, kind in layers if kind is not None}
    if computed:
        name = min(computed)
        raise InputError(
            str(path),
            f"{name} is a {found[name]}, whose values are made as it is read: write them to a plain"
            " table, in a GeoPackage of their own (ogr2ogr)",
        )
