r"""Reflectance from how often beamlets were seen; domain: space.

Source: [W17] 8.2.2 with Eq. 2.1 and 2.7. A single-photon channel detects one photo-electron or
none: brightness is in the share of beamlets that were seen. A beamlet that expects :math:`k \rho`
photo-electrons is seen with :math:`p = 1 - e^{-k \rho}`, where

.. math:: k = C \, g \, \cos\alpha \, e^{-2 \beta R} / R^2

====================  ==========================================================
symbol                name
====================  ==========================================================
:math:`C`             ``FiredPart.constant_m2``
:math:`g`             ``FiredPart.gain``: dead channels count as not fired
:math:`\alpha`        incidence on the slope of the cell, :func:`slopes`
:math:`\beta`         ``products.extinction_per_m``
:math:`R`             range
:math:`\rho`          result
====================  ==========================================================

Each fired beamlet belongs to one raster cell: that of its first signal return or, when silent, that
where its ray meets the surface of the first returns. Unequal beamlets are put together by
likelihood, which for equal ones is the source's :math:`n = -\ln(1 - p)`.

Deviations. The source proposes a regression on intensities of another sensor; the link budget makes
the result absolute. Half a silent beamlet is added to each cell: it takes away the first order of
the bias, :math:`p / (2 N (1 - p))` photo-electrons. Afterpulses and background are no first
returns. Background in front of the surface blinds a channel for the dead time only, and is
neglected; so is light that passes a crown. Water, wires and leaves have no incidence: the number is
that of a Lambertian surface in their place. It may exceed one, and is not cut: means would be too
dark.

Rays end on the surface that beams meet first: not the DSM, but the median of the first returns of a
cell, whatever is below them, without what noise has left in the air.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.cell_values import (
    fill_voids,
    north_up,
    ring_offsets,
    shape_of,
    sort_into_cells,
)
from spl_batch.airborne.products.reflectance.beamlet_matching import (
    CELL_BITS,
    COARSE,
    SILENT,
    Blocks,
    Grid,
    expose_cells,
    match_points,
    shots_near,
)
from spl_batch.airborne.products.reflectance.fired_beamlets import FiredPart
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NODATA, NOISE_SIGNAL, QUANTUM_M
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import FIXED_POINT, PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta
from spl_batch.numerics.compiled import njit

COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "line", "noise_class")

FIRED_MIN: Final = 5
"""Cells that fewer beamlets were fired at hold nothing [count]. Half moves 254 + 243 cells of the
intensity, twice 476 + 303 cells of the intensity."""

ALIKE_CELLS: Final = 2.0
"""Neighbouring cells no farther apart in height than this are of one surface [cells]. Half moves
2646 + 3685 cells of the intensity, twice 708 + 832 cells of the intensity."""


def raster(
    table: PointTable, parts: Sequence[FiredPart], cell: Bounds, settings: ProductSettings
) -> NDArray[np.float32]:
    """Reflectance of a ground cell, north up; nodata where too little was fired.

    Parameters
    ----------
    table : PointTable
        Points of the cell and of a fixed margin, in any order, with :data:`COLUMNS_NEEDED`.
    parts : sequence of FiredPart
        Stretches that may have fired at it, in any order.
    cell : Bounds
        The ground cell [quanta].
    """
    size = quanta(settings.cell_m)
    margin = _margin_cells(settings)
    wide = grow(cell, margin * size)
    shape, cells = shape_of(cell, size), shape_of(wide, size)
    fired, silent = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.int64)
    parts = [p for p in parts if len(p.blocks)]
    signal = table["noise_class"] == NOISE_SIGNAL
    signal = np.flatnonzero(signal & inside(table["x"], table["y"], wide))
    z = table["z"][signal]
    if not len(z) or not parts:
        return np.full(shape, NODATA, np.float32)
    blocks = _join(parts, wide)
    level = float(np.median(z)) * QUANTUM_M
    depth = float((z.max() * QUANTUM_M) - (z.min() * QUANTUM_M))
    shots = int(blocks.offset[-1] + blocks.last[-1] - blocks.first[-1] + 1)
    number, block = np.empty(shots, np.int64), np.empty(shots, np.int64)
    tau = np.empty(shots)
    edges = (np.array(cell) - [wide.xmin, wide.ymin, wide.xmin, wide.ymin]) * QUANTUM_M
    near = shots_near(blocks, level, depth, tuple(edges.tolist()), number, block, tau)
    del z
    top = np.full((near, blocks.pattern.shape[1]), SILENT)
    match_points(
        table["gps_time"], table["channel"], table["line"], (table["x"], table["y"], table["z"]),
        signal, (wide.xmin, wide.ymin, size, cells[1]), blocks, number, top,
    )  # fmt: skip
    first = top[top != SILENT]
    height = (first >> 32).astype(np.int32)
    first &= CELL_BITS  # in place: of a dense cell each column is tens of megabytes
    grid = first_surface(first, height, cells, settings)
    seen_cell, amount = np.empty(len(first), dtype=np.int64), np.empty(len(first))
    del first, height
    inner = (margin, margin + shape[0], margin, margin + shape[1])
    count = expose_cells(
        (block[:near], tau[:near]), blocks, top, grid, inner,
        level, settings.extinction_per_m, silent,
        fired, seen_cell, amount,
    )  # fmt: skip
    del top, blocks, number, block, tau
    return north_up(_estimate(seen_cell[:count], amount[:count], silent, fired))


def _estimate(
    cell: NDArray[np.int64],
    amount: NDArray[np.float64],
    silent: NDArray[np.int64],
    fired: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Most likely reflectance of each cell; NaN where fewer than :data:`FIRED_MIN` were fired."""
    seen = np.bincount(cell, minlength=fired.size)
    start = np.concatenate([[0], np.cumsum(seen)]).astype(np.int64)
    # Beamlets come by time and channel, however the points came: the same sums always.
    amount = amount[lexicographic_order([cell])] if len(cell) else amount
    total = np.concatenate([[0], np.cumsum(np.rint(amount * FIXED_POINT).astype(np.int64))])
    mean = (total[start[1:]] - total[start[:-1]] + silent.ravel()) / np.maximum(fired.ravel(), 1)
    rho = np.empty(fired.size)
    most_likely(start, amount, (silent.ravel() + 0.5 * mean) / FIXED_POINT, rho)
    rho = np.where(fired.ravel() >= FIRED_MIN, rho, np.nan)
    return rho.reshape(fired.shape)


