"""The noise filter: labels against a slow twin, rules for odd points, independence of tiling."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from spl_batch.airborne.afterpulse import afterpulse_decision
from spl_batch.airborne.filter.denoise import denoise, reach_m
from spl_batch.airborne.filter.ellipsoid import ellipsoid_test
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import Shape
from spl_batch.airborne.filter.ellipsoid.ellipsoid_test import Spent, judge
from spl_batch.airborne.filter.ellipsoid.null_distribution import (
    null_table,
    periodic_noise,
    repeated,
)
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.filter.wires import wire_null, wire_scan
from spl_batch.airborne.settings import FilterSettings, WireSettings
from spl_batch.constants import NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.lattice.tables import PointFlag, PointTable, canonical_order
from tests.airborne.filter.test_ellipsoid import brute_counts, mixed_cloud

DEFAULT = FilterSettings()
SHAPE = Shape(15, 1500.0, 30.0, 12_000.0, 12_000, 1.0)
ALONE = WireSettings(enabled=False)
CLOSE = FilterSettings(
    neighbours=15,
    neighbour_cap_m=3.0,
    axis_cap_m=3.0,
    link_m=1.5,
    link_count=3,
    spacing_cap_m=1.0,
    wires=ALONE,
)
"""Short reaches, so that a small cloud has an inside and an outside."""


def as_table(xyz: NDArray[Any], **columns: NDArray[Any]) -> PointTable:
    n = len(xyz)
    zeros = ("channel", "return_number", "flags", "source", "line_density", "afterpulse_rate",
             "afterpulse_share", "range_sigma")  # fmt: skip
    table = PointTable({}).with_columns(
        x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2], gps_time=np.arange(n), index=np.arange(n),
        **dict.fromkeys(zeros, np.zeros(n)),
    )  # fmt: skip
    return table.with_columns(**columns)


def everything(n: int) -> NDArray[np.bool_]:
    return np.ones(n, dtype=np.bool_)


def labels(
    table: PointTable, density: float, filtering: FilterSettings = DEFAULT
) -> NDArray[np.uint8]:
    n = len(table)
    return denoise(table, np.full(n, density), everything(n), filtering)["noise_class"]


@pytest.fixture
def shipped_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """The null distribution of the defaults for whatever settings: none is drawn."""
    table = null_table(DEFAULT)
    monkeypatch.setattr(ellipsoid_test, "null_table", lambda _: table)


def test_published_labels_are_the_slow_twins() -> None:
    density = 0.13
    filtering = FilterSettings(test="published", neighbours=15, wires=ALONE)
    xyz = mixed_cloud(21, 500)
    low, high, volume = brute_counts(xyz, SHAPE, None)
    assert (low == high).all()
    signal = stats.poisson.cdf(low, density * volume * 1e-9) >= 0.95
    found = labels(as_table(xyz), density, filtering)
    np.testing.assert_array_equal(found, np.where(signal, 0, 1))
    assert 0 < signal.mean() < 1


@pytest.mark.usefixtures("shipped_table")
def test_what_shots_show_to_be_noise_is_noise_however_dense() -> None:
    xyz = np.random.default_rng(4).normal(0, 100, (300, 3)).astype(np.int64)
    flags = np.zeros(300, np.uint8)
    flags[::2] = PointFlag.SHOT_NOISE
    found = labels(as_table(xyz, flags=flags), 1e-3)
    assert found[::2].tolist() == [NOISE_BACKGROUND] * 150
    assert (found[1::2] == NOISE_SIGNAL).mean() > 0.8


def test_the_scan_and_the_test_share_alpha(monkeypatch: pytest.MonkeyPatch) -> None:
    xyz, _, core = periodic_noise(np.random.default_rng(7), 0.2, 9000, DEFAULT)
    n = len(xyz)
    cloud = Cloud(xyz, (0, 0, 0), np.full(n, 0.2), core, ~everything(n))
    half = FilterSettings(alpha=0.025, wires=ALONE)
    with_half = judge(cloud, half).signal
    whole = DEFAULT.model_copy(update={"alpha": 0.05})
    rng = np.random.default_rng(1)

    def all_spend(share: float) -> Spent:
        return lambda density: np.full(len(density), share)

    found = judge(cloud, whole, spent=all_spend(0.025)).signal
    np.testing.assert_array_equal(found, with_half)
    without = judge(cloud, whole).signal
    middle, link = xyz[:, 0].mean(), 1000 * DEFAULT.link_m
    slightly = np.where(xyz[:, 0] < middle, 0.2, np.nextafter(0.2, 1.0))
    mixed = judge(
        replace(cloud, density=slightly), whole, spent=lambda of: np.where(of == 0.2, 0.025, 0.0)
    ).signal
    x = xyz[core, 0]
    # away from the images of the other half too, by a link
    left = (x < middle - link) & (x > x.min() + link)
    right = (x > middle + link) & (x < x.max() - link)
    np.testing.assert_array_equal(mixed[left], with_half[left])
    np.testing.assert_array_equal(mixed[right], without[right])
    assert with_half.sum() < without.sum()
    # the filter gives the test what the scan leaves
    drawn = rng.uniform(size=int(core.sum())) < 0.01
    scanned = wire_scan.Found(drawn, drawn, np.where(drawn, 0.01, np.nan).astype(np.float32))
    monkeypatch.setattr(wire_null, "spent", lambda density, _: np.full(len(density), 0.01))
    monkeypatch.setattr(wire_scan, "scan", lambda *_: scanned)
    found = denoise(as_table(xyz), np.full(n, 0.2), core, whole)
    label = found["noise_class"]
    assert (label[drawn] == 0).all()
    rest = judge(cloud, whole, spent=all_spend(0.01))
    np.testing.assert_array_equal(label == 0, drawn | rest.signal)
    assert with_half.sum() < rest.signal.sum() < without.sum()
    # and p says what both keep
    tested = np.flatnonzero(~drawn & (rest.p_value > 0.02) & (rest.p_value < 0.9))
    assert len(tested) > 100
    np.testing.assert_allclose(found["p_value"][tested], rest.p_value[tested] + 0.01, rtol=1e-5)


def test_p_is_exact_down_to_what_the_table_tells(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counting goes on beyond the decision, as far as p is tabulated, and changes no label."""
    xyz, core = wide_noise(0.4, 20_000)
    rng = np.random.default_rng(3)
    crown, surface = (rng.uniform(0, (20_000, 20_000, z), (3000, 3)) for z in (8000, 300))
    xyz = np.unique(np.concatenate([xyz[core], crown, surface]).astype(np.int32), axis=0)
    n = len(xyz)
    cloud = Cloud(xyz.astype(np.int32), (0, 0, 0), np.full(n, 0.4), everything(n), ~everything(n))
    quick = judge(cloud, DEFAULT)
    monkeypatch.setattr(ellipsoid_test, "TOLD_TO", 1e-12)
    exact = judge(cloud, DEFAULT)
    np.testing.assert_array_equal(quick.signal, exact.signal)
    told = exact.p_value > 3e-5
    assert 0.1 < told.mean() < 0.9
    assert ((exact.p_value < DEFAULT.alpha / 2) & told).sum() > 30
    np.testing.assert_array_equal(quick.p_value[told], exact.p_value[told])
    assert (exact.p_value[~told] <= quick.p_value[~told]).all()
    assert (quick.p_value[~told] <= 3e-5).all()


