"""Reader of LAS, LAZ and COPC: facts without the points, and points as a stream.

Coordinates become integers on the survey lattice. That is exact integer arithmetic where scale and
offset are whole multiples of the quantum; elsewhere they are rounded to the nearest quantum, and a
warning reports it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.constants import CLASS_HIGH_NOISE, CLASS_LOW_NOISE, QUANTA_PER_M
from spl_batch.errors import InputError, as_input_fault
from spl_batch.formats.las.chunks import RecordReader
from spl_batch.formats.las.header import ADJUSTED_BIT, LasHeader, read_header
from spl_batch.formats.las.known_records import header_crs
from spl_batch.formats.las.layers import can_be_copied
from spl_batch.formats.las.records import (
    FIRST_CLASS,
    FIRST_EXTENDED_FORMAT,
    SCAN_ANGLE_STEP_DEG,
    RecordLayout,
    added,
    dimension,
    given_classes,
    record_layout,
)
from spl_batch.formats.units import METRES, Units
from spl_batch.lattice.tables import COLUMNS, EXCLUDED, SOURCE_COLUMNS, PointFlag, PointTable

_BBOX_SLACK_M: Final = 1.0
_MULTIPLE_TOLERANCE: Final = 1e-12
_OFFSET_TOLERANCE: Final = 1e-6


@dataclass(frozen=True)
class LasFacts:
    """A LAS file by its header; its points are not read."""

    path: Path
    size_bytes: int
    n_points: int
    version: tuple[int, int]
    point_format: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    #: The header's bounding box, finite and in order; zeros where there are no points. In the
    #: unit of its CRS until :meth:`in_metres`.
    mins_m: tuple[float, float, float]
    maxs_m: tuple[float, float, float]
    crs: CRS | None  #: From the WKT record or from GeoTIFF keys.
    #: Meaning of ``gps_time`` by the header; not always true of the values.
    adjusted_standard_bit: bool
    has_gps_time: bool
    dimensions: tuple[str, ...]  #: Names that ``channel_dimension`` may take.
    warnings: tuple[str, ...]  #: Oddities that do not stop the work; each is one sentence.
    #: That coordinates are not whole millimetres, which in feet none are: one sentence, or none.
    rounding: tuple[str, ...]
    #: Whether :mod:`spl_batch.formats.las.layers` knows how its points are compressed.
    layers_can_be_copied: bool

    def in_metres(self, units: Units) -> "LasFacts":
        """The same with the box in metres; scales and offsets stay in the file's units."""
        if units.are_metres:
            return self
        low, high = units.metres(np.array([self.mins_m, self.maxs_m])).tolist()
        return replace(self, mins_m=tuple(low), maxs_m=tuple(high), rounding=())

    @property
    def area_m2(self) -> float:
        """Area of the header's box [m2]."""
        return (self.maxs_m[0] - self.mins_m[0]) * (self.maxs_m[1] - self.mins_m[1])


def inspect(path: Path) -> LasFacts:
    """Facts of a LAS, LAZ or COPC file from header, VLRs and chunk table.

    ``path``: the file; a few kilobytes of it are read.

    Raises
    ------
    InputError
        With every fault of the file, each with its remedy.
    """
    with as_input_fault(path):
        header = read_header(path)
        with RecordReader(header) as reader:
            layout, layered = reader.layout, can_be_copied(reader)
        empty = () if header.n_points else ("the file holds no points",)
        crs, crs_warnings = header_crs(header)
        return LasFacts(
            path=path,
            size_bytes=header.size_bytes,
            n_points=header.n_points,
            version=header.version,
            point_format=header.point_format,
            scales=header.scales,
            offsets=header.offsets,
            mins_m=header.mins_m if header.n_points else (0.0, 0.0, 0.0),
            maxs_m=header.maxs_m if header.n_points else (0.0, 0.0, 0.0),
            crs=crs,
            adjusted_standard_bit=bool(header.global_encoding & ADJUSTED_BIT),
            has_gps_time="gps_time" in layout.names,
            dimensions=layout.names,
            warnings=(*empty, *crs_warnings),
            rounding=tuple(_rounding(header)),
            layers_can_be_copied=layered,
        )


def is_delivered(path: Path) -> bool:
    """Whether a file is a copy with labels that a run has made, by its extra bytes."""
    described = {one.descriptor for one in record_layout(read_header(path)).extra}
    return described >= {added(name).descriptor for name in (FIRST_CLASS, "noise_class")}


def promised_points(path: Path) -> int:
    """Points of a file by its header, whatever else is wrong with it; 0 if the header is, too."""
    try:
        return read_header(path).n_points
    except InputError:
        return 0


def _rounding(header: LasHeader) -> Iterator[str]:
    """Say that coordinates are rounded; in words that files of other offsets share."""
    if all(_whole(header.scales[a], header.offsets[a]) is not None for a in range(3)):
        return
    steps = all(_whole(scale, 0.0) is not None for scale in header.scales)
    what = "the offset is" if steps else f"the scale {header.scales} is"
    yield (
        f"{what} not whole millimetres: working coordinates are rounded to the nearest millimetre"
    )


