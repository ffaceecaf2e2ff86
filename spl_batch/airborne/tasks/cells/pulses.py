"""What the returns of a ground cell cover, how densely and evenly; added up for the report."""

from collections.abc import Mapping
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.classes.overlap import lines_by_square
from spl_batch.airborne.context import Context
from spl_batch.airborne.products.footprint import SQUARE_Q, Covered, Within, refused, whole_squares
from spl_batch.airborne.products.surface_rasters import margin_cells
from spl_batch.airborne.pulses.level_places import places_in
from spl_batch.airborne.pulses.pulse_coverage import SPACINGS, EmptySquares, not_flown, reach_q
from spl_batch.airborne.pulses.pulse_maps import PulseMaps
from spl_batch.airborne.pulses.pulse_returns import COLUMNS_NEEDED, Ends
from spl_batch.airborne.pulses.smooth_surfaces import Sums, smooth_sums
from spl_batch.airborne.pulses.square_kernels import count_squares
from spl_batch.airborne.pulses.swath_coverage import Swaths, at_places
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NODATA, NOISE_NOT_ASSESSED, NOISE_SIGNAL
from spl_batch.formats.vector_files import contains, read_polygons
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, quanta

_SQUARES: Final = "footprint"
"""Fact of a ground cell: squares that returns cover [count]."""

_CELLS: Final = "cells_by_returns"
"""Fact of a ground cell: raster cells that were flown, by the signal returns in them [count]."""

_VOIDS: Final = "voids"
"""Fact of a ground cell: raster cells that were flown and have no terrain height [count]."""

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

SWATHS: Final = "swaths"
"""Fact of a ground cell: what :class:`~spl_batch.airborne.pulses.swath_coverage.Swaths` found, on
flown squares, no water."""

OUTLINES: Final = "swath_outlines"
"""Fact of a ground cell: where each swath lies in it."""

COLUMNS: Final = (*COLUMNS_NEEDED, "line")
"""What is looked at, and ``noise_class, flags``."""


def of_interest(context: Context) -> Within | None:
    """Which places lie within the area of interest; None where there is none."""
    aoi = context.workflow.aoi
    if aoi is None:
        return None
    return partial(contains, read_polygons(context.resolve(aoi), context.crs))


def covered(
    squares: NDArray[np.bool_], arrays: Mapping[str, NDArray[np.float32]], context: Context
) -> dict[str, Any]:
    """Facts of a ground cell: whole numbers, so that sums do not depend on their order.

    Parameters
    ----------
    squares : (rows, cols) bool
        Its squares that returns cover, within the area of interest.
    arrays : mapping of str to (rows, cols) float32
        Its rasters; ``dtm`` and ``density`` are looked at.
    """
    products = context.workflow.products
    flown = arrays["density"] != NODATA
    returns = np.rint(arrays["density"][flown].astype(np.float64) * products.cell_m**2)
    values, counts = np.unique(returns.astype(np.int64), return_counts=True)
    return {
        _SQUARES: int(np.count_nonzero(squares)),
        _CELLS: dict(zip(map(str, values.tolist()), counts.tolist(), strict=True)),
        _VOIDS: int(np.count_nonzero(arrays["dtm"][flown] == NODATA)),
    }


class PulseReturns(NamedTuple):
    """First and last returns of pulses."""

    first: NDArray[np.int64]  #: (n, 3): where the first ones are [quanta].
    last: NDArray[np.int64]  #: (n, 2): where the last ones are [quanta].
    line: NDArray[np.int64]  #: (n,): flightlines of the first ones.


def usable(table: PointTable) -> NDArray[np.bool_]:
    """Signal that may be a return of a pulse: (n,) bool, of each point by itself."""
    noise_class = table["noise_class"]
    found: NDArray[np.bool_] = (noise_class == NOISE_SIGNAL) | (noise_class == NOISE_NOT_ASSESSED)
    return found & ~table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)


def reach(products: ProductSettings) -> int:
    """How far around a ground cell returns are looked at [quanta].

    Returns of one pulse lie side by side: what leans across the margin counts on its own side.
    """
    return max(margin_cells(products) * quanta(products.cell_m), reach_q())


def _held(sums: Sums | None) -> list[list[int]]:
    """Sums of the thicknesses that there are, with their numbers."""
    if sums is None:
        return []
    return [[k, *sums[k].tolist()] for k in np.flatnonzero(sums[:, 0]).tolist()]


