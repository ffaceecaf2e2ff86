"""Tasks: frames and detections into the working store, points of tiles, delivery.

Detections are sorted within each stretch of rows and found again by the frames of their row groups.
Files in the order of their frames, as sensors write them, are so in order as a whole.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.tasks.context import Produced, RunContext
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.errors import InputError, counted
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.verified.parquet_npz import write_arrays
from spl_batch.geiger.coincidence.formats import l1_files, stored
from spl_batch.geiger.coincidence.settings import ArraySettings, CoincidenceWorkflow
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, cell_bounds, grow, parse_cell

CoincidenceContext = RunContext[CoincidenceWorkflow]

FAR_OFF: Final = 2.0
"""Fields of view between a detection and its line of sight that are warned of [1/1]."""

SIGHT_FRAMES: Final = 64
"""Frames whose detections are compared with their lines of sight [count]."""


def index_frames(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a frames file and keep it with its attitudes as directions."""
    path, target = Path(args["path"]), context.store.path("frames", f"{args['source']}.parquet")
    with unchanged(path, args["stamp"]):
        frames = l1_files.read_frames(path)
        digest = checksum(path)
    stored.store(target, Frames, [frames])
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "frames": len(frames),
        "numbers": frames.number[[0, -1]].tolist() if len(frames) else [],
        # West, east, south, north.
        "places_m": [float(end(frames.origin_m[:, k])) for k in (0, 1) for end in (np.min, np.max)]
        if len(frames)
        else [],
        "reach_m": _reach_m(frames, context.workflow.array),
    }
    return Produced([target], facts, 0, {args["path"]: args["stamp"]})


def _reach_m(frames: Frames, array: ArraySettings) -> float:
    """How far sideways a look comes from its sensor, at most [m]."""
    if not len(frames):
        return 0.0
    # The array's axis and half a diagonal of its field of view.
    half = 0.5 * float(np.hypot(array.rows, array.columns)) * array.ifov_rad
    steepest = float(np.clip(frames.turn[:, 2, 2].min(), -1.0, 1.0))
    slant = float(np.arccos(steepest)) + half
    return float(array.gate_stop_m * np.sin(min(slant, 0.5 * np.pi)))


class _Seen(NamedTuple):
    """Facts of a stretch of detections."""

    points: int
    numbers: tuple[int, int]  #: First and last frame.
    #: (3,): smallest and largest coordinates [quanta].
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    tiles: Counter[str]  #: Detections of each tile.
    unknown: int  #: Detections of frames that no frames file has [count].
    first_unknown: int


