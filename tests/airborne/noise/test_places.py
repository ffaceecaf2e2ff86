"""Places of points: what is worked out by multiplying is what whole quotients say."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.airborne.noise.haze_counts import count_strips
from spl_batch.airborne.noise.noise_interpolation import put_places
from spl_batch.airborne.products.air.place_kernels import below, in_places
from spl_batch.airborne.pulses.square_kernels import count_squares, mark_squares
from spl_batch.constants import NOISE_AFTERPULSE, NOISE_SIGNAL

EDGE, PARTS = 5000, 4
AROUND = st.lists(st.integers(-2, 2), min_size=1, max_size=12)


def near_edges(edge: int, whole: int, off: list[int], count: int = 40) -> np.ndarray:
    """Coordinates beside multiples of an edge, where a rounded quotient would show."""
    return ((whole + np.arange(count))[:, None] * edge + np.array(off)).ravel()


@given(whole=st.integers(-1_000_000, 1_000_000), off=AROUND)
def test_voxels_and_squares_are_whole_quotients(whole: int, off: list[int]) -> None:
    x = near_edges(EDGE // PARTS, whole * PARTS, off)
    y, z = x[::-1].copy(), near_edges(EDGE, 3, off, len(x) // len(off)).astype(np.int32)
    corner, top, n = (whole - 1, whole - 2, 5), 9, len(x)
    voxel, square = np.empty((3, n), np.int64), np.empty((2, n), np.int64)
    offset = np.empty((3, n))
    put_places(x, y, z, EDGE, PARTS, corner, top, voxel, square, offset)
    for axis, v in enumerate((x, y)):
        np.testing.assert_array_equal(voxel[axis], v // EDGE - corner[axis])
        np.testing.assert_array_equal(square[axis], (v - corner[axis] * EDGE) * PARTS // EDGE)
        np.testing.assert_array_equal(offset[axis], v * PARTS % EDGE / EDGE - 0.5)
    np.testing.assert_array_equal(voxel[2], np.clip(z // EDGE - corner[2], 0, top))
    np.testing.assert_array_equal(offset[2], z.astype(np.int64) % EDGE / EDGE - 0.5)


@given(whole=st.integers(-1_000_000, 1_000_000), off=AROUND)
def test_squares_are_whole_quotients(whole: int, off: list[int]) -> None:
    x, count = near_edges(EDGE, whole, off), np.zeros((30, 30), np.int64)
    marked, expected = np.zeros(count.shape, np.bool_), np.zeros_like(count)
    count_squares(x, x, whole, whole, EDGE, count)
    mark_squares(x, x, whole, whole, EDGE, marked)
    at = x // EDGE - whole
    at = at[(at >= 0) & (at < 30)]
    np.add.at(expected, (at, at), 1)
    np.testing.assert_array_equal(count, expected)
    np.testing.assert_array_equal(marked, expected > 0)


@given(whole=st.integers(-1_000_000, 1_000_000), off=AROUND)
def test_cells_of_places_are_whole_quotients(whole: int, off: list[int]) -> None:
    edge, cell, raster, frame = 10_000, 1000, 500, (whole * 10_000, -20_000, 3, 4)
    x = near_edges(raster, whole * 20, off, 80)
    y = near_edges(raster, -40, off, 80)
    kind = np.where(np.arange(len(x)) % 5, NOISE_SIGNAL, NOISE_AFTERPULSE).astype(np.uint8)
    chosen, place, within = in_places(x, y, kind, frame, edge, cell)
    east, north = x - frame[0], y - frame[1]
    there = (kind == NOISE_SIGNAL) & (east >= 0) & (east < 3 * edge)
    there &= (north >= 0) & (north < 4 * edge)
    np.testing.assert_array_equal(chosen, np.flatnonzero(there))
    east, north = east[there], north[there]
    np.testing.assert_array_equal(place, north // edge * 3 + east // edge)
    np.testing.assert_array_equal(within, north % edge // cell * 10 + east % edge // cell)
    highest = np.random.default_rng(3).normal(size=(80, 60)).astype(np.float32)
    found = below(x, y, chosen, (frame[0], frame[1]), raster, highest)
    np.testing.assert_array_equal(found, highest[79 - north // raster, east // raster])


@given(whole=st.integers(-1_000_000, 1_000_000), off=AROUND)
def test_cubes_and_their_cells_are_whole_quotients(whole: int, off: list[int]) -> None:
    edge, cell = 5000, 1000
    y, z = near_edges(cell, whole * 5, off, 20), near_edges(cell, 0, off, 20)[::-1].copy()
    x, layer = y.copy(), (z // edge - z.min() // edge).astype(np.int32)
    west, rows = int(x.min()) // edge, int(y.max() - y.min()) // edge + 2
    strip = x // edge - west
    order = np.argsort(strip, kind="stable")
    start = np.append(0, np.cumsum(np.bincount(strip)))
    shape = (len(start) - 1, rows, int(layer.max()) + 1)
    count = np.zeros(shape, np.int32)
    columns, cells = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    room = np.zeros((rows, shape[2], 5, 5, 5), np.int32)
    count_strips(x, y, z, layer, order, start, edge, cell, west, room, count, columns, cells)
    expected, pairs = np.zeros_like(count), [np.zeros_like(columns) for _ in range(2)]
    cube = strip, y // edge - west, layer
    np.add.at(expected, cube, 1)
    within = [v % edge // cell for v in (x, y, z)]
    for out, axes in zip(pairs, (within[:2], within), strict=True):
        key, n = np.unique(np.stack([*cube, *axes]), axis=1, return_counts=True)
        np.add.at(out, tuple(key[:3]), n * (n - 1))
    np.testing.assert_array_equal(count, expected)
    np.testing.assert_array_equal(columns, pairs[0])
    np.testing.assert_array_equal(cells, pairs[1])
