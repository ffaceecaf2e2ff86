"""Tasks: frames and detections into the working store, points of tiles, delivery.

Detections are sorted within each stretch of rows and found again by the frames of their row groups.
Files in the order of their frames, as sensors write them, are so in order as a whole.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.tasks.context import Produced, RunContext
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.errors import InputError, counted
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.verified.parquet_npz import group_ranges, read_columns, write_arrays
from spl_batch.geiger.coincidence import files
from spl_batch.geiger.coincidence.settings import ArraySettings, CoincidenceWorkflow
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, cell_bounds, grow, parse_cell

CoincidenceContext = RunContext[CoincidenceWorkflow]


def index_frames(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a frames file and keep it with its attitudes as directions."""
    path, target = Path(args["path"]), context.store.path("frames", f"{args['source']}.parquet")
    with unchanged(path, args["stamp"]):
        frames = files.read_frames(path)
        digest = checksum(path)
    files.store(target, Frames, [frames])
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "frames": len(frames),
        "numbers": frames.number[[0, -1]].tolist(),
        # West, east, south, north.
        "places_m": [float(end(frames.origin_m[:, k])) for k in (0, 1) for end in (np.min, np.max)],
        "reach_m": _reach_m(frames, context.workflow.array),
    }
    return Produced([target], facts, 0, {args["path"]: args["stamp"]})


def _reach_m(frames: Frames, array: ArraySettings) -> float:
    """How far sideways a look comes from its sensor, at most [m]."""
    # The array's axis and half a diagonal of its field of view.
    half = 0.5 * float(np.hypot(array.rows, array.columns)) * array.ifov_rad
    steepest = float(np.clip(frames.turn[:, 2, 2].min(), -1.0, 1.0))
    slant = float(np.arccos(steepest)) + half
    return float(array.gate_stop_m * np.sin(min(slant, 0.5 * np.pi)))


