"""P-values of noise below surfaces, and signal that hangs in the air, against slow twins."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.filter.box_counts import count_values
from spl_batch.airborne.filter.denoise import denoise
from spl_batch.airborne.filter.judged_fit import GAP, P_VALUES, THICK, THIN, floating, uniformity
from spl_batch.airborne.filter.stray_returns import Bare, bare_cells
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests.airborne.filter.test_denoise import as_table

EVERYWHERE = Bounds(-(2**40), -(2**40), 2**40, 2**40)
SIDE = 30.0
WIDE = 60.0

Points = NDArray[np.float64]


def judged(bare: Bare, table: PointTable) -> NDArray[np.int64]:
    """Counts of p-values away from the edges of the noise."""
    counts, away = np.zeros(len(P_VALUES) + 1, np.int64), table["z"] > -45_000
    for axis in "xy":
        away &= np.abs(table[axis] - 500 * WIDE) < 500 * WIDE - 12_000
    bare.count_chances(table, away, counts)
    return counts


def cells(table: PointTable) -> Bare:
    bare = bare_cells(lambda: (table,))
    assert bare is not None
    return bare


def over_ground(noise: Points, side: float = SIDE) -> Points:
    """Level ground beside other points [m]."""
    rng = np.random.default_rng(7)
    ground = rng.uniform((0, 0, 0), (side, side, 0.1), (round(10 * side**2), 3))
    return np.concatenate([ground, noise])


def test_values_are_counted_as_a_histogram_counts_them() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.integers(-7000, 43_000, (2, 4000))
    z = rng.integers(-20_000, 20_000, 4000).astype(np.int32)
    kind, mine = rng.integers(0, 4, 4000).astype(np.uint8), rng.random(4000) < 0.7
    value = np.where(rng.random(4000) < 0.1, np.nan, rng.random(4000)).astype(np.float32)
    corner = np.array([-10_000, -10_000, -20_000])
    index = [(axis - low) // 5000 for axis, low in zip((x, y, z), corner, strict=True)]
    place = tuple(np.arange(along.max() + 1) for along in index)
    marked = rng.random([len(along) for along in place]) < 0.5
    ends, found = np.array([0.1, 0.25, 0.7]), np.zeros(4, np.int64)
    count_values((x, y, z), (kind, mine), (0, 1), value, corner, 5000.0, place, marked, ends, found)
    chosen = mine & (kind < 2) & ~np.isnan(value) & marked[tuple(index)]
    np.testing.assert_array_equal(
        found, np.histogram(value[chosen], [0, *np.nextafter(ends, 1), 1])[0]
    )


def slow_floating(kept: NDArray[np.int64], stray: NDArray[np.bool_]) -> NDArray[np.int64]:
    out = np.zeros(kept.shape[:2], np.int64)
    solid = np.where(stray, 0, kept)
    for i, j in np.ndindex(out.shape):
        around = solid[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2].sum(axis=(0, 1))
        for k in np.flatnonzero(kept[i, j]):
            below = np.flatnonzero(around[:k])
            if len(below) and k - below[-1] > GAP and solid[i, j, : below[-1] + 1].any():
                above, rest = kept[i, j, k:], kept[i, j, :k].sum()
                thick = np.count_nonzero(above) >= THICK and rest >= THIN * above.sum()
                out[i, j] = above.sum() if thick or above.sum() < THIN * rest else 0
                break
    return out


def test_what_floats_is_what_a_slow_twin_finds_in_each_column() -> None:
    rng = np.random.default_rng(2)
    seen = 0
    for share in (0.01, 0.03, 0.1):
        kept = np.where(rng.random((12, 11, 14)) < share, rng.integers(1, 30, (12, 11, 14)), 0)
        kept[:, :, 2] = rng.integers(0, 300, (12, 11))
        stray = rng.random(kept.shape) < 0.2
        found = floating(kept, stray)
        np.testing.assert_array_equal(found, slow_floating(kept, stray))
        seen += np.count_nonzero(found)
    assert seen > 5


@pytest.mark.parametrize(
    ("low", "thick", "count", "floats"),
    [(30, 30, 4000, True), (30, 2, 9000, False), (2, 30, 4000, False), (30, 2, 20, True)],
    ids=["a cloud", "a deck", "a forest", "a wire"],
)
def test_a_cloud_floats_and_what_stands_or_is_a_surface_does_not(
    low: float, thick: float, count: int, *, floats: bool
) -> None:
    rng = np.random.default_rng(3)
    above = rng.uniform((0, 0, low), (SIDE, SIDE, low + thick), (count, 3))
    refused = rng.uniform((0, 0, -40), (SIDE, SIDE, 80), (500, 3))
    xyz = over_ground(np.concatenate([above, refused]))
    table = as_table((1000 * xyz).astype(np.int64)).with_columns(
        noise_class=(np.arange(len(xyz)) >= len(xyz) - 500).astype(np.uint8)
    )
    aloft, kept, columns, *box = cells(table).facts(EVERYWHERE, np.zeros((0, 0), np.bool_))[
        "afloat"
    ]
    assert kept == len(xyz) - 500
    if floats:
        assert aloft == pytest.approx(count, rel=0.15)
        assert columns == pytest.approx(min(count, (SIDE / 5) ** 2), rel=0.5)
        assert box[0] >= -5000
        assert box[1] <= 1000 * SIDE
    else:
        assert (aloft, columns, box) == (0, 0, [])


@pytest.mark.parametrize(("pairs", "expected", "least", "most"), [
    (0.0, 0.3, 0.67, 1.5), (0.2, 0.3, 1.5, 99.0), (0.0, 0.15, 1.5, 99.0), (0.0, 0.6, -1.0, 0.6),
], ids=["as expected", "in pairs", "denser", "thinner"])  # fmt: skip
def test_small_p_values_tell_noise_that_is_not_what_is_expected(
    pairs: float, expected: float, least: float, most: float
) -> None:
    """Below level ground, in noise of 0.3 per m3 of which some comes in clusters of four."""
    rng = np.random.default_rng(4)
    count = round(0.3 * WIDE**3)
    seeds = rng.uniform((0, 0, -WIDE), (WIDE, WIDE, 0), (round(count * (1 - 0.75 * pairs)), 3))
    more = seeds[: round(pairs * count / 4)].repeat(3, axis=0)
    noise = np.concatenate([seeds, more + rng.uniform(-0.4, 0.4, more.shape)])
    table = as_table((1000 * over_ground(noise, WIDE)).astype(np.int64))
    everything = np.ones(len(table), np.bool_)
    verdict = denoise(table, np.full(len(table), expected), everything, FilterSettings())
    table = table.with_columns(**{k: verdict[k] for k in ("noise_class", "p_value")})
    found = uniformity(judged(cells(table), table))
    assert found is not None
    assert least < found.times < most


def test_few_returns_tell_nothing_of_p_values() -> None:
    counts = np.array([0, 0, 0, 0, 0, 999])
    assert uniformity(counts) is None
    assert uniformity(counts + np.eye(6, dtype=np.int64)[5]) == (1000, 0.0, P_VALUES[-1])
