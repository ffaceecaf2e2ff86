"""Neighbourhoods decide about afterpulse candidates: kernels against loops, and scenes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import afterpulse_decision
from spl_batch.airborne.afterpulse.returns_behind_planes import behind_plane, parents_of
from spl_batch.airborne.afterpulse.weighted_counts import UNIT, weigh_around
from spl_batch.airborne.beams.shot_runs import beamlets_of
from spl_batch.airborne.settings import AfterpulseSettings
from spl_batch.airborne.steps import STEPS
from spl_batch.lattice.lattice_columns import columns, most_around
from spl_batch.lattice.tables import PointFlag, PointTable, canonical_order
from tests.airborne.filter.test_denoise import as_table

DEFAULT = AfterpulseSettings()
BEAMLETS_PER_M2 = 20.0
NOISE_PER_M = 1e-3


def survey(
    first: NDArray[np.float64],
    second: NDArray[np.float64] | None = None,
    rate: float = 0.15,
    afterpulse: float = 0.2,
) -> tuple[PointTable, NDArray[np.float64]]:
    """First returns, each of its own beamlet, and followers of some of them [m]."""
    second = np.empty((0, 4)) if second is None else second
    n, m = len(first), len(second)
    xyz = np.rint(1000 * np.concatenate([first, second[:, 1:]]))
    parent = second[:, 0].astype(np.int64)
    table = as_table(
        xyz,
        gps_time=np.concatenate([np.arange(n), parent]) * 1e-3,
        afterpulse=np.concatenate([np.zeros(n), np.full(m, afterpulse)]).astype(np.float32),
    ).with_columns(
        afterpulse_rate=np.concatenate([np.zeros(n), np.full(m, rate)]),
        afterpulse_share=np.full(n + m, 0.15),
        line_density=np.full(n + m, NOISE_PER_M),
        range_sigma=np.full(n + m, 0.05),
    )
    return table, np.full(n + m, NOISE_PER_M * BEAMLETS_PER_M2)


def plate(per_m2: float, z: float, slope: float, seed: int) -> NDArray[np.float64]:
    """Returns of a plane with 5 cm spread, 8 m x 8 m."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 8, (int(64 * per_m2), 2))
    return np.column_stack([xy, z + slope * xy[:, 0] + rng.normal(0, 0.05, len(xy))])


def followers(
    first: NDArray[np.float64], rows: NDArray[np.intp], lag: float, spread: float = 0.0
) -> NDArray[np.float64]:
    """Returns straight below some of the first ones, with the rows of their parents."""
    below = first[rows].copy()
    below[:, 2] -= lag + spread * np.random.default_rng(9).random(len(rows))
    return np.column_stack([rows, below])


