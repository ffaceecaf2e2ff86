"""Points beside a surface: heights are the TIN's, and the band is that of the formula."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from spl_batch.airborne.ground.multiscale.near_surface import (
    SLOPE_M,
    Near,
    near_surface,
    needed,
    surface_of,
    within,
)
from spl_batch.airborne.ground.point_spacing import Blocks
from spl_batch.airborne.ground.scales import BLOCK_M
from spl_batch.numerics.triangulation.tin import interpolate, vertex_slopes

Float = NDArray[np.float64]


def nodes(n: int, seed: int) -> Float:
    """Steep ground with a gap, over which triangles are long."""
    x, y = np.random.default_rng(seed).uniform(0, 60, (2, n))
    kept = np.hypot(x - 30, y - 30) > 12
    x, y = x[kept] + 272_000.0, y[kept] + 3_290_000.0
    return np.column_stack([x, y, 0.5 * np.abs(x - 272_030) + 2 * np.sin(y / 5)])


def slopes_by_facet(xyz: Float, slopes: Float, x: Float, y: Float) -> Float:
    """Slope of the triangle that holds each place, NaN outside, by another library."""
    off = xyz[:, :2].mean(axis=0)
    found = Delaunay(xyz[:, :2] - off)
    facet = found.find_simplex(np.column_stack([x, y]) - off)
    steep = np.hypot(*slopes[found.simplices].mean(axis=1).T)
    return np.where(facet >= 0, steep[facet], np.nan)


@pytest.mark.parametrize("seed", range(3))
def test_heights_and_slopes_are_those_of_the_triangles_and_go_on_beyond(seed: int) -> None:
    surface = surface_of(nodes(300, seed))
    assert surface.tin is not None
    rng = np.random.default_rng(seed + 10)
    x, y = rng.uniform(-3, 63, (2, 8000))
    x, y = x + 272_000.0, y + 3_290_000.0
    height = interpolate(surface.tin, x, y)
    z = np.where(np.isnan(height), 10.0, height) + rng.normal(0, 12, len(x))
    asked = rng.random(len(x)) < 0.9
    near = near_surface(surface, (x, y, z), asked)
    slope = slopes_by_facet(surface.nodes, vertex_slopes(surface.tin), x, y)
    assert np.array_equal(near.at, np.flatnonzero(asked))
    inside = ~np.isnan(height[near.at])
    known = near.at[inside]
    np.testing.assert_allclose(near.off[inside], (z - height)[known], atol=1e-8)
    np.testing.assert_allclose(near.slope[inside], slope[known], atol=1e-8)
    assert 50 < np.count_nonzero(~inside) < 2000
    for k in np.flatnonzero(~inside)[:50]:
        away = np.array([x[near.at[k]], y[near.at[k]]]) - surface.nodes[:, :2]
        nearest = np.hypot(*away.T).argmin()
        expected = surface.nodes[nearest, 2] + away[nearest] @ surface.slopes[nearest]
        assert near.off[k] == pytest.approx(z[near.at[k]] - expected, abs=1e-8)


def test_a_line_of_nodes_has_no_triangles_and_is_continued() -> None:
    surface = surface_of(np.array([[0.0, 0.0, 1.0], [5.0, 0.0, 2.0]]))
    x, y, z = np.array([[1.0, 4.0], [2.0, 0.0], [9.0, 9.0]])
    near = near_surface(surface, (x, y, z), np.array([True, True]))
    assert near.off.tolist() == [8.0, 7.0]


def test_evidence_around_what_is_asked_is_needed() -> None:
    edge = np.arange(6) * BLOCK_M + 3.0
    x, y = (v.ravel() for v in np.meshgrid(edge, edge))
    asked = np.arange(36) == 14  # third row, third column
    own = np.arange(36) != 8
    found = needed(x, y, own, asked, Blocks(np.zeros((6, 6, 1)), (0, 0)))
    near = np.maximum(abs(np.arange(36) // 6 - 2), abs(np.arange(36) % 6 - 2)) <= 1
    assert np.array_equal(found, near & own | asked)


def test_points_within_the_band_are_those_of_the_formula() -> None:
    rng = np.random.default_rng(2)
    x, y = rng.uniform(-40, 100, (2, 3000))
    at = np.sort(rng.choice(3000, 2000, replace=False))
    off, slope = rng.normal(0, 1, 2000), rng.uniform(0, 1, 2000)
    spacing = rng.uniform(0.2, 3, (5, 4))
    above, below = rng.uniform(0.05, 0.7, (2, 3, 4))
    reach = Blocks(above, (0, 1)), Blocks(below, (0, 1))
    found = within(Near(at, off, slope), (x, y), Blocks(spacing, (0, -1)), reach, 0.25)
    expected = np.zeros(3000, np.bool_)
    for i, up, rise in zip(at, off, slope, strict=True):
        square = np.clip(np.floor([y[i] / BLOCK_M, x[i] / BLOCK_M + 1]), 0, [4, 3]).astype(int)
        block = np.clip(np.floor([y[i] / BLOCK_M, x[i] / BLOCK_M - 1]), 0, [2, 3]).astype(int)
        apart, reach = spacing[*square], (above if up > 0 else below)[*block]
        band = max(reach, 0.25 * apart) + min(apart, SLOPE_M) * rise
        expected[i] = abs(up) <= band
    assert 0.2 < expected[at].mean() < 0.8
    assert np.array_equal(found, expected[at])
