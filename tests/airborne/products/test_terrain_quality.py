"""The terrain's standard deviation against what withheld heights are off."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.terrain_quality import (
    AROUND,
    RINGS,
    Scatter,
    _add_up,
    _boxes,
    _moments,
    _off_ring,
    _room,
    scatter_of,
    terrain_sigma,
)
from spl_batch.numerics.triangulation.tin_raster import tin_raster

REACH = 2 * RINGS[-1] + AROUND
"""Cells around a cell that decide on its value."""

Float = NDArray[np.float64]


def cell_means(height: Float, held: NDArray[np.bool_], cell_m: float = 1.0) -> Float:
    """Ground in the middle of the cells that are held."""
    y, x = (np.indices(height.shape) + 0.5) * cell_m
    means = np.stack([x, y, height], axis=-1)
    means[~held] = np.nan
    return means


def rough(rng: np.random.Generator, edge: int, sigma: float, scale_m: float) -> Float:
    smooth: Float = ndimage.gaussian_filter(rng.standard_normal((edge, edge)), scale_m, mode="wrap")
    return sigma * smooth / smooth.std()


@pytest.mark.parametrize("relief", [0.02, 0.2])
@pytest.mark.parametrize("share", [0.02, 0.3])
def test_withheld_heights_lie_within_it_as_often_as_they_should(
    relief: float, share: float
) -> None:
    """Relief of all sizes, each as high as it is wide: terrain is no smooth hill."""
    rng = np.random.default_rng(5)
    scales = (1.0, 2.0, 4.0, 8.0, 16.0)
    truth = sum((rough(rng, 200, relief * s, s) for s in scales), 0.3 * np.arange(200))
    measured = truth + rng.normal(0, 0.03, truth.shape)
    held = rng.random(truth.shape) < share
    held[60:75, 90:102] = False
    means = cell_means(measured, held)
    dtm = tin_raster(means[held], 1.0, truth.shape, 20.0)
    off = np.abs(dtm - truth) / terrain_sigma(means, 1.0)
    inner = off[15:-15, 15:-15][~held[15:-15, 15:-15]]
    assert 0.68 < np.nanmean(inner < 1) < 0.95
    assert np.nanmean(inner < 1.96) > 0.95


def test_rings_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(8)
    held = rng.random((24, 24)) < 0.4
    means = cell_means(rng.normal(0, 1, (24, 24)), held)
    integrals = _moments(means, 2 * RINGS[-1])
    row, column = np.indices(held.shape)
    for ring in RINGS[:3]:
        off = _off_ring(means, integrals, 2 * RINGS[-1], ring)
        for r, c in np.argwhere(held)[::9]:
            away = np.maximum(abs(row - r), abs(column - c))
            near = means[held & (away >= ring) & (away <= 2 * ring)]
            assert np.isnan(off[r, c]) == (len(near) < 6)
            if len(near) >= 6:
                d = near - near.mean(axis=0)
                normal = d[:, :2].T @ d[:, :2] / len(near) + 0.25 * np.eye(2)
                slope = np.linalg.solve(normal, d[:, :2].T @ d[:, 2] / len(near))
                own = means[r, c] - near.mean(axis=0)
                assert off[r, c] == pytest.approx(abs(own[2] - slope @ own[:2]), abs=1e-9)


def test_boxes_hold_what_lies_in_them() -> None:
    values = np.random.default_rng(9).random((9, 13))
    for reach in (0, 1, 4):
        expected = ndimage.correlate(
            values, np.ones((2 * reach + 1, 2 * reach + 1)), mode="constant"
        )
        for more in (0, 2):
            room, inner = _room(1, values.shape, reach + more)
            inner[0] = values
            _add_up(room)
            assert np.allclose(_boxes(room, reach + more, reach)[0], expected)


def returns(heights: Float) -> tuple[Float, NDArray[np.int64]]:
    """Returns of so many heights in each cell: (n, 3) [m], and where each cell begins."""
    rows, columns, each = heights.shape
    rng = np.random.default_rng(11)
    y, x = (
        np.indices((rows, columns))[:, :, :, None] + rng.random((2, rows, columns, each))
    ).reshape(2, -1)
    start = np.arange(rows * columns + 1) * each
    return np.column_stack([x, y, heights.ravel() + 0.4 * x]), start


def test_scatter_is_that_of_each_cell_about_its_mean() -> None:
    rng = np.random.default_rng(13)
    places = rng.integers(0, 1000, (3, 40)).astype(np.int32)
    start = np.array([0, 0, 7, 8, 40, 40])
    found = scatter_of((*places,), start, 1e-3)
    assert found.returns.tolist() == [7, 1, 32]
    for k, (begin, end) in enumerate(((0, 7), (7, 8), (8, 40))):
        of = np.cov(places[:, begin:end] * 1e-3, ddof=0)
        assert np.allclose(found.products[k], of[np.tril_indices(3)][[0, 1, 2, 3, 4, 5]])
    none = scatter_of(([places[0][:0]] * 3), np.zeros(4, np.int64), 1e-3)
    assert none.products.shape == (0, 6)


def test_the_layer_that_returns_fill_counts_and_a_slope_does_not() -> None:
    """Cells that differ by more than what grows in them: its variance about the slope is added."""
    rng = np.random.default_rng(12)
    each, edge, spread_m = 8, 48, 0.1
    cells = rng.normal(0, 0.5, (edge, edge, 1))
    places, start = returns(cells + rng.normal(0, spread_m, (edge, edge, each)))
    means = places.reshape(edge, edge, each, 3).mean(axis=2)
    found = scatter_of((*np.rint(places.T * 1000).astype(np.int32),), start, 1e-3)
    scatter = Scatter(found.returns.reshape(edge, edge), found.products.reshape(edge, edge, 6))
    layer = terrain_sigma(means, 1.0, scatter) ** 2 - terrain_sigma(means, 1.0) ** 2
    inner = layer[REACH // 2 : -REACH // 2, REACH // 2 : -REACH // 2]
    assert np.sqrt(inner) == pytest.approx(spread_m * np.sqrt(1 - 1 / each), rel=0.1)


def test_nothing_is_said_without_ground() -> None:
    held = np.zeros((40, 40), np.bool_)
    assert np.isnan(terrain_sigma(cell_means(np.zeros((40, 40)), held), 1.0)).all()
    held[3, 4:8] = True
    assert np.isnan(terrain_sigma(cell_means(np.zeros((40, 40)), held), 1.0)).all()


def test_a_cell_is_told_by_what_lies_within_reach() -> None:
    """Two windows agree where both hold all that decides: ground cells join."""
    rng = np.random.default_rng(10)
    held = rng.random((90, 140)) < 0.3
    means = cell_means(rng.normal(0, 1, held.shape), held)
    left, right = terrain_sigma(means[:, :100], 1.0), terrain_sigma(means[:, 40:], 1.0)
    common = slice(REACH, -REACH)
    assert np.allclose(left[common, 40 + REACH : 100 - REACH], right[common, REACH : 60 - REACH])