def index_file(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a detections file, keep it, and count its detections by tile."""
    path, target = Path(args["path"]), context.store.path("detections", f"{args['source']}.parquet")
    seen: list[_Seen] = []
    found: list[Finding] = []

    def counted_parts() -> Iterator[Detections]:
        for part in l1_files.read_detections(path, context.workflow.array):
            if not seen:
                found.extend(_sight_findings(args, context, part))
            seen.append(_see(part, args, context))
            yield part

    with unchanged(path, args["stamp"]):
        stored.store(target, Detections, counted_parts())
        digest = checksum(path)
    if any(one.unknown for one in seen):
        raise InputError(str(path), _reason(seen, args["unread_frames"]))
    tiles = sum((one.tiles for one in seen), Counter[str]())
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "points": sum(one.points for one in seen),
        "numbers": [min(s.numbers[0] for s in seen), max(s.numbers[1] for s in seen)]
        if seen
        else [],
        "bounds": [
            *np.min([one.low for one in seen], axis=0).tolist(),
            *np.max([one.high for one in seen], axis=0).tolist(),
        ]
        if seen
        else [],
        "tiles": dict(sorted(tiles.items())),
        "findings": found,
    }
    return Produced([target], facts, facts["points"], {args["path"]: args["stamp"]})


def _see(part: Detections, args: Mapping[str, Any], context: CoincidenceContext) -> _Seen:
    cells, count = np.unique(part.xyz[:, :2] // context.workflow.tile_q, axis=0, return_counts=True)
    numbers, in_frame = np.unique(part.frame, return_counts=True)
    known = np.zeros(len(numbers), np.bool_)
    for key in args["frames"]:
        known |= stored.known_frames(context.store.path("frames", f"{key}.parquet"), numbers)
    return _Seen(
        len(part),
        (int(numbers[0]), int(numbers[-1])),
        part.xyz.min(axis=0),
        part.xyz.max(axis=0),
        Counter({f"{i}_{j}": n for (i, j), n in zip(cells.tolist(), count.tolist(), strict=True)}),
        int(in_frame[~known].sum()),
        int(numbers[~known][0]) if not known.all() else -1,
    )


def _reason(seen: list[_Seen], unread: list[str]) -> str:
    """Why detections cannot be used whose frames are not known."""
    found = counted(sum(one.unknown for one in seen), "detections", "are")
    first = min(one.first_unknown for one in seen if one.unknown)
    text = f"{found} of frames that no frames file has, the first is {first}; "
    if not unread:
        return f"{text}name the file with it in survey.frames"
    return (
        f"{text}{' and '.join(unread)} could not be read: mend that file, these detections are "
        "then taken in by the next run"
    )


def _sight_findings(
    args: Mapping[str, Any], context: CoincidenceContext, part: Detections
) -> Iterator[Finding]:
    """Warn where detections do not lie where their detectors look."""
    number = int(part.frame[len(part) // 2])
    paths = (context.store.path("frames", f"{key}.parquet") for key in args["frames"])
    frames = Frames.joined([stored.frames_around(path, number) for path in paths]).in_order()
    frames = frames.take(np.abs(frames.number - number) <= SIGHT_FRAMES // 2)
    off = coincide.sight_error(frames, part, context.workflow.array)
    if off >= FAR_OFF:
        yield Finding("K02", {"fields": off}, badness=off)


MAP_CELLS: Final = 100
"""Cells along a tile's edge in the report's maps [count]."""

SLICE_Q: Final = 200
"""Width of the slice of a tile that the report may show [quanta]."""

SLICE_PLACES: Final = 20_000
"""Places of a slice at most [count]."""

_FULL: Final = 65_535


def coincide_tile(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Make the points of a tile from all looks at it."""
    workflow, store = context.workflow, context.store
    region = cell_bounds(parse_cell(args["tile"]), workflow.tile_q)
    frames = _frames(args, context, region)
    detections = _detections(args, store, frames)
    points = coincide.coincide(frames, detections, region, workflow.coincidence, workflow.array)
    target, drawn = (
        store.path("points", f"{args['tile']}.parquet"),
        store.path("maps", f"{args['tile']}.npz"),
    )
    stored.store(target, Points, [points])
    write_arrays(drawn, {**_map(points, region), **_slice(detections, points, region)})
    kinds = np.bincount(points.kind, minlength=4).tolist()
    spread = np.percentile(points.intensity, [5, 50, 95]).tolist() if len(points) else []
    facts = {"points": len(points), "kinds": kinds, "intensity": spread, "frames": len(frames)}
    return Produced([target, drawn], facts, int(args["detections"]))


def _frames(args: Mapping[str, Any], context: CoincidenceContext, region: Bounds) -> Frames:
    """Frames of which a look may cross a tile at the heights of its detections."""
    workflow = context.workflow
    around = grow(region, coincide.reach_q(workflow.coincidence, workflow.array))
    west, south, east, north = (v * QUANTUM_M for v in around)
    low = np.array([west, south, args["heights_q"][0] * QUANTUM_M - 1.0])
    high = np.array([east, north, args["heights_q"][1] * QUANTUM_M + 1.0])
    parts = []
    for key, reach in zip(args["frames"], args["reach_m"], strict=True):
        box = (west - reach, east + reach, south - reach, north + reach)
        found = stored.stored_frames(context.store.path("frames", f"{key}.parquet"), *box)
        found = found.take(_answered(found.number, args["answered"]))
        parts.append(found.take(coincide.looking_at(found, workflow.array, low, high)))
    return Frames.joined(parts).in_order()


def _answered(
    numbers: NDArray[np.int64], spans: Sequence[Sequence[int]] | None
) -> NDArray[np.bool_]:
    """Frames whose detections are known."""
    known = np.full(len(numbers), spans is None)
    for first, last in spans or ():
        known |= (numbers >= first) & (numbers <= last)
    return known


def _detections(args: Mapping[str, Any], store: Store, frames: Frames) -> Detections:
    """All detections of some frames."""
    parts = [
        stored.stored_detections(store.path("detections", f"{key}.parquet"), frames.number)
        for key in args["files"]
    ]
    return Detections.joined(parts).distinct()


def _map(points: Points, region: Bounds) -> dict[str, NDArray[Any]]:
    """Highest point and mean intensity of each cell of a tile; north first, NaN for none."""
    edge = (region.xmax - region.xmin) / MAP_CELLS
    column = np.clip((points.xyz[:, 0] - region.xmin) / edge, 0, MAP_CELLS - 1).astype(int)
    row = np.clip((region.ymax - 1 - points.xyz[:, 1]) / edge, 0, MAP_CELLS - 1).astype(int)
    cell = row * MAP_CELLS + column
    top = np.full(MAP_CELLS**2, -np.inf)
    np.maximum.at(top, cell, points.xyz[:, 2] / QUANTA_PER_M)
    count = np.bincount(cell, minlength=MAP_CELLS**2)
    total = np.bincount(cell, points.intensity.astype(np.float64), MAP_CELLS**2)
    shape = (MAP_CELLS, MAP_CELLS)
    empty = count == 0
    return {
        "height": np.where(empty, np.nan, top).astype(np.float32).reshape(shape),
        "intensity": np.where(empty, np.nan, total / np.maximum(count, 1))
        .astype(np.float32)
        .reshape(shape),
    }


def _slice(detections: Detections, points: Points, region: Bounds) -> dict[str, NDArray[Any]]:
    """A thin upright slice of a tile seen from the south: along it, and height (n, 2) [m]."""
    south = int(np.median(points.xyz[:, 1])) - SLICE_Q // 2 if len(points) else region.ymin
    found = {}
    for name, xyz in (("slice_detections", detections.xyz), ("slice_points", points.xyz)):
        inside = (xyz[:, 1] >= south) & (xyz[:, 1] < south + SLICE_Q)
        inside &= (xyz[:, 0] >= region.xmin) & (xyz[:, 0] < region.xmax)
        shown = xyz[inside]
        shown = shown[:: -(-len(shown) // SLICE_PLACES) or 1]
        found[name] = np.stack([shown[:, 0] - region.xmin, shown[:, 2]], axis=-1) / QUANTA_PER_M
    return found


def deliver_tile(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Write the points of a tile as LAZ."""
    points = stored.stored_points(context.store.path("points", f"{args['tile']}.parquet"))
    n = len(points)
    columns = points.columns()
    del columns["kind"]
    # A point of an aggregate model is none of a pulse's returns [LAS 1.4 R15, 2.6].
    columns |= {
        "intensity": np.rint(np.clip(points.intensity, 0, 1) * _FULL).astype(np.uint16),
        "point_source_id": np.ones(n, np.uint16),
        "input_class": np.ones(n, np.uint8),
    }
    target = context.output / "points" / f"{args['tile']}.laz"
    write_points(
        target,
        PointTable(columns),
        crs=context.crs,
        extra={"detection_share": points.intensity, "maximum": points.kind},
        aggregate=True,
        aggregate_bit=context.workflow.outputs.aggregate_bit,
    )
    return Produced([target], {"points": n}, n)
