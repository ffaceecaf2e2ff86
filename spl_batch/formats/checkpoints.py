"""Checkpoints of a field survey: CSV or any vector format, in the survey's CRS.

A checkpoint is a place whose height was measured better than the product's. A fault leaves out that
checkpoint alone, and is told in a sentence that names it.
"""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, isnan
from pathlib import Path
from typing import Any, Final, Literal, TextIO

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from spl_batch.errors import InputError, counted, named
from spl_batch.formats.crs import crs_name, horizontal, same_crs, vertical
from spl_batch.formats.gdal_files import read_as, refuse_referring

Surface = Literal["open", "vegetated"]
"""Whether heights there are non-vegetated (NVA) or vegetated (VVA) ones."""

SURFACES: Final[Mapping[str, Surface]] = {
    "open": "open",
    "nva": "open",
    "vegetated": "vegetated",
    "vva": "vegetated",
}
"""Words for a surface class in a file, in any case."""

COLUMNS: Final = ("id", "x", "y", "z", "surface")
"""Columns that a file has, ``surface`` unless all are open; others are optional."""

_NUMBERS: Final = frozenset({"x", "y", "z", "accuracy_m"})

PARTS: Final = "PARTS"
"""Points in the geometry of a row; fields are in lower case, so none has this name."""

SAME_PLACE_M: Final = 0.01
"""Checkpoints nearer to each other than this in every axis are one [m]."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A place of known height."""

    id: str  #: Its name in the field survey.
    #: x_m, y_m, z_m: easting, northing and height in the survey's CRS [m].
    x_m: float
    y_m: float
    z_m: float
    surface: Surface
    #: Its own vertical accuracy, one standard deviation [m]; None where nothing tells it.
    accuracy_m: float | None


_Row = dict[str, Any]


def read_checkpoints(
    path: Path, crs: CRS | None, own: CRS | None = None, accuracy_m: float | None = None
) -> tuple[list[Checkpoint], list[str]]:
    """Checkpoints of a file in the survey's CRS.

    Parameters
    ----------
    path : Path
        Table with the columns :data:`COLUMNS`, see :func:`table`, or points of any vector format
        that GDAL reads with the same fields; there ``x``, ``y`` and, if the points are 3D, ``z``
        come from the geometry.
    own : CRS, optional
        The file's, where neither a column ``crs`` nor the format tells it; by default the survey's.
    accuracy_m : float, optional
        Accuracy of checkpoints that state none [m].

    Returns
    -------
    checkpoints : list of Checkpoint
        Those that can be used, in the file's order.
    remarks : list of str
        One sentence for each kind of fault, with the checkpoints that it concerns.

    Raises
    ------
    InputError
        If the file as a whole cannot be used.
    """
    if not path.exists():
        raise InputError(str(path), "no such file; check reference.checkpoints")
    is_csv = path.suffix.lower() in {".csv", ".txt"}
    rows = _csv_rows(path) if is_csv else _vector_rows(path)
    if not rows:
        raise InputError(
            str(path), "holds no checkpoints: no line below the first, no layer of points"
        )
    remarks: list[str] = []
    if not any("surface" in row for row in rows):
        remarks.append("no column surface, so every checkpoint counts as open; add it for others")
        rows = [{**row, "surface": "open"} for row in rows]
    kept = _checked(rows, accuracy_m, remarks)
    moved = _in_crs(path, kept, crs, own, remarks)
    found = [_checkpoint(row) for row in _once(moved, remarks)]
    return found, remarks


def _checkpoint(row: _Row) -> Checkpoint:
    x_m, y_m, z_m = row["xyz"]
    return Checkpoint(row["id"], x_m, y_m, z_m, row["surface"], row["accuracy_m"])


def _csv_rows(path: Path) -> list[_Row]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = table(stream)
            names = {name: _plain(name) for name in reader.fieldnames or ()}
            _refuse_without(path, names.values())
            rows = [
                {names[key]: value for key, value in row.items() if key in names} for row in reader
            ]
    except (UnicodeDecodeError, csv.Error) as error:
        reason = " ".join(str(error).split())
        raise InputError(str(path), f"is no CSV of text in UTF-8: {reason}") from None

    if reader.reader.dialect.delimiter == ";":  # as where the comma is the decimal sign
        for row in rows:
            row |= {key: str(row[key]).replace(",", ".") for key in _NUMBERS & row.keys()}
    return rows


