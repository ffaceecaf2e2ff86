"""Vertical strips that a report shows: where they lie, and their points."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.accuracy.differences import TALL_M
from spl_batch.airborne.context import Context
from spl_batch.airborne.report.plots import Profile
from spl_batch.airborne.store.flown_lines import read_shifts
from spl_batch.airborne.store.label_tables import read_region, units_within
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.rasters.parts import RasterPart
from spl_batch.lattice.tables import TILE_COLUMNS
from spl_batch.lattice.tiles import Bounds, cells_touching, quanta

LENGTH_M = 100.0
WIDTH_M = 3.0

_TALLEST_M = 30.0
"""Heights count up to this: one mast is no reason [m]."""

_GROUND_SHARE = 0.2
"""Part of the covered cells that are the ground or lie on it, at which a strip shows enough."""


def read_strip(
    strip: Bounds, done: Mapping[str, Mapping[str, Receipt]], context: Context
) -> Profile | None:
    """Points of a strip along its easting, with what a run took them for; None without points."""
    tile_q = quanta(context.workflow.tiling.tile_m)
    built = done.get("build_tile", {})
    tiles = [t for t in cells_touching(strip, tile_q) if str(t) in built]
    labels = units_within(strip, ["noise_class", "classification"], done)
    shifts = read_shifts({"aligned": bool(done.get("align"))}, context.store)
    table, _ = read_region(context.store, tiles, strip, TILE_COLUMNS, labels, shifts=shifts)
    if not len(table):
        return None
    middle_m = (strip.ymin + strip.ymax) / 2 * QUANTUM_M
    return Profile(
        (table["x"] - strip.xmin) * QUANTUM_M,
        table["z"] * QUANTUM_M,
        table["noise_class"],
        table["classification"],
        (strip.ymax - strip.ymin) * QUANTUM_M,
        (strip.xmin * QUANTUM_M, middle_m, strip.xmax * QUANTUM_M, middle_m),
        context.shown_units,
    )


def tallest_strip(height: RasterPart) -> Bounds:
    """Covered strip with the largest sum of heights above ground; the first of equals.

    Heights count in full where the strip also shows :data:`_GROUND_SHARE` of ground: under a closed
    canopy there is hardly any, and a profile of leaves alone shows nothing of the terrain. A cell
    with a surface counts for a metre besides: a picture shows no empty place.
    """
    known = height.values > NODATA
    capped = np.where(known, np.clip(height.values.astype(np.float64), 0.0, _TALLEST_M), 0.0)
    cover, low = (strip_sums(height, some) for some in (known, known & (capped <= TALL_M)))
    open_share = np.minimum(low / np.maximum(cover, 1.0) / _GROUND_SHARE, 1.0)
    return best_strip(height, cover + strip_sums(height, capped) * open_share)[0]


def strip_sums(part: RasterPart, values: NDArray[Any]) -> NDArray[np.float64]:
    """Sums of values of a raster's cells over the strips that begin in each, (rows, m) float64."""
    length = min(max(round(LENGTH_M / part.cell_m), 1), values.shape[1])
    total = np.cumsum(np.pad(values.astype(np.float64), ((0, 0), (1, 0))), axis=1)
    return np.asarray(total[:, length:] - total[:, :-length])


def best_strip(part: RasterPart, score: NDArray[np.float64]) -> tuple[Bounds, float]:
    """Strip of the highest score, the first of equals, and that score.

    ``score``: of the strip that begins in each cell, as :func:`strip_sums` has them.
    """
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    west = quanta(part.left_m + float(column) * part.cell_m)
    middle = quanta(part.top_m - (float(row) + 0.5) * part.cell_m)
    half = quanta(WIDTH_M / 2)
    strip = Bounds(west, middle - half, west + quanta(LENGTH_M), middle + half)
    return strip, float(score[row, column])
