"""Ground that goes on at its own height: rims, decks and roofs; slow twins of kernels."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.ground.level_ground import (
    DOWN,
    GAP,
    ISLAND,
    NEAR_M,
    REACH_M,
    ROUGH_M,
    ROUNDS,
    STEP_M,
    STEP_SLOPE,
    edges,
    levelled,
)
from spl_batch.airborne.ground.node_grids import lowest_nodes, nearest_node
from spl_batch.airborne.ground.steep_ground import FEWEST, FLAT, STEEP
from spl_batch.airborne.settings import GroundSettings
from spl_batch.lattice.tables import PointTable

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


@pytest.fixture(scope="module")
def quarry() -> dict[str, Mask]:
    """A plateau that ends in a cliff with spurs, a gorge with a deck over it, and a hall below."""
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 1, (2, 14_000)) * [[260], [220]]
    plateau = x > 90 + 20 * np.cos(2 * np.pi * y / 55)
    gorge = np.abs(x - 215) < 10
    deck = gorge & (np.abs(y - 110) < 5)
    hall = (np.abs(x - 30) < 10) & (np.abs(y - 110) < 15)
    z = 12.0 * plateau - 12.0 * gorge + 12.0 * deck + 6.0 * hall + rng.normal(0, 0.03, len(x))
    columns = {
        name: np.rint(1000 * v).astype(np.int64) for name, v in zip("xyz", (x, y, z), strict=True)
    }
    found = ground_mask(PointTable(columns), np.ones(len(x), dtype=np.bool_), GroundSettings())
    inner = deck & (np.abs(x - 215) < 8)
    rim = plateau & (x < 125)
    return {"found": found, "rim": rim, "deck": inner, "hall": hall, "ground": ~deck & ~hall}


def test_rims_and_spurs_of_a_cliff_are_ground(quarry: dict[str, Mask]) -> None:
    assert quarry["found"][quarry["rim"]].mean() > 0.85
    assert quarry["found"][quarry["ground"]].mean() > 0.97


@pytest.mark.parametrize("what", ["deck", "hall"])
def test_ground_goes_on_to_no_deck_and_no_hall(quarry: dict[str, Mask], what: str) -> None:
    assert quarry["found"][quarry[what]].mean() < 0.05


def default_ground(x: Float, y: Float, z: Float) -> Mask:
    """Ground by the default method, in the order of the points."""
    columns = [np.rint(1000 * v).astype(np.int64) for v in (x, y, z)]
    table = PointTable(dict(zip("xyz", columns, strict=True)))
    return ground_mask(table, np.ones(len(x), dtype=np.bool_), GroundSettings())


def terraces(seed: int) -> tuple[Float, NDArray[np.int64], Mask]:
    """Nodes of two levels with a jagged step between, and what is left of their ground."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 30, (2, 500))
    upper = x > 15 + 3 * np.sin(y)
    xyz = np.column_stack([x, y, 6.0 * upper + 0.02 * y + rng.normal(0, 0.04, len(x))])
    grid = lowest_nodes(xyz, np.ones(len(x), dtype=np.bool_), 1.0)
    return xyz, grid, (np.abs(x - 15) > 5) & (rng.random(len(x)) < 0.9)


@pytest.mark.parametrize("seed", range(2))
def test_nodes_that_level_ground_goes_on_to_are_those_of_a_slow_twin(seed: int) -> None:
    xyz, grid, ground = terraces(seed)
    found = levelled(xyz, grid, nearest_node(grid), ground, 1.0)
    assert np.array_equal(found, _levelled(xyz, grid, ground))
    assert found.sum() > ground.sum() + 25


def test_nothing_grows_from_a_few_nodes_on_a_roof() -> None:
    xyz, grid, _ = terraces(3)
    upper = xyz[:, 2] > 3
    few = np.flatnonzero(upper & (np.abs(xyz[:, 1] - 10) < 2))
    assert FEWEST < len(few) < ISLAND
    ground = ~upper
    ground[few] = True
    assert not levelled(xyz, grid, nearest_node(grid), ground, 1.0)[upper].sum() > len(few)


def test_a_rim_is_an_edge_and_neither_a_deck_nor_a_plain_is() -> None:
    height = np.zeros((60, 110))
    height[:, 30:] = 8.0
    height[25:35, 5:30] = 8.0
    found = edges(height, height > 4, 1.0)
    assert not found[25:35, 5:25].any()
    assert found[:15, 30:68].all()
    assert not found[:, 72:].any()
    assert not found[height < 4].any()


def test_what_widens_behind_its_end_is_a_corner_and_a_pier_is_none() -> None:
    row, column = np.mgrid[0:60, 0:80]
    across = np.abs(row - 30)
    height = np.where(across < 40 - column, 5.0, 0.0)
    assert edges(height, height > 0, 1.0)[26:35, 34].all()
    pier = np.where((column < 20) | ((across < 5) & (column < 60)), 5.0, 0.0)
    assert not edges(pier, pier > 0, 1.0)[26:35, 24:60].any()


