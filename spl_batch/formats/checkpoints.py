"""Checkpoints of a field survey: CSV or any vector format, on the axes of the survey's CRS.

A checkpoint is a point whose height was measured better than the product's. A fault leaves out that
checkpoint alone, in a sentence that names it.
"""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Any, Final, Literal, TextIO

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError, ProjError

from spl_batch.errors import InputError, as_input_fault, counted, named
from spl_batch.formats.crs import crs_name, horizontal, no_survey_crs, same_crs
from spl_batch.formats.heights import completed, heights_ratio, other_heights, unknown_unit
from spl_batch.formats.transformations import best_transformer
from spl_batch.formats.units import Units, in_words
from spl_batch.formats.vector_files import all_layers

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

SAME_POSITION_M: Final = 0.01
"""Checkpoints nearer to each other than this in every axis are one [m]."""

_NUMBERS: Final = frozenset({"x", "y", "z", "accuracy_m"})


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """A point of known height."""

    id: str  #: Its name in the field survey.
    #: x_m, y_m, z_m: easting, northing and height in the survey's CRS, converted to metres [m].
    x_m: float
    y_m: float
    z_m: float
    surface: Surface
    #: Its own vertical accuracy, one standard deviation [m]; None where nothing states it.
    accuracy_m: float | None


_Row = dict[str, Any]


def read_checkpoints(
    path: Path, crs: CRS | None, own: CRS | None = None, accuracy_m: float | None = None
) -> tuple[list[Checkpoint], list[str], list[str]]:
    """Checkpoints of a file on the axes of the survey's CRS, in metres.

    Parameters
    ----------
    path : Path
        Table with the columns :data:`COLUMNS`, see :func:`table`, or points of any vector format
        that GDAL reads with the same fields; there ``x``, ``y`` and, if the points are 3D, ``z``
        come from the geometry.
    own : CRS, optional
        The file's, where neither a column ``crs`` nor the format has it, and that of heights where
        these name none beside the same eastings; by default the survey's.
    accuracy_m : float, optional
        Accuracy of checkpoints that state none [m].

    Returns
    -------
    checkpoints : list of Checkpoint
        Those that can be used, in the file's order.
    remarks : list of str
        One sentence for each kind of fault, with the checkpoints that it concerns.
    units : list of str
        Units that heights are in, by PROJ's names: of the file's CRS, else of the survey's.

    Raises
    ------
    InputError
        If the file as a whole cannot be used.
    """
    if not path.exists():
        raise InputError(str(path), "no such file; check reference.checkpoints")
    is_csv = path.suffix.lower() in {".csv", ".txt"}
    rows = _csv_rows(path) if is_csv else list(_vector_rows(path))
    if not rows:
        raise InputError(
            str(path), "holds no checkpoints: no line below the first, no layer of points"
        )
    remarks: list[str] = []
    if not any("surface" in row for row in rows):
        rows = [{**row, "surface": "open"} for row in rows]
    kept = _checked(rows, accuracy_m, remarks)
    moved, units = _in_crs(path, kept, crs, own, remarks)
    to_m = np.array(Units.of(crs).xyz_m)
    moved = [{**row, "xyz": (np.array(row["xyz"]) * to_m).tolist()} for row in moved]
    found = [
        Checkpoint(row["id"], x, y, z, row["surface"], row["accuracy_m"])
        for row in _once(moved, remarks)
        for x, y, z in [row["xyz"]]
    ]
    return found, remarks, units


def _csv_rows(path: Path) -> list[_Row]:
    with (
        as_input_fault(path, "is no CSV of text in UTF-8"),
        path.open(newline="", encoding="utf-8-sig") as stream,
    ):
        reader = table(stream)
        names = {name: (name or "").strip("# ").lower() for name in reader.fieldnames or ()}
        _refuse_without(path, names.values())
        rows = [{names[key]: row[key] for key in row if key in names} for row in reader]
    if reader.reader.dialect.delimiter != ",":  # it may be the decimal sign
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


def _refuse_without(path: Path, names: Iterable[str]) -> None:
    lacking = [name for name in COLUMNS if name not in {*names, "surface"}]
    if lacking:
        raise InputError(
            str(path),
            f"lacks the columns {named(lacking)}; rename its columns to "
            f"{','.join(COLUMNS)},accuracy_m",
        )


