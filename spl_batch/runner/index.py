"""Stage ``index``: what is in each input file, its points by time; the trajectory in one piece."""

import hashlib
from collections.abc import Mapping
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.io.atomic import checksum
from spl_batch.io.gpstime import bit_warning, time_standard
from spl_batch.io.las import inspect, iter_points
from spl_batch.io.las_frame import Extent
from spl_batch.io.las_layers import GIVEN, given_of
from spl_batch.io.tables import read_arrays, write_arrays, writing
from spl_batch.io.trajectory import PointExtent, gathering, write_trajectory
from spl_batch.io.trajectory_files import Records
from spl_batch.model import COLUMNS, EXCLUDED, PointFlag, PointTable, rows_of
from spl_batch.runner.context import Context, Produced
from spl_batch.runner.rate import Rate
from spl_batch.runner.stretches import KEPT_COLUMNS, add_points
from spl_batch.runner.unchanged import unchanged
from spl_batch.stages.geometry import (
    estimate_prf,
    heading_from_track,
    merge_track,
    observe_track,
    ordered_times,
    shot_steps,
)

Track = dict[str, NDArray[np.int64]]

POSITIONS_S = 64
"""Span of the trajectory that has one hash [s]: what reads of it is done again if that changes."""

CHUNK_POINTS = 1 << 18
"""Points read at once from an input file [count]."""


_TIMED = ("gps_time", "point_source_id", "x", "y", "scan_angle")
"""Columns that say when and whereto a flightline was flown."""


class _Tally:
    """Running totals over the chunks of one file."""

    def __init__(self, gap_s: float) -> None:
        self.gap_s = gap_s
        self.counts: dict[str, int] = dict.fromkeys(
            ("points", "timeless", "withheld", "vendor_noise", "excluded"), 0
        )
        self.spans: dict[int, list[list[float]]] = {}
        self.steps: dict[int, NDArray[np.int64]] = {}
        self.tracks: dict[int, Track] = {}
        self.rates: dict[int, Rate] = {}
        self.low = np.full(3, np.iinfo(np.int64).max)
        self.high = np.full(3, np.iinfo(np.int64).min)
        self.channels: set[int] = set()
        self.sample: list[float] = []

    def add(self, table: PointTable) -> None:
        """Count one chunk in."""
        time = table["gps_time"]
        valid = np.isfinite(time)
        excluded = table.has(EXCLUDED)
        self.counts["points"] += len(table)
        self.counts["timeless"] += int(np.count_nonzero(~valid & ~excluded))
        self.counts["withheld"] += int(np.count_nonzero(table.has(PointFlag.WITHHELD)))
        self.counts["vendor_noise"] += int(np.count_nonzero(table.has(PointFlag.VENDOR_NOISE)))
        self.counts["excluded"] += int(np.count_nonzero(excluded))
        for axis, name in enumerate("xyz"):
            self.low[axis] = min(self.low[axis], int(table[name].min()))
            self.high[axis] = max(self.high[axis], int(table[name].max()))
        self.channels.update(np.flatnonzero(np.bincount(table["channel"])).tolist())
        self._add_times(table.select(_TIMED).take(rows_of(valid & ~excluded)))

    def _add_times(self, table: PointTable) -> None:
        time = table["gps_time"]
        if not len(time):
            return
        self.sample.extend((float(time.min()), float(time.max())))
        line = table["point_source_id"]
        for psid in np.flatnonzero(np.bincount(line)).tolist():
            mine = table.take(rows_of(line == psid))
            ordered = ordered_times(mine["gps_time"])
            cuts = np.flatnonzero(np.diff(ordered) > self.gap_s) + 1
            for piece in np.split(ordered, cuts):
                self.spans.setdefault(psid, []).append(
                    [float(piece[0]), float(piece[-1]), len(piece)]
                )
            self.rates.setdefault(psid, Rate()).add(ordered)
            steps = shot_steps(ordered)
            self.steps[psid] = self.steps[psid] + steps if psid in self.steps else steps
            earlier = [self.tracks[psid]] if psid in self.tracks else []
            self.tracks[psid] = merge_track([*earlier, observe_track(mine)])


