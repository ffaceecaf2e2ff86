"""Ground of a flightline that lies apart is found at its own height; else nothing changes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale import masks
from spl_batch.airborne.ground.multiscale.lines_apart import (
    CELL_M,
    FAR_M,
    FEWEST,
    FEWEST_BARE,
    MOST_LINES,
    SQUARE_M,
    STEP_M,
    THIN,
    Lines,
    lines_apart,
    lines_of,
    offsets,
    seen_lines,
)
from spl_batch.airborne.ground.multiscale.near_surface import Near
from spl_batch.airborne.ground.multiscale.ranging_layer import Spread
from spl_batch.airborne.ground.multiscale_surface import ABOVE_SIGMA
from spl_batch.airborne.ground.point_spacing import added_up

CORNER_M = np.array([272_003.0, 3_290_005.0])
SIGMA_M = 0.05
SIGMA = Spread(np.full((1, 1), SIGMA_M), (0, 0))

Float = NDArray[np.float64]
Place = tuple[Float, Float, Float]


def hills(x: Float, y: Float) -> Float:
    return 2.0 * np.sin(x / 19) + 1.5 * np.cos(y / 23)


def scene(
    shift: tuple[float, float, float], seed: int, *, edge_m: float = 96.0, plants: float = 0.0
) -> tuple[Place, NDArray[np.uint16], NDArray[np.bool_]]:
    """Hills under two flightlines; places, the ids of these, and which points are of the ground.

    ``plants``: share of the places with shrubs of up to a metre, for both.
    """
    rng = np.random.default_rng(seed)
    n = round(4 * edge_m**2)
    x, y = rng.uniform(0, edge_m, (2, 2 * n))
    psid = np.repeat(np.array([7, 4], np.uint16), n)
    off = np.where(psid == 4, 1.0, 0.0)[:, None] * np.array(shift)
    z = hills(x - off[:, 0], y - off[:, 1]) + off[:, 2] + rng.normal(0, SIGMA_M, 2 * n)
    grown = (np.sin(x / 3) * np.sin(y / 3) > 0.2) & (rng.random(2 * n) < plants)
    z[grown] += rng.uniform(0.1, 1.0, int(grown.sum()))
    return (x + CORNER_M[0], y + CORNER_M[1], z), psid, ~grown


def told(place: Place, lines: Lines | None) -> NDArray[np.uint8]:
    every = np.ones(len(place[0]), np.bool_)
    return masks.multiscale_mask(place, every, every, SIGMA, lines)


@settings(max_examples=4, deadline=None)
@given(
    st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(0.1, 0.4),
    st.booleans(), st.sampled_from([0.0, 0.7]), st.integers(0, 99),
)  # fmt: skip
def test_ground_of_both_is_found_and_the_terrain_stays(
    east: float, north: float, up: float, lower: bool, plants: float, seed: int  # noqa: FBT001
) -> None:  # fmt: skip
    place, psid, ground = scene((east, north, -up if lower else up), seed, plants=plants)
    lines = lines_of(psid, None, 60.0)
    found, alone = told(place, lines), told(place, None)
    assert np.array_equal(found == masks.GROUND, alone == masks.GROUND), "what the terrain is of"
    fits = told(scene((0.0, 0.0, 0.0), seed, plants=plants)[0], None) > 0
    for one in (4, 7):
        mine = ground & (psid == one)
        assert (found[mine] > 0).mean() > fits[mine].mean() - 0.02
    assert (found[~ground] > 0).sum() <= 1.3 * fits[~ground].sum() + 0.005 * len(psid)


@pytest.mark.parametrize("plants", [0.0, 0.9])
@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (0.03, 0.0, 0.02)])
def test_where_flightlines_fit_nothing_changes(
    shift: tuple[float, float, float], plants: float
) -> None:
    place, psid, _ = scene(shift, 3, plants=plants)
    assert np.array_equal(told(place, lines_of(psid, None, 60.0)), told(place, None))


def test_what_one_flightline_alone_sees_in_a_small_place_is_no_ground() -> None:
    place, psid, _ = scene((0.0, 0.0, 0.0), 5)
    x, y, z = place
    parked = (psid == 4) & (np.hypot(*(np.stack([x, y]) - CORNER_M[:, None] - 48)) < 9)
    place = x, y, np.where(parked, z + 0.3, z)
    found = told(place, lines_of(psid, None, 60.0))
    assert np.array_equal(found, told(place, None))
    assert found[parked].mean() < 0.02


def test_a_field_that_grew_between_two_flights_is_no_ground() -> None:
    place, psid, _ = scene((0.0, 0.0, 0.0), 3, edge_m=128.0)
    x, y, z = place
    field = (np.abs(np.stack([x, y]) - CORNER_M[:, None] - 64) < 38).all(axis=0) & (psid == 4)
    crop = field & (np.random.default_rng(1).random(len(z)) < 0.85)
    place = x, y, np.where(crop, z + 0.3, z)
    found = told(place, lines_of(psid, None, 60.0))
    assert np.array_equal(found, told(place, None))


def in_strips(place: Place, psid: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Labels of points that are looked at in strips of 32 m, each with its own flightlines."""
    strip = np.floor(place[0] / 32)

    def strips() -> list[masks.Strip]:
        parts = []
        for one in np.unique(strip):
            points = tuple(v[strip == one] for v in place)
            of = lines_of(psid[strip == one], None, 60.0)
            parts.append(masks.Strip(points, points, one, of, of))
        return parts

    found = np.zeros(len(psid), np.uint8)
    for part, labels in masks.multiscale_masks(strips, SIGMA):
        found[strip == part.known_as] = labels
    return found


