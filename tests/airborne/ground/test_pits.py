"""Pits below smooth ground, what is buried below hard surfaces, and cuts that must not show."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.ground.lowest_layers import lowest_layers
from spl_batch.airborne.ground.pits import in_pits
from spl_batch.airborne.ground.point_spacing import spacings_m
from spl_batch.airborne.ground.smrf import fill_gaps
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.cell_groups import group_by_cell
from tests.airborne.ground.clouds import ground_of, table


def pits(
    xyz: np.ndarray,
    cell: np.ndarray,
    shape: tuple[int, int],
    doubtful: np.ndarray | None = None,
) -> np.ndarray:
    out = np.empty(len(cell), dtype=np.bool_)
    if doubtful is None:
        doubtful = np.zeros(len(cell), dtype=np.bool_)
    in_pits(xyz, cell, np.ones(len(cell), dtype=np.bool_), doubtful, *shape, 2, out)
    return out


def plain_pit(
    xyz: np.ndarray, cell: np.ndarray, shape: tuple[int, int], doubtful: np.ndarray, i: int
) -> bool:
    """The rule once more, pair by pair, with dictionaries and no sorting tricks."""
    lowest: dict[tuple[int, int], int] = {}
    for j, c in enumerate(cell):
        lowest.setdefault((int(c) // shape[1], int(c) % shape[1]), j)
    row, column = int(cell[i]) // shape[1], int(cell[i]) % shape[1]
    heights, ends = [], []
    for dr in range(-2, 3):
        for dc in range(-2, 3):
            a, b = lowest.get((row - dr, column - dc)), lowest.get((row + dr, column + dc))
            if (dr, dc) <= (0, 0) or a is None or b is None:
                continue
            u = xyz[b, :2] - xyz[a, :2]
            t = (xyz[i, :2] - xyz[a, :2]) @ u / (u @ u)
            heights.append(xyz[a, 2] + t * (xyz[b, 2] - xyz[a, 2]))
            ends.append(np.mean([not doubtful[a], not doubtful[b]]))
    h, firm = np.array(heights), np.array(ends)
    own = np.sum(np.abs(h - xyz[i, 2]) <= 0.2) if len(h) else 0
    for low in h[h > xyz[i, 2] + 0.25]:
        agree = (h >= low) & (h <= low + 0.4)
        if agree.sum() < max(4, 6 * own):
            continue
        if low <= xyz[i, 2] + 2 and agree.sum() >= np.sum(h <= low + 0.4) / 2:
            return True
        told = not doubtful[i] or firm[agree].mean() >= 0.5
        if agree.sum() >= len(h) / 2 and told:
            return True
    return False


def sparse_grid(seed: int, rough_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in most cells of a 9 x 9 grid on a tilted plane, some of them low."""
    rng = np.random.default_rng(seed)
    cell = np.flatnonzero(rng.random(81) < 0.8)
    x, y = cell % 9 + rng.uniform(0, 1, len(cell)), cell // 9 + rng.uniform(0, 1, len(cell))
    z = 0.6 * x - 0.3 * y + rng.normal(0, rough_m, len(cell))
    z[rng.random(len(cell)) < 0.15] -= rng.uniform(0.2, 5)
    z[rng.random(len(cell)) < 0.2] += rng.uniform(1, 9)
    return np.column_stack([x, y, z]), cell


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.03, 0.3, 2.0]), st.sampled_from([0.0, 0.4, 0.9]))
def test_pits_agree_with_a_plain_twin(seed: int, rough_m: float, share: float) -> None:
    xyz, cell = sparse_grid(seed, rough_m)
    doubtful = np.random.default_rng(seed + 1).random(len(cell)) < share
    expected = [plain_pit(xyz, cell, (9, 9), doubtful, i) for i in range(len(cell))]
    assert pits(xyz, cell, (9, 9), doubtful).tolist() == expected


@pytest.mark.parametrize(
    ("above", "buried"),
    [
        (np.linspace(1.0, 1.5, 8), True),  # a meadow on a slope
        (np.linspace(7.0, 7.6, 8), True),  # a roof
        (np.linspace(1.0, 5.0, 8), False),  # leaves
        (np.linspace(1.0, 1.5, 5), False),  # too few to tell
    ],
)
def test_a_single_return_is_buried_by_a_sheet_only(above: np.ndarray, *, buried: bool) -> None:
    z = np.concatenate([[0.0], above])
    x = np.linspace(0.1, 0.9, len(z))
    nodes = lowest_layers(x, x, z, group_by_cell(x, x, 1.0), 0.3)
    assert nodes.xyz[0, 2] == 0.0
    assert nodes.buried[0] == buried
    assert not nodes.buried[1:].any()


def survey(seed: int = 5, edge_m: float = 70.0, density: float = 8.0) -> dict[str, np.ndarray]:
    """Rolling meadow with a roof and trees; returns behind it that follow its own."""
    rng = np.random.default_rng(seed)
    n = int(density * edge_m**2)
    x, y = rng.uniform(0, edge_m, (2, n))
    base = 50 + 0.3 * x + 2 * np.sin(x / 9) * np.cos(y / 11)
    z = base + rng.normal(0, 0.04, n)
    roof = (np.abs(x - 20) < 7) & (np.abs(y - 30) < 5)
    z[roof] = 62 + rng.normal(0, 0.04, int(roof.sum()))
    wood = (x > 45) & (rng.random(n) < 0.8)
    z[wood] = base[wood] + rng.uniform(2, 15, int(wood.sum()))
    late = rng.random(n) < 0.2
    z[late] = base[late] - 0.3 - rng.exponential(0.7, int(late.sum()))
    ground = ~(roof | wood | late)
    afterpulse = np.where(late, 0.4, 0.0).astype(np.float32)
    return {"x": x, "y": y, "z": z, "base": base, "ground": ground, "afterpulse": afterpulse}