def test_p_is_uniform_under_noise_with_the_scan_on() -> None:
    """Whatever the scan adds to small p: within four times what blocks differ by chance."""
    xyz, core = wide_noise(0.1, 60_000)
    p = denoise(as_table(xyz), np.full(len(xyz), 0.1), core, FilterSettings())["p_value"]
    for level in (1e-4, 3e-4, 6e-4, 1e-3, 0.01, 0.1, 0.5):
        low = p <= level
        error = max(standard_error(xyz[core], low), np.sqrt(level / core.sum()))
        assert low.mean() == pytest.approx(level, abs=4 * error)
        assert error < max(0.5 * level, 5e-5)


@pytest.mark.parametrize(
    ("alpha", "points", "largest"),
    [
        (0.05, 30_000, 0.04),
        (0.01, 60_000, 0.09),
    ],
)
def test_alpha_is_the_share_of_pure_noise_that_is_kept(
    alpha: float, points: int, largest: float
) -> None:
    """By the whole filter as it ships, within three times what blocks of noise differ by chance."""
    ratios, errors = [], []
    for density in (0.05, 0.4):
        xyz, core = wide_noise(density, points)
        found = denoise(
            as_table(xyz), np.full(len(xyz), density), core, FilterSettings(alpha=alpha)
        )
        kept = found["noise_class"] == 0
        ratios.append(kept.mean() / alpha)
        errors.append(standard_error(xyz[core], kept) / alpha)
        # without links a part of alpha; p itself is uniform, up to what the scan adds
        p_share = (found["p_value"] <= alpha).mean()
        assert p_share == pytest.approx(alpha, abs=4 * errors[-1] * alpha + 3e-4)
    error = np.hypot(*errors) / 2
    assert error < largest
    np.testing.assert_allclose(ratios, 1, atol=3 * max(errors))
    assert np.mean(ratios) == pytest.approx(1, abs=3 * error)


