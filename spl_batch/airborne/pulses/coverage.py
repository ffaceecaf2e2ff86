"""How evenly first returns cover the ground: spatial distribution, data voids.

Source: USGS Lidar Base Specification, Collection Requirements: spatial distribution, 90 % of the
squares of twice the nominal spacing hold a first return; data voids, areas of (4 x spacing)^2
without one. All swaths count together: voids may be filled by another one. Single swaths are those
of :mod:`~spl_batch.airborne.pulses.swaths`. Deviations: a void is a whole empty square of four
spacings, not any shape of its area; only places that were flown count.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.raster_grid import at_centres, held, owned
from spl_batch.lattice.tiles import Bounds, grow

SPACINGS: Final[Mapping[str, int]] = {"QL1": 350, "QL2": 710, "QL3": 1410}
"""Aggregate nominal pulse spacing of a quality level, that of QL0 is QL1's [quanta]; USGS Lidar
Base Specification, table of nominal pulse spacing and density."""

VOID_SPACINGS: Final = 4
"""Edge of a data void [spacings]."""


class Coverage(NamedTuple):
    """Squares of a region that was flown, water excepted; counts of several regions add up."""

    #: Squares of twice the spacing; those that hold a first return [count].
    squares: int
    filled: int
    #: Squares of the spacing; those that lie in a data void [count].
    places: int
    void: int


def coverage(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    counted: NDArray[np.bool_],
    core: Bounds,
    spacing: int,
) -> Coverage:
    """Squares of a region by one of :data:`SPACINGS` [quanta].

    ``x, y``: first returns of the region and of five spacings around it [quanta]; ``counted``:
    cells of the region that count, row 0 southernmost.
    """
    pairs, places = owned(core, 2 * spacing), owned(core, spacing)
    wide = grow(places, VOID_SPACINGS)
    window = np.ones((VOID_SPACINGS, VOID_SPACINGS), np.bool_)
    void = ndimage.binary_opening(~held(x, y, wide, spacing), window)
    inner = slice(VOID_SPACINGS, -VOID_SPACINGS)
    there = at_centres(counted, core, pairs, 2 * spacing)
    beside = at_centres(counted, core, places, spacing)
    filled, empty = there & held(x, y, pairs, 2 * spacing), beside & void[inner, inner]
    return Coverage(*(int(np.count_nonzero(some)) for some in (there, filled, beside, empty)))
