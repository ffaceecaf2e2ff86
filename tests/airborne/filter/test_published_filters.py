"""The sources' own filters: each against slow Python, and the same whatever the tiling."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.filter.denoise import METHODS, denoise, reach_m
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import Shape
from spl_batch.airborne.filter.published import _numbers, shot_noise
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tables import BeamTable, PointFlag, canonical_order
from tests.airborne.beams.test_differential_cell_count import slow_dcc
from tests.airborne.filter.test_denoise import as_table
from tests.airborne.filter.test_ellipsoid import brute_counts, mixed_cloud
from tests.airborne.filter.wires.test_wire_scan import made_cloud

SOURCES = ["aes", "voxel", "multilevel", "cylinder"]

SMALL = FilterSettings(
    neighbour_cap_m=2.0,
    axis_cap_m=2.0,
    aes={"voxel_m": 1.0, "square": 2, "radius_m": 0.8, "neighbours": 9},
    voxel={"edge_m": 0.75, "height_m": 0.3, "column_m": 2.0},
    multilevel={
        "bin_m": 2.0, "column_m": 2.0, "coarse_voxel_m": 0.9, "coarse_count": 8,
        "fine_voxel_m": 0.4, "fine_count": 4,
    },
    cylinder={"height_m": 0.6, "radius_m": 0.7, "count": 4},
)  # fmt: skip
"""Short lengths, so that a small cloud has an inside and an outside."""


def chosen(method: str) -> FilterSettings:
    return SMALL.model_copy(update={"method": method})


def cells(xyz: NDArray[Any], *edges: int) -> list[tuple[int, ...]]:
    """Index of each point on an absolute lattice."""
    return [tuple(int(c) // e for c, e in zip(p, edges, strict=False)) for p in xyz]


def slow_voxel(xyz: NDArray[Any], edge: int, height: int, column: int) -> list[bool]:
    voxel = cells(xyz, edge, edge, height)
    count = Counter(voxel)
    squares: dict[tuple[int, int], list[int]] = {}
    for i, j, k in count:
        square = (i * edge // column, j * edge // column)
        squares.setdefault(square, []).append(count[i, j, k])
    mean = {s: sum(n) / len(n) for s, n in squares.items()}
    return [count[v] >= mean[v[0] * edge // column, v[1] * edge // column] for v in voxel]


def slow_window(xyz: NDArray[Any], edge: int) -> list[int]:
    voxel = cells(xyz, edge, edge, edge)
    count = Counter(voxel)
    steps = (-1, 0, 1)
    return [
        sum(count[i + a, j + b, k + c] for a in steps for b in steps for c in steps)
        for i, j, k in voxel
    ]


def slow_multilevel(xyz: NDArray[Any]) -> list[bool]:
    bins = Counter(cells(xyz, 2000, 2000, 2000))
    fullest = {
        (i, j): min((-n, k) for (a, b, k), n in bins.items() if (a, b) == (i, j))[1]
        for i, j, _ in bins
    }
    left = [n for n, (i, j, k) in enumerate(cells(xyz, 2000, 2000, 2000))
            if abs(k - fullest[i, j]) <= 1]  # fmt: skip
    for edge, least in ((900, 8), (400, 4)):
        window = slow_window(xyz[left], edge)
        left = [n for n, count in zip(left, window, strict=True) if count >= least]
    return [n in set(left) for n in range(len(xyz))]


def slow_cylinder(xyz: NDArray[Any], radius: int, height: int, count: int) -> NDArray[np.bool_]:
    d = xyz[:, None].astype(np.int64) - xyz[None]
    near = (d[..., 0] ** 2 + d[..., 1] ** 2 < radius**2) & (2 * abs(d[..., 2]) < height)
    enough: NDArray[np.bool_] = near.sum(axis=1) - 1 >= count
    return enough


def slow_aes(xyz: NDArray[Any], density: NDArray[Any]) -> tuple[list[bool], list[bool]]:
    """Whether each point may stay, and whether it must: they differ on an ellipsoid's border."""
    d2 = ((xyz[:, None].astype(np.int64) - xyz[None]) ** 2).sum(axis=2)
    quotient = ((d2 < 800**2).sum(axis=1) - 1) / density
    square, voxel = cells(xyz[:, :2], 2000, 2000), cells(xyz, 1000, 1000, 1000)
    left = []
    for own in sorted(set(square)):
        rows = [n for n, s in enumerate(square) if s == own]
        inside: dict[tuple[int, ...], list[float]] = {}
        for n in rows:
            inside.setdefault(voxel[n], []).append(density[n])
        total = min(round(sum(np.mean(v) for v in inside.values())), len(rows))
        limit = sorted(quotient[rows])[total - 1] if total else -1.0
        left += [n for n in rows if quotient[n] > limit]
    left = sorted(left)
    low, high, _ = brute_counts(xyz[left], Shape(9, 800.0, 30.0, 2000.0, 2000, 1.0))
    sphere = (d2[np.ix_(left, left)] < 800**2).sum(axis=1) - 1
    may, must = [False] * len(xyz), [False] * len(xyz)
    for n, least, most, around in zip(left, low, high, sphere, strict=True):
        may[n] = bool(around and most >= 0.2 * around)
        must[n] = bool(around and least >= 0.2 * around)
    return may, must


