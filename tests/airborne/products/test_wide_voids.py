"""Voids too wide to be filled are found, by area and place; rims of swaths are none."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.products import wide_voids as module
from spl_batch.airborne.products.wide_voids import Void, wide_voids
from spl_batch.constants import NODATA

CORNER_XY_M = (500_000.0, 4_000_100.0)
SHAPE = (200, 260)


def raster(held: NDArray[np.bool_]) -> list[tuple[int, int, NDArray[np.float32]]]:
    """A raster in pieces, which do not end where squares do; nothing of its last columns."""
    values = np.where(held, np.float32(7.0), np.float32(NODATA))
    return [
        (row, column, values[row : row + 70, column : column + 50])
        for row in range(0, SHAPE[0], 70)
        for column in range(0, 250, 50)
    ]


def scene() -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Terrain and what was flown: 120 m x 100 m in cells of half a metre, a rim without ground."""
    terrain = np.zeros(SHAPE, np.bool_)
    terrain[20:180, 10:240] = True
    flown = np.zeros(SHAPE, np.bool_)
    flown[20:180, 4:246] = True  # 3 m off the edges there is noise alone
    return terrain, flown


def voids(terrain: NDArray[np.bool_], flown: NDArray[np.bool_]) -> list[Void]:
    return wide_voids(raster(terrain), raster(flown), SHAPE, CORNER_XY_M, 0.5)


@pytest.mark.parametrize("squares", [2**22, 3000])
def test_a_lake_is_told_by_area_and_place(squares: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SQUARES", squares)
    terrain, flown = scene()
    assert voids(terrain, flown) == []
    terrain[60:90, 100:140] = False  # 15 m x 20 m, whether or not anybody saw noise there
    terrain[150:152, 200:203] = False
    for seen in (flown, flown & terrain):
        large, small = voids(terrain, seen)
        assert (large.area_m2, small.area_m2) == (300.0, 1.5)
        assert abs(large.east_m - (CORNER_XY_M[0] + 60.0)) <= 4.0
        assert abs(large.north_m - (CORNER_XY_M[1] - 37.5)) <= 4.0


def test_a_lake_at_the_edge_is_told_where_it_was_flown() -> None:
    terrain, flown = scene()
    terrain[60:100, 200:240] = False  # 20 m x 20 m, open to a rim of 3 m in the east
    (lake,) = voids(terrain, flown)
    assert lake.area_m2 == pytest.approx(20.0 * 23.0, rel=0.1)
    assert voids(terrain, flown & terrain) == []  # nobody was there: the survey ends
