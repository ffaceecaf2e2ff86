"""Air that holds noise: found where it is even, and nowhere else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.diagnostics.noise_layers import noise_by_layer
from spl_batch.airborne.noise import haze
from spl_batch.lattice.tiles import quanta

EDGE = quanta(haze.CUBE_M)
CORNER = np.array([272_000, 3_290_000, 40]) * 1000
SIDE_M = 120.0
CORE = (*CORNER[:2], *(CORNER[:2] + quanta(SIDE_M)))


def box(rng, per_m3, low, high, side=SIDE_M):
    """Uniform points in a box as wide as the survey [quanta]."""
    size = np.array([side, side, high - low])
    xyz = rng.random((rng.poisson(per_m3 * size.prod()), 3)) * size + [0, 0, low]
    return np.floor(xyz * 1000).astype(np.int64) + CORNER


def model(noise):
    return lambda at: np.full(len(at[0]), noise)


def counted(xyz):
    """Coordinates of points by axis, and their counts, of all of them."""
    axes = tuple(np.ascontiguousarray(xyz[:, k]) for k in range(3))
    return axes, haze.count_cubes(axes, np.ones(len(xyz), np.bool_))


def found(parts, noise=0.05):
    axes, counts = counted(np.concatenate(parts))
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


def tapering(rng, per_m3=1.0, base=45.0, tilt=0.2, thick=25.0):
    """A tilted layer that is dense in its middle alone."""
    xyz = rng.random((int(per_m3 * SIDE_M**2 * thick), 3)) * [SIDE_M, SIDE_M, thick]
    xyz = xyz[rng.random(len(xyz)) < np.sin(np.pi * xyz[:, 2] / thick) ** 2]
    xyz[:, 2] += base + tilt * xyz[:, 0]
    return np.floor(xyz * 1000).astype(np.int64) + CORNER


def crowns_on_trunks(rng):
    """Crowns that are evenly turbid, their bases 30 m above the ground."""
    n = 900
    middle = rng.random((n, 2)) * SIDE_M
    radius, half = rng.uniform(3, 6, n), rng.uniform(5, 8, n)
    tree = rng.integers(0, n, 260 * n)
    inside = rng.uniform(-1, 1, (len(tree), 3))
    kept = (inside**2).sum(axis=1) < 1
    tree, inside = tree[kept], inside[kept]
    xyz = np.column_stack(
        [
            middle[tree] + radius[tree, np.newaxis] * inside[:, :2],
            30 + half[tree] * (1 + inside[:, 2]),
        ]
    )
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


def test_a_tilted_cloud_with_soft_edges_is_found_where_clear_air_lies_below(monkeypatch):
    rng = np.random.default_rng(3)
    cloud = tapering(rng)
    parts = [cloud, box(rng, 30.0, -0.1, 0.0), box(rng, 0.05, -60, 120)]
    axes, air = found(parts)
    noise = haze.noise_with_air(axes, np.full(len(axes[0]), 0.05), air)
    assert (noise[: len(cloud)] > 0.05).mean() > 0.99
    monkeypatch.setattr(haze, "CLEAR", 100)
    assert found(parts)[1] is None


def test_crowns_high_above_clear_air_are_kept_by_their_tops_and_gaps(monkeypatch):
    rng = np.random.default_rng(0)
    parts = [crowns_on_trunks(rng), box(rng, 30.0, -0.1, 0.0), box(rng, 0.05, -60, 120)]
    assert found(parts)[1] is None
    monkeypatch.setattr(haze, "ALIKE", 100.0)
    assert found(parts)[1] is not None


def some_counts(rng, shape=(9, 8, 24)):
    """Counts of a few layers, some of them missing, and what a model expects there."""
    layer = np.sort(rng.choice(np.arange(-8, 24), shape[2], replace=False)).astype(np.int64)
    held = rng.poisson(rng.choice([0.2, 1.0, 30.0], shape[2], p=[0.7, 0.2, 0.1]), shape)
    held[:, :4] += rng.poisson(6, (shape[0], 4, shape[2])) * (layer > 3)
    columns = rng.poisson(held * (held - 1) / 25.0)
    counts = haze.Counts((-3, 5), layer, held.astype(np.int32), columns, columns)
    return counts, lambda at: np.where(at[2] > -6 * EDGE, 1.0, 0.0) / haze.CUBE_M**3


def squares(counts):
    """Each square that lies inside: its place, and its counts."""
    nx, ny, _ = counts.held.shape
    for i in range(2, nx - 2):
        for j in range(2, ny - 2):
            yield i, j, counts.held[i - 2 : i + 3, j - 2 : j + 3].astype(np.float64)


def test_what_hangs_above_clear_air_is_found_as_by_going_up_each_column():
    counts, expected = some_counts(np.random.default_rng(0))
    asked = np.random.default_rng(0).random(counts.held.shape) < 0.5
    hung, any_hung = haze._hung(counts, asked, expected), 0
    for i, j, held in squares(counts):
        filled = dict(zip(counts.layer.tolist(), held.sum(axis=(0, 1)), strict=True))
        marks = ""
        for layer in range(-8, 24):
            listened = layer * EDGE + EDGE // 2 > -6 * EDGE
            dense = filled.get(layer, 0) > 25 * 2.5
            if layer in filled:
                h = int(np.searchsorted(counts.layer, layer))
                above = "s" in marks and "c" * haze.CLEAR in marks[marks.index("s") :]
                assert hung[i, j, h] == (asked[i, j, h] and above)
                any_hung += above
            marks += "?" if not listened else "s" if dense else "c"
    assert any_hung


def test_what_a_plane_through_the_cubes_tells_agrees_with_least_squares(monkeypatch):
    counts, _ = some_counts(np.random.default_rng(5))
    monkeypatch.setattr(haze, "ALIKE", 1.1)
    alike = haze._alike(counts)
    u, v = np.meshgrid(np.arange(5.0), np.arange(5.0), indexing="ij")
    basis = np.column_stack([np.ones(25), u.ravel(), v.ravel()])
    seen = []
    for i, j, held in squares(counts):
        fit = basis @ np.linalg.lstsq(basis, held.reshape(25, -1), rcond=None)[0]
        # A fit by three numbers holds the chance of three cubes.
        told = (fit**2).sum(axis=0) - 3 * held.mean(axis=(0, 1))
        pairs = 25 * counts.columns[i - 2 : i + 3, j - 2 : j + 3].sum(axis=(0, 1))
        for h in range(1, len(counts.layer) - 1):
            about = slice(h - 1, h + 2)
            assert alike[i, j, h] == (pairs[about].sum() <= 1.1 * told[about].sum())
            seen.append(alike[i, j, h])
    assert 0 < sum(seen) < len(seen)


def test_a_layer_is_found_with_its_height_and_its_density():
    per_m3 = 0.3
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


def test_returns_that_do_not_count_are_not_counted():
    rng = np.random.default_rng(6)
    axes, _ = counted(np.concatenate([box(rng, 0.05, -50, 100), box(rng, 1.0, 50, 80)]))
    assert haze.count_cubes(axes, np.zeros(len(axes[0]), np.bool_)) is None
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
    _, counts = counted(xyz)
    cell, cube = xyz // quanta(haze.CELL_M), xyz // EDGE
    assert counts.held.sum() == len(xyz)
    for place in np.unique(cube, axis=0):
        inside = (cube == place).all(axis=1)
        at = place[0] - counts.corner[0], place[1] - counts.corner[1], counts.layer == place[2]
        assert counts.held[at] == inside.sum()
        assert counts.columns[at] == pairs(cell[inside, :2])
        assert counts.cells[at] == pairs(cell[inside])


@pytest.mark.parametrize("tapers", [False, True])
def test_noise_does_not_depend_on_what_lies_beyond_its_reach(tapers):
    rng = np.random.default_rng(7)
    patch = tapering(rng, 2.0) if tapers else box(rng, 1.2, 50, 75)
    patch = patch[np.hypot(*(patch[:, :2] - CORNER[:2] - 60_000).T) < 45_000]
    deep = np.array([[1_000, 1_000, -400_000]]) + CORNER  # layers of the whole alone
    parts = [box(rng, 0.05, -60, 110), patch, box(rng, 20.0, -0.1, 0.0), deep]
    xyz = np.concatenate(parts if tapers else parts[:2])

    def noise_of(chosen):
        axes, air = found([xyz[chosen]])
        return haze.noise_with_air(axes, np.full(len(axes[0]), 0.05), air)

    whole = noise_of(np.ones(len(xyz), np.bool_))
    for west in (20_000, 41_300, 63_000):
        place = xyz[:, 0] - CORNER[0]
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


def test_haze_at_the_edge_of_a_swath_does_not_depend_on_how_far_other_points_reach():
    rng = np.random.default_rng(9)
    xyz, n = at_a_ragged_edge(rng, 150_000)
    xyz[:, :2] += 2000
    core = (*(CORNER[:2] - 20_000), *(CORNER[:2] + 140_000))
    noises, layers = [], []
    for chosen in (xyz, xyz[:n]):
        axes, counts = counted(chosen)
        air = haze.find_air(counts, model(0.05))
        noises.append(haze.noise_with_air(axes, np.full(len(chosen), 0.05), air)[:n])
        seen = noise_by_layer(counts, air, model(0.05), core)
        layers.append((seen.layer.tolist(), seen.returns.tolist(), seen.expected.tolist()))
    np.testing.assert_array_equal(noises[0], noises[1])
    assert layers[0] == layers[1]
    assert (noises[0] > 1.0).sum() > 10_000


def test_layers_that_hold_noise_alone_tell_how_far_the_model_is_off():
    rng = np.random.default_rng(8)
    parts = [box(rng, 0.05, -100, -5), box(rng, 0.09, 30, 120), canopy(rng)]
    parts.append(box(rng, 1.0, 60, 80))
    _, counts = counted(np.concatenate(parts))
    air = haze.find_air(counts, model(0.05))
    seen = noise_by_layer(counts, air, model(0.05), CORE)
    height = seen.layer * haze.CUBE_M - 40
    for low, high, times in ((-95, -10, 1.0), (85, 120, 1.8)):
        band = (height >= low) & (height < high)
        ratio = seen.returns[band].sum() / seen.expected[band].sum()
        assert ratio == pytest.approx(times, rel=0.1)
    assert seen.expected[(height >= 60) & (height < 80)].sum() == 0.0
    ground = (height >= 0) & (height < 5)
    assert seen.returns[ground].sum() == 0, "what holds a surface is not looked at"


def test_layers_that_the_end_of_a_gate_cuts_are_not_counted():
    """Beyond 92 m nothing listens, though the model of points goes on; one of two ends at 42 m."""
    rng = np.random.default_rng(4)
    parts = [box(rng, 0.05, -100, 42), box(rng, 0.03, 42, 92), box(rng, 2e-4, 92, 130)]
    _, counts = counted(np.concatenate(parts))

    def heard(at):
        height = at[2] * 1e-3 - CORNER[2] * 1e-3
        return np.select([height < -98, height < 42, height < 92], [0.0, 0.05, 0.03], 0.0)

    def believed(at):
        return np.where(at[2] * 1e-3 - CORNER[2] * 1e-3 < 42, 0.05, 0.03)

    whole = noise_by_layer(counts, None, believed, CORE)
    seen = noise_by_layer(counts, None, believed, CORE, heard)
    height = seen.layer * haze.CUBE_M - CORNER[2] * 1e-3
    assert whole.expected[height >= 95].sum() > 0.0
    for low, high in ((-105, -95), (35, 45), (85, 140)):
        band = (height >= low) & (height < high)
        assert seen.expected[band].sum() == seen.returns[band].sum() == 0.0, low
    for low, high in ((-95, 35), (50, 85)):
        band = (height >= low) & (height < high)
        assert seen.expected[band].tolist() == whole.expected[band].tolist()
        assert seen.returns[band].sum() == pytest.approx(seen.expected[band].sum(), rel=0.1)