def table(stream: TextIO) -> "csv.DictReader[str]":
    """Rows of a CSV from its start; commas, semicolons, tabs or spaces part its columns."""
    head = stream.readline(65_536)
    stream.seek(0)
    delimiter = max(",;\t", key=head.count)
    if delimiter in head:
        return csv.DictReader(stream, delimiter=delimiter)
    lines = (line.strip("# ") for line in stream)
    return csv.DictReader(lines, delimiter=" ", skipinitialspace=True)


def _plain(name: str | None) -> str:
    """A column's name as :data:`COLUMNS` has it."""
    return (name or "").strip("# ").lower()


def _refuse_without(path: Path, names: Iterable[str]) -> None:
    there = set(names)
    lacking = [name for name in COLUMNS if name not in {*there, "surface"}]
    if lacking:
        raise InputError(
            str(path),
            f"lacks the columns {named(lacking)}; rename its columns to "
            f"{','.join(COLUMNS)},accuracy_m",
        )


def _vector_rows(path: Path) -> list[_Row]:
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    refuse_referring(path)
    rows: list[_Row] = []
    with read_as("points", path):
        for layer, kind in pyogrio.list_layers(path):
            if kind is None or "Point" not in kind:
                continue
            meta, _, wkb, columns = pyogrio.raw.read(path, layer=layer)
            fields = [str(name).lower() for name in meta["fields"]]
            points = _single(shapely.from_wkb(wkb))
            there = ~(shapely.is_missing(points) | shapely.is_empty(points))
            flat = not shapely.has_z(points[there]).all()
            _refuse_without(path, {*fields, "x", "y", *(() if flat else ("z",))})
            for k, point in enumerate(points):
                row = {name: column[k] for name, column in zip(fields, columns, strict=True)}
                row |= {"x": shapely.get_x(point), "y": shapely.get_y(point)}
                row |= {} if flat else {"z": shapely.get_z(point)}
                row[PARTS] = shapely.get_num_geometries(point)
                rows.append({"crs": meta["crs"], **row})
    return rows


def _single(shapes: NDArray[Any]) -> NDArray[Any]:
    """Shapes, single-part ones as that part: many programs write nothing but MultiPoints.

    Empty ones are none.
    """
    shapes = shapes.copy()
    shapes[shapely.is_empty(shapes)] = None
    alone = shapely.get_num_geometries(shapes) == 1
    return np.where(alone, shapely.get_geometry(shapes, 0), shapes)


