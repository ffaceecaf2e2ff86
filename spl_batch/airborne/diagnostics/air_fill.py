r"""Returns that fill the air above ground, or float with nothing below them.

Haze, fog, a cloud or noise in clusters has enough neighbours to pass a test of noise, and its top
becomes the surface. *Filled* is a block of air of :data:`PLACE_M` and :data:`BLOCK` metres of
height above the ground in which many more signals than noise explains lie evenly: with n of them in
each of its k columns of :data:`COLUMN_M`,

.. math:: \kappa = k \sum n (n - 1) / (\sum n)^2

is 1 in air and above 1 among leaves, trunks and wires. Roofs and decks are even, too, but nothing
is seen below them. Single places are even by chance, so several must lie together.

A signal *floats* if nothing was kept in the :data:`GAP` layers of cells of 5 m below it, in its
column and the eight around, while a surface lies farther down in its own column. Roofs and decks
hang so beside their edges: what is thinner than as many, and not far thinner spread
than what lies below, is a surface itself. Where noise is not removed, single returns high up that
the DSM lies on are named, too.
"""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.diagnostics.patches import WARNED_M2, largest_of_squares, patches
from spl_batch.airborne.filter.stray_returns import CELL_M, GAP, Bare
from spl_batch.airborne.findings import WARNED_SHARE
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import NODATA, NOISE_SIGNAL, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta
from spl_batch.numerics.compiled import njit

PLACE_M: Final = 10.0
COLUMN_M: Final = 2.0
"""Edges of a place and of its columns [m]."""

FLOOR_M: Final = 0.75
"""Lower end of the air: above what errors of the terrain and ranging noise lift off it [m]."""

LAYERS: Final = 120
BLOCK: Final = 2
"""Layers of a metre that are looked at, and those of a block [count]."""

EVEN: Final = 1.1
"""Largest clumping of a filled block: with that of haze, 1.15, crowns of 1.2 m are filled air."""

LEAST_PER_M3: Final = 0.3
TIMES_NOISE: Final = 4.0
"""Signals of a filled block: enough to show clumps, and many more than noise [1/m3, 1]."""

SEEN: Final = 0.8
"""Least share of the columns of a place in which the ground is seen."""

BESIDE: Final = 3
"""Filled places among nine [count]. Without, crowns that are clumped by 1.2 fill air."""

THIN: Final = 0.1
"""Signals of a column that are fewer than this share of others in it are no surface."""

FILLED: Final = "filled"
"""Fact of a ground cell: area [m2], lower and upper end above ground, and west, south, east and
north of its largest patch [m], if there is one."""

FLOATS: Final = "floats"
"""Fact of a ground cell: floating signals, all signals [count], area [m2], and west, south, east
and north of its largest place [m] where there is one."""

ALONE: Final = "alone"
"""Fact of a ground cell: cells of its DSM that rise alone [count], and the most above terrain [m],
if there are such."""

_EDGE, _COLUMN = quanta(PLACE_M), quanta(COLUMN_M)
_SIDE: Final = _EDGE // _COLUMN

Counts = NDArray[np.int64]
Marks = NDArray[np.bool_]


def highest_ground(dtm: NDArray[np.float32]) -> NDArray[np.float32]:
    """Ground below the air, NaN where it is void [m]; of the DTM of a whole ground cell.

    On a slope a cell rises half-way towards the highest cell beside it: bare ground of 60 degrees
    would fill the air above the middle of its cells.
    """
    top = (dtm + ndimage.maximum_filter(dtm, 3)) / np.float32(2.0)
    return np.where(dtm == np.float32(NODATA), np.float32(np.nan), top)