def index_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Read a file once from end to end: prove that it is readable, find what is in it, keep it."""
    path = Path(args["path"])
    settings = context.workflow.survey
    tally = _Tally(settings.gap_s)
    points = context.store.path("points", f"{args['source']}.parquet")
    dtypes = {name: COLUMNS[name].dtype for name in KEPT_COLUMNS}
    given = _Given(context.store.path("given", f"{args['source']}.parquet"))
    with ExitStack() as stack:
        stack.enter_context(unchanged(path, args["stamp"]))
        writer = stack.enter_context(writing(points, dtypes, sought=("gps_time",), sharing=True))
        digest = checksum(path)
        header = inspect(path)
        if header.layers_can_be_copied:
            given.open(stack)
        for table in iter_points(
            path,
            channel_dimension=settings.channel_dimension,
            source=int(args["source"]),
            chunk=CHUNK_POINTS,
            watch=given.add if given.outputs else None,
        ):
            tally.add(table)
            add_points(writer, table)
    index = context.store.path("index", f"{args['source']}.npz")
    tracks = {f"{psid}/{k}": v for psid, t in sorted(tally.tracks.items()) for k, v in t.items()}
    write_arrays(index, tracks | given.extent.to_arrays())
    standard = time_standard(np.array(tally.sample))
    contradiction = bit_warning(standard, adjusted_bit=header.adjusted_standard_bit)
    facts = {
        "name": args["name"],
        "path": str(path),
        "hash": digest,
        "size": args["stamp"][0],
        **tally.counts,
        "bounds": [*tally.low.tolist(), *tally.high.tolist()] if tally.counts["points"] else None,
        "channels": [min(tally.channels), max(tally.channels)] if tally.channels else None,
        "spans": {str(k): merge_spans(v, settings.gap_s) for k, v in sorted(tally.spans.items())},
        "fullest": {str(k): v.fullest() for k, v in sorted(tally.rates.items())},
        "prf_hz": {str(k): estimate_prf(v) for k, v in sorted(tally.steps.items())},
        "standard": standard,
        "warnings": [*header.warnings, *([contradiction] if contradiction else [])],
    }
    inputs = {str(path): args["stamp"]}
    return Produced([index, points, *given.outputs], facts, tally.counts["points"], inputs)


class _Given:
    """Keeps what delivery needs of the records of a file whose layers can be copied."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.extent = Extent()
        self.outputs: list[Path] = []

    def open(self, stack: ExitStack) -> None:
        """Begin to write."""
        self._writer = stack.enter_context(writing(self.path, {GIVEN: np.uint32}))
        self.outputs.append(self.path)

    def add(self, records: NDArray[Any]) -> None:
        """Keep what is needed of records, in the order of the file."""
        self.extent.add(records)
        self._writer.write({GIVEN: given_of(records)})


def merge_spans(spans: list[list[float]], gap_s: float) -> list[list[float]]:
    """Join time spans ``[first, last, points]`` that lie no farther apart than a gap [s]."""
    merged: list[list[float]] = []
    for first, last, points in sorted(spans):
        if merged and first - merged[-1][1] <= gap_s:
            merged[-1][1] = max(merged[-1][1], last)
            merged[-1][2] += points
        else:
            merged.append([first, last, points])
    return merged


def find_heading(args: Mapping[str, Any], context: Context) -> Produced:
    """Flight direction of a flightline without a trajectory, from the drift of its points."""
    parts = []
    for source in args["sources"]:
        arrays = read_arrays(context.store.path("index", f"{source}.npz"))
        prefix = f"{args['psid']}/"
        track = {k.removeprefix(prefix): v for k, v in arrays.items() if k.startswith(prefix)}
        low, high = args["seconds"]
        within = (track["second"] >= low) & (track["second"] <= high)
        parts.append({k: v if k == "angle" else v[within] for k, v in track.items()})
    return Produced((), {"heading_rad": heading_from_track(merge_track(parts))})


def gather_trajectory(args: Mapping[str, Any], context: Context) -> Produced:
    """Bring the trajectory into the survey's CRS and the points' time, in one file."""
    path, hashes = context.store.path("trajectory.parquet"), _Hashes()
    with ExitStack() as stack:
        for name, stamp in zip(args["paths"], args["stamps"], strict=True):
            stack.enter_context(unchanged(Path(name), stamp))
        found = stack.enter_context(
            gathering(
                [Path(p) for p in args["paths"]],
                survey_crs=context.crs,
                trajectory_crs=context.workflow.survey.trajectory_crs,
                points=PointExtent(tuple(args["time_span_s"]), tuple(args["bounds_m"])),
                folder=context.store.local,
            )
        )
        write_trajectory(path, map(hashes.see, found))
    facts = {
        "records": found.records,
        "span_s": list(found.span_s),
        "positions": hashes.found(),
        "warnings": list(found.warnings),
        "inputs": [{"path": p, "hash": checksum(Path(p))} for p in args["paths"]],
    }
    return Produced([path], facts)


class _Hashes:
    """Hash of the positions in each span of :data:`POSITIONS_S` that has some."""

    def __init__(self) -> None:
        self._open: dict[int, Any] = {}

    def see(self, records: Records) -> Records:
        """Add records that follow those before; they are given back."""
        time, xyz = records
        span = np.floor_divide(time, POSITIONS_S).astype(np.int64)
        cuts = [0, *(np.flatnonzero(np.diff(span)) + 1).tolist(), len(span)]
        rows = np.column_stack([time, xyz])
        for a, b in pairwise(cuts):
            digest = self._open.setdefault(int(span[a]), hashlib.blake2b(digest_size=8))
            digest.update(rows[a:b].tobytes())
        return records

    def found(self) -> dict[str, str]:
        """Hashes by the number of the span."""
        return {str(span): digest.hexdigest() for span, digest in self._open.items()}
