"""Roofs that stay in the terrain, gaps without ground, and what is neither."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale import masks
from spl_batch.airborne.ground.multiscale.raised_patches import Patch, on_houses, raised_patches
from spl_batch.airborne.products.doubts.cut_off_blocks import cut_off_blocks
from spl_batch.airborne.products.doubts.raised_strips import (
    ALIKE,
    AXES,
    BEYOND_M,
    LEVEL_M,
    OPEN,
    REACH_M,
    WALL_M,
    WIDER,
    between_walls,
    raised_strips,
)
from spl_batch.airborne.products.doubts.terrain_doubts import (
    BLOCKS,
    CLIMBS,
    DECKS,
    GAPS,
    RAISED,
    block_facts,
    doubt_facts,
    doubts,
)
from spl_batch.airborne.report.coverage import block_warning, doubt_warnings, terrain_doubts
from spl_batch.constants import NODATA, QUANTA_PER_M
from spl_batch.lattice.tiles import Bounds

Grid = NDArray[np.float64]


def plain(edge: int = 140) -> tuple[Grid, Grid, Grid]:
    """Places of cells, and slightly tilted rough ground."""
    y, x = np.indices((edge, edge)) + 0.5
    return x, y, 0.03 * x + np.random.default_rng(2).normal(0, 0.05, x.shape)


def warehouse(x: Grid, y: Grid) -> NDArray[np.bool_]:
    return (np.abs(x - 70) < 20) & (np.abs(y - 66) < 14)


def plateau(x: Grid, y: Grid, height_m: float, slope: float) -> Grid:
    """A square of 40 m with sides of a slope."""
    away = np.maximum(np.abs(x - 70), np.abs(y - 70)) - 20
    found: Grid = np.clip(height_m - slope * away, 0, height_m)
    return found


def thinned(height: Grid, share: float) -> Grid:
    kept = np.random.default_rng(4).random(height.shape) < share
    return np.where(kept, height, np.nan)


@pytest.mark.parametrize("share", [1.0, 0.2])
def test_a_warehouse_that_a_ramp_leads_up_to_is_found(share: float) -> None:
    x, y, ground = plain()
    ramp = (np.abs(x - 62) < 5) & (y >= 80) & (y < 110)
    height = np.where(warehouse(x, y), 6.0, ground + ramp * (110 - y) / 30 * 6.0)
    (found,) = raised_patches(thinned(height, share), 1.0)
    assert 0.6 * 1120 < found.area_m2 < 1.2 * 1120
    assert warehouse(x, y)[found.row, found.column]
    assert found.height_m == pytest.approx(4.0, abs=0.7)


@pytest.mark.parametrize(("wall_m", "house"), [(3.5, True), (12.0, False)])
def test_nodes_on_a_house_are_taken_off_and_those_of_a_high_rock_stay(
    wall_m: float, *, house: bool
) -> None:
    x, y, ground = plain()
    roof = warehouse(x, y)
    z = ground + wall_m * roof
    nodes = np.column_stack([v.ravel() for v in (x + 600.0, y - 40.0, z)])
    held = np.random.default_rng(5).random(len(nodes)) < 0.3
    off = on_houses(nodes, held)
    assert not off[~held | ~roof.ravel()].any()
    assert off[held & roof.ravel()].mean() == pytest.approx(float(house), abs=0.1)


def test_a_roof_that_an_opening_leaves_is_no_ground(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        masks, "ground_nodes", lambda xyz, _, grid, __: np.isin(np.arange(len(xyz)), grid)
    )
    x, y, ground = (v.ravel() for v in plain(120))
    roof = warehouse(x, y)
    points = x, y, ground + 4.0 * roof
    ((_, found),) = masks.multiscale_masks(lambda: (masks.Strip(points, points),))
    assert found[roof].mean() < 0.05
    assert found[~roof].mean() > 0.97
    every = np.ones(len(x), np.bool_)
    assert np.array_equal(masks.multiscale_mask(points, every, every), found)


@pytest.mark.parametrize(
    "shape",
    ["terrace", "ridge", "mound", "steep mound", "embankment", "shed", "headland", "plain"],
)
def test_ground_that_rises_is_no_roof(shape: str) -> None:
    x, y, ground = plain()
    away = np.hypot(x - 70, y - 70)
    height = (
        ground
        + {
            "terrace": 8.0 * (x > 60 + 8 * np.sin(y / 9)),
            "ridge": np.maximum(25 - 1.5 * np.abs(x - 70), 0),
            "mound": np.clip(30 - 0.7 * away, 0, 9),
            "steep mound": plateau(x, y, 12.0, 1.43),
            "embankment": np.clip(12 - 0.7 * np.abs(x - 70), 0, 6),
            "shed": 4.0 * ((np.abs(x - 70) < 3) & (np.abs(y - 70) < 3)),
            "headland": 9.0 * ((np.abs(x - 70) < 30) & (y > 50)),
            "plain": np.zeros_like(x),
        }[shape]
    )
    assert raised_patches(height, 1.0) == []
    assert raised_patches(thinned(height, 0.2), 1.0) == []


def test_cells_of_half_a_metre_tell_the_same_place_as_those_of_a_metre() -> None:
    x, y, ground = plain()
    height = ground + 5.0 * warehouse(x, y)
    (coarse,), (fine,) = (
        raised_patches(height, 1.0),
        raised_patches(np.kron(height, np.ones((2, 2))), 0.5),
    )
    assert fine.area_m2 == coarse.area_m2
    assert (fine.row // 2, fine.column // 2) == pytest.approx((coarse.row, coarse.column), abs=1)


def test_a_ground_cell_owns_its_patches_and_gaps_and_counts_rows_from_the_north() -> None:
    x, y, ground = plain()
    height = ground + 5.0 * warehouse(x, y)
    height[(np.abs(x - 70) < 15) & (np.abs(y - 105) < 12)] = np.nan
    found = doubts(height, 20, 1.0)
    (patch,) = found.patches
    assert isinstance(patch, Patch)
    assert warehouse(x, y)[20:-20, 20:-20][::-1][patch.row, patch.column]
    arrays = {name: np.full((100, 100), 1.0, np.float32) for name in ("dtm", "dtm_quality")}
    core = Bounds(0, 0, 100 * QUANTA_PER_M, 100 * QUANTA_PER_M)
    facts = doubt_facts(found, arrays, core, QUANTA_PER_M)
    ((area, east, north, away, sigma),) = facts[GAPS]
    # Between 5 m from the rim on; its middle is at 50, 85 in the cell.
    assert 200 < area < 400
    assert (east / QUANTA_PER_M, north / QUANTA_PER_M) == pytest.approx((50, 85), abs=6)
    assert (away, sigma) == pytest.approx((12.0, 1.0), abs=1)
    ((_, east, north, _),) = facts[RAISED]
    assert (east / QUANTA_PER_M, north / QUANTA_PER_M) == pytest.approx((50, 46), abs=8)
    for name, value in (("dtm", NODATA), ("dtm_quality", 0.4)):
        level = doubt_facts(found, {**arrays, name: np.full_like(arrays[name], value)}, core, 1)
        assert level[GAPS] == []
    assert doubts(height[:, :60], 20, 1.0).patches == []


def climbs_of(ground: Grid, dtm: Grid) -> list[list[float]]:
    """Steep patches without ground of a cell of 100 m within a margin of 20 m."""
    arrays = {
        "dtm": dtm[20:-20, 20:-20][::-1].astype(np.float32),
        "dtm_quality": np.full((100, 100), 0.1, np.float32),
    }
    core = Bounds(0, 0, 100 * QUANTA_PER_M, 100 * QUANTA_PER_M)
    found: list[list[float]] = doubt_facts(doubts(ground, 20, 1.0), arrays, core, QUANTA_PER_M)[
        CLIMBS
    ]
    return found


def test_a_steep_ramp_over_ground_that_was_cut_off_is_told() -> None:
    x, y, ground = plain()
    rim = (np.abs(x - 70) < 10) & (np.abs(y - 90) < 3)
    ramp = ground + np.where(rim, 2.0 * (y - 87), 0.0) + np.where(y >= 93, 12.0, 0.0)
    ((area, east, north, rise),) = climbs_of(np.where(rim, np.nan, ramp), ramp)
    assert area == pytest.approx(20 * 6, abs=45)
    assert (east / QUANTA_PER_M, north / QUANTA_PER_M) == pytest.approx((50, 70), abs=2)
    assert rise == pytest.approx(10.0, abs=2.5)
    assert climbs_of(ramp, ramp) == []
    # A few cells of a ramp; they are told where they rise by more than two storeys.
    few = rim & (np.abs(x - 70) < 2)
    flatter = ground + 0.6 * (ramp - ground)
    assert climbs_of(np.where(few, np.nan, flatter), flatter) == []
    ((area, *_),) = climbs_of(np.where(few, np.nan, ramp), ramp)
    assert area < 25


@pytest.mark.parametrize("share", [0.9, 0.3, 0.1])
def test_a_hillside_with_ground_at_its_usual_spacing_is_none(share: float) -> None:
    x, _, ground = plain()
    hill = ground + 1.5 * x
    assert climbs_of(thinned(hill, share), hill) == []


def test_the_edge_of_a_void_is_no_slope() -> None:
    _, y, ground = plain()
    dtm = np.where(y > 90, NODATA, ground)
    assert climbs_of(np.full_like(dtm, np.nan), dtm) == []


def receipts(*facts: dict[str, Any]) -> Any:
    """Of ground cells."""
    return {"surface": {str(k): SimpleNamespace(facts=f) for k, f in enumerate(facts)}}


def crossing(shape: str) -> Grid:
    """A cutting of 5 m, 22 m wide, that something crosses; or a bank."""
    x, y, ground = plain(160)
    away = np.abs(x - 80 - 0.2 * (y - 80)) if shape != "bank" else np.full(x.shape, 80.0)
    along = np.abs(y - 80 + 0.3 * (x - 80))
    cut = np.clip(away - 11, -5, 0)
    if shape == "bank":
        return ground + np.clip(17 - along, 0, 5)
    if shape == "dam":
        cut = np.where(y > 80, cut * 0.5, cut)
    if shape == "gentle":
        return ground + np.maximum(cut, np.clip(0.6 * (12 - along), -5, 0))
    if shape == "pier":
        cut, along = np.where((x > 75) & (x < 130), -5.0, cut), np.where(x < 100, along, 80.0)
    return ground + np.where(along < 12, 0.0, cut)


@pytest.mark.parametrize("share", [1.0, 0.2])
def test_a_wide_deck_over_a_cutting_is_told(share: float) -> None:
    (found,) = raised_strips(thinned(crossing("deck"), share), 1.0)
    assert (found.row, found.column) == pytest.approx((80, 80), abs=12)
    assert 0.3 * 530 < found.area_m2 < 530
    assert found.height_m == pytest.approx(5.0, abs=0.6)


@pytest.mark.parametrize("shape", ["bank", "dam", "gentle", "pier"])
def test_what_has_no_walls_on_two_sides_alone_is_no_deck(shape: str) -> None:
    assert list(raised_strips(crossing(shape), 1.0)) == []


def _ray(surface: Grid, start: tuple[int, int], towards: Grid, steps: int) -> Grid:
    """Heights on the way from a square; NaN beyond the survey."""
    at = np.rint(np.outer(np.arange(1, steps + 1), towards)).astype(int) + start
    wide = np.pad(surface, 200, constant_values=np.nan)
    heights: Grid = wide[tuple(at.T + 200)]
    return heights


def _first_wall(surface: Grid, start: tuple[int, int], towards: Grid, steps: int) -> int:
    ray = np.concatenate([[surface[start]], _ray(surface, start, towards, steps)])
    with np.errstate(invalid="ignore"):
        falls = ray[1:] <= np.minimum(ray[0], ray[:-1]) - WALL_M
        stops = (ray[1:] >= ray[0] + WALL_M) | np.isnan(ray[1:])
    first = int(np.argmax(np.append(falls | stops, True)))
    return first + 1 if first < steps and falls[first] else 0


def _is_open(
    surface: Grid, start: tuple[int, int], along: Grid, sides: tuple[int, int], fall: float, n: int
) -> bool:
    ray = np.concatenate([[surface[start]], _ray(surface, start, along, n)])
    highest = np.maximum.accumulate(ray)
    for k in range(1, n + 1):
        if not abs(ray[k] - ray[k - 1]) < WALL_M:
            return False
        here = tuple(np.array(start) + np.rint(k * along).astype(int))
        left, right = np.array([-along[1], along[0]]), np.array([along[1], -along[0]])
        beside = [*_ray(surface, here, left, sides[0]), *_ray(surface, here, right, sides[1])]
        if np.all(np.array(beside) >= highest[k] - fall):
            return True
    return False


def _mark_strips(surface: Grid, start: tuple[int, int], edge_m: float, above: Grid) -> None:
    for k in range(AXES):
        across = np.array([np.sin(np.pi * k / AXES), np.cos(np.pi * k / AXES)])
        across /= np.abs(across).max()
        steps = int(REACH_M / edge_m / np.hypot(*across))
        one = _first_wall(surface, start, across, steps)
        two = _first_wall(surface, start, -across, steps - one) if one else 0
        if not two:
            continue
        n = max(int(BEYOND_M / edge_m / np.hypot(*across)), 2)
        ends = [_ray(surface, start, s * across, w + n)[w:] for s, w in ((1, one), (-1, two))]
        if not all(np.ptp(end) <= LEVEL_M for end in ends):
            continue
        floors = [float(end.min()) for end in ends]
        tall = float(surface[start]) - max(floors)
        if tall < WALL_M or abs(floors[0] - floors[1]) > ALIKE * tall:
            continue
        along, sides = np.array([across[1], -across[0]]), (WIDER * one, WIDER * two)
        if _is_open(surface, start, along, sides, OPEN * tall, steps) and _is_open(
            surface, start, -along, sides[::-1], OPEN * tall, steps
        ):
            between = np.rint(np.outer(np.arange(1 - two, one), across)).astype(int) + start
            np.maximum.at(above, tuple(between.T), tall)


def test_squares_between_walls_equal_a_slow_twin() -> None:
    rng = np.random.default_rng(6)
    found = 0
    for _ in range(2):
        y, x = np.indices((30, 22))
        cut = np.abs(x - 11 - rng.uniform(-0.4, 0.4) * (y - 15)) < 4
        deck = np.abs(y - 15 - rng.uniform(-0.6, 0.6) * (x - 11)) < rng.uniform(3, 6)
        surface = rng.normal(0, 0.15, x.shape) - np.where(cut & ~deck, 5.0, 0.0)
        surface[rng.random(x.shape) < 0.002] -= 4
        above = between_walls(surface, 2.0)
        found += int((above > 0).sum())
        slow = np.zeros(surface.shape)
        for r, c in np.ndindex(surface.shape):
            _mark_strips(surface, (r, c), 2.0, slow)
        np.testing.assert_array_equal(above, slow)
    assert found > 50


def test_warnings_tell_number_place_and_consequence() -> None:
    q = QUANTA_PER_M
    done = receipts(
        {GAPS: [[90.0, 1000.0 * q, 2000.0 * q, 8.0, 0.9]], RAISED: []},
        {
            GAPS: [[410.0, 1200.0 * q, 2500.0 * q, 12.4, 0.7]],
            RAISED: [[220.0, 976.0 * q, 404.0 * q, 4.8]],
            DECKS: [[480.0, 530.0 * q, 320.0 * q, 5.1]],
            CLIMBS: [[58.0, 1300.0 * q, 404.0 * q, 10.8], [141.0, 1310.0 * q, 90.0 * q, 12.4]],
        },
        {"voids": 3},
    )
    gap, roof, deck, climb = doubt_warnings(terrain_doubts(done))
    assert gap.startswith("2 gaps in the ground, 500 m2 in all, the largest 410 m2 at 1 200 E, ")
    assert "up to 12 m away" in gap
    assert "known to 0.7 m" in gap
    assert roof.startswith("1 raised flat patch of a building's size in the terrain, 220 m2 at 976")
    assert "4.8 m above the ground" in roof
    assert deck.startswith("1 raised strip of the terrain between two walls, 480 m2 at 530 E, 320 ")
    assert "5.1 m above the level floor" in deck
    assert climb.startswith("2 steep patches of the terrain, over 45 degrees, without a ground ")
    assert "199 m2 in all, the largest 141 m2 at 1 310 E, 90 N, rising by 12 m" in climb
    assert not list(doubt_warnings(terrain_doubts(receipts({GAPS: [], RAISED: []}))))


@pytest.mark.parametrize("sides", ["all", "half"])
@pytest.mark.parametrize(("held", "told"), [(1.0, True), (0.8, False)])
def test_a_small_block_is_told_where_all_of_its_sides_are_no_walls(
    sides: str, held: float, *, told: bool
) -> None:
    """A tree beside a house passes for a side."""
    row, column = np.indices((60, 60)) - 30.0
    rock = np.clip(10.0 - 3.7 * (np.hypot(row, column) - 5.5), 0.0, 10.0)
    if sides == "half":
        rock[(column > 0) & (rock < 10.0)] = 0.0
    lowest = 20.0 + rock
    lowest[np.random.default_rng(2).random(rock.shape) > held] = np.nan
    found = list(cut_off_blocks(lowest, np.full(rock.shape, 20.0), rock == 0, 1.0))
    assert len(found) == (told and sides == "all")
    assert all(100 < block.area_m2 < 400 for block in found)


@pytest.mark.parametrize("steep", [0.4, 0.7, 1.0, 1.2])
@pytest.mark.parametrize("shape", ["gable", "hipped"])
def test_eaves_below_a_ridge_are_no_sides_of_a_mound(shape: str, steep: float) -> None:
    row, column = np.indices((60, 60)) - 30.0
    along, across = 0.96 * column + 0.28 * row, 0.96 * row - 0.28 * column
    inner = 6.0 - np.abs(across)
    if shape == "hipped":
        inner = np.minimum(inner, 10.0 - np.abs(along))
    house = (np.abs(across) < 6.0) & (np.abs(along) < 10.0)
    lowest = np.where(house, 3.0 + steep * inner, 0.0)
    assert list(cut_off_blocks(lowest, np.zeros(house.shape), ~house, 1.0)) == []


@pytest.mark.parametrize(
    ("ends_m", "width_m", "told"),
    [
        ((-9, 300), 16, True),
        ((-9, 165), 12, True),
        ((20, 180), 16, False),
        ((-9, 110), 16, False),
        ((-9, 300), 60, False),
    ],
)
def test_a_bank_between_walls_that_runs_on_is_told_and_a_house_is_not(
    ends_m: tuple[float, float], width_m: float, *, told: bool
) -> None:
    row, column = np.indices((200, 200)) + 0.5
    along, across = 0.98 * column + 0.2 * row - 20, 0.98 * row - 0.2 * column - 80
    bank = (np.abs(across) < width_m / 2) & (along > ends_m[0]) & (along < ends_m[1])
    rng = np.random.default_rng(6)
    lowest = 6.0 * bank + rng.normal(0, 0.05, bank.shape)
    lowest[rng.random(bank.shape) < 0.1] = np.nan
    found = list(cut_off_blocks(lowest, np.zeros(bank.shape), ~bank, 1.0))
    assert len(found) == told
    for block in found:
        assert block.area_m2 == pytest.approx(bank.sum(), rel=0.1)
        assert block.height_m == pytest.approx(6.0, abs=0.2)
        assert bank[block.row, block.column]


@pytest.mark.parametrize("shape", ["mound", "hall", "wood", "hill with ground"])
def test_a_block_whose_sides_are_no_walls_is_told_whole(shape: str) -> None:
    x, y, ground = plain()
    cut_off = plateau(x, y, 12.0, 5.7) > 0
    lowest = (
        ground
        + {
            "mound": plateau(x, y, 12.0, 5.7),
            "hall": 12.0 * (plateau(x, y, 12.0, 5.7) == 12.0),
            "wood": np.random.default_rng(3).uniform(0, 12, x.shape) * cut_off,
            "hill with ground": plateau(x, y, 12.0, 5.7),
        }[shape]
    )
    there = ~cut_off | (shape == "hill with ground")
    lowest[::7, ::5] = np.nan
    found = list(cut_off_blocks(lowest, ground, there & (x > 0), 1.0))
    if shape != "mound":
        assert found == []
        return
    (block,) = found
    assert block.area_m2 == block.cells.sum() == pytest.approx(cut_off.sum(), rel=0.1)
    assert (block.row, block.column) == pytest.approx((70, 70), abs=3)
    assert block.height_m == pytest.approx(12.0, abs=0.3)


def test_what_is_cut_off_and_perhaps_a_hill_has_no_small_sigma_and_is_told_with_its_place() -> None:
    x, y, ground = plain()
    lowest = ground + plateau(x, y, 12.0, 5.7)
    inner = slice(20, -20)
    found = doubts(np.where(lowest > ground, np.nan, ground), 20, 1.0)
    found = found._replace(lowest=lowest[inner, inner][::-1])
    arrays = {
        "dtm": ground[inner, inner][::-1].astype(np.float32),
        "dtm_quality": np.full((100, 100), 0.2, np.float32),
    }
    given = arrays["dtm_quality"].copy()
    core = Bounds(0, 0, 100 * QUANTA_PER_M, 100 * QUANTA_PER_M)
    facts = block_facts(found, arrays, core, QUANTA_PER_M)
    off = (lowest - ground > 1.0)[inner, inner][::-1]
    assert arrays["dtm_quality"][off].min() == pytest.approx(6.0, abs=0.2)
    assert (arrays["dtm_quality"] > 0.2).sum() < 1.1 * off.sum()
    assert (given == np.float32(0.2)).all()
    ((area, east, north, height),) = facts[BLOCKS]
    assert (east / QUANTA_PER_M, north / QUANTA_PER_M) == pytest.approx((50, 50), abs=3)
    report = terrain_doubts(receipts({BLOCKS: [[area, east, north, height]]}))
    (text,) = block_warning(report)
    assert report.blocks_m2 == area
    assert text.startswith("1 raised block, 1 ")
    assert "12 m above the terrain model" in text
    assert list(block_warning(terrain_doubts(receipts({})))) == []