def iter_points(
    path: Path,
    *,
    channel_dimension: str | None,
    source: int,
    start: int = 0,
    stop: int | None = None,
    chunk: int = 1_000_000,
    watch: Callable[[NDArray[Any], RecordLayout], None] | None = None,
    units: Units = METRES,
) -> Iterator[PointTable]:
    """Points of a file in its own order, as tables of bounded length.

    Parameters
    ----------
    path : Path
        LAS, LAZ or COPC.
    channel_dimension : str or None
        Dimension with the beamlet number; none gives channel 0.
    source : int
        Key of the file, for the column ``source``.
    start, stop : int
        Range of points, half-open; by default all.
    watch : callable, optional
        Is given the records of each table, and their layout, before it comes.
    units : Units
        Of the survey's CRS, which the file has or lacks.

    Yields
    ------
    PointTable
        With :data:`~spl_batch.lattice.tables.SOURCE_COLUMNS`.

    Raises
    ------
    InputError
        If the file is damaged, or the channel dimension is missing or not in 0..255;
        messages name the points.
    """
    header = read_header(path)
    layout = record_layout(header)
    if channel_dimension is not None and channel_dimension not in layout.names:
        raise InputError(
            str(path),
            f"has no dimension {channel_dimension!r} for survey.channel_dimension;"
            f" there are {', '.join(layout.names)}",
        )
    end = header.n_points if stop is None else min(stop, header.n_points)
    with RecordReader(header) as reader:
        for first in range(start, end, chunk):
            records = reader.read(first, min(first + chunk, end))
            if watch is not None:
                watch(records, layout)
            x, y, z = (coordinate(records, header, axis, first, units) for axis in range(3))
            channel = _channel(records, header, layout, channel_dimension, first)
            base = {"x": x, "y": y, "z": z, "channel": channel}
            base["source"] = np.full(len(records), source, dtype=np.uint64)
            base["index"] = np.arange(first, first + len(records))
            columns = base | _attributes(records, layout)
            yield PointTable(
                {k: np.ascontiguousarray(columns[k], COLUMNS[k].dtype) for k in SOURCE_COLUMNS}
            )


SAMPLE_POINTS: Final = 4096
"""Points that are looked at of each end of a file [count]: of an SPL100 a tenth of a second."""


_CHANNEL_MAX: Final = 255
"""Largest number of a beamlet."""

_FREE: Final = ("user_data", "intensity")
"""Standard dimensions that deliveries use for beamlet numbers; others mean what LAS states."""


class Numbers(NamedTuple):
    """What a dimension holds in some points."""

    low: int
    high: int
    different: int
    points: int  #: Points that were looked at [count].
    most: int  #: Points that share the most frequent value [count].


class Ends(NamedTuple):
    """Times and channels of some points from both ends of a file, (n,) each."""

    gps_time: NDArray[np.float64]  #: (n,): not finite where the file has none [s].
    channel: NDArray[Any]  #: (n,) uint8: beamlet numbers.
    numbers: dict[str, Numbers]  #: Dimensions that hold small whole numbers, by name.
    classes: tuple[int, ...]  #: Classifications that occur.
    sources: tuple[int, ...]  #: Values of ``point_source_id`` that occur.
    used: bool  #: Whether any of them is neither withheld nor noise of the vendor's.


def read_ends(path: Path, channel_dimension: str | None, count: int) -> Ends:
    """Look at the first points of a file, and at those where its last chunk starts.

    Parameters
    ----------
    path : Path
        LAS, LAZ or COPC.
    channel_dimension : str or None
        Dimension with the beamlet number, which the file has; none gives channel 0.

    Raises
    ------
    InputError
        If they are damaged, or the channels are not in 0..255; in the words of
        :func:`iter_points`.
    """
    with as_input_fault(path), RecordReader(read_header(path)) as reader:
        pieces, layout, header = reader.read_ends(count), reader.layout, reader.header
    for first, some in pieces:
        for axis in range(3):
            coordinate(some, header, axis, first)
    channel = np.concatenate(
        [_channel(some, header, layout, channel_dimension, first) for first, some in pieces]
    )
    records = np.concatenate([some for _, some in pieces])
    seen = _attributes(records, layout)
    classes, sources = (np.unique(seen[name]) for name in ("input_class", "point_source_id"))
    return Ends(
        seen["gps_time"].astype(np.float64),
        channel,
        _small_numbers(records, layout),
        tuple(classes.tolist()),
        tuple(sources.tolist()),
        bool(np.any(seen["flags"] & EXCLUDED == 0)),
    )


def _small_numbers(records: NDArray[Any], layout: RecordLayout) -> dict[str, Numbers]:
    """Dimensions whose values are whole numbers from 0 to 255, by name.

    ``records``: (n,) structured, point records of this layout.
    """
    found: dict[str, Numbers] = {}
    if not len(records):
        return found
    for name in (*_FREE, *(extra.name for extra in layout.extra)):
        values = dimension(records, layout, name)
        if values.ndim > 1 or values.dtype.kind not in "ui":
            continue
        low, high = int(values.min()), int(values.max())
        if low >= 0 and high <= _CHANNEL_MAX:
            counts = np.bincount(values.astype(np.int64))
            different = int(np.count_nonzero(counts))
            found[name] = Numbers(low, high, different, len(values), int(counts.max()))
    return found