def _vector_rows(path: Path) -> Iterator[_Row]:
    for layer in all_layers(path, fields=True):
        if "Point" not in layer.kind:
            continue
        # Many programs write nothing but MultiPoints; of one with several points there is no x.
        alone = shapely.get_num_geometries(layer.shapes) == 1
        points = np.where(alone, shapely.get_geometry(layer.shapes, 0), None)
        there = ~shapely.is_missing(points) & ~shapely.is_empty(points)
        xyz = {"x": shapely.get_x(points), "y": shapely.get_y(points)}
        if shapely.has_z(points[there]).all():
            xyz["z"] = shapely.get_z(points)
        columns = {"crs": np.full(len(points), layer.crs, object), **layer.fields, **xyz}
        _refuse_without(path, columns)
        for k in range(len(points)):
            yield {name: column[k] for name, column in columns.items()}


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
        xyz = [_number(row.get(axis)) for axis in "xyz"]
        word = str(row.get("surface") or "").strip()
        accuracy = str(row.get("accuracy_m") or "").strip().replace("nan", "")  # null of GDAL's
        own = _number(accuracy) if accuracy else accuracy_m
        if None in xyz:
            faults.setdefault("there is no single point with finite x, y and z", []).append(name)
        elif word.lower() not in SURFACES:
            why = "the surface is neither open nor vegetated"
            faults.setdefault(why, []).append(f"{name} ({word!r})")
        elif accuracy and (own is None or own <= 0):
            why = "accuracy_m is no positive number of metres"
            faults.setdefault(why, []).append(f"{name} ({accuracy!r})")
        else:
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


def _left_out(names: Sequence[str], why: str) -> str:
    noun = "checkpoint is" if len(names) == 1 else "checkpoints are"
    return f"{len(names)} {noun} left out, as {why}: {named(names)}"


def _once(rows: Sequence[_Row], remarks: list[str]) -> Iterator[_Row]:
    """Rows whose name and position no earlier one has."""
    known: set[str | tuple[int, ...]] = set()
    again: list[str] = []
    for row in rows:
        position = tuple(round(value / SAME_POSITION_M) for value in row["xyz"])
        if {row["id"], position} & known:
            again.append(row["id"])
            continue
        known |= {row["id"], position}
        yield row
    if again:
        remarks.append(_left_out(again, "an earlier one has the name or position"))


def _in_crs(
    path: Path, rows: Sequence[_Row], crs: CRS | None, own: CRS | None, remarks: list[str]
) -> tuple[list[_Row], list[str]]:
    """Rows with coordinates in the survey's CRS, in their order; units that heights were in."""
    placed: dict[int, _Row] = dict(enumerate(rows))
    units: dict[str, None] = {}
    names = [str(row.get("crs") or "").strip() for row in rows]
    for stated in dict.fromkeys(names):
        members = [k for k, name in enumerate(names) if name == stated]
        try:
            source = completed(CRS.from_user_input(stated), own) if stated else own
        except CRSError:
            why = f"the CRS {stated!r} is not known"
            remarks.append(_left_out([placed.pop(k)["id"] for k in members], why))
            continue
        units[Units.of(source or crs).vertical] = None
        if source is None:
            continue
        if crs is None:
            raise InputError(str(path), no_survey_crs(source))
        ratio, heights = _ratio(path, source, crs), other_heights(source, crs)
        if same_crs(source, crs) and not heights and ratio == 1.0:
            continue
        whence = f"from {crs_name(source)} to {crs_name(crs)}"
        xyz = np.array([rows[k]["xyz"] for k in members], float)
        xyz[:, 2] *= 1.0 if heights else ratio
        lost = []
        for k, moved in zip(members, _transformed(path, source, crs, xyz), strict=True):
            placed[k] = {**rows[k], "xyz": moved.tolist()}
            if not np.isfinite(moved).all():
                lost.append(placed.pop(k)["id"])
        if lost:
            remarks.append(_left_out(lost, f"they cannot be transformed {whence}"))
        if count := len(members) - len(lost):
            unit, ours = (in_words(Units.of(one).vertical) for one in (source, crs))
            how = "heights too" if heights else "heights are taken as they are"
            how = how if unit == ours else f"heights from {unit} to {ours}"
            remarks.append(f"{counted(count, 'checkpoints', 'are')} transformed {whence}; {how}")
    return list(placed.values()), list(units)


def _ratio(path: Path, source: CRS, crs: CRS) -> float:
    """Units of the survey's heights in one of the file's; InputError where nothing states it."""
    ratio = heights_ratio(source, crs)
    if ratio is None:
        fault = unknown_unit(source, crs, "name it in reference.checkpoints_crs:")
        raise InputError(str(path), fault)
    return ratio


def _transformed(
    path: Path, source: CRS, crs: CRS, xyz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Coordinates in another CRS, (n, 3); infinite where one of them cannot be transformed."""
    whole = bool(other_heights(source, crs))
    ends = (source, crs) if whole else (horizontal(source), horizontal(crs))
    try:
        transformer = best_transformer(*ends)
        x, y, z = xyz.T
        x, y, z = transformer.transform(x, y, z, errcheck=whole and len(xyz) == 1)
    except ProjError as error:
        raise InputError(
            str(path),
            f"cannot be transformed from {crs_name(source)} to {crs_name(crs)} ({error}): give the "
            "checkpoints in the survey's CRS, or give PROJ the grid that it lacks",
        ) from None
    return np.column_stack([x, y, z if whole else xyz[:, 2]])
