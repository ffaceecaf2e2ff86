"""First returns of a ground cell: how densely and how evenly they cover what was flown."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.products.footprint import (
    SQUARE_Q,
    refused,
    whole_squares,
    within_returns,
)
from spl_batch.airborne.products.surface_rasters import margin_cells
from spl_batch.airborne.pulses.pulse_coverage import SPACINGS, coverage, not_flown, reach_q
from spl_batch.airborne.pulses.pulse_maps import flightline_of, pulse_maps
from spl_batch.airborne.pulses.pulse_returns import COLUMNS_NEEDED, pulse_ends
from spl_batch.airborne.pulses.smooth_surfaces import smooth_sums
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NOISE_NOT_ASSESSED, NOISE_SIGNAL
from spl_batch.formats.polygons import contains, read_polygons
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable, rows_of
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta

PULSES: Final = "pulses"
"""Fact of a ground cell: first returns on flown squares with signal around, no water [count]."""

FLOWN: Final = "pulse_squares"
"""Fact of a ground cell: those squares [count]."""

BARE: Final = "pulse_bare"
"""Fact of a ground cell: flown squares beyond every signal, off the edge or in a wide hole
[count]."""

LEVELS: Final = "pulse_levels"
"""Fact of a ground cell: a :class:`~spl_batch.airborne.pulses.pulse_coverage.Coverage` by
spacing."""

SMOOTH: Final = "smooth"
"""Fact of a ground cell: sums of :mod:`~spl_batch.airborne.pulses.smooth_surfaces` by spacing; of
each thickness that is there: its number, places, cells, squared differences [quanta2]."""

PASS_S: Final = 60.0
"""Returns of one point source id in the same minute are of one pass [s]."""

COLUMNS: Final = (*COLUMNS_NEEDED, "point_source_id")
"""What is looked at, and ``noise_class, flags``."""


class PulseReturns(NamedTuple):
    """First and last returns of pulses."""

    first: NDArray[np.int64]  #: (n, 3): where the first ones are [quanta].
    last: NDArray[np.int64]  #: (n, 2): where the last ones are [quanta].
    time_s: NDArray[np.float64]  #: (n,): times of the first ones [s].
    point_source_id: NDArray[np.uint16]  #: (n,): theirs.


def usable(table: PointTable) -> NDArray[np.bool_]:
    """Signal that may be a return of a pulse: (n,) bool, of each point by itself."""
    noise_class = table["noise_class"]
    found: NDArray[np.bool_] = (noise_class == NOISE_SIGNAL) | (noise_class == NOISE_NOT_ASSESSED)
    return found & ~table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)


def pulse_returns(table: PointTable, core: Bounds, products: ProductSettings) -> PulseReturns:
    """First and last signal returns in and around a ground cell.

    Parameters
    ----------
    table : PointTable
        Points of the cell and around it that are :func:`usable`, with :data:`COLUMNS`.
    core : Bounds
        The cell [quanta].
    """
    # Returns of one pulse lie side by side: what leans across the margin counts on its own side.
    margin = max(margin_cells(products) * quanta(products.cell_m), reach_q())
    near = inside(table["x"], table["y"], grow(core, margin))
    signal = table.select(COLUMNS).take(rows_of(near))
    first, last = pulse_ends(signal)
    xyz = np.column_stack([signal[axis][first] for axis in "xyz"]).astype(np.int64)
    xy = np.column_stack([signal[axis][last] for axis in "xy"])
    of_first = (signal[name][first] for name in ("gps_time", "point_source_id"))
    return PulseReturns(xyz, xy, *of_first)


def pulse_facts(
    returns: PulseReturns, core: Bounds, squares: NDArray[np.bool_], context: Context
) -> dict[str, Any]:
    """What the report needs to know: whole numbers, so that sums do not depend on their order.

    Nothing here depends on the raster's cells: at the edge of a survey coarse ones would count
    ground that nobody has flown.

    Parameters
    ----------
    core : Bounds
        The cell [quanta].
    squares : (rows, cols) bool
        Its squares that were flown (:mod:`~spl_batch.airborne.products.footprint`).
    """
    x, y, _ = returns.first.T
    dry = squares
    if context.workflow.water is not None:
        polygons = read_polygons(context.resolve(context.workflow.water), context.crs)
        dry = refused(squares, core, lambda east, north: ~contains(polygons, east, north))
    signal = within_returns(x, y, core, context.workflow.products)
    flown, region = dry & signal, whole_squares(core)
    levels: Mapping[str, Any] = {
        level: coverage(x, y, region, flown, spacing)[0] for level, spacing in SPACINGS.items()
    }
    own = inside(x, y, region)
    counted = flown[(y[own] - region.ymin) // SQUARE_Q, (x[own] - region.xmin) // SQUARE_Q]
    return {
        PULSES: int(np.count_nonzero(counted)),
        FLOWN: int(np.count_nonzero(flown)),
        BARE: int(np.count_nonzero(dry & ~signal)),
        LEVELS: {level: list(found) for level, found in levels.items()},
        SMOOTH: {
            level: [[k, *sums[k].tolist()] for k in np.flatnonzero(sums[:, 0]).tolist()]
            for level, sums in smooth_sums(returns.first, _passes(returns), core).items()
        },
    }


def _passes(returns: PulseReturns) -> NDArray[np.int64]:
    """A number for each pass of a flightline: one that turns comes back some minutes later."""
    minute = np.nan_to_num(np.floor(returns.time_s / PASS_S), nan=-1.0).astype(np.int64)
    return minute * 2**16 + returns.point_source_id


def pulse_rasters(
    returns: PulseReturns,
    core: Bounds,
    density: NDArray[np.float32],
    passes: Sequence[tuple[int, float, float]],
) -> dict[str, NDArray[np.float32]]:
    """Maps of a ground cell.

    Parameters
    ----------
    core : Bounds
        The cell [quanta].
    density : (rows, cols) float32
        Its raster of density, nodata where nothing was flown.
    passes : sequence of (int, float, float)
        Point source id, first and last time of each flightline [s].
    """
    line = flightline_of(returns.point_source_id, returns.time_s, passes)
    return pulse_maps(returns.first[:, :2], returns.last, line, core, ~not_flown(density))