@pytest.mark.parametrize("ends_m", [96.0, 92.9, 63.5])
def test_points_in_strips_have_the_same_labels(ends_m: float) -> None:
    place, psid, _ = scene((0.3, 0.0, 0.2), 8)
    # The other swath may end so that a strip, or the edge of one, has a single flightline.
    kept = (psid == 4) | (place[0] - CORNER_M[0] < ends_m)
    place, psid = (place[0][kept], place[1][kept], place[2][kept]), psid[kept]
    whole = told(place, lines_of(psid, None, 60.0))
    assert (whole == masks.APART).mean() > 0.1
    assert np.array_equal(in_strips(place, psid), whole)


def test_where_too_many_flightlines_meet_none_is_apart() -> None:
    place, psid, _ = scene((0.0, 0.0, 0.3), 8)
    assert (told(place, lines_of(psid, None, 60.0)) == masks.APART).any()
    east = np.flatnonzero(place[0] > CORNER_M[0] + 70.0)
    psid[east[:MOST_LINES]] = np.arange(100, 100 + MOST_LINES)
    for found in (told(place, lines_of(psid, None, 60.0)), in_strips(place, psid)):
        assert not (found == masks.APART).any()


def test_cells_with_their_surroundings_agree() -> None:
    place, psid, _ = scene((0.3, -0.2, 0.25), 9, edge_m=150.0)
    every = np.ones(len(psid), np.bool_)
    whole = told(place, lines_of(psid, None, 60.0))
    cut = CORNER_M[0] + 71.0
    for own in (place[0] < cut, place[0] >= cut):
        reach = np.abs(place[0] - cut) < 60
        near = own | reach
        part = tuple(v[near] for v in place)
        lines = lines_of(psid[near], None, 60.0)
        found = masks.multiscale_mask(part, every[near], own[near], SIGMA, lines)
        assert (found != whole[own]).mean() < 2e-4


def slow_offsets(
    off: Float, x: Float, y: Float, line: NDArray[np.uint16], one: int
) -> dict[tuple[int, int], float]:
    """Height of the fullest layer of a flightline by square, from the points themselves."""
    near = np.abs(off) < FAR_M
    off, x, y, line = off[near], x[near], y[near], line[near]
    cell = np.floor(np.stack([y, x]) / CELL_M).astype(int).T
    bare = set()
    for place in np.unique(cell, axis=0):
        here = (cell == place).all(axis=1)
        for other in set(line.tolist()) - {one}:
            mine = off[here & (line == other)]
            thin = np.count_nonzero(np.abs(mine) <= ABOVE_SIGMA * SIGMA_M)
            if thin >= FEWEST_BARE and thin >= THIN * len(mine):
                bare.add(tuple(place))
    used = np.array([tuple(place) in bare for place in cell.tolist()]) & (line == one)
    square = np.floor(np.stack([y, x]) / SQUARE_M).astype(int).T
    found = {}
    for place in np.unique(square[used], axis=0):
        step = np.floor((off[used & (square == place).all(axis=1)] + FAR_M) / STEP_M).astype(int)
        if len(step) < FEWEST:
            continue
        reach = round(ABOVE_SIGMA * SIGMA_M / STEP_M)
        inside = [np.abs(step - s) <= reach for s in range(round(2 * FAR_M / STEP_M))]
        best = inside[int(np.argmax([some.sum() for some in inside]))]
        if best.sum() >= THIN * len(step):
            found[int(place[0]), int(place[1])] = (step[best].mean() + 0.5) * STEP_M - FAR_M
    return found


def test_offsets_are_those_of_a_slow_twin() -> None:
    rng = np.random.default_rng(2)
    n = 6000
    x, y = rng.uniform(0, 48, (2, n)) + 16.0 * np.array([[5], [9]])
    line = rng.choice(np.array([3, 5, 8], np.uint16), n)
    off = rng.normal(0, SIGMA_M, n) + np.where(line == 5, 0.2 + 0.004 * (x - 80), 0.0)
    off += np.where(rng.random(n) < 0.3 * (y > 170), rng.uniform(0, 2, n), 0.0)
    lines = lines_of(line, None, 60.0)
    half = x < 104.0
    parts = [
        seen_lines(Near(np.flatnonzero(some), off[some], off[some]), (x, y), lines, SIGMA)
        for some in (half, ~half)
    ]
    for key, one in zip(lines.keys.tolist(), (3, 5, 8), strict=True):
        heights = added_up([part[key] for part in parts])
        told_m, measured_m = offsets(heights, SIGMA)
        expected = np.full(measured_m.shape, np.nan)
        for (row, column), value in slow_offsets(off, x, y, line, one).items():
            expected[row - heights.first[0], column - heights.first[1]] = value
        np.testing.assert_allclose(measured_m, expected, atol=1e-9)
        assert 10 < np.isfinite(expected).sum() < 36
        assert np.isfinite(told_m).all() == (one == 5)
    apart = lines_apart(parts, [lines], SIGMA)
    assert apart is not None
    assert apart.keys.tolist() == [lines.keys[1]]


def test_flightlines_are_told_by_id_and_span() -> None:
    rng = np.random.default_rng(1)
    psid = rng.integers(0, 3, 500).astype(np.uint16)
    time_s = rng.uniform(0, 300, 500)
    time_s[:20] = np.nan
    found = lines_of(psid, time_s, 60.0)
    assert found.several
    span = np.where(np.isnan(time_s), -1, np.floor(time_s / 60))
    _, expected = np.unique(np.stack([psid, span]), axis=1, return_inverse=True)
    assert np.array_equal(found.number, expected)
    assert np.all(np.diff(found.keys) > 0)
    for ids in (np.full(9, 3), np.arange(MOST_LINES + 1), np.arange(MOST_LINES + 9)):
        assert not lines_of(ids.astype(np.uint16), None, 60.0).several