@pytest.mark.parametrize("turned_deg", [3, 12, 30])
def test_a_deck_that_lies_oblique_to_the_grid_is_no_corner(turned_deg: float) -> None:
    row, column = np.mgrid[0:90, 0:120]
    cos, sin = np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))
    along, across = cos * column + sin * (row - 30), cos * (row - 30) - sin * column
    height = np.where((along < 20) | (along > 80) | (np.abs(across) < 4.5), 7.0, 0.0)
    deck = (along > 26) & (along < 74) & (np.abs(across) < 4.5)
    assert deck.sum() > 350
    assert not edges(height, height > 0, 1.0)[deck].any()


def test_the_rim_of_a_low_cliff_on_a_slope_is_ground() -> None:
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, 120, (2, 24_000))
    rim = 60 + 0.1 * x + 3 * np.sin(x / 4)
    z = 0.3 * x + 0.3 * y + 6.0 * (y < rim) + rng.normal(0, 0.03, len(x))
    leaf = rng.random(len(x)) < 0.5
    z[leaf] += rng.uniform(1, 14, leaf.sum())
    near = (y < rim) & (y > 48 + 0.1 * x) & ~leaf & (np.abs(x - 60) < 50)
    assert default_ground(x, y, z)[near].mean() > 0.7


def test_the_corner_of_a_plateau_is_ground() -> None:
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, 140, (2, 30_000))
    plateau = (x < 70 + 0.3 * y) & (y < 90)
    found = default_ground(x, y, 14.0 * plateau + rng.normal(0, 0.03, len(x)))
    tip = plateau & (y > 80) & (x > 82)
    assert tip.sum() > 150
    assert found[tip].mean() > 0.8


def _levelled(xyz: Float, grid: NDArray[np.int64], ground: Mask) -> Mask:
    """Round by round, every node against planes by least squares, one for each side of it."""
    held = grid >= 0
    spacing = 16 * np.sqrt(4 / held.sum())  # four squares of 16 m hold the scene
    near, reach = max(1.6 * spacing, 2.0), float(np.clip(3 * spacing, *REACH_M))
    known = held & ground[grid]
    asked = held & ~known
    barred = asked & ~edges(xyz[nearest_node(grid), 2], asked, 1.0)
    cells = {int(grid[*cell]): cell for cell in np.argwhere(held & ~barred)}
    of = np.array([i for i in cells if ground[i]])
    pairs = cKDTree(xyz[of, :2]).sparse_distance_matrix(cKDTree(xyz[of, :2]), near).tocoo()
    rise = np.abs(xyz[of[pairs.row], 2] - xyz[of[pairs.col], 2])
    both = (pairs.row, pairs.col)
    joined = coo_matrix((rise <= STEP_M + STEP_SLOPE * pairs.data, both), pairs.shape).tocsr()
    joined.eliminate_zeros()
    part = connected_components(joined)[1]
    small = set(of[np.bincount(part)[part] < ISLAND].tolist())
    state = {i: bool(ground[i]) for i in cells if i not in small}
    fresh = [i for i in state if state[i]]
    grown: list[int] = []
    for _ in range(ROUNDS):
        beside = np.array([cells[i] for i in fresh])
        joins = [
            i for i in state
            if not state[i] and (np.abs(beside - cells[i]).max(axis=1) <= np.ceil(reach)).any()
            and _goes_on(xyz, cells, state, i, reach)
        ]  # fmt: skip
        if not joins:
            break
        state.update(dict.fromkeys(joins, True))
        grown += joins
        fresh = joins
    out = ground.copy()
    out[grown] = True
    return out


def _goes_on(
    xyz: Float, cells: dict[int, NDArray[np.int64]], state: dict[int, bool], i: int, reach: float
) -> bool:
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        side = [
            j for j, known in state.items()
            if known and (cells[j] - cells[i]) @ step >= 0
            and np.hypot(*(xyz[j, :2] - xyz[i, :2])) <= reach
        ]  # fmt: skip
        if len(side) < FEWEST:
            continue
        off = xyz[side] - xyz[i]
        spread = np.cov(off[:, :2].T, bias=True)
        if np.linalg.det(spread) < FLAT * np.trace(spread) ** 2:
            continue
        design = np.column_stack([np.ones(len(off)), off[:, :2]])
        plane, *gradient = np.linalg.lstsq(design, off[:, 2], rcond=None)[0]
        rough = np.sqrt(np.mean((off[:, 2] - design @ np.array([plane, *gradient])) ** 2))
        away = np.hypot(*off[:, :2].T)
        slope, nearest = np.hypot(*gradient), away.min()
        if (
            slope <= STEEP
            and rough <= ROUGH_M
            and nearest <= GAP * reach
            and -NEAR_M <= plane <= DOWN * nearest + NEAR_M
            and -off[away.argmin(), 2] <= slope * nearest + NEAR_M
        ):
            return True
    return False
