"""Tasks of coincidence processing: make the points of a tile, deliver them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M, QUANTUM_M
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.verified.parquet_npz import write_arrays
from spl_batch.geiger.coincidence.formats import stored
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points
from spl_batch.geiger.coincidence.tasks.index import (
    CoincidenceContext,
    detections_path,
    frames_path,
)
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, cell_bounds, grow, parse_cell

MAP_CELLS: Final = 100
"""Cells along a tile's edge in the report's maps [count]."""

SLICE_Q: Final = 200
"""Width of the slice of a tile that the report may show [quanta]."""

SLICE_PLACES: Final = 20_000
"""Places of a slice at most [count]."""

_FULL: Final = 65_535


def points_path(store: Store, tile: str) -> Path:
    """Points of a tile, in the working store."""
    return store.path("points", f"{tile}.parquet")


def map_path(store: Store, tile: str) -> Path:
    """Map of a tile for the report, in the working store."""
    return store.path("maps", f"{tile}.npz")


def coincide_tile(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Make the points of a tile from all looks at it."""
    workflow, store = context.workflow, context.store
    region = cell_bounds(parse_cell(args["tile"]), workflow.tile_q)
    frames = _frames(args, context, region)
    detections = _detections(args, store, frames)
    points = coincide.coincide(frames, detections, region, workflow.coincidence, workflow.array)
    target, drawn = points_path(store, args["tile"]), map_path(store, args["tile"])
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
        found = stored.stored_frames(frames_path(context.store, key), *box)
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
        stored.stored_detections(detections_path(store, key), frames.number)
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
    points = stored.stored_points(points_path(context.store, args["tile"]))
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