@pytest.mark.parametrize(("step", "shift"), [(1, 0), (250, -7_654_321)])
def test_each_filter_is_its_slow_twin(step: int, shift: int) -> None:
    xyz = mixed_cloud(3, 500, step=step).astype(np.int64) + shift
    cloud = made_cloud(xyz, 0.3)
    voxel = METHODS["voxel"].judge(cloud, SMALL).signal
    np.testing.assert_array_equal(voxel, slow_voxel(xyz, 750, 300, 2000))
    levels = METHODS["multilevel"].judge(cloud, SMALL).signal
    np.testing.assert_array_equal(levels, slow_multilevel(xyz))
    cylinder = METHODS["cylinder"].judge(cloud, SMALL).signal
    np.testing.assert_array_equal(cylinder, slow_cylinder(xyz, 700, 600, 4))
    density = np.random.default_rng(1).choice([0.1, 0.5], len(xyz))
    ellipsoid = METHODS["aes"].judge(made_cloud(xyz, density), SMALL).signal
    may, must = (np.array(x) for x in slow_aes(xyz, density))
    assert (ellipsoid <= may).all()
    assert (ellipsoid >= must).all()
    assert (may == must).mean() > 0.8
    for signal in (voxel, levels, cylinder, ellipsoid):
        assert 0.1 < signal.mean() < 0.9


