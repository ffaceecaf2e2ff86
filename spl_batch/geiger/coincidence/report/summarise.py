"""Stage ``report``: what all receipts say together, with pictures."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.page import write_both
from spl_batch.engine.report.parts import InputFile
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    common_parts,
    indexed_file,
    remember,
)
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.coincidence.report.model import CoincidenceReport, Counts, Intensity, Scene
from spl_batch.geiger.coincidence.report.page import Slice, pictures, render
from spl_batch.geiger.coincidence.tasks.index import CoincidenceContext
from spl_batch.geiger.coincidence.tasks.points import MAP_CELLS, map_path
from spl_batch.lattice.tiles import parse_cell

LARGEST_MAP: Final = 4_000
"""More cells along a side are thinned, whole tiles at a time [count]."""


def summarise(done: Receipts, context: CoincidenceContext, facts: RunFacts) -> CoincidenceReport:
    """Write ``report.json`` and ``report.html``."""
    counts = _counts(done, context)
    workflow = context.workflow
    report = CoincidenceReport(
        scene=Scene(
            name=workflow.survey.name,
            crs=context.crs.name if context.crs is not None else None,
            method=workflow.coincidence.method,
            voxel_m=workflow.voxel_q / QUANTA_PER_M,
            tile_m=workflow.tiling.tile_m,
        ),
        counts=counts,
        intensity=_intensity(done),
        **common_parts(context, facts, counts.detections, list(_inputs(done))),
    )
    height, intensity = (_map(done, context, name) for name in ("height", "intensity"))
    shown = pictures(height, intensity, _slice(done, context))
    write_both(context.output, report, render(report, shown))
    remember(done, context, facts)
    return report


def _counts(done: Receipts, context: CoincidenceContext) -> Counts:
    frames = sum(r.facts["frames"] for r in done.get("frames", {}).values())
    made = [r.facts for r in done.get("coincide", {}).values()]
    kinds = np.sum([f["kinds"] for f in made], axis=0).tolist() if made else [0] * 4
    return Counts(
        frames=frames,
        looks=frames * context.workflow.array.detectors,
        detections=sum(r.facts["points"] for r in done.get("index_file", {}).values()),
        tiles=sum(1 for facts in made if facts["points"]),
        points=sum(f["points"] for f in made),
        surface=kinds[1],
        ridge=kinds[2],
        peak=kinds[3],
    )


def _intensity(done: Receipts) -> Intensity:
    made = [r.facts for r in done.get("coincide", {}).values() if r.facts["points"]]
    if not made:
        return Intensity()
    weight = [f["points"] for f in made]
    low, middle, high = np.average([f["intensity"] for f in made], axis=0, weights=weight)
    return Intensity(p05=low, median=middle, p95=high)


def _inputs(done: Receipts) -> Iterable[InputFile]:
    for kind, role in (("frames", "frames"), ("index_file", "detections")):
        for receipt in done.get(kind, {}).values():
            held = receipt.facts["frames" if kind == "frames" else "points"]
            yield indexed_file(receipt.facts, role, held)


def _map(done: Receipts, context: CoincidenceContext, name: str) -> Raster | None:
    """Maps of all tiles side by side, north first."""
    tiles = [parse_cell(tile) for tile, r in done.get("coincide", {}).items() if r.facts["points"]]
    if not tiles:
        return None
    west, east = min(t.i for t in tiles), max(t.i for t in tiles) + 1
    south, north = min(t.j for t in tiles), max(t.j for t in tiles) + 1
    # One cell of several where all would be too many for a picture.
    skip = max(1, -(-max(east - west, north - south) * MAP_CELLS // LARGEST_MAP))
    cells = len(range(0, MAP_CELLS, skip))
    values = np.full(((north - south) * cells, (east - west) * cells), np.nan, np.float32)
    for tile in tiles:
        part: NDArray[Any] = read_arrays(map_path(context.store, str(tile)))[name][::skip, ::skip]
        row, column = (north - 1 - tile.j) * cells, (tile.i - west) * cells
        values[row : row + cells, column : column + cells] = part
    edge = context.workflow.tiling.tile_m
    return Raster(values, (west * edge, east * edge, south * edge, north * edge))


def _slice(done: Receipts, context: CoincidenceContext) -> Slice | None:
    """The slice of the tile with most points."""
    made = {t: r.facts["points"] for t, r in done.get("coincide", {}).items()}
    if not any(made.values()):
        return None
    tile = max(sorted(made), key=lambda name: made[name])
    arrays = read_arrays(map_path(context.store, tile))
    return arrays["slice_detections"], arrays["slice_points"]
