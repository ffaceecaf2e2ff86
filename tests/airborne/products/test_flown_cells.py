"""Returns about as high as the ground around them show what was flown."""

import numpy as np
import pytest

from spl_batch.airborne.products.flown_cells import NEAR_GROUND_M, about_ground
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

SIZE = quanta(1.0)
REGION = Bounds(0, 0, 100 * SIZE, 60 * SIZE)


def ground(slope: float = 0.0) -> np.ndarray:
    """Raster cells with ground in the west, 40 m wide: one in three, rising eastwards [quanta]."""
    column, row = (axis.ravel() for axis in np.meshgrid(np.arange(40), np.arange(60)))
    place = np.column_stack([column + 0.5, row + 0.5, slope * (column + 0.5)]) * SIZE
    return place[(column + row) % 3 == 0]


def returns(*places_m: tuple[float, float, float]) -> PointTable:
    x, y, z = np.round(np.array(places_m).T * SIZE).astype(np.int64)
    return PointTable({"x": x, "y": y, "z": z.astype(np.int32)})


def test_noise_taken_for_ground_beyond_the_edge_shows_nothing_flown() -> None:
    island = np.array([[70.5, 30.5, 130.0], [70.5, 31.5, 130.4]]) * SIZE
    table = returns((75, 30, 128), (60, 45, 131), (45, 30, 3), (20, 30, 60), (20, 30, -9))
    found = about_ground(table, REGION, np.concatenate([ground(), island]), SIZE)
    assert found.tolist() == [False, False, True, False, True]


@pytest.mark.parametrize("off_m", [-NEAR_GROUND_M - 1.0, 0.0, NEAR_GROUND_M + 1.0])
def test_a_return_is_compared_with_the_ground_beside_it(off_m: float) -> None:
    table = returns((5.5, 30.5, 2.5 + off_m), (38.5, 30.5, 19.0 + off_m))
    assert (about_ground(table, REGION, ground(0.5), SIZE) == (off_m == 0.0)).all()


def test_amid_ground_and_without_any_all_returns_of_the_region_count() -> None:
    table = returns((20, 30, 90), (20, 70, 0))
    row, column = (axis.ravel() for axis in np.indices((60, 40)))
    full = np.column_stack([column + 0.5, row + 0.5, np.zeros(2400)]) * SIZE
    for known in (full, np.empty((0, 3))):
        assert about_ground(table, REGION, known, SIZE).tolist() == [True, False]
