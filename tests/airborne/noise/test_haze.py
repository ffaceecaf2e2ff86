"""Air that holds noise: found where it is even, and nowhere else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.noise import haze
from spl_batch.lattice.tiles import quanta

EDGE = quanta(haze.CUBE_M)
CORNER = np.array([272_000, 3_290_000, 40]) * 1000
SIDE_M = 120.0


def box(rng, per_m3, low, high, side=SIDE_M):
    """Uniform points in a box as wide as the survey [quanta]."""
    size = np.array([side, side, high - low])
    xyz = rng.random((rng.poisson(per_m3 * size.prod()), 3)) * size + [0, 0, low]
    return np.floor(xyz * 1000).astype(np.int64) + CORNER


def model(noise):
    return lambda at: np.full(len(at[0]), noise)


def found(parts, noise=0.05):
    xyz = np.concatenate(parts)
    axes = tuple(np.ascontiguousarray(xyz[:, k]) for k in range(3))
    counted = np.ones(len(xyz), np.bool_)
    counts = haze.count_cubes(axes, counted)
    return axes, haze.find_air(counts, model(noise))


def heights(air):
    return air.cube[air.held, 2] * haze.CUBE_M - 40


def canopy(rng, per_m2=20.0):
    """Crowns of leaves in clumps over the whole place, and the ground below."""
    n = int(per_m2 * SIDE_M**2)
    clump = rng.random((n // 12, 3)) * [SIDE_M, SIDE_M, 12] + [0, 0, 8]
    leaves = clump[rng.integers(0, len(clump), n)] + rng.normal(0, 0.3, (n, 3))
    ground = np.column_stack([rng.random((n // 3, 2)) * SIDE_M, rng.normal(0.5, 0.05, n // 3)])
    return np.floor(np.concatenate([leaves, ground]) * 1000).astype(np.int64) + CORNER


def turbid(rng, per_m3=1.0, extinction=0.15):
    """A closed canopy, evenly turbid: what it returns falls off with the depth, 20 m of it."""
    depth = rng.exponential(1 / extinction, int(per_m3 * SIDE_M**2 / extinction))
    depth = depth[depth < 20]
    xyz = np.column_stack([rng.random((len(depth), 2)) * SIDE_M, 30.0 - depth])
    return np.floor(xyz * 1000).astype(np.int64) + CORNER


def thin(rng, per_m3=0.05):
    """Bare branches, seen so seldom that returns in pairs are all that tells them."""
    middle = rng.random((int(per_m3 * SIDE_M**2 * 10), 3)) * [SIDE_M, SIDE_M, 20] + [0, 0, 8]
    xyz = np.repeat(middle, 2, axis=0) + rng.normal(0, 0.5, (2 * len(middle), 3))
    return np.floor(xyz * 1000).astype(np.int64) + CORNER


@pytest.mark.parametrize(
    ("leaves", "constant", "without"), [(turbid, "STEADY", 100.0), (thin, "PAIRS_LEAST", 40)]
)
def test_canopies_that_one_rule_alone_keeps_out(monkeypatch, leaves, constant, without):
    rng = np.random.default_rng(3)
    parts = [box(rng, 0.004, -60, 80), leaves(rng)]
    assert found(parts, 0.004)[1] is None
    monkeypatch.setattr(haze, constant, without)
    assert found(parts, 0.004)[1] is not None


@pytest.mark.parametrize("per_m3", [0.3, 1.5])
def test_a_layer_is_found_with_its_height_and_its_density(per_m3):
    rng = np.random.default_rng(1)
    axes, air = found([box(rng, 0.05, -100, 120), box(rng, per_m3, 60, 90)])
    assert set(np.unique(heights(air))) == set(range(60, 90, 5))
    z = axes[2] / 1000 - 40
    noise = haze.noise_with_air(axes, np.full(len(z), 0.05), air)
    middle = (z > 66) & (z < 84)
    assert np.median(noise[middle]) == pytest.approx(per_m3 + 0.05, rel=0.25)
    assert noise[middle].min() > per_m3
    assert (noise[(z < 54) | (z > 96)] == 0.05).all()


def test_clear_air_holds_none():
    rng = np.random.default_rng(2)
    for per_m3 in (0.02, 0.05, 0.4):
        assert found([box(rng, per_m3, -100, 120)], per_m3)[1] is None


def test_ground_roofs_wires_and_canopies_are_no_air():
    rng = np.random.default_rng(3)
    flat = box(rng, 40.0, 20.0, 20.1)
    slope = box(rng, 20.0, 0.0, 1.0)
    slope[:, 2] += (slope[:, 0] - CORNER[0]) // 2
    wire = box(rng, 0.5, 40.0, 40.05)
    wire = wire[abs(wire[:, 1] - CORNER[1] - 60_000) < 200]
    assert found([box(rng, 0.05, -100, 120), flat, slope, wire, canopy(rng)])[1] is None


def test_a_canopy_below_a_layer_keeps_its_noise_as_it_was():
    rng = np.random.default_rng(4)
    leaves = canopy(rng)
    axes, air = found([leaves, box(rng, 0.05, -100, 120), box(rng, 1.0, 40, 70)])
    assert heights(air).min() == 40
    noise = haze.noise_with_air(axes, np.full(len(axes[2]), 0.05), air)
    assert (noise[: len(leaves)] == 0.05).all()


def test_a_wire_in_a_cloud_does_not_raise_its_own_noise():
    rng = np.random.default_rng(5)
    cloud = box(rng, 0.6, 40, 80)
    wire = box(rng, 60.0, 60.0, 60.05)
    wire = wire[abs(wire[:, 1] - CORNER[1] - 61_000) < 200]
    clear, with_wire = (found(parts)[1] for parts in ([cloud], [cloud, wire]))
    at = heights(clear) == 60
    assert clear.density[clear.held][at].max() * 1.1 > with_wire.density.max()


def test_returns_that_do_not_count_are_not_counted():
    rng = np.random.default_rng(6)
    xyz = np.concatenate([box(rng, 0.05, -50, 100), box(rng, 1.0, 50, 80)])
    axes = tuple(np.ascontiguousarray(xyz[:, k]) for k in range(3))
    nothing = np.zeros(len(xyz), np.bool_)
    assert haze.count_cubes(axes, nothing) is None
    deep = axes[2] < CORNER[2] + 40_000
    assert haze.find_air(haze.count_cubes(axes, deep), model(0.05)) is None


def pairs(values):
    _, count = np.unique(values, axis=0, return_counts=True)
    return int((count * (count - 1)).sum())


@given(
    st.lists(st.tuples(*[st.integers(-9000, 9000)] * 3), min_size=1, max_size=60),
    st.integers(1, 900),
)
@settings(max_examples=60, deadline=None)
def test_counts_and_pairs_agree_with_counting_them_one_by_one(points, scale):
    xyz = np.array(points, dtype=np.int64) * scale // 900
    counts = haze._count(tuple(np.ascontiguousarray(xyz[:, k]) for k in range(3)))
    cell, cube = xyz // quanta(haze.CELL_M), xyz // EDGE
    assert counts.held.sum() == len(xyz)
    for place in np.unique(cube, axis=0):
        inside = (cube == place).all(axis=1)
        at = place[0] - counts.corner[0], place[1] - counts.corner[1], counts.layer == place[2]
        assert counts.held[at] == inside.sum()
        assert counts.columns[at] == pairs(cell[inside, :2])
        assert counts.cells[at] == pairs(cell[inside])


def test_noise_does_not_depend_on_what_lies_beyond_its_reach():
    rng = np.random.default_rng(7)
    patch = box(rng, 1.2, 50, 75)
    patch = patch[np.hypot(*(patch[:, :2] - CORNER[:2] - 60_000).T) < 45_000]
    xyz = np.concatenate([box(rng, 0.05, -60, 110), patch])
    axes = tuple(np.ascontiguousarray(xyz[:, k]) for k in range(3))
    noise = np.full(len(xyz), 0.05)

    def noise_of(chosen):
        some = tuple(axis[chosen] for axis in axes)
        counts = haze.count_cubes(some, np.ones(len(some[0]), np.bool_))
        return haze.noise_with_air(some, noise[chosen], haze.find_air(counts, model(0.05)))

    whole = noise_of(np.ones(len(xyz), np.bool_))
    for west in (20_000, 41_300, 63_000):
        place = axes[0] - CORNER[0]
        owned = (place >= west) & (place < west + 20_000)
        margin = quanta(haze.REACH_M)
        near = (place >= west - margin) & (place < west + 20_000 + margin)
        np.testing.assert_array_equal(noise_of(near)[owned[near]], whole[owned])
    assert (whole > 1.0).sum() > 10_000


def at_a_ragged_edge(rng, reach):
    """Haze between a hillside and the edge of a swath, and a few points that lie beyond it."""
    haze_at_edge = box(rng, 1.2, 50, 75)
    haze_at_edge = haze_at_edge[haze_at_edge[:, 0] - CORNER[0] < 20_000]
    hill = box(rng, 5.0, 0.0, 8.0)
    east = hill[:, 0] - CORNER[0]
    hill = hill[(east >= 20_000) & (east < 35_000)]
    hill[:, 2] = CORNER[2] + 45_000 + 3 * (hill[:, 0] - CORNER[0] - 20_000)
    xyz = np.concatenate([box(rng, 0.05, -60, 110), haze_at_edge, hill])
    far = np.array([[-reach, 60_000, 0], [60_000, -reach, 0]]) + CORNER
    return np.concatenate([xyz, far]), len(xyz)


@pytest.mark.parametrize("shift", [0, 2, 3])
def test_haze_at_the_edge_of_a_swath_does_not_depend_on_how_far_other_points_reach(shift):
    rng = np.random.default_rng(9)
    xyz, n = at_a_ragged_edge(rng, 150_000)
    xyz[:, :2] += shift * 1000
    core = (*(CORNER[:2] - 20_000), *(CORNER[:2] + 140_000))
    noises, layers = [], []
    for chosen in (xyz, xyz[:n]):
        axes = tuple(np.ascontiguousarray(chosen[:, k]) for k in range(3))
        counts = haze.count_cubes(axes, np.ones(len(chosen), np.bool_))
        air = haze.find_air(counts, model(0.05))
        noises.append(haze.noise_with_air(axes, np.full(len(chosen), 0.05), air)[:n])
        seen = haze.noise_by_layer(counts, air, model(0.05), core)
        layers.append((seen.layer.tolist(), seen.returns.tolist(), seen.expected.tolist()))
    np.testing.assert_array_equal(noises[0], noises[1])
    assert layers[0] == layers[1]
    assert (noises[0] > 1.0).sum() > 10_000


def test_layers_that_hold_noise_alone_tell_how_far_the_model_is_off():
    rng = np.random.default_rng(8)
    parts = [box(rng, 0.05, -100, -5), box(rng, 0.09, 30, 120), canopy(rng)]
    parts.append(box(rng, 1.0, 60, 80))
    xyz = np.concatenate(parts)
    axes = tuple(np.ascontiguousarray(xyz[:, k]) for k in range(3))
    counts = haze.count_cubes(axes, np.ones(len(xyz), np.bool_))
    core = (CORNER[0], CORNER[1], CORNER[0] + 120_000, CORNER[1] + 120_000)
    air = haze.find_air(counts, model(0.05))
    seen = haze.noise_by_layer(counts, air, model(0.05), core)
    height = seen.layer * haze.CUBE_M - 40
    for low, high, times in ((-95, -10, 1.0), (85, 120, 1.8)):
        band = (height >= low) & (height < high)
        ratio = seen.returns[band].sum() / seen.expected[band].sum()
        assert ratio == pytest.approx(times, rel=0.1)
    assert seen.expected[(height >= 60) & (height < 80)].sum() == 0.0
    ground = (height >= 0) & (height < 5)
    assert seen.returns[ground].sum() == 0, "what holds a surface is not looked at"
