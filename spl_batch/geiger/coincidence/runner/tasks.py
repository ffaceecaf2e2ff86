"""Tasks of coincidence processing: index the files, make the points of a tile, deliver them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M, QUANTUM_M
from spl_batch.errors import InputError
from spl_batch.geiger.coincidence import io, stages
from spl_batch.geiger.coincidence.model import Detections, Frames, Points
from spl_batch.geiger.coincidence.settings import ArraySettings, CoincidenceWorkflow
from spl_batch.io.atomic import checksum
from spl_batch.io.las_write import write_points
from spl_batch.io.store import Store
from spl_batch.io.tables import write_arrays
from spl_batch.kernels.sim_scan import rotations
from spl_batch.model import PointTable
from spl_batch.runner import Kind
from spl_batch.runner.context import Produced, RunContext
from spl_batch.runner.unchanged import unchanged
from spl_batch.tiling import Bounds, cell_bounds, grow, parse_cell

CoincidenceContext = RunContext[CoincidenceWorkflow]

MAP_CELLS: Final = 100
"""Cells along a tile's edge in the report's maps [count]."""

SLICE_Q: Final = 200
"""Width of the slice of a tile that the report may show [quanta]."""

SLICE_PLACES: Final = 20_000
"""Places of a slice at most [count]."""

FAR_OFF: Final = 2.0
"""Fields of view between a detection and its line of sight that are warned of [1/1]."""

_FAR_APART: Final = 512
"""Frames between two that look at a tile that are rather read than skipped [count]."""

_FULL: Final = 65_535


def frames_path(store: Store, key: str) -> Path:
    """Frames of an input file, in the working store."""
    return store.path("frames", f"{key}.parquet")


def detections_path(store: Store, key: str) -> Path:
    """Detections of an input file, in the working store."""
    return store.path("detections", f"{key}.parquet")


def points_path(store: Store, tile: str) -> Path:
    """Points of a tile, in the working store."""
    return store.path("points", f"{tile}.parquet")


def map_path(store: Store, tile: str) -> Path:
    """Map of a tile for the report, in the working store."""
    return store.path("maps", f"{tile}.npz")


def index_frames(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a frames file and keep it with its attitudes as directions."""
    path = Path(args["path"])
    with unchanged(path, args["stamp"]):
        found = io.read_frames(path)
        digest = checksum(path)
    heading, roll, pitch = found.attitude_rad.T
    frames = Frames(found.number, found.origin_m, rotations(heading, roll, pitch))
    target = frames_path(context.store, args["source"])
    io.store_frames(target, frames)
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "frames": len(frames),
        "numbers": [int(frames.number[0]), int(frames.number[-1])] if len(frames) else [],
        "places_m": [*_ends(frames.origin_m, 0), *_ends(frames.origin_m, 1)],
        "reach_m": _reach_m(frames, context.workflow.array),
    }
    return Produced([target], facts, 0, {args["path"]: args["stamp"]})


def _ends(values: NDArray[np.float64], axis: int) -> list[float]:
    """Smallest and largest coordinate; none of no frame."""
    column = values[:, axis]
    return [float(column.min()), float(column.max())] if len(column) else []


def _reach_m(frames: Frames, array: ArraySettings) -> float:
    """How far sideways a look comes from its sensor, at most [m]."""
    if not len(frames):
        return 0.0
    down = -frames.turn[:, 2, 2]
    # The array's axis and half a diagonal of its field of view.
    half = 0.5 * float(np.hypot(array.rows, array.columns)) * array.ifov_rad
    slant = float(np.arccos(np.clip(-down.max(), -1.0, 1.0))) + half
    return float(array.gate_stop_m * np.sin(min(slant, 0.5 * np.pi)))