def table_of(points: dict[str, np.ndarray], *, probability: bool) -> PointTable:
    made = table(*(points[axis] for axis in "xyz"))
    return made.with_columns(afterpulse=points["afterpulse"]) if probability else made


@pytest.mark.parametrize("method", ["ptd", "smrf"])
def test_followers_hold_each_other_up_but_pull_no_ground_down(method: str) -> None:
    points = survey()
    low = points["z"] < points["base"] - 1.5
    told, untold = (
        ground_of(table_of(points, probability=known), method) for known in (True, False)
    )
    assert told[points["ground"]].mean() > 0.995
    assert told[low].mean() < 0.01
    assert untold[low].mean() > 2 * told[low].mean()


def test_where_every_return_follows_another_no_ground_is_known() -> None:
    points = survey(edge_m=30.0)
    points["afterpulse"][:] = 0.9
    assert not ground_of(table_of(points, probability=True)).any()


def test_filled_gaps_do_not_depend_on_what_else_is_in_sight() -> None:
    rng = np.random.default_rng(8)
    surface = rng.normal(0, 5, (80, 80))
    surface[rng.random((80, 80)) < 0.4] = np.nan
    cutout = fill_gaps(surface[20:, 10:])
    whole = fill_gaps(surface)[40:-10, 30:-10]
    np.testing.assert_allclose(cutout[20:-10, 20:-10], whole, atol=1e-9)


def test_spacing_around_a_place_is_that_of_nine_squares_whatever_else_is_in_sight() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-100, 150, 3000), rng.uniform(40, 330, 3000)
    keep = (x > -40) | (y > 200)
    x, y = x[keep], y[keep]
    at = rng.uniform(0, 90, 50), rng.uniform(130, 240, 50)
    found = spacings_m(x, y).at(*at)
    square = [np.floor(v / 16).astype(int) for v in (x, y)]
    for k, (i, j) in enumerate(np.floor(np.transpose(at) / 16).astype(int)):
        near = (abs(square[0] - i) <= 1) & (abs(square[1] - j) <= 1)
        held = len(set(zip(square[0][near], square[1][near], strict=True)))
        assert found[k] == pytest.approx(16 * math.sqrt(held / near.sum()))
    part = (x > -33) & (x < 130) & (y > 90) & (y < 290)
    np.testing.assert_array_equal(spacings_m(x[part], y[part]).at(*at), found)
    nowhere = spacings_m(x, y).at(np.array([900.0]), np.array([900.0]))
    np.testing.assert_array_equal(nowhere, 16.0)


def test_kept_noise_below_steep_ground_among_nearly_empty_cells_is_no_ground() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 80, (2, 80 * 80 * 6))
    thin = np.hypot(x - 40, y - 40) < 6  # a crown hides the ground there
    x, y = np.stack([x, y])[:, ~thin | (rng.random(len(x)) < 0.08)]
    z = 0.9 * x + rng.normal(0, 0.03, len(x))
    low = np.array([[38.5, 40.5], [38.6, 41.6], [42.4, 38.3]])
    x, y, z = (
        np.concatenate(pair)
        for pair in ((x, low[:, 0]), (y, low[:, 1]), (z, 0.9 * low[:, 0] - (4.0, 4.5, 2.0)))
    )
    found = ground_of(table(x, y, z))
    assert not found[-3:].any()
    assert found[:-3].mean() > 0.98


@pytest.mark.parametrize("slope", [0.0, 0.5, 2.0])
def test_a_low_node_of_a_smooth_slope_is_a_pit_and_its_neighbours_are_none(slope: float) -> None:
    x, y = (v.ravel() + 0.5 for v in np.meshgrid(np.arange(9.0), np.arange(9.0)))
    z = slope * x
    z[40] -= 0.6
    found = pits(np.column_stack([x, y, z]), np.arange(81), (9, 9))
    assert np.flatnonzero(found).tolist() == [40]


def test_the_bottom_of_a_ditch_is_no_pit() -> None:
    x, y = (v.ravel() + 0.5 for v in np.meshgrid(np.arange(9.0), np.arange(9.0)))
    z = np.where(np.abs(x - 4.5) < 0.6, -1.0, 0.0)
    bottom = np.abs(x - 4.5) < 0.6
    inner = (y > 2) & (y < 7)
    assert not pits(np.column_stack([x, y, z]), np.arange(81), (9, 9))[bottom & inner].any()


@pytest.mark.parametrize(
    ("height_m", "doubtful", "below"),
    [
        (3.5, "all", False),  # lowest leaves of a crown that happen to agree
        (3.5, "node", True),  # a roof, and trees over it
        (3.5, "none", True),  # open ground far above what noise left
        (1.5, "all", True),  # no crown begins so low
    ],
)
def test_what_agrees_high_above_returns_below_leaves_must_be_firm(
    height_m: float, doubtful: str, *, below: bool
) -> None:
    x, y = (v.ravel() + 0.5 for v in np.meshgrid(np.arange(9.0), np.arange(9.0)))
    z = np.where((x.astype(int) + y.astype(int)) % 2, height_m, height_m + 0.1)
    z[40] = 0.0
    asked = {"all": np.ones(81, bool), "node": np.arange(81) == 40, "none": np.zeros(81, bool)}
    assert pits(np.column_stack([x, y, z]), np.arange(81), (9, 9), asked[doubtful])[40] == below