def _margin_cells(settings: ProductSettings) -> int:
    """Raster cells around a ground cell that are looked at; a multiple of the coarse squares."""
    cells = -(-quanta(settings.void_max_m) // quanta(settings.cell_m))
    return -(-cells // COARSE) * COARSE


def reach_m(settings: ProductSettings) -> float:
    """Width of the margin that :func:`raster` reads around a ground cell [m]."""
    return _margin_cells(settings) * quanta(settings.cell_m) * QUANTUM_M


def _join(parts: Sequence[FiredPart], wide: Bounds) -> Blocks:
    """Blocks of several stretches by time, relative to a corner."""
    size = [len(p.blocks) for p in parts]
    channels = max(p.patterns.shape[1] for p in parts)
    t0_s, prf_hz, line = (
        np.repeat([getattr(p, k) for p in parts], size) for k in ("t0_s", "prf_hz", "line")
    )
    blocks = np.concatenate([p.blocks for p in parts])
    blocks["anchor"] -= np.array([wide.xmin * QUANTUM_M, wide.ymin * QUANTUM_M, 0.0])
    begin_s = t0_s + (blocks["first"] - 0.5) / prf_hz
    pattern = np.concatenate([_widen(p.pattern, channels, np.nan) for p in parts])
    bright = np.concatenate(
        [np.repeat(_widen(p.gain[None] * p.constant_m2, channels, 0.0), len(p.blocks), 0)
         for p in parts]
    )  # fmt: skip
    order = np.lexsort((line, begin_s))
    blocks = blocks[order]
    shots = blocks["last"] - blocks["first"] + 1
    fitted = "first", "last", "middle", "half", "anchor", "coefficient", "origin"
    return Blocks(
        begin_s=begin_s[order],
        line=line[order],
        t0_s=t0_s[order],
        prf_hz=prf_hz[order],
        **{name: np.ascontiguousarray(blocks[name]) for name in fitted},
        pattern=pattern[order],
        exposure=bright[order],
        offset=np.cumsum(shots) - shots,
    )


def _widen(values: NDArray[np.float64], channels: int, fill: float) -> NDArray[np.float64]:
    """The same for more channels, along the second axis."""
    missing = [(0, 0)] * values.ndim
    missing[1] = (0, channels - values.shape[1])
    wider: NDArray[np.float64] = np.pad(values, missing, constant_values=fill)
    return wider


@njit()
def most_likely(
    start: NDArray[np.int64],
    amount: NDArray[np.float64],
    silent: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    r"""Reflectance under which what was seen, and what not, is most likely; 0 if none was seen.

    A beamlet that expects :math:`k \rho` photo-electrons is seen with probability :math:`1 - e^{-k
    \rho}` [W17 Eq. 2.7], so :math:`\sum_{seen} k / (e^{k \rho} - 1) = \sum_{silent} k`; equal ones
    give :math:`k \rho = -\ln(1 - p)`. ``amount``: k of each seen beamlet, those of a cell together
    from its ``start`` (m + 1,) on; ``silent`` (m,): sum of k over the silent ones, > 0 where any
    was seen.
    """
    for cell in range(len(start) - 1):
        low, high = start[cell], start[cell + 1]
        out[cell] = 0.0
        if low == high:
            continue
        total = 0.0
        for s in range(low, high):
            total += amount[s]
        mean = total / (high - low)
        rho = math.log1p(total / silent[cell]) / mean
        for _ in range(50):
            value, fall = -silent[cell], 0.0
            for s in range(low, high):
                # of what falls: the exponential of many photo-electrons is beyond all numbers
                unseen, seen = math.exp(-amount[s] * rho), -math.expm1(-amount[s] * rho)
                value += amount[s] * unseen / seen
                fall += amount[s] * amount[s] * unseen / (seen * seen)
            # The left side is convex and falls: from the right a step may go too far.
            new = max(rho + value / fall, 0.25 * rho)
            done = abs(new - rho) <= 1e-10 * rho
            rho = new
            if done:
                break
        out[cell] = rho


def first_surface(
    cell: NDArray[np.int64],
    z: NDArray[np.int32],
    shape: tuple[int, int],
    settings: ProductSettings,
) -> Grid:
    """Median height of the first returns of each cell, small voids filled, and its slope.

    ``cell, z``: cell of each first return, row by row, and its height [quanta].
    """
    rows, cols = shape
    order, start = sort_into_cells(cell, z, rows * cols)
    count = np.diff(start)
    median = np.full(rows * cols, np.nan)
    used = np.flatnonzero(count)
    median[used] = z[order[start[used] + (count[used] - 1) // 2]] * QUANTUM_M
    credible = credible_heights(median.reshape(shape), settings.cell_m)
    height = fill_voids(credible, settings.dsm_void_max_m / settings.cell_m)
    low, high = bounds(height), -bounds(-height)
    return Grid(settings.cell_m, height, slopes(height, settings.cell_m), low, high)


def credible_heights(height: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """Heights of cells (rows, columns) without those where noise may be taken for a surface (NaN).

    A surface goes on in at least two of the eight neighbours.
    """
    padded = np.pad(height, 1, constant_values=np.nan)
    rows, cols = height.shape
    like = np.zeros(height.shape, dtype=np.int64)
    for dr, dc in ring_offsets(1.5)[:, :2]:
        there = slice(1 + dr, 1 + dr + rows), slice(1 + dc, 1 + dc + cols)
        like += np.abs(padded[there] - height) <= ALIKE_CELLS * cell_m
    return np.where(like >= 2, height, np.nan)


def slopes(height: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """Gradient of a surface that does not look across edges, to east and north: (., ., 2).

    Along each axis the flatter of the steps to both neighbours counts, and none where they lead to
    opposite sides: beside a wall it is that of the roof, in a crown it is small.
    """
    out = np.zeros((*height.shape, 2))
    for k, axis in enumerate((1, 0)):
        if height.shape[axis] < 2:
            continue
        step = np.diff(height, axis=axis) / cell_m
        edge = [(0, 0), (0, 0)]
        edge[axis] = (1, 0)
        behind = np.pad(step, edge, constant_values=np.nan)
        edge[axis] = (0, 1)
        ahead = np.pad(step, edge, constant_values=np.nan)
        behind, ahead = (
            np.where(np.isnan(behind), ahead, behind),
            np.where(np.isnan(ahead), behind, ahead),
        )
        flat = np.where(np.abs(behind) < np.abs(ahead), behind, ahead)
        out[..., k] = np.where(behind * ahead > 0, flat, 0.0)
    return out


def bounds(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lowest of the cells in and around each coarse square; NaN without any."""
    edges = [(0, -side % COARSE) for side in height.shape]
    filled = np.pad(np.where(np.isnan(height), np.inf, height), edges, constant_values=np.inf)
    squares = filled.reshape(-1, COARSE, filled.shape[1] // COARSE, COARSE).min(axis=(1, 3))
    lowest = ndimage.minimum_filter(squares, 3, mode="constant", cval=np.inf)
    return np.where(np.isinf(lowest), np.nan, lowest)
