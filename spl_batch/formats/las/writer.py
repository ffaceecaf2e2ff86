"""Writer of classified clouds: what the input had is kept, labels come beside it.

Output is LAS 1.4, point formats 6-10, compressed. The same input and labels give the same bytes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.constants import (
    CLASS_GROUND,
    CLASS_UNCLASSIFIED,
    FLAG_WITHHELD,
    NOISE_NOT_ASSESSED,
    QUANTA_PER_M,
    QUANTUM_M,
)
from spl_batch.errors import WorkflowError
from spl_batch.formats.gps_clock import TimeStandard, time_standard, usable_times
from spl_batch.formats.las.chunks import RecordReader
from spl_batch.formats.las.convert import conversion
from spl_batch.formats.las.copc import write_copc
from spl_batch.formats.las.frame import (
    HEADER_SIZE,
    Extent,
    Frame,
    copied_encoding,
    preamble,
    wkt_vlr,
    write_laz,
    write_packed,
)
from spl_batch.formats.las.header import (
    ADJUSTED_BIT,
    WKT_BIT,
    LasHeader,
    Vlr,
    read_header,
)
from spl_batch.formats.las.known_records import kept_records
from spl_batch.formats.las.layers import LayerCopy, can_be_copied
from spl_batch.formats.las.records import (
    ADDED,
    FIRST_CLASS,
    HEIGHT,
    SCAN_ANGLE_STEP_DEG,
    ExtraDimension,
    RecordLayout,
    added,
    given_classes,
    new_dimension,
)
from spl_batch.formats.units import Units
from spl_batch.lattice.tables import PointFlag, PointTable

Labels = Callable[[int, int], Mapping[str, NDArray[Any]]]
"""Labels of points ``[start, stop)``: classification, noise_class and diagnostics."""

Kept = Callable[[NDArray[Any], Mapping[str, NDArray[Any]]], NDArray[np.bool_]]
"""Which labelled records are written, by them and their labels: (n,) bool."""

KEEP_CLASS: Final = 255
"""Label ``classification`` of a point that keeps the class of the input."""

KEEP_BUT_GROUND: Final = 254
"""The same, but ground of the input becomes unclassified: this project has not found it."""

SYNTHETIC_BIT: Final = 8
"""Bit of the global encoding: return numbers are synthetic."""

AGGREGATE_BIT: Final = 32
"""Bit 5 of the global encoding, the aggregate model of drafts of LAS 1.4 R14. The published
revisions dropped it for rules on single fields and reserve the bit [LAS 1.4 R15, 2.6]."""

_ONLY_RETURN: Final = 0x11
"""First of one return."""

_DIAGNOSTICS: Final = ("noise_density", "p_value")
_CHUNK: Final = 500_000
_POINT_FORMAT: Final = 6
_ORIGIN_STEP: Final = 1_000 * QUANTA_PER_M
_INT32: Final = np.iinfo(np.int32)


@dataclass(frozen=True, slots=True)
class Shifted:
    """Heights that are added to the points of a file, and its record of them."""

    #: Point source ids and times of n points -> what is added to them: (n,) [quanta].
    up_q: Callable[[NDArray[np.uint16], NDArray[np.float64]], NDArray[np.int32]]
    record: Vlr  #: What was done, for whoever gets the file.


@dataclass(frozen=True, slots=True)
class Decoded:
    """Facts of a file's points from whoever has decoded them before."""

    #: ``given(start, stop)`` is :func:`~spl_batch.formats.las.layers.given_of` of these records.
    given: Callable[[int, int], NDArray[np.uint32]]
    extent: Extent


def added_dimensions(
    layout: RecordLayout, *, diagnostics: bool, heights: bool = False
) -> list[ExtraDimension]:
    """Extra bytes that a copy of records gets: of an earlier output the first classes stay."""
    there = {d.descriptor for d in layout.extra}
    left_out = {*_DIAGNOSTICS * (not diagnostics), *(HEIGHT,) * (not heights)}
    found = (added(n) for n in ADDED if n not in left_out)
    return [d for d in found if d.name != FIRST_CLASS or d.descriptor not in there]