def _number(value: Any) -> float | None:
    """A finite number; None for anything else."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if isfinite(number) else None


def _checked(rows: Sequence[_Row], accuracy_m: float | None, remarks: list[str]) -> list[_Row]:
    """Rows with usable values, converted."""
    kept: list[_Row] = []
    faults: dict[str, list[str]] = {}
    for number, row in enumerate(rows, start=1):
        name = str(row.get("id") or "").strip() or f"row {number}"
        word, said = (str(row.get(key) or "").strip() for key in ("surface", "accuracy_m"))
        xyz = [_number(row.get(axis)) for axis in "xyz"]
        if row.get(PARTS, 1) > 1:
            faults.setdefault(_SEVERAL, []).append(name)
        elif None in xyz:
            faults.setdefault(_NOWHERE, []).append(name)
        elif word.lower() not in SURFACES:
            faults.setdefault(_STRANGE, []).append(f"{name} ({word!r})")
        elif not _usable_accuracy(row.get("accuracy_m")):
            faults.setdefault(_UNSURE, []).append(f"{name} ({said!r})")
        else:
            own = _number(row.get("accuracy_m")) or accuracy_m
            known = {"id": name, "xyz": xyz, "surface": SURFACES[word.lower()], "accuracy_m": own}
            kept.append({**row, **known})
    remarks += [_left_out(names, why) for why, names in sorted(faults.items())]
    silent = [row["id"] for row in kept if row["accuracy_m"] is None]
    if 0 < len(silent) < len(kept):
        noun = "checkpoint states" if len(silent) == 1 else "checkpoints state"
        remarks.append(
            f"{len(silent)} {noun} no accuracy_m, without which there is no statement of accuracy; "
            f"fill it in, or set reference.checkpoints_accuracy_m: {named(silent)}"
        )
    return kept


_SEVERAL: Final = "a checkpoint is one point, not several"
_NOWHERE: Final = "x, y or z is no finite number"
_STRANGE: Final = "the surface is neither open nor vegetated"
_UNSURE: Final = "accuracy_m is no positive number of metres"


def _usable_accuracy(value: Any) -> bool:
    """Whether an accuracy is a positive number, or not given: empty, or null of a GeoPackage."""
    if value is None or not str(value).strip() or (isinstance(value, float) and isnan(value)):
        return True
    number = _number(value)
    return number is not None and number > 0


def _left_out(names: Sequence[str], why: str) -> str:
    noun = "checkpoint is" if len(names) == 1 else "checkpoints are"
    return f"{len(names)} {noun} left out, as {why}: {named(names)}"


def _once(rows: Sequence[_Row], remarks: list[str]) -> Iterator[_Row]:
    """Rows whose name and place no earlier one has."""
    names: set[str] = set()
    places: set[tuple[int, ...]] = set()
    again: list[str] = []
    for row in rows:
        place = tuple(round(value / SAME_PLACE_M) for value in row["xyz"])
        if row["id"] in names or place in places:
            again.append(row["id"])
            continue
        names.add(row["id"])
        places.add(place)
        yield row
    if again:
        remarks.append(_left_out(again, "an earlier one has the name or place"))


def _in_crs(
    path: Path, rows: Sequence[_Row], crs: CRS | None, own: CRS | None, remarks: list[str]
) -> list[_Row]:
    """Rows with coordinates in the survey's CRS, in their order."""
    by_crs: dict[str, list[int]] = {}
    for k, row in enumerate(rows):
        by_crs.setdefault(str(row.get("crs") or "").strip(), []).append(k)
    placed: dict[int, _Row] = dict(enumerate(rows))
    for stated, members in by_crs.items():
        try:
            source = CRS.from_user_input(stated) if stated else own
        except CRSError:
            why = f"the CRS {stated!r} is not known"
            remarks.append(_left_out([placed.pop(k)["id"] for k in members], why))
            continue
        heights = source is not None and crs is not None and _heights_differ(source, crs)
        if source is None or crs is None or (same_crs(source, crs) and not heights):
            continue
        moved = _transformed(path, source, crs, np.array([rows[k]["xyz"] for k in members], float))
        whence = f"from {crs_name(source)} to {crs_name(crs)}"
        lost = [k for k, xyz in zip(members, moved, strict=True) if not np.isfinite(xyz).all()]
        for k, xyz in zip(members, moved, strict=True):
            placed[k] = {**rows[k], "xyz": xyz.tolist()}
        if lost:
            names = [placed.pop(k)["id"] for k in lost]
            remarks.append(_left_out(names, f"they cannot be transformed {whence}"))
        if count := len(members) - len(lost):
            how = "heights too" if heights else "heights are taken as they are"
            are = counted(count, "checkpoints", "are")
            remarks.append(f"{are} transformed {whence}; {how}")
    return list(placed.values())


def _heights_differ(one: CRS, other: CRS) -> bool:
    first, second = vertical(one), vertical(other)
    return first is not None and second is not None and not first.equals(second)


def _transformed(
    path: Path, source: CRS, crs: CRS, xyz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Places in another CRS, (n, 3); infinite where one of them cannot be transformed."""
    whole = _heights_differ(source, crs)
    ends = (source, crs) if whole else (horizontal(source), horizontal(crs))
    try:
        # Without the grid of a geoid PROJ would leave heights as they are and keep silent.
        transformer = Transformer.from_crs(*ends, always_xy=True, only_best=whole)
        x, y, z = xyz.T
        moved = transformer.transform(x, y, z, errcheck=whole and len(xyz) == 1)
    except ProjError as error:
        raise InputError(
            str(path),
            f"cannot be transformed from {crs_name(source)} to {crs_name(crs)} ({error}): give the "
            "checkpoints in the survey's CRS, or put the grid that PROJ lacks into its data folder",
        ) from None
    return np.column_stack([*moved[:2], moved[2] if whole else xyz[:, 2]])
