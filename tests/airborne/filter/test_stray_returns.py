"""Clusters of kept noise where nothing stands make no surface; thin surfaces do."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.filter.stray_returns import BOXES, COLUMN, Box, stray
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.lattice.tables import PointTable

Points = NDArray[np.float64]
Corner = tuple[float, float, float]
"""x, y, z [m]."""

KEPT, REFUSED, AFTERPULSE = 0, 1, 2


def table(points: dict[int, list[Points]]) -> PointTable:
    """Points [m] by noise class."""
    xyz = np.concatenate([part for parts in points.values() for part in parts])
    count = [sum(map(len, parts)) for parts in points.values()]
    quanta = np.round(xyz * 1000).astype(np.int64)
    return PointTable(
        {
            **dict(zip("xyz", quanta.T, strict=True)),
            "noise_class": np.repeat(list(points), count).astype(np.uint8),
        }
    )


def plate(rng: np.random.Generator, low: Corner, high: Corner, per_m2: float) -> Points:
    """Returns of a level surface between two corners."""
    area = (high[0] - low[0]) * (high[1] - low[1])
    return rng.uniform(low, (high[0], high[1], high[2] + 0.2), (rng.poisson(per_m2 * area), 3))


def background(rng: np.random.Generator, per_m3: float = 0.04) -> Points:
    """Refused noise of a gate of 250 m over 80 m x 80 m."""
    count = rng.poisson(per_m3 * 80 * 80 * 250)
    return rng.uniform((0, 0, -80), (80, 80, 170), (count, 3))


@pytest.mark.parametrize("height", [-20.0, 70.0])
def test_a_cluster_beside_a_surface_but_far_above_or_below_is_stray(height: float) -> None:
    # Beside the edge of a survey: the columns around the cluster hold true ground.
    rng = np.random.default_rng(5)
    ground = plate(rng, (0, 0, 40), (80, 40, 40), 8.0)
    cluster = rng.normal((40, 47, height), 1.0, (9, 3))
    found = stray(table({KEPT: [cluster, ground], REFUSED: [background(rng)]}))
    assert found[:9].all()
    assert not found[9:].any()


def test_afterpulses_of_noise_do_not_stand_beside_it() -> None:
    # Off the edge of a survey, where little is refused: one beamlet's train of returns.
    rng = np.random.default_rng(7)
    ground = plate(rng, (0, 0, 40), (80, 40, 40), 8.0)
    train = np.array([(40.0, 72.0, 170.0), (40.0, 72.1, 169.4), (40.0, 72.3, 168.2)])
    beside = rng.uniform((36, 68, 100), (44, 76, 170), (13, 3))
    points = table({KEPT: [train, ground], REFUSED: [beside, background(rng)[:2000] * (1, 0.6, 1)]})
    assert not stray(points)[:3].any()
    chance = np.zeros(len(points), np.float32)
    chance[1:3] = 0.45
    found = stray(points.with_columns(afterpulse=chance))
    assert found[:3].all()
    assert not found[3:].any()


@pytest.mark.parametrize(
    ("low", "high", "per_m2"),
    [
        ((30, 30, -30), (38, 38, -30), 4.0),  # a shaft of 70 m: 8 m wide
        ((45, 0, -60), (80, 80, -60), 0.5),  # a quarry with dark floor, 100 m deep
        ((30, 0, -10), (50, 80, -10), 0.1),  # a canyon's river of few returns
        ((0, 0, 5), (80, 80, 5), 0.08),  # forest floor 35 m below closed crowns
    ],
)
def test_deep_surfaces_stay(low: Corner, high: Corner, per_m2: float) -> None:
    rng = np.random.default_rng(6)
    deep = plate(rng, low, high, per_m2)
    top = plate(rng, (0, 0, 40), (80, 80, 40), 8.0)
    found = stray(table({KEPT: [deep, top], REFUSED: [background(rng)]}))
    # Along its rim the last few of a thin surface may have too little around them.
    assert np.count_nonzero(found[: len(deep)]) <= 0.02 * len(deep)
    assert not found[len(deep) :].any()


def test_what_stands_above_a_surface_is_spared_as_a_top_only() -> None:
    rng = np.random.default_rng(8)
    ground = plate(rng, (0, 0, 40), (80, 40, 40), 8.0)
    wire = np.stack([np.linspace(2, 78, 30), np.full(30, 20.0), np.full(30, 72.0)], axis=1)
    below = rng.normal((40, 20, -30), 0.5, (9, 3))
    points = table({KEPT: [wire, below, ground], REFUSED: [background(rng)]})
    assert stray(points)[:39].all()
    spared = stray(points, spare_above=True)
    assert not spared[:30].any()
    assert spared[30:39].all()
    assert not spared[39:].any()


def test_noise_of_a_loose_filter_makes_no_ground_off_the_edge() -> None:
    # The survey ends at x = 45. Published tests keep up to a quarter of pure noise, and two fifths
    # of noise that has afterpulses.
    rng = np.random.default_rng(10)
    ground = plate(rng, (0, 0, 40), (45, 80, 40), 8.0)
    canopy = plate(rng, (10, 20, 60), (25, 60, 60), 1.0)
    noise = background(rng)
    kept = rng.random(len(noise)) < 0.25
    points = table({KEPT: [noise[kept], ground, canopy], REFUSED: [noise[~kept]]})
    found, count = stray(points), int(kept.sum())
    assert found[:count][noise[kept, 0] > 65].all()
    assert not found[count:].any()
    # Plates are 0.2 m thick, evenly: so much is their spread.
    told = points.with_columns(range_sigma=np.full(len(points), 0.2 / np.sqrt(12), np.float32))
    mask = ground_mask(told, (points["noise_class"] == KEPT) & ~found, GroundSettings())
    assert mask[count : count + len(ground)].mean() > 0.996
    assert points["z"][mask].min() > 35_000


@pytest.mark.parametrize("refused", [100, 800])
def test_counts_are_those_of_the_slow_twin(refused: int) -> None:
    rng = np.random.default_rng(refused)
    kept = rng.uniform((0, 0, -20), (90, 40, 60), (150, 3))
    noise = rng.uniform((0, 0, -20), (90, 40, 60), (refused, 3))
    echoes = rng.uniform((0, 0, -20), (90, 40, 60), (50, 3))
    for part in (kept, noise, echoes):
        # Gaps that boxes reach across, and far wider ones.
        part[:, 0] += np.where(part[:, 0] > 60, 10.0, 0.0)
        part[:, 2] += np.where(part[:, 2] > 40, 500.0, 0.0)
    points = table({KEPT: [kept], REFUSED: [noise], AFTERPULSE: [echoes]})
    slow = slow_twin(points)
    assert 0 < np.count_nonzero(slow) < len(kept) or refused == 100
    np.testing.assert_array_equal(stray(points), slow)
    order = rng.permutation(len(points))
    np.testing.assert_array_equal(stray(points.take(order)), slow[order])


def slow_twin(points: PointTable) -> NDArray[np.bool_]:
    """The rule, written down pair by pair."""
    cells = np.stack([points[a] // 5000 for a in "xyz"], axis=1)
    away = np.abs(cells[:, None] - cells[None])
    signal, refused = (points["noise_class"] == k for k in (KEPT, REFUSED))

    cell = np.unique(cells, axis=0)
    wide = (np.abs(cell[:, None] - cells[None]) <= (3, 3, 1)).all(axis=2)
    in_wide = np.array([wide[:, signal].sum(1), wide[:, refused].sum(1)])
    odds = 0.002
    told = in_wide.sum(0) >= 100
    if told.any():
        share = np.quantile((in_wide[0] / in_wide.sum(0))[told], 0.1)
        odds = max(odds, 2 * share / (1 - share)) if share <= 0.5 else odds

    def bare(near: NDArray[np.bool_], box: Box) -> NDArray[np.bool_]:
        kept, gone = near[:, signal].sum(1), near[:, refused].sum(1)
        few: NDArray[np.bool_] = kept < np.minimum(box.cluster, box.share * gone) + odds * gone
        return few

    nowhere = np.ones(len(points), np.bool_)
    for box in BOXES:
        nowhere &= bare((away <= (box.reach, box.reach, 1)).all(axis=2), box)
    nowhere |= bare((away[:, :, :2] <= COLUMN.reach).all(axis=2), COLUMN)
    stray_ones: NDArray[np.bool_] = signal & nowhere
    return stray_ones