def filled_blocks(
    table: PointTable, part: Bounds, highest: NDArray[np.float32], noise_m3: float
) -> Marks | None:
    """Blocks of air that signals fill evenly: (rows, columns, blocks) bool, or None.

    By place from the south-west and lowest metre; squares of the absolute grid that lie in the cell
    are places, and there may be none. ``table``: with ``x, y, z, noise_class``; ``highest``:
    :func:`highest_ground`, north up.
    """
    west, south = -(-part.xmin // _EDGE), -(-part.ymin // _EDGE)
    columns, rows = int(part.xmax // _EDGE - west), int(part.ymax // _EDGE - south)
    if columns < 1 or rows < 1:
        return None
    counts = np.zeros((rows, columns, LAYERS, _SIDE * _SIDE), np.uint16)
    seen = np.zeros((rows, columns, _SIDE * _SIDE), np.bool_)
    frame = (west * _EDGE, south * _EDGE, part.xmin, part.ymax)
    size = (part.xmax - part.xmin) // highest.shape[1]
    _count(
        (table["x"], table["y"], table["z"]), table["noise_class"], frame, highest, size,
        counts, seen,
    )  # fmt: skip
    least = PLACE_M**2 * BLOCK * max(LEAST_PER_M3, TIMES_NOISE * noise_m3)
    out = np.zeros((rows, columns, LAYERS - BLOCK + 1), np.bool_)
    for row in range(rows):
        whole = sum(
            counts[row, :, k : LAYERS - BLOCK + 1 + k].astype(np.int64) for k in range(BLOCK)
        )
        total, pairs = np.sum(whole, axis=-1), np.sum(whole * (whole - 1), axis=-1)
        out[row] = (total >= least) & (_SIDE * _SIDE * pairs <= EVEN * total**2)
    out &= (seen.mean(axis=2) >= SEEN)[:, :, np.newaxis]
    return out


def fill_facts(filled: Marks, core: Bounds) -> dict[str, list[float]]:
    """What the report needs of a ground cell, by its :func:`filled_blocks`."""
    beside = ndimage.convolve(filled.astype(np.int8), np.ones((3, 3, 1), np.int8), mode="constant")
    air = filled & (beside >= BESIDE)
    anywhere: Marks = np.asarray(air.any(axis=2))
    found = [one for one in patches(anywhere) if PLACE_M**2 * one.squares >= WARNED_M2]
    if not found:
        return {FILLED: []}
    own = air[found[0].at][found[0].marked]
    low_m = float(np.median(own.argmax(axis=1))) + FLOOR_M
    high_m = float(np.median(own.shape[1] - 1 - own[:, ::-1].argmax(axis=1))) + BLOCK + FLOOR_M
    west_m, south_m = (-(-side // _EDGE) * PLACE_M for side in (core.xmin, core.ymin))
    box = found[0].box(west_m, south_m, PLACE_M)
    area_m2 = PLACE_M**2 * sum(one.squares for one in found)
    return {FILLED: [area_m2, low_m, high_m, *box]}


def float_facts(bare: Bare, region: Bounds) -> dict[str, list[float]]:
    """Signal of a region that floats, for the report; ``bare`` reaches around the region too."""
    numbers, (x, y) = bare.columns(region)
    at = np.ix_(*numbers)
    found = floating(bare.kept, bare.marked)[at]
    facts = [float(found.sum()), float(bare.kept.sum(axis=2)[at].sum())]
    if found.any():
        column, row = np.nonzero(found)
        squares = np.column_stack([x[column], y[row]]) // quanta(CELL_M)
        area_m2, box = largest_of_squares(squares, CELL_M)
        facts += [area_m2, *box]
    return {FLOATS: facts}


def floating(kept: Counts, stray: Marks) -> Counts:
    """Signals that float, by column: (a, b).

    ``kept``: signals of each cell, layers rise along the last axis, gaps of more than :data:`GAP`
    may be closed to that [count]; ``stray``: cells whose signals are no surface: nothing floats
    above these.
    """
    layers = np.arange(kept.shape[2])
    solid = np.where(stray, 0, kept)
    # The last layer with a surface below each one, and what stands in a column up to there.
    wide = ndimage.maximum_filter(solid > 0, (3, 3, 1), mode="constant")
    last = np.maximum.accumulate(np.where(wide, layers, -1), axis=2)
    before = np.concatenate([np.full((*kept.shape[:2], 1), -1), last[:, :, :-1]], axis=2)
    below = np.take_along_axis(np.cumsum(solid, axis=2), np.maximum(before, 0), axis=2)
    hangs = (kept > 0) & (before >= 0) & (layers - before > GAP) & (below > 0)
    aloft = np.where(np.logical_or.accumulate(hangs, axis=2), kept, 0)
    count = aloft.sum(axis=2)
    under = np.where(hangs.any(axis=2), kept.sum(axis=2) - count, 0)
    thick = np.count_nonzero(aloft, axis=2) >= GAP
    found: Counts = np.where((thick & (under >= THIN * count)) | (count < THIN * under), count, 0)
    return found


def alone_facts(dsm: NDArray[np.float32], dtm: NDArray[np.float32]) -> dict[str, list[float]]:
    """Cells that rise by more than :data:`LAYERS` metres above all but one cell beside them [m]."""
    beside = ndimage.rank_filter(dsm, -3, 3, mode="constant", cval=NODATA)
    alone = (dsm - beside > LAYERS) & (beside > NODATA) & (dtm > NODATA)
    above = (dsm - dtm)[alone]
    return {ALONE: [float(above.size), float(above.max())]} if above.size else {}


def air_findings(done: Receipts, settings: FilterSettings) -> Iterator[Finding]:
    """Air that signals fill, and signals that float."""
    for name, receipt in done.get("surface", {}).items():
        if fact := receipt.facts.get(FILLED):
            area_m2, low_m, high_m, *box = fact
            values = {"area_m2": area_m2, "low_m": low_m, "high_m": high_m}
            yield Finding("N04", values, name, box, area_m2)
        if fact := receipt.facts.get(ALONE):
            count, highest_m = fact
            values = {
                "kind": "alone", "count": int(count), "least_m": LAYERS, "highest_m": highest_m,
            }  # fmt: skip
            yield Finding("N07", values, name, badness=highest_m)
    alpha = settings.alpha if settings.method == "vsaes" else 0.0
    least = WARNED_SHARE + alpha
    cells = [(name, r.facts.get(FLOATS, ())) for name, r in done.get("ground", {}).items()]
    off = [(name, fact) for name, fact in cells if len(fact) > 2 and fact[0] > least * fact[1]]
    if sum(fact[2] for _, fact in off) < WARNED_M2:
        return
    for name, (count, kept, area_m2, *box) in off:
        values = {"kind": "thick", "share": count / kept, "area_m2": area_m2}
        yield Finding("N07", values, name, box, area_m2)


@njit()
def _count(
    place: tuple[Any, Any, Any], kind: NDArray[np.uint8], frame: tuple[int, int, int, int],
    highest: NDArray[np.float32], size: int, counts: NDArray[np.uint16], seen: Marks,
) -> None:  # fmt: skip
    """Count signals by place, metre above the ground and column; mark columns with ground.

    ``frame``: west and south of the places, west and north of ``highest`` [quanta].
    """
    x, y, z = place
    rows, columns = seen.shape[0], seen.shape[1]
    for i in range(len(x)):
        east, north = x[i] - frame[0], y[i] - frame[1]
        if kind[i] != NOISE_SIGNAL or east < 0 or north < 0:
            continue
        row, column = north // _EDGE, east // _EDGE
        if row >= rows or column >= columns:
            continue
        ground = highest[(frame[3] - 1 - y[i]) // size, (x[i] - frame[2]) // size]
        above = z[i] * QUANTUM_M - ground
        within = north % _EDGE // _COLUMN * _SIDE + east % _EDGE // _COLUMN
        if abs(above) < FLOOR_M:
            seen[row, column, within] = True
        elif FLOOR_M <= above < FLOOR_M + LAYERS:
            layer = int(above - FLOOR_M)
            if counts[row, column, layer, within] < 65535:
                counts[row, column, layer, within] += np.uint16(1)