def index_file(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a detections file, keep it, and count its detections by tile."""
    path, target = Path(args["path"]), context.store.path("detections", f"{args['source']}.parquet")
    looks = [context.store.path("frames", f"{key}.parquet") for key in args["frames"]]
    tiles = Counter[str]()
    found: list[Finding] = []
    # Detections of frames that no frames file has, and the first of these frames.
    unknown: list[tuple[int, int]] = []

    def noted() -> Iterator[Detections]:
        for part in files.read_detections(path, context.workflow.array):
            if not tiles:
                found.extend(_sight_findings(looks, context, part))
            tile = part.xyz[:, :2] // context.workflow.tile_q
            cells, count = np.unique(tile, axis=0, return_counts=True)
            for (i, j), n in zip(cells.tolist(), count.tolist(), strict=True):
                tiles[f"{i}_{j}"] += n
            numbers, count = np.unique(part.frame, return_counts=True)
            lost = ~files.known_frames(looks, numbers)
            if lost.any():
                unknown.append((int(count[lost].sum()), int(numbers[lost][0])))
            yield part

    with unchanged(path, args["stamp"]):
        files.store(target, Detections, noted())
        digest = checksum(path)
    if unknown:
        raise InputError(str(path), _reason(unknown, args["unread_frames"]))
    spans = np.array([group_ranges(target, name) for name in ("frame", "x", "y", "z")])
    low, high = spans[..., 0].min(axis=1).tolist(), spans[..., 1].max(axis=1).tolist()
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "points": tiles.total(),
        "numbers": [low[0], high[0]],
        "bounds": [*low[1:], *high[1:]],
        "tiles": dict(sorted(tiles.items())),
        "findings": found,
    }
    return Produced([target], facts, facts["points"], {args["path"]: args["stamp"]})


def _reason(unknown: list[tuple[int, int]], unread: list[str]) -> str:
    """Why detections cannot be used whose frames are not known."""
    found = counted(sum(count for count, _ in unknown), "detections", "are")
    first = min(number for _, number in unknown)
    text = f"{found} of frames that no frames file has, the first is {first}; "
    if not unread:
        return f"{text}name the file with it in survey.frames"
    text += f"{' and '.join(unread)} could not be read: mend that file, these detections are then"
    return f"{text} taken in by the next run"


def _sight_findings(
    looks: Sequence[Path], context: CoincidenceContext, part: Detections
) -> Iterator[Finding]:
    """Warn where detections do not lie where their detectors look."""
    number = int(part.frame[len(part) // 2])
    near = [files.stored_frames(path, frame=(number, number)) for path in looks]
    frames = Frames.joined(near).in_order()
    # Those of 32 frames on either side are enough.
    frames = frames.take(np.abs(frames.number - number) <= 32)
    off = coincide.sight_error(frames, part, context.workflow.array)
    if off >= 2.0:  # fields of view between a detection and its line of sight
        yield Finding("K02", {"fields": off}, badness=off)


MAP_CELLS: Final = 100
"""Cells along a tile's edge in the report's maps [count]."""

SLICE_Q: Final = 200
"""Width of the slice of a tile that the report may show [quanta]."""

SLICE_POINTS: Final = 20_000
"""Points of a slice at most [count]."""


def coincide_tile(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Make the points of a tile from all looks at it."""
    workflow, store = context.workflow, context.store
    region = cell_bounds(parse_cell(args["tile"]), workflow.tile_q)
    frames = _frames(args, context, region)
    parts = [
        files.stored_detections(store.path("detections", f"{key}.parquet"), frames.number)
        for key in args["files"]
    ]
    detections = Detections.joined(parts).distinct()
    points = coincide.coincide(frames, detections, region, workflow.coincidence, workflow.array)
    target = store.path("points", f"{args['tile']}.parquet")
    drawn = store.path("maps", f"{args['tile']}.npz")
    files.store(target, Points, [points])
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
        path = context.store.path("frames", f"{key}.parquet")
        x, y = (west - reach, east + reach), (south - reach, north + reach)
        found = files.stored_frames(path, x=x, y=y)
        if args["answered"] is not None:
            spans = np.array(args["answered"]).reshape(-1, 1, 2)
            answered = (found.number >= spans[..., 0]) & (found.number <= spans[..., 1])
            found = found.take(np.flatnonzero(answered.any(axis=0)))
        parts.append(found.take(coincide.looking_at(found, workflow.array, low, high)))
    return Frames.joined(parts).in_order()


def _map(points: Points, region: Bounds) -> dict[str, NDArray[Any]]:
    """Highest point and mean intensity of each cell of a tile; north first, NaN for none."""
    edge = (region.xmax - region.xmin) / MAP_CELLS
    east, south = points.xyz[:, 0] - region.xmin, region.ymax - 1 - points.xyz[:, 1]
    row, column = (np.clip(v / edge, 0, MAP_CELLS - 1).astype(int) for v in (south, east))
    top, count, total = np.full((3, MAP_CELLS, MAP_CELLS), [[[-np.inf]], [[0.0]], [[0.0]]])
    np.maximum.at(top, (row, column), points.xyz[:, 2] / QUANTA_PER_M)
    np.add.at(count, (row, column), 1.0)
    np.add.at(total, (row, column), points.intensity.astype(np.float64))
    top[count == 0] = count[count == 0] = np.nan
    return {"height": top.astype(np.float32), "intensity": (total / count).astype(np.float32)}


def _slice(detections: Detections, points: Points, region: Bounds) -> dict[str, NDArray[Any]]:
    """A thin upright slice of a tile seen from the south: along it, and height (n, 2) [m]."""
    south = int(np.median(points.xyz[:, 1])) - SLICE_Q // 2 if len(points) else region.ymin
    found = {}
    for name, xyz in (("slice_detections", detections.xyz), ("slice_points", points.xyz)):
        inside = (xyz[:, 1] >= south) & (xyz[:, 1] < south + SLICE_Q)
        inside &= (xyz[:, 0] >= region.xmin) & (xyz[:, 0] < region.xmax)
        shown = xyz[inside]
        shown = shown[:: -(-len(shown) // SLICE_POINTS) or 1]
        found[name] = np.stack([shown[:, 0] - region.xmin, shown[:, 2]], axis=-1) / QUANTA_PER_M
    return found


def deliver_tile(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Write the points of a tile as LAZ."""
    path = context.store.path("points", f"{args['tile']}.parquet")
    points = Points.of(read_columns(path, [*Points.types()]))
    n = len(points)
    # A point of an aggregate model is none of a pulse's returns [LAS 1.4 R15, 2.6].
    columns: dict[str, NDArray[Any]] = {
        **{axis: points.xyz[:, k] for k, axis in enumerate("xyz")},
        "intensity": np.rint(np.clip(points.intensity, 0, 1) * 65_535).astype(np.uint16),
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
