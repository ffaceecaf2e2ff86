"""Sheets of haze of a metre or two: told apart from roofs, decks, wires and crowns."""

import numpy as np
import pytest

from spl_batch.airborne.products.air import near_ground, thin_haze, thin_sheets
from tests.airborne.products.test_thin_haze import CORE, FLAT, ground, scatter, table


def placed(*parts, terrain=FLAT):
    return near_ground.placed(
        table(np.concatenate(parts)), CORE, near_ground.highest_ground(terrain)
    )


def found(*parts):
    return thin_haze.layers(thin_sheets.sheets(placed(*parts)), CORE)


def on_plane(rng, n, height, rise=0.0):
    """Returns of a surface that rises to the east."""
    points = rng.uniform((0, 0, 0), (60, 50, 1), (n, 3))
    points[:, 2] = height + rise * points[:, 0] + rng.normal(0, 0.05, n)
    return points


@pytest.mark.parametrize(
    ("low", "thick", "per_m3"), [(10.0, 1.0, 1.0), (30.0, 2.0, 1.0), (56.0, 1.0, 2.2)]
)
def test_a_sheet_is_told_with_its_place_and_heights(low, thick, per_m3):
    rng = np.random.default_rng(1)
    (layer,) = found(ground(rng), scatter(rng, per_m3, low, low + thick))
    places, lower, upper, x, y, down = layer
    assert places >= 20
    assert low - 4 <= lower <= low
    assert low + thick <= upper <= low + thick + 4
    assert (x, y) == (pytest.approx(30_000, abs=5000), pytest.approx(25_000, abs=5000))
    assert down == 0.0


def test_a_level_sheet_over_a_slope_and_one_along_it_are_told():
    rng = np.random.default_rng(2)
    rise = 0.3
    slope = np.broadcast_to((rise * (np.arange(60) + 0.5)).astype(np.float32), FLAT.shape)
    floor = on_plane(rng, 9000, 0.0, rise)
    level = scatter(rng, 1.0, 35, 36)
    along = scatter(rng, 1.0, 35, 36)
    along[:, 2] += rise * along[:, 0]
    for sheet in (level, along):
        blocks = thin_sheets.sheets(placed(floor, sheet, terrain=slope))
        assert thin_haze.layers(blocks, CORE)


def test_a_sheet_above_a_forest_is_told():
    rng = np.random.default_rng(5)
    crowns = scatter(rng, 3.0, 5, 16)
    (layer,) = found(ground(rng), crowns, scatter(rng, 1.0, 30, 32))
    assert layer[0] >= 20
    assert layer[1] > 25


def test_what_is_no_air_is_none():
    rng = np.random.default_rng(3)
    floor, sheet = ground(rng), scatter(rng, 1.5, 20, 22)
    assert not found(floor, on_plane(rng, 9000, 20.0)), "a roof of glass"
    gables = on_plane(rng, 9000, 20.0)
    gables[:, 2] += 0.5 * np.abs(gables[:, 0] % 4 - 2)
    assert not found(floor, gables), "one of many gables"
    assert not found(floor[:200], sheet), "what hides the ground"
    assert not found(floor[floor[:, 0] % 4 < 2], sheet), "what hides it in stripes"
    assert not found(floor[:3000], scatter(rng, 1.5, 20, 23)), "a crown that takes half of it"
    assert not found(floor, scatter(rng, 0.8, 14, 20)), "a deep crown"
    assert not found(floor, sheet[sheet[:, 0] % 2 < 0.2]), "wires"
    assert not found(floor, sheet[(sheet[:, 0] < 20) & (sheet[:, 1] < 20)]), "a small one"
    assert not found(floor, scatter(rng, 1.5, 4, 6)), "one that is low"
    refused = np.concatenate([floor, sheet])
    blocks = thin_sheets.sheets(
        near_ground.placed(table(refused, kind=1), CORE, near_ground.highest_ground(FLAT))
    )
    assert not blocks.any(), "what the filter refuses"


def test_windows_are_judged_as_counting_by_hand_says():
    rng = np.random.default_rng(4)
    cloud = scatter(rng, 1.0, 20, 22)
    cloud = cloud[rng.random(len(cloud)) < np.where(cloud[:, 1] % 2 < 1, 1.0, cloud[:, 0] / 60)]
    cloud[:, 2] = 20 + (cloud[:, 2] - 20) * cloud[:, 1] / 50
    points = placed(ground(rng), cloud)
    blocks = thin_sheets.sheets(points)
    marked = blocks.any(axis=2).ravel()
    assert 3 < np.count_nonzero(marked) < 27
    for place in range(30):
        mine = points.place == place
        height, cell = points.half_metre[mine], points.within[mine]
        z = points.z[mine] / 1000
        first = min(range(16, 115), key=lambda k: -np.sum((height >= k) & (height < k + 6)))
        there = (height >= first) & (height < first + 6)
        n = np.bincount(cell[there], minlength=100)
        by_cell = [z[there & (cell == k)] for k in np.flatnonzero(n > 1)]
        steps = [np.unique(np.floor(4 * h + 1e-9), return_counts=True)[1] for h in by_cell]
        flat = sum((m * (m - 1)).sum() for m in steps) / (n * (n - 1)).sum()
        even = 100 * (n * (n - 1)).sum() <= thin_sheets.CLUMPED * n.sum() ** 2
        assert marked[place] == (n.sum() >= thin_sheets.LEAST and even and flat <= thin_sheets.FLAT)
        if marked[place]:
            middle = first / 2 + 1.5
            held = [k for k in range(thin_haze.BLOCKS) if abs(k + 2 - middle) <= 1]
            assert np.flatnonzero(blocks.reshape(30, -1)[place]).tolist() == held
