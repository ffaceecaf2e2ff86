"""Terrain under a bridge over a gorge, and what is left as it is."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.doubts.under_decks import under_decks
from spl_batch.constants import QUANTA_PER_M
from spl_batch.numerics.triangulation.tin_raster import tin_raster

Grid = NDArray[np.float64]
EDGE, MARGIN = 60, 24


def made(height: Grid, hidden: NDArray[np.bool_], surface: Grid) -> tuple[Grid, Grid]:
    """Terrain by triangles alone, and with what goes on under surfaces, of the core [m]."""
    ground = np.where(hidden, np.nan, height) * QUANTA_PER_M
    row, column = np.nonzero(~hidden)
    vertices = np.column_stack([column + 0.5 - MARGIN, row + 0.5 - MARGIN, height[row, column]])
    size = EDGE + 0.0
    dtm = tin_raster(vertices, 1.0, (EDGE, EDGE), size) * QUANTA_PER_M
    core: Any = slice(MARGIN, MARGIN + EDGE)
    top = np.where(hidden, surface, height)[core, core] * QUANTA_PER_M
    found = under_decks(dtm, ground, top, top, QUANTA_PER_M)
    return dtm / QUANTA_PER_M, found / QUANTA_PER_M


def places() -> tuple[Grid, Grid]:
    y, x = np.indices((EDGE + 2 * MARGIN,) * 2) + 0.5 - MARGIN
    return x, y


@pytest.mark.parametrize("skew", [0.0, 0.2])
def test_the_floor_of_a_gorge_goes_on_under_a_bridge(skew: float) -> None:
    x, y = places()
    floor = np.abs(x - 30 - skew * (y - 30)) < 6
    height = np.where(floor, -15.0, 0.05 * x) + 0.02 * y
    deck = (np.abs(y - 30) < 5) & (np.abs(x - 30) < 20)
    # Beams lean: beside the deck the floor is hidden as well.
    hidden = deck | (floor & (np.abs(y - 30) < 8))
    triangles, found = made(height, hidden, np.full_like(x, 2.0))
    core = slice(MARGIN, MARGIN + EDGE)
    # In a cell at a wall any height between foot and top is right.
    wall = ndimage.maximum_filter(height, 3) - ndimage.minimum_filter(height, 3) > 5.0
    of_deck = (deck & ~wall)[core, core]
    wrong, left = (np.abs(some - height[core, core])[of_deck] > 0.5 for some in (triangles, found))
    assert wrong.sum() > 30
    assert not left.any()
    seen = ~hidden[core, core]
    assert np.array_equal(found[seen], triangles[seen])


@pytest.mark.parametrize("slope", [0.0, 0.2, 0.6])
def test_a_house_on_a_hillside_changes_nothing(slope: float) -> None:
    x, y = places()
    height = slope * x + 0.3 * np.sin(x / 3) + 0.3 * np.sin(y / 4)
    house = (np.abs(x - 30) < 5) & (np.abs(y - 30) < 8)
    triangles, found = made(height, house, height + 4.0)
    assert np.array_equal(found, triangles)
