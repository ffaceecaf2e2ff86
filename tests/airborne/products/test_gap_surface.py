"""Plates across gaps of the terrain, against scipy's and against the truth."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.interpolate import RBFInterpolator

from spl_batch.airborne.products.gap_surface import FAR_M, bridged
from spl_batch.numerics.triangulation.tin_raster import tin_raster

MARGIN, EDGE = 40, 60
SIDE = EDGE + 2 * MARGIN
CORNER = -15, 8
"""Absolute row and column of the first cell."""

ROW, COLUMN = np.indices((SIDE, SIDE)) + 0.5
NOTHING_WET = np.zeros((SIDE, SIDE), np.bool_)
HALL = (np.abs(ROW - 68) < 13) & (np.abs(COLUMN - 72) < 17)
HILL = 5e-3 * ((ROW - 70) ** 2 + (COLUMN - 70) ** 2) + 0.1 * COLUMN


def ground(height, held):
    """Means of cells with ground, in their middle."""
    means = np.stack([COLUMN, ROW, height], axis=-1)
    means[~held] = np.nan
    return means


def both(means, wet=NOTHING_WET, corner=CORNER):
    """TIN of the inner cells, and the same with plates."""
    held = means[~np.isnan(means[:, :, 2])] - (MARGIN, MARGIN, 0)
    inner = [n - 2 * MARGIN for n in means.shape[:2]]
    tin = tin_raster(held, 1, tuple(inner), 20.0)
    return tin, bridged(tin, means, wet, 1, FAR_M, corner)


def inner(field):
    """What lies within the margin."""
    return field[MARGIN:-MARGIN, MARGIN:-MARGIN]


def slow(tin, held, height):
    """Plates of scipy, node by node, on blocks of 4 cells of an absolute lattice."""
    absolute = [axis.astype(int) + c for axis, c in zip((ROW, COLUMN), CORNER, strict=True)]
    numbers = [axis // 4 for axis in absolute]
    blocks = {}
    for i, j, r, c in zip(numbers[0][held], numbers[1][held], *np.nonzero(held), strict=True):
        blocks.setdefault((i, j), []).append((COLUMN[r, c], ROW[r, c], height[r, c]))
    means = {place: np.mean(rows, axis=0) for place, rows in blocks.items()}
    away = inner(ndimage.distance_transform_edt(~held))
    off = np.zeros_like(tin)
    for i in range(-6, 36, 3):
        for j in range(-3, 42, 3):
            window = [(u, v) for u in range(i - 7, i + 7) for v in range(j - 7, j + 7)]
            empty = {place for place in window if place not in means}
            rim = [
                means[u, v]
                for u, v in window
                if (u, v) in means
                and any((u + a, v + b) in empty for a in range(-2, 3) for b in range(-2, 3))
            ]
            if len(rim) < 8:
                continue
            points = np.array(rim)
            plate = RBFInterpolator(
                points[:, :2] / 4, points[:, 2], kernel="thin_plate_spline", smoothing=1.0
            )
            y, x = 4 * i - CORNER[0], 4 * j - CORNER[1]
            weight = np.maximum(1 - np.abs(inner(ROW) - y) / 12, 0)
            weight = weight * np.maximum(1 - np.abs(inner(COLUMN) - x) / 12, 0)
            counts = (weight > 0) & (away > 4)
            places = np.column_stack([inner(COLUMN)[counts], inner(ROW)[counts]]) / 4
            if len(places):
                heights = np.clip(plate(places), points[:, 2].min(), points[:, 2].max())
                off[counts] += weight[counts] * (heights - tin[counts])
    return tin + np.clip(away / 4 - 1, 0, 1) * off


def test_plates_are_those_of_scipy_node_by_node():
    rng = np.random.default_rng(2)
    height = HILL + rng.normal(0, 0.1, HILL.shape)
    held = ~HALL & (rng.random(HALL.shape) < 0.6)
    # The survey ends within the margin: the slow one knows no blocks outside the cells.
    held[:12], held[:, :12], held[-12:], held[:, -12:] = False, False, False, False
    tin, found = both(ground(height, held))
    np.testing.assert_allclose(found, slow(tin, held, height), atol=1e-6)
    assert np.abs(found - tin).max() > 0.2


def test_no_cut_between_ground_cells_shows():
    _, whole = both(ground(HILL, ~HALL))
    south, north = slice(0, SIDE - 30), slice(30, SIDE)
    for part, row, mine in ((south, 0, slice(0, 30)), (north, 30, slice(30, EDGE))):
        means = ground(HILL, ~HALL)[part]
        means[:, :, 1] -= row
        _, found = both(means, NOTHING_WET[part], (CORNER[0] + row, CORNER[1]))
        np.testing.assert_allclose(found, whole[mine], atol=1e-9)


@pytest.mark.parametrize("share", [0.08, 1.0])
def test_sparse_or_full_ground_stays_as_it_is(share):
    held = np.random.default_rng(3).random(HILL.shape) < share
    tin, found = both(ground(HILL, held))
    np.testing.assert_array_equal(found, tin)


def test_no_ground_at_all_stays_void():
    _, found = both(ground(HILL, np.zeros_like(HALL)))
    assert np.isnan(found).all()