def returns_of(table: PointTable, ends: Ends) -> PulseReturns:
    """First and last returns of pulses.

    Parameters
    ----------
    table : PointTable
        Points with :data:`COLUMNS`.
    ends : ((n,) bool, (n,) bool)
        Which of them are first and last returns.
    """
    first, last = ends
    xyz = np.column_stack([table[axis][first] for axis in "xyz"]).astype(np.int64)
    xy = np.column_stack([table[axis][last] for axis in "xy"])
    return PulseReturns(xyz, xy, table["line"][first].astype(np.int64))


class Judged(NamedTuple):
    """Squares of a cell that requirements look at, row 0 southernmost; water is none."""

    dry: NDArray[np.bool_]  #: (rows, cols): what was flown.
    counted: NDArray[np.bool_]  #: (rows, cols): where there is signal around.


class Pulses:
    """What the pulses of a ground cell tell.

    Parameters
    ----------
    returns : PulseReturns
        First and last returns in the cell and :func:`reach` around it.
    core : Bounds
        The cell [quanta].
    context : Context
        The run.
    """

    def __init__(
        self,
        returns: PulseReturns,
        core: Bounds,
        context: Context,
    ) -> None:
        self._core, self._context = core, context
        workflow = context.workflow
        self._region = whole_squares(core)
        x, y = (np.ascontiguousarray(axis) for axis in returns.first.T[:2])
        self._signal, self._empty = Covered(core, workflow.products), EmptySquares(self._region)
        self._signal.add(x, y)
        self._empty.add(x, y)
        self._count = np.zeros(self._signal.squares().shape, np.int64)
        west, south = self._region.xmin // SQUARE_Q, self._region.ymin // SQUARE_Q
        count_squares(x, y, west, south, SQUARE_Q, self._count)
        self._swaths = Swaths(core, reach(workflow.products))
        self._swaths.add(x, y, returns.line)
        places = places_in(returns.first, returns.line, core)
        self._smooth = {} if places is None else smooth_sums(places)
        self._maps: PulseMaps | None = None
        self.lines: NDArray[np.int64] | None = None  #: Flightlines by square, for overlap.
        if workflow.products.maps:
            self._maps = PulseMaps(core, quanta(workflow.products.cell_m))
            self._maps.add(returns.first[:, :2], returns.last, returns.line)
        if workflow.classes.overlap:
            self.lines = lines_by_square(returns.first[:, :2], returns.line)

    def judged(self, squares: NDArray[np.bool_]) -> Judged:
        """Which of the cell's squares count.

        Parameters
        ----------
        squares : (rows, cols) bool
            Those that were flown (:mod:`~spl_batch.airborne.products.footprint`).
        """
        context, dry = self._context, squares
        if context.workflow.water is not None:
            polygons = read_polygons(context.resolve(context.workflow.water), context.crs)
            dry = refused(squares, self._core, lambda x, y: ~contains(polygons, x, y))
        return Judged(dry, dry & self._signal.squares())

    def facts(self, judged: Judged) -> dict[str, Any]:
        """What the report needs to know: whole numbers, so that sums do not depend on their order.

        Nothing here depends on the raster's cells: at the edge of a survey coarse ones would count
        ground that nobody has flown.
        """
        dry, flown = judged
        return {
            PULSES: int(self._count[flown].sum()),
            FLOWN: int(np.count_nonzero(flown)),
            BARE: int(np.count_nonzero(dry & ~flown)),
            LEVELS: {
                level: list(self._empty.coverage(flown, spacing)[0])
                for level, spacing in SPACINGS.items()
            },
            SWATHS: self._swaths.facts(dry, self._region),
            OUTLINES: self._swaths.outlines(),
            SMOOTH: {level: _held(self._smooth.get(level)) for level in SPACINGS},
        }

    def rasters(
        self, density: NDArray[np.float32], judged: Judged
    ) -> dict[str, NDArray[np.float32]]:
        """Maps of the cell, where they are asked for.

        Parameters
        ----------
        density : (rows, cols) float32
            Its raster of density, nodata where nothing was flown.
        judged : Judged
            Voids are looked for where the report counts them.
        """
        if self._maps is None:
            return {}
        flown, core = ~not_flown(density), self._core
        size = (core.xmax - core.xmin) // flown.shape[1]
        x, y = (
            np.arange(low + size // 2, high, size)
            for low, high in ((core.xmin, core.xmax), (core.ymin, core.ymax))
        )
        return self._maps.rasters(flown, flown & at_places(judged.counted, self._region, x, y))