def index_file(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a detections file, keep it in order, and count its detections by tile."""
    path, workflow = Path(args["path"]), context.workflow
    with unchanged(path, args["stamp"]):
        detections = io.read_detections(path, workflow.array)
        digest = checksum(path)
    known = [io.frame_numbers(frames_path(context.store, key)) for key in args["frames"]]
    _refuse_unknown(path, detections, np.concatenate([np.empty(0, np.int64), *known]))
    target = detections_path(context.store, args["source"])
    io.store_detections(target, detections)
    cells, count = np.unique(detections.xyz[:, :2] // workflow.tile_q, axis=0, return_counts=True)
    tiles = {f"{i}_{j}": n for (i, j), n in zip(cells.tolist(), count.tolist(), strict=True)}
    low, high = (
        ([int(v) for v in getattr(detections.xyz, end)(axis=0)] if len(detections) else [])
        for end in ("min", "max")
    )
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "points": len(detections),
        "numbers": [int(detections.frame[0]), int(detections.frame[-1])] if low else [],
        "bounds": [*low, *high],
        "tiles": tiles,
        "warnings": _sight_warnings(args, context, detections),
    }
    return Produced([target], facts, len(detections), {args["path"]: args["stamp"]})


def _sight_warnings(
    args: Mapping[str, Any], context: CoincidenceContext, detections: Detections
) -> list[str]:
    """Warn where detections do not lie where their detectors look."""
    if not len(detections):
        return []
    number = int(detections.frame[len(detections) // 2])
    paths = (frames_path(context.store, key) for key in args["frames"])
    frames = Frames.joined([io.frames_around(path, number) for path in paths])
    off = stages.sight_error(frames, detections, context.workflow.array)
    if off < FAR_OFF:
        return []
    said = (
        f"detections lie {off:.1f} fields of view off their lines of sight; looks are counted "
        "elsewhere: check heading, roll and pitch of the frames, and rows, columns and ifov_rad "
        "of the array"
    )
    return [said]


def _refuse_unknown(path: Path, detections: Detections, frames: NDArray[np.int64]) -> None:
    unknown = detections.frame[~np.isin(detections.frame, frames)]
    if len(unknown):
        raise InputError(
            str(path),
            f"{len(unknown)} detections are of frames that no frames file has, the first is "
            f"{unknown[0]}; name the file with it in survey.frames",
        )


def coincide_tile(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Make the points of a tile from all looks at it."""
    workflow, store = context.workflow, context.store
    region = cell_bounds(parse_cell(args["tile"]), workflow.tile_q)
    frames = _frames(args, context, region)
    detections = _detections(args, store, frames)
    points = stages.coincide(frames, detections, region, workflow.coincidence, workflow.array)
    target, drawn = points_path(store, args["tile"]), map_path(store, args["tile"])
    io.store_points(target, points)
    write_arrays(drawn, {**_map(points, region), **_slice(detections, points, region)})
    kinds = np.bincount(points.kind, minlength=4).tolist()
    spread = np.percentile(points.intensity, [5, 50, 95]).tolist() if len(points) else []
    facts = {"points": len(points), "kinds": kinds, "intensity": spread, "frames": len(frames)}
    return Produced([target, drawn], facts, int(args["detections"]))


def _frames(args: Mapping[str, Any], context: CoincidenceContext, region: Bounds) -> Frames:
    """Frames of which a look may cross a tile at the heights of its detections."""
    workflow = context.workflow
    around = grow(region, stages.reach_q(workflow.coincidence, workflow.array))
    west, south, east, north = (v * QUANTUM_M for v in around)
    low = np.array([west, south, args["heights_q"][0] * QUANTUM_M - 1.0])
    high = np.array([east, north, args["heights_q"][1] * QUANTUM_M + 1.0])
    parts = []
    for key, reach in zip(args["frames"], args["reach_m"], strict=True):
        box = (west - reach, east + reach, south - reach, north + reach)
        found = io.stored_frames(frames_path(context.store, key), *box)
        found = found.take(_answered(found.number, args["answered"]))
        parts.append(found.take(stages.looking_at(found, workflow.array, low, high)))
    return Frames.joined(parts)


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
        io.stored_detections(detections_path(store, key), first, last)
        for key in args["files"]
        for first, last in _runs(frames.number)
    ]
    found = Detections.joined(parts).distinct()
    return found.take(np.isin(found.frame, frames.number))


def _runs(numbers: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
    """First and last of numbers that lie close together."""
    if len(numbers):
        cuts = np.flatnonzero(np.diff(numbers) > _FAR_APART) + 1
        for part in np.split(numbers, cuts):
            yield int(part[0]), int(part[-1])


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
    points = io.stored_points(points_path(context.store, args["tile"]))
    n = len(points)
    columns: dict[str, NDArray[Any]] = {name: points.xyz[:, k] for k, name in enumerate("xyz")}
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


_FILTER: Final = ("array", "coincidence", "tiling.tile_m")

KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "frames": Kind("index", index_frames, ("array",)),
        "index_file": Kind("index", index_file, ("array.rows", "array.columns", "tiling.tile_m")),
        "coincide": Kind("coincidence", coincide_tile, _FILTER),
        "deliver_tile": Kind("deliver", deliver_tile, ("outputs.aggregate_bit",)),
    }
)
"""Tasks of coincidence processing."""