@pytest.mark.parametrize("method", SOURCES)
def test_tiles_with_halo_give_the_whole(method: str) -> None:
    filtering, step = chosen(method), 200
    parts = [mixed_cloud(s, 900, step=step) + np.int32([8000 * s, 0, 0]) for s in range(3)]
    table = as_table(np.concatenate(parts) - 11_111)
    table = table.take(canonical_order(table))
    # As in a run, the expected noise depends on the place alone.
    density = 0.2 + 0.3 * ((table["x"] // 1000 + table["y"] // 1000) % 2)
    everything = np.ones(len(table), dtype=np.bool_)
    whole = denoise(table, density, everything, filtering)
    assert 0.1 < (whole["noise_class"] == 0).mean() < 0.9
    assert np.isnan(whole["p_value"]).all()
    halo = round(reach_m(filtering) * 1000)
    for low in range(-12_000, 13_000, 3000):
        own = (table["x"] >= low) & (table["x"] < low + 3000)
        read = (table["x"] >= low - halo) & (table["x"] < low + 3000 + halo)
        part = denoise(table.take(read), density[read], own[read], filtering)
        np.testing.assert_array_equal(part["noise_class"], whole["noise_class"][own])


@pytest.mark.parametrize("method", SOURCES)
@pytest.mark.parametrize("n", [0, 1, 40])
def test_odd_clouds(method: str, n: int) -> None:
    """No points, a lone one, and all in one place; and where no noise is expected."""
    for density in (0.0, 0.1):
        signal = (
            METHODS[method].judge(made_cloud(np.zeros((n, 3), np.int64), density), SMALL).signal
        )
        assert signal.shape == (n,)
        if n == 40:
            assert signal.all()
        if n == 1:
            assert signal.tolist() == [method == "voxel"]


def test_shots_are_judged_one_by_one() -> None:
    rng = np.random.default_rng(4)
    sizes = [0, 1, 2, 60, 80, 3]
    time = np.repeat(np.arange(len(sizes), dtype=np.float64), sizes)
    ranges = np.where(
        rng.random(len(time)) < 0.6, 3000 + rng.normal(0, 0.2, len(time)),
        rng.uniform(2850, 3150, len(time)),
    )  # fmt: skip
    known = rng.random(len(time)) < 0.9
    n = len(time)
    beams = BeamTable(np.zeros((n, 3)), np.zeros((n, 3)), ranges, known)
    table = as_table(np.zeros((n, 3), np.int64), gps_time=time)
    noise = shot_noise(table, beams, _dcc(4.0), 300.0, 10)
    assert not noise[~known].any()
    for shot in range(len(sizes)):
        rows = np.flatnonzero(known & (time == shot))
        if len(rows):
            expected = slow_dcc(ranges[rows].tolist(), 300.0, 30.0, 4.0)
            np.testing.assert_array_equal(~noise[rows], expected)
    assert 0.1 < noise.mean() < 0.9


@pytest.mark.parametrize("count", [2, 3, 5])
def test_pixels_are_counted_as_by_hand(count: int) -> None:
    rng = np.random.default_rng(count)
    time = np.repeat(np.arange(4.0), 60)
    n = len(time)
    ranges = np.where(rng.random(n) < 0.5, 3000 + rng.normal(0, 0.3, n), rng.uniform(2980, 3020, n))
    channel = rng.integers(0, 101, n).astype(np.uint8)
    beams = BeamTable(np.zeros((n, 3)), np.zeros((n, 3)), ranges, np.ones(n, np.bool_))
    table = as_table(np.zeros((n, 3), np.int64), gps_time=time, channel=channel)
    chosen = FilterSettings.model_validate({"method": "pixels", "pixels": {"count": count}})
    noise = shot_noise(table, beams, chosen, 300.0, 10)
    channel = channel.astype(int)
    for i in range(n):
        row, column = divmod(channel[i] - 1, 10)
        near = {
            int(c) for c, t, r in zip(channel, time, ranges, strict=True)
            if t == time[i] and abs(r - ranges[i]) <= 1.0 and c > 0
            and abs((c - 1) // 10 - row) <= 1 and abs((c - 1) % 10 - column) <= 1
        }  # fmt: skip
        assert noise[i] == (channel[i] > 0 and len(near) < count)
    assert 0.1 < noise.mean() < 0.99


def _dcc(fine_bin_m: float) -> FilterSettings:
    return FilterSettings.model_validate({"method": "dcc", "dcc": {"fine_bin_m": fine_bin_m}})


def test_what_shots_said_becomes_the_label() -> None:
    flags = np.zeros(6, dtype=np.uint8)
    flags[[1, 3]] = PointFlag.SHOT_NOISE
    flags[3] |= PointFlag.NO_BEAM
    table = as_table(mixed_cloud(1, 6), flags=flags)
    everything = np.ones(6, dtype=np.bool_)
    result = denoise(table, np.full(6, 0.1), everything, FilterSettings(method="dcc"))
    np.testing.assert_array_equal(result["noise_class"], [0, 1, 0, 255, 0, 0])
    assert np.isnan(result["p_value"]).all()
    assert METHODS["dcc"].reach_m(FilterSettings(method="dcc")) == 0.0
    other = denoise(table, np.full(6, 0.1), everything, FilterSettings(method="cylinder"))
    assert (other["noise_class"] == [1, 1, 1, 255, 1, 1]).all()


def test_more_voxels_than_keys_ask_for_larger_ones() -> None:
    far = np.array([0, 2**31 - 1])
    with pytest.raises(ValueError, match="too many"):
        _numbers([far, far, far])