def write_classified(
    src: Path,
    dst: Path,
    *,
    labels: Labels,
    diagnostics: bool,
    crs: CRS | None,
    flags: bool = False,
    heights: bool = False,
    decoded: Decoded | None = None,
    classes: NDArray[np.int64] | None = None,
    shifted: Shifted | None = None,
    standard: TimeStandard = "none",
    kept: Kept | None = None,
) -> int:
    """Copy a file with new classes and the extra bytes of :data:`ADDED`; points written [count].

    Every point comes once and in order, with all its dimensions, raw coordinates, scale and offset.
    Point formats 0-5 become 6-10. Records are kept, but for those that describe the old packing
    (LASzip, COPC) or that no reader could parse
    (:func:`~spl_batch.formats.las.known_records.broken_records`). Formats 6-10 know no GeoTIFF
    keys: a CRS in these is given as WKT as well. Of an earlier output of this function
    ``input_classification`` is kept; other dimensions of :data:`ADDED` are replaced or left out.

    Parameters
    ----------
    src, dst : Path
        Input; output, whose folder is made where it is missing.
    labels : callable
        ``labels(start, stop)`` gives ``classification`` (:data:`KEEP_CLASS` and
        :data:`KEEP_BUT_GROUND` keep the input's) and ``noise_class`` (uint8) and, with
        diagnostics, ``noise_density`` and ``p_value`` (float32) of these points.
    crs : CRS or None
        The survey's, for an input that carries none, or none that is understood; where it is a
        compound one an input without a vertical datum gets that one beside its own.
    flags : bool
        Whether labels have ``set_flags`` (uint8): classification flags that are set beside those
        of the input.
    heights : bool
        Whether labels have ``HeightAboveGround`` (float32).
    decoded : Decoded, optional
        Spares decoding a file of which :func:`~spl_batch.formats.las.layers.can_be_copied` holds:
        what is not changed is copied as it is compressed.
    classes : (2, 256) int64 ndarray, optional
        The points of each class that is written are added to it: those whose ``noise_class`` is
        "not assessed", and the others [count].
    shifted : Shifted, optional
        Shifts that are added to the heights, rounded to the file's scale.
    standard : str
        What the values of ``gps_time`` are, for the header.
    kept : callable, optional
        Which points are written; all by default.

    Raises
    ------
    InputError
        If the input is damaged.
    WorkflowError
        If the output cannot be written, or is the input.
    """
    if dst.exists() and dst.samefile(src):
        raise WorkflowError(f"{dst}: is an input; choose another output folder")
    header = read_header(src)
    written = np.zeros((2, 256), np.int64) if classes is None else classes
    with RecordReader(header) as reader:
        new = added_dimensions(reader.layout, diagnostics=diagnostics, heights=heights)
        names = [d.name for d in new]
        convert = conversion(reader.layout, new)

        def chunks() -> Iterator[NDArray[Any]]:
            for start in range(0, header.n_points, _CHUNK):
                stop = min(start + _CHUNK, header.n_points)
                given = reader.read(start, stop)
                out = convert.records(given)
                if shifted is not None:
                    _shift(out, given, header, shifted, Units.of(crs).vertical_m)
                before = given_classes(given, reader.layout)
                values = labels(start, stop)
                _label(out, convert.layout, before, values, names)
                assessed = values["noise_class"] != NOISE_NOT_ASSESSED
                if kept is not None:
                    chosen = kept(out, values)
                    out, assessed = out[chosen], assessed[chosen]
                written[:] += _counts(out["classification"], assessed)
                yield out

        def packed(known: Decoded, copy: LayerCopy) -> Iterator[tuple[int, bytes]]:
            for start, stop, chunk in reader.packed_chunks():
                own, first = copy.records(known.given(start, stop)), copy.first(chunk)
                before, values = own["classification"].copy(), labels(start, stop)
                _label(own, copy.own, before, values, names)
                assessed = values["noise_class"] != NOISE_NOT_ASSESSED
                written[:] += _counts(own["classification"], assessed)
                of_first = {name: v[:1] for name, v in values.items()}
                _label(first, convert.layout, before[:1], of_first, names)
                yield stop - start, copy.chunk(chunk, first, own)

        vlrs, evlrs, wkt = kept_records(header, crs)
        if shifted is not None:
            vlrs.append(shifted.record)
        frame = Frame(
            preamble=preamble(header.raw, copied_encoding(header, standard, evlrs, wkt=wkt)),
            scales=header.scales,
            offsets=header.offsets,
            layout=convert.layout,
            vlrs=vlrs,
            evlrs=[(e, src) for e in evlrs],
        )
        changed = shifted is not None or kept is not None
        if decoded is None or changed or not can_be_copied(reader):
            return write_laz(dst, frame, chunks())
        copy = LayerCopy(reader, convert, len(names), flags=flags)
        return write_packed(dst, frame, copy.laz, decoded.extent, packed(decoded, copy))