def inner(first: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Rows well inside the plate."""
    within = np.all((first[:, :2] > 2.5) & (first[:, :2] < 5.5), axis=1)
    return np.flatnonzero(within)[:count]


def echo_of(
    table: PointTable, density: NDArray[np.float64], given: AfterpulseSettings = DEFAULT
) -> NDArray[np.bool_]:
    return afterpulse_decision.resolve(table, density, given, beamlets_of(table)).echo


def chances(table: PointTable, density: NDArray[np.float64]) -> NDArray[np.float64]:
    """Probability of each return, 0 where nothing can be said."""
    rows, chance, *_ = afterpulse_decision.probability(table, density, beamlets_of(table))
    out = np.zeros(len(table))
    out[rows] = chance
    return out


@given(st.integers(0, 2**32 - 1), st.integers(1, 120))
@settings(max_examples=40, deadline=None)
def test_weights_around_are_those_of_a_plain_loop(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.integers(0, [5000, 3000, 4000], (n, 3)).astype(np.int64)
    time, channel = rng.integers(0, 4, n).astype(np.float64), rng.integers(0, 3, n).astype(np.uint8)
    weight = rng.integers(0, UNIT + 1, n)
    radii = np.array([[1500, 1000], [700, 300]])
    made = columns((xyz - xyz.min(axis=0)).astype(np.int32), np.arange(n), (0, 0, 0), 1500)
    o = made.points[3]
    out = np.empty((n, 2), np.int64)
    tilt = np.where(rng.random((n, 1)) < 0.5, rng.uniform(-1.5, 1.5, (n, 2)), 0.0)
    own = int(rng.choice([0, UNIT, 1741]))
    weigh_around(
        made, time[o], channel[o], weight[o], np.arange(n), radii, tilt, own, out,
    )  # fmt: skip
    for q, row in enumerate(o):
        d = (xyz - xyz[row]).astype(np.float64)
        mine = (time == time[row]) & (channel == channel[row])
        worth = np.where(mine, np.where(d[:, 2] > 0, own / UNIT, 0.0), 1.0)
        up = d[:, 2] - d[:, :2] @ tilt[q]
        for k, (a, b) in enumerate(radii):
            left = np.maximum(1 - (d[:, 0] ** 2 + d[:, 1] ** 2) / a**2 - (up / b) ** 2, 0)
            expected = (worth * weight * left**2 * UNIT).sum()
            # kernels and the worth of own returns are rounded down
            assert out[q, k] == pytest.approx(expected, abs=3 * UNIT * n)


@given(st.integers(0, 2**32 - 1), st.integers(30, 90), st.floats(-0.8, 0.8))
@settings(max_examples=25, deadline=None)
def test_what_lies_behind_a_plane_is_that_of_a_plain_loop(seed: int, n: int, slope: float) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.integers(0, 2500, (n, 3))
    flat = rng.random(n) < 0.8
    xyz[flat, 2] = 4000 + slope * xyz[flat, 0] + rng.normal(0, 40, flat.sum())
    xyz[~flat, 2] += 1000
    time, channel = rng.integers(0, 9, n).astype(np.float64), rng.integers(0, 2, n).astype(np.uint8)
    true = rng.random(n) < 0.9
    lag, aside, wide, high, thick, share, least = 5000, 1500, 800, 1000, 150, 0.6, 8
    xyz[:, 2] -= xyz[:, 2].min()
    made = columns((xyz - xyz.min(axis=0)).astype(np.int32), np.arange(n), (0, 0, 0), 1500)
    o = made.points[3]
    xyz, time, channel, true = xyz[o], time[o], channel[o], true[o]
    beamlets = beamlets_of(PointTable({"gps_time": time, "channel": channel}))
    parents, chosen = np.empty(n, np.int32), rng.random(n) < 0.9
    parents_of(*beamlets, xyz.astype(np.int32), chosen, lag, aside, parents)
    out, tilt = np.empty(n, np.bool_), np.empty((n, 2))
    behind_plane(
        made, true, np.arange(n, dtype=np.int32), parents, (wide, high, thick),
        share, least, out, tilt, np.empty((3, most_around(made))),
    )  # fmt: skip
    for q in range(n):
        d = xyz - xyz[q]
        above = np.flatnonzero((time == time[q]) & (channel == channel[q]) & (d[:, 2] > 0))
        lowest = above[d[above, 2] == d[above, 2].min(initial=10**6)]
        first = lowest[:1]
        found = first[(d[first, 2] <= lag) & (np.hypot(*d[first, :2].T) <= aside)]
        if not len(found) or not chosen[q]:
            assert parents[q] == -1
            assert not out[q]
            continue
        assert parents[q] == found[0]
        u, v, w = (xyz - xyz[parents[q]]).T
        near = true & (u**2 + v**2 <= wide**2) & (np.abs(w) <= high)
        behind, slopes = False, np.zeros(2)
        if near.sum() >= least:
            fit = np.column_stack([np.ones(n), u, v])
            moments = np.cov(np.stack([u, v])[:, near], bias=True)
            plane = np.linalg.lstsq(fit[near], w[near].astype(np.float64))[0]
            off = w - fit @ plane
            spread = np.linalg.det(moments) > 1e-3 * np.trace(moments) ** 2
            if spread and off[q] < -thick:
                on = near & (np.abs(off) <= thick)
                there = near & ~on & (np.abs(off - off[q]) <= thick)
                if on.sum() >= share * near.sum():
                    slopes, behind = plane[1:], 20 * there.sum() <= near.sum()
        assert out[q] == behind
        np.testing.assert_allclose(tilt[q], slopes, atol=1e-9)


@pytest.mark.parametrize("slope", [0.0, 0.7])
def test_what_follows_a_surface_is_an_afterpulse(slope: float) -> None:
    first = plate(15, 20.0, slope, 1)
    rows = inner(first, 60)
    for lag in (0.35, 0.8, 2.0):
        table, density = survey(first, followers(first, rows, lag, spread=1.0))
        assert echo_of(table, density)[len(first) :].mean() > 0.85
        assert not echo_of(table, density)[: len(first)].any()


def test_close_behind_a_steep_roof_an_afterpulse_is_no_surface() -> None:
    first = plate(15, 20.0, 1.0, 1)
    table, density = survey(
        first, followers(first, inner(first, 60), 0.35, spread=0.3), afterpulse=0.9
    )
    assert echo_of(table, density)[len(first) :].mean() > 0.95


def test_ground_below_a_shrub_stays() -> None:
    ground = plate(15, 20.0, 0.1, 1)
    shrub = ground[inner(ground, 40)] + [0.0, 0.0, 1.2]
    first = np.concatenate([ground, shrub])
    rows = np.arange(len(ground), len(first))
    table, density = survey(first, followers(first, rows, 1.2))
    assert not echo_of(table, density)[len(first) :].any()


def test_in_crowns_the_ratio_of_rates_decides() -> None:
    rng = np.random.default_rng(2)
    first = np.column_stack([rng.uniform(0, 8, (3000, 2)), rng.uniform(10, 18, 3000)])
    rows = np.flatnonzero(np.all(np.abs(first - [4, 4, 14]) < [2, 2, 2], axis=1))[::6]
    true_rate = 3000 / 8**3 / BEAMLETS_PER_M2
    for odds in (0.2, 1.0, 30.0):
        table, density = survey(first, followers(first, rows, 0.6), rate=odds * true_rate)
        _, chance, hard, *_ = afterpulse_decision.probability(table, density, beamlets_of(table))
        assert not hard.any()
        assert float(np.median(chance)) == pytest.approx(odds / (odds + 1.0), abs=0.04)
        assert bool(echo_of(table, density)[len(first) :].mean() > 0.9) is (odds > 5)


@pytest.mark.parametrize("budget", [0.016, 0.05])
def test_the_budget_holds_in_any_foliage_and_is_reached_in_some(budget: float) -> None:
    given = AfterpulseSettings(vegetation_loss=budget)
    table, _ = survey(plate(1, 5.0, 0.0, 1))
    rows, even = np.arange(1), np.zeros(1)
    for share, scale in ((0.1, 1.0), (0.15, 0.6), (0.2, 0.3)):
        known = table.with_columns(afterpulse_share=np.full(len(table), share, np.float32))
        limit = afterpulse_decision._enough(known, rows, even, given)[0]
        lost = []
        for true_rate in np.geomspace(1e-4, 100, 400):
            lag = np.linspace(0, 10 * scale, 4001)[1:]
            rate = share / scale * np.exp(-lag / scale)
            believed = rate / (rate + true_rate) >= limit
            lost.append(true_rate * lag[believed].max(initial=0.0))
        assert max(lost) == pytest.approx(budget, rel=0.02)
    by_default = afterpulse_decision._enough(table, rows, even, given)[0]
    assert by_default == pytest.approx(1 / (1 + np.e * budget / 0.15))


def test_another_budget_leaves_the_time_domain_as_it_is() -> None:
    used = {name for kind in ("fit_line", "scatter") for name in STEPS[kind].settings}
    ours = {f"afterpulse.{key}" for key in AfterpulseSettings.model_fields}
    assert ours - used == {"afterpulse.vegetation_loss"}
    assert "afterpulse" not in used
    assert "afterpulse" in STEPS["denoise"].settings


def test_a_bed_lives_although_the_time_domain_takes_it_for_echoes() -> None:
    surface, bed = plate(6, 10.0, 0.0, 5), plate(12, 8.8, 0.0, 6)
    first = np.concatenate([surface, bed])
    rows = inner(surface, 30)
    table, density = survey(first, followers(first, rows, 1.2), rate=0.06, afterpulse=0.95)
    late = slice(len(first), None)
    assert not echo_of(table, density)[late].any()
    bare, density = survey(surface, followers(surface, rows, 1.2), rate=0.06, afterpulse=0.95)
    assert echo_of(bare, density)[len(surface) :].all()
    # A faint bed needs a polygon that says it is water.
    first = np.concatenate([surface, plate(1.5, 8.8, 0.0, 6)])
    late = slice(len(first), None)
    table, density = survey(first, followers(first, rows, 1.2), rate=0.06, afterpulse=0.95)
    water = table.with_columns(flags=np.full(len(table), PointFlag.WATER))
    assert echo_of(water, density)[late].mean() < echo_of(table, density)[late].mean()


def test_as_published_the_time_domain_decides() -> None:
    surface, bed = plate(6, 10.0, 0.0, 5), plate(12, 8.8, 0.0, 6)
    first = np.concatenate([surface, bed])
    published = AfterpulseSettings(method="published")
    table, density = survey(first, followers(first, inner(surface, 30), 1.2), afterpulse=0.95)
    found = afterpulse_decision.resolve(table, density, published, beamlets_of(table))
    assert found.echo.tolist() == (table["afterpulse"] > 0.5).tolist()
    assert not found.dependent.any()
    assert not echo_of(table, density)[len(first) :].any(), "ours spares the bed"


def test_without_rates_or_noise_the_time_domain_decides() -> None:
    first = plate(10, 5.0, 0.0, 1)
    rows = inner(first, 20)
    for share, expected in ((0.2, False), (0.6, True)):
        table, density = survey(first, followers(first, rows, 0.8), afterpulse=share)
        assert (echo_of(table, 0 * density)[len(first) :] == expected).all()
        silent = table.with_columns(afterpulse_rate=np.zeros(len(table)))
        assert (echo_of(silent, density)[len(first) :] == expected).all()
    bare = PointTable({k: v for k, v in table.columns.items() if k != "afterpulse"})
    assert not echo_of(bare, density).any()
    gone = table.with_columns(flags=np.full(len(table), PointFlag.WITHHELD))
    assert not echo_of(gone, density).any()


def _wide_crowns() -> tuple[PointTable, NDArray[np.float64]]:
    """Crowns, even and in clumps, above a floor, with returns behind some; in canonical order."""
    rng = np.random.default_rng(8)
    crown = np.column_stack([rng.uniform(0, 24, 4000), rng.uniform(0, 6, 4000),
                             rng.uniform(10, 15, 4000)])  # fmt: skip
    clumps = np.repeat(crown[::20], 10, axis=0) + rng.uniform(-0.3, 0.3, (2000, 3))
    crown = np.concatenate([crown[crown[:, 0] < 12], clumps[clumps[:, 0] > 12]])
    floor = np.column_stack([rng.uniform(0, 24, 2500), rng.uniform(0, 6, 2500),
                             rng.normal(9, 0.05, 2500)])  # fmt: skip
    first = np.concatenate([crown, floor])
    rows = rng.choice(len(first), 1500, replace=False)
    lag = 0.3 + rng.exponential(0.7, len(rows))
    second = np.column_stack([rows, first[rows] - np.column_stack([0 * lag, 0 * lag, lag])])
    table, density = survey(first, second)
    return table.take(canonical_order(table)), density


def test_halo_and_order_do_not_matter() -> None:
    rng = np.random.default_rng(8)
    table, density = _wide_crowns()
    whole = afterpulse_decision.resolve(table, density, DEFAULT, beamlets_of(table))
    chance = chances(table, density)
    assert 0.05 < whole.echo[table["afterpulse"] > 0].mean() < 0.95
    shuffled = rng.permutation(len(table))
    np.testing.assert_array_equal(
        echo_of(table.take(shuffled), density[shuffled]), whole.echo[shuffled]
    )
    halo = round(1000 * afterpulse_decision.REACH_M)
    for low in range(0, 24_000, 3000):
        near = (table["x"] >= low - halo) & (table["x"] < low + 3000 + halo)
        own = ((table["x"] >= low) & (table["x"] < low + 3000))[near]
        given = table.take(near)
        part = afterpulse_decision.resolve(given, density[near], DEFAULT, beamlets_of(given))
        for got, want in zip(part, whole, strict=True):
            np.testing.assert_array_equal(got[own], want[near][own])
        np.testing.assert_array_equal(
            chances(table.take(near), density[near])[own], chance[near][own]
        )