def wide_noise(density: float, points: int) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Uniform noise that repeats itself farther than the test and two tubes of the scan reach."""
    side = (points / density / 100) ** 0.5
    size, around = ([round(1000 * v) for v in box] for box in ((side, side, 100), (28, 28, 13)))
    xyz, _, core = repeated(np.random.default_rng(6), density, np.array(size), np.array(around))
    return xyz, core


def standard_error(xyz: NDArray[np.int32], kept: NDArray[np.bool_]) -> float:
    """Of the share kept, from cubes of 20 m: noise is kept in groups, far smaller than those."""
    _, cube = np.unique(xyz // 20_000, axis=0, return_inverse=True)
    number, size = np.bincount(cube.reshape(-1)), np.bincount(cube.reshape(-1), weights=kept)
    return float(np.sqrt(((size - kept.mean() * number) ** 2).sum()) / len(kept))


def test_flags_and_afterpulses() -> None:
    xyz = mixed_cloud(23, 300)
    flags = np.zeros(300, dtype=np.uint8)
    flags[:4] = PointFlag.WITHHELD, PointFlag.VENDOR_NOISE, PointFlag.NO_BEAM, PointFlag.OUTSIDE_AOI
    echo = np.zeros(300, dtype=np.float32)
    echo[[0, 10, 11]] = 0.5, 0.9, 0.49
    table = as_table(xyz, flags=flags, afterpulse=echo)
    result = denoise(table, np.full(300, 0.05), everything(300), DEFAULT)
    np.testing.assert_array_equal(result["noise_class"][:4], 255)
    np.testing.assert_array_equal(result["noise_class"] == 2, np.arange(300) == 10)
    assert np.isnan(result["p_value"][[0, 1, 2, 3, 10]]).all()
    # Row 11 depends on another return, so it has no p of its own.
    assert np.isnan(result["p_value"][11])
    assert np.isfinite(np.delete(result["p_value"], [0, 1, 2, 3, 10, 11])).all()


def test_excluded_points_and_afterpulses_shape_nothing() -> None:
    xyz = mixed_cloud(24, 400)
    gone = np.arange(400) % 3 == 0
    flags = np.where(gone & (np.arange(400) % 2 == 0), PointFlag.WITHHELD, 0).astype(np.uint8)
    echo = np.where(gone & (np.arange(400) % 2 == 1), 1.0, 0.0).astype(np.float32)
    mixed = denoise(as_table(xyz, flags=flags, afterpulse=echo), np.full(400, 0.1), ~gone, DEFAULT)
    alone = labels(as_table(xyz[~gone]), 0.1)
    np.testing.assert_array_equal(mixed["noise_class"], alone)


def test_points_that_are_not_decided_serve_as_neighbours() -> None:
    xyz = mixed_cloud(25, 400)
    flags = np.zeros(400, dtype=np.uint8)
    flags[::2] = PointFlag.OUTSIDE_AOI
    result = labels(as_table(xyz, flags=flags), 0.1)
    whole = labels(as_table(xyz), 0.1)
    np.testing.assert_array_equal(result[::2], 255)
    np.testing.assert_array_equal(result[1::2], whole[1::2])


def test_method_none_keeps_all() -> None:
    flags = np.array([0, PointFlag.WITHHELD, PointFlag.NO_BEAM, 0], dtype=np.uint8)
    echo = np.array([0, 1, 0, 1], dtype=np.float32)
    table = as_table(np.zeros((4, 3)), flags=flags, afterpulse=echo)
    result = labels(table, 0.1, FilterSettings(method="none"))
    np.testing.assert_array_equal(result, [0, 255, 0, 2])
    assert reach_m(FilterSettings(method="none")) == 0.0


@pytest.mark.parametrize(
    ("cloud", "density", "expected"),
    [
        (np.zeros((0, 3)), 0.1, []),
        (np.zeros((1, 3)), 0.1, [1]),
        (np.zeros((1, 3)), 0.0, [0]),
        (np.zeros((2, 3)), 0.0, [0, 0]),
        (np.zeros((60, 3)), 0.1, [0] * 60),
        (np.array([[0, 0, 0], [0, 0, 50_000]]), 6.8e-6, [0, 0]),
        (np.array([[0, 0, 0], [0, 0, 50_000]]), 7.0e-6, [1, 1]),
    ],
)
def test_odd_clouds(cloud: NDArray[Any], density: float, expected: list[int]) -> None:
    np.testing.assert_array_equal(labels(as_table(cloud), density), expected)


def test_reach_is_the_sum_of_the_links() -> None:
    assert reach_m(CLOSE) == 10.5 + afterpulse_decision.REACH_M
    alone = FilterSettings(link_count=0, neighbour_cap_m=9.0, axis_cap_m=7.0, wires=ALONE)
    assert reach_m(alone) == 15.0 + afterpulse_decision.REACH_M
    assert (
        reach_m(FilterSettings(test="published", axis_cap_m=13.0))
        == 13.0 + afterpulse_decision.REACH_M
    )


@pytest.mark.usefixtures("shipped_table")
@given(st.integers(0, 2**32 - 1), st.tuples(*[st.integers(-(10**9), 10**9)] * 2))
@settings(max_examples=15, deadline=None)
def test_order_and_place_do_not_matter(seed: int, shift: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    # a coarse lattice: ties are everywhere, and canonical order has to break them
    table = as_table(mixed_cloud(seed % 1000, 300, step=300))
    density = np.full(300, 0.05)
    order = canonical_order(table)
    first = denoise(table.take(order), density, everything(300), CLOSE)["noise_class"]
    moved = table.take(rng.permutation(300))
    moved = moved.with_columns(x=moved["x"] + shift[0], y=moved["y"] + shift[1])
    again = canonical_order(moved)
    second = denoise(moved.take(again), density, everything(300), CLOSE)["noise_class"]
    np.testing.assert_array_equal(second, first)


@pytest.mark.usefixtures("shipped_table")
@pytest.mark.parametrize("filtering", [
    CLOSE, CLOSE.model_copy(update={"test": "published"}), DEFAULT
], ids=["short reaches", "published", "default"])  # fmt: skip
def test_labels_depend_on_neither_tiles_nor_order(filtering: FilterSettings) -> None:
    rng, long = np.random.default_rng(32), filtering is DEFAULT
    if long:
        size = np.array([120_000, 15_000, 15_000])
        noise, plane = rng.uniform(0, 1, (4000, 3)) * size, rng.uniform(0, 1, (9000, 3)) * size
        plane[:, 2] = 3000 + rng.normal(0, 50, 9000)
        wire = rng.uniform(0, 1, (250, 3)) * [120_000, 0, 0] + [0, 7000, 11_000]
        # a coarse lattice: ties are everywhere, and canonical order has to break them
        xyz = np.rint(np.concatenate([noise, plane, wire]) / 50) * 50
    else:
        parts = [mixed_cloud(s, 900, step=200) + np.int32([8000 * s, 0, 0]) for s in range(3)]
        xyz = np.concatenate(parts)
    table = as_table(xyz)
    table = table.take(canonical_order(table))
    low_per_m3, high_per_m3 = (0.1, 0.2) if long else (0.5, 4.0)

    def found(part: PointTable, own: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[Any]]:
        density = np.where(part["x"] // 700 % 2, low_per_m3, high_per_m3)
        columns = denoise(part, density, own, filtering)
        return columns["noise_class"], columns["p_value"]

    label, p_value = found(table, everything(len(table)))
    assert 0.1 < (label == 0).mean() < 0.9
    halo, width = round(reach_m(filtering) * 1000), 30_000 if long else 3000
    for low in range(0, int(xyz[:, 0].max()), width):
        own = (table["x"] >= low) & (table["x"] < low + width)
        read = np.flatnonzero((table["x"] >= low - halo) & (table["x"] < low + width + halo))
        part = table.take(rng.permutation(read))
        part = part.take(canonical_order(part))
        mine = (part["x"] >= low) & (part["x"] < low + width)
        for got, want in zip(found(part, mine), (label, p_value), strict=True):
            np.testing.assert_array_equal(got, want[own])


@pytest.mark.usefixtures("shipped_table")
def test_noise_above_a_surface_does_not_live_on_the_surface() -> None:
    rng = np.random.default_rng(42)
    ground = rng.uniform(0, 40, (32_000, 3))
    ground[:, 2] = rng.normal(0, 0.05, len(ground))
    noise = rng.uniform(0, 40, (1600, 3))
    xyz = np.rint(np.concatenate([ground, noise]) * 1000)
    near = np.r_[np.zeros(len(ground), np.bool_), (noise[:, 2] > 1) & (noise[:, 2] < 4)]
    near &= np.all(np.abs(xyz[:, :2] - 20_000) < 15_000, axis=1)
    assert near.sum() > 50
    kept = labels(as_table(xyz), 0.025) == 0
    every = labels(as_table(xyz), 0.025, FilterSettings(peer_ratio=1e6)) == 0
    assert kept[: len(ground)].mean() > 0.999
    assert kept[near].mean() < 0.1
    assert every[near].mean() > 0.3