def _shift(
    records: NDArray[Any], given: NDArray[Any], header: LasHeader, shifted: Shifted, unit_m: float
) -> None:
    """Add shifts to the heights of records; the flightlines are those of what was given."""
    timed = "gps_time" in (given.dtype.names or ())
    time = given["gps_time"] if timed else np.full(len(given), np.nan)
    up_q = shifted.up_q(given["point_source_id"], time)
    z = records["Z"] + np.rint(up_q / (header.scales[2] * unit_m * QUANTA_PER_M)).astype(np.int64)
    if len(z) and not _INT32.min <= z.min() <= z.max() <= _INT32.max:
        raise WorkflowError(
            f"{header.path}: with its shift z of some points does not fit into the file's "
            "numbers; give the file another offset, or set survey.align: none"
        )
    records["Z"] = z


def kept_classes(label: NDArray[np.uint8], given: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Classes of points by their labels and the classes that the input gave them."""
    unconfirmed = np.where(given == CLASS_GROUND, np.uint8(CLASS_UNCLASSIFIED), given)
    kept = np.where(label == KEEP_CLASS, given, unconfirmed)
    return np.where(label >= KEEP_BUT_GROUND, kept, label)


def _counts(classes: NDArray[np.uint8], assessed: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Points of each class that nothing assessed, and the others: (2, 256) [count]."""
    return np.bincount(assessed * 256 + classes.astype(np.int64), minlength=512).reshape(2, 256)


def _label(
    out: NDArray[Any],
    layout: RecordLayout,
    classes: NDArray[np.uint8],
    values: Mapping[str, NDArray[Any]],
    names: list[str],
) -> None:
    field = {d.name: d.field for d in layout.extra}
    given = np.asarray(values["classification"], dtype=np.uint8)
    out["classification"] = kept_classes(given, classes)
    if "set_flags" in values:
        out["classification_flags"] |= values["set_flags"]
    for name in names:
        out[field[name]] = classes if name == FIRST_CLASS else values[name]


def write_points(
    path: Path,
    table: PointTable,
    *,
    crs: CRS | None,
    extra: Mapping[str, NDArray[Any]] | None = None,
    copc: bool = False,
    aggregate: bool = False,
    aggregate_bit: bool = False,
    records_of_file: Sequence[Vlr] = (),
) -> int:
    """Write a table as LAZ or COPC, point format 6, to a thousandth of the CRS's unit.

    In metres that is the survey's lattice. The beamlet number goes to ``user_data``.

    Parameters
    ----------
    table : PointTable
        At least ``x, y, z``; columns of the model that it lacks are 0. ``classification``
        is the class, or else ``input_class``; where both are there the latter becomes
        ``input_classification``. Labels of :data:`ADDED` become extra bytes.
    extra : mapping of str to (n,) ndarray
        More extra bytes, numeric; these win over columns of the same name.
    copc : bool
        Write an octree (COPC) instead of plain LAZ; this changes the points' order.
    aggregate : bool
        Points are of an aggregate model, none of a pulse's returns: the header states that return
        numbers are synthetic, and each point is the only one.
    aggregate_bit : bool
        Set :data:`AGGREGATE_BIT` as well.
    records_of_file : sequence of Vlr
        Further records of its header.

    Raises
    ------
    WorkflowError
        If the output cannot be written.
    """
    labels: dict[str, NDArray[Any]] = {n: table[n] for n in ADDED if n in table}
    if "input_class" in table and "classification" in table:
        labels[FIRST_CLASS] = table["input_class"]
    labels |= extra or {}
    described = [
        new_dimension(n, np.asarray(v).dtype, ADDED[n][1] if n in ADDED else "")
        for n, v in labels.items()
    ]
    layout = conversion(RecordLayout(_POINT_FORMAT, ()), described).layout
    records = np.zeros(len(table), dtype=layout.dtype)
    offsets = [_set_axis(records, table, k, u, path) for k, u in enumerate(Units.of(crs).xyz_m)]
    _fill(records, table)
    if aggregate:
        records["bit_fields"] = _ONLY_RETURN
    for known, values in zip(layout.extra, labels.values(), strict=True):
        records[known.field] = values
    time = table["gps_time"] if "gps_time" in table else np.empty(0)
    time = time[usable_times(time)]
    standard = time_standard(time)
    head = bytearray(HEADER_SIZE)
    head[26:31] = b"OTHER"  # neither captured so nor one file that was changed
    encoding = WKT_BIT | SYNTHETIC_BIT * aggregate | AGGREGATE_BIT * aggregate_bit
    frame = Frame(
        preamble=preamble(
            bytes(head),
            encoding | ADJUSTED_BIT * (standard != "week"),
        ),
        scales=(QUANTUM_M, QUANTUM_M, QUANTUM_M),
        offsets=(offsets[0], offsets[1], offsets[2]),
        layout=layout,
        vlrs=[*([] if crs is None else [wkt_vlr(crs)]), *records_of_file],
    )
    return write_copc(path, frame, records) if copc else write_laz(path, frame, [records])


def _set_axis(
    records: NDArray[Any], table: PointTable, axis: int, unit_m: float, path: Path
) -> float:
    """Put one axis into the records; gives its offset, a whole number of thousand units."""
    values = np.rint(table["xyz"[axis]] / unit_m).astype(np.int64)
    if not len(values):
        return 0.0
    low, high = int(values.min()), int(values.max())
    fits = _INT32.min <= low and high <= _INT32.max
    origin = 0 if fits else low // _ORIGIN_STEP * _ORIGIN_STEP
    if high - origin > _INT32.max:
        span = f"{2000 * unit_m:.0f} km"
        raise WorkflowError(f"{path}: {'xyz'[axis]} spans more than {span}; write it in parts")
    records["XYZ"[axis]] = values - origin
    return float(origin // QUANTA_PER_M)


def _fill(records: NDArray[Any], table: PointTable) -> None:
    for name in ("intensity", "point_source_id", "gps_time", "channel"):
        if name in table:
            records["user_data" if name == "channel" else name] = table[name]
    if "return_number" in table:
        records["bit_fields"] = table["return_number"] & np.uint8(15)
    if "number_of_returns" in table:
        records["bit_fields"] |= table["number_of_returns"] << np.uint8(4)
    if "scan_angle" in table:
        records["scan_angle"] = np.rint(table["scan_angle"] / SCAN_ANGLE_STEP_DEG)
    if "flags" in table:
        records["classification_flags"] = table.has(PointFlag.WITHHELD) * np.uint8(FLAG_WITHHELD)
    if "set_flags" in table:
        records["classification_flags"] |= table["set_flags"]
    name = "classification" if "classification" in table else "input_class"
    if name in table:
        records["classification"] = table[name]