def _attributes(records: NDArray[Any], layout: RecordLayout) -> dict[str, NDArray[Any]]:
    classes = given_classes(records, layout)
    withheld = dimension(records, layout, "withheld") != 0
    noise = (classes == CLASS_LOW_NOISE) | (classes == CLASS_HIGH_NOISE)
    timed = "gps_time" in layout.names
    if layout.point_format < FIRST_EXTENDED_FORMAT:
        angle_deg = records["scan_angle_rank"]
    else:
        angle_deg = records["scan_angle"] * SCAN_ANGLE_STEP_DEG
    return {
        "gps_time": records["gps_time"] if timed else np.full(len(records), np.nan),
        "return_number": dimension(records, layout, "return_number"),
        "number_of_returns": dimension(records, layout, "number_of_returns"),
        "scan_angle": angle_deg,
        "point_source_id": records["point_source_id"],
        "intensity": records["intensity"],
        "input_class": classes,
        "flags": withheld * int(PointFlag.WITHHELD) | noise * int(PointFlag.VENDOR_NOISE),
    }


def _whole(scale: float, offset: float) -> tuple[int, int] | None:
    """Scale and offset in whole quanta; none where they are not whole."""
    step, base = scale * QUANTA_PER_M, offset * QUANTA_PER_M
    whole_step, whole_base = round(step), round(base)
    if whole_step < 1 or abs(step / whole_step - 1) > _MULTIPLE_TOLERANCE:
        return None
    if abs(base - whole_base) > _OFFSET_TOLERANCE:
        return None
    return whole_step, whole_base


def coordinate(
    records: NDArray[Any], header: LasHeader, axis: int, first: int, units: Units = METRES
) -> NDArray[np.int64]:
    """Coordinates of one axis on the lattice [quanta]: (n,) int64.

    A point well outside the header's bounding box means damaged data, against which LAZ has no
    checksum, or a box that the plan must not rely on.
    """
    raw = records["XYZ"[axis]]
    scale, offset, unit_m = header.scales[axis], header.offsets[axis], units.xyz_m[axis]
    whole = _whole(scale, offset) if unit_m == 1.0 else None
    quanta: NDArray[np.int64]
    if whole is not None:
        quanta = raw.astype(np.int64) * whole[0] + whole[1]
    else:
        quanta = np.rint((raw * scale + offset) * unit_m * QUANTA_PER_M).astype(np.int64)
    slack = _BBOX_SLACK_M * QUANTA_PER_M
    _refuse_beyond(quanta, header, axis, first, (unit_m * QUANTA_PER_M, slack))
    return quanta


def own_coordinate(
    records: NDArray[Any], header: LasHeader, axis: int, first: int
) -> NDArray[np.float64]:
    """Coordinates of one axis in the cloud's unit, as every reader has them: (n,) float64.

    Points outside the header's box are refused as by :func:`coordinate`.
    """
    found = records["XYZ"[axis]] * header.scales[axis] + header.offsets[axis]
    _refuse_beyond(found, header, axis, first, (1.0, _BBOX_SLACK_M))
    return found


def _refuse_beyond(
    values: NDArray[Any], header: LasHeader, axis: int, first: int, scaled: tuple[float, float]
) -> None:
    """Refuse coordinates of an axis, scaled, that lie beyond the header's box and a slack."""
    per_unit, slack = scaled
    low, high = header.mins_m[axis] * per_unit - slack, header.maxs_m[axis] * per_unit + slack
    if len(values) and (values.min() < low or values.max() > high):
        where = int(np.argmax((values < low) | (values > high)))
        raise InputError(
            str(header.path),
            f"point {first + where} has {'xyz'[axis]} {values[where] / per_unit},"
            f" outside the header's {header.mins_m[axis]} to {header.maxs_m[axis]}: the points are"
            " damaged,"
            " copy the file again; or the header is wrong, repair it (lasinfo -repair_bb)",
        )


def _channel(
    records: NDArray[Any], header: LasHeader, layout: RecordLayout, name: str | None, first: int
) -> NDArray[Any]:
    if name is None:
        return np.zeros(len(records), dtype=np.uint8)
    values = dimension(records, layout, name)
    if values.ndim > 1:
        fault = f"dimension {name!r} has {values.shape[1]} values a point; a channel is one"
        raise InputError(str(header.path), fault)
    if values.dtype == np.uint8:
        return values
    wrong = ~((values >= 0) & (values <= _CHANNEL_MAX) & (values == np.rint(values)))
    if wrong.any():
        where = int(np.argmax(wrong))
        raise InputError(
            str(header.path),
            f"dimension {name!r} is {values[where]} at point {first + where}; a channel is a whole"
            " number 0 to 255: name another one in survey.channel_dimension",
        )
    return values
