"""Raised land with sloping sides: dams and rocks against houses; a slow twin of the kernel."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.ground.multiscale.sloping_sides import (
    LEAST,
    SLOPE,
    STEP_M,
    _forms,
    with_sloping_sides,
)
from spl_batch.airborne.ground.node_grids import lowest_nodes
from spl_batch.airborne.settings import GroundSettings
from spl_batch.lattice.tables import PointTable

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE_M = 110.0


def scene(
    slope_deg: float, points_per_m2: float, seed: int
) -> tuple[tuple[Float, Float, Float], dict[str, Mask]]:
    """A dam, a rock, and two houses: one with a gabled roof, one amid bushes."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, EDGE_M, (2, int(points_per_m2 * EDGE_M**2)))
    rise = np.tan(np.radians(slope_deg))
    dam = np.clip(8.0 - rise * (np.abs(y - 85 - 0.1 * x) - 2.0), 0.0, 8.0)
    rock = np.clip(7.0 - rise * (np.hypot(x - 30, y - 35) - 5.0), 0.0, 7.0)
    z = 0.03 * x + dam + rock + rng.normal(0, 0.03, len(x))
    gabled = (np.abs(x - 65) < 6) & (np.abs(y - 35) < 8)
    flat = (np.abs(x - 92) < 6) & (np.abs(y - 35) < 8)
    beside = (np.abs(x - 92) < 7) & (np.abs(y - 35) < 9) & ~flat & (rng.random(len(x)) < 0.6)
    z += gabled * (3.0 + 0.7 * (6.0 - np.abs(x - 65))) + flat * 5.0
    z += beside * rng.uniform(0.3, 3.0, len(x))
    return (x, y, z), {"dam": dam > 1.0, "rock": rock > 1.0, "gabled": gabled, "flat": flat}


@pytest.mark.parametrize("points_per_m2", [4.0, 12.0])
def test_dams_and_rocks_that_slope_are_ground_and_houses_are_not(points_per_m2: float) -> None:
    places, parts = scene(60.0, points_per_m2, 1)
    columns = [np.rint(1000 * v).astype(np.int64) for v in places]
    table = PointTable(dict(zip("xyz", columns, strict=True)))
    found = ground_mask(table, np.ones(len(table), dtype=np.bool_), GroundSettings())
    assert found[parts["dam"]].mean() > 0.9
    assert found[parts["rock"]].mean() > 0.85
    assert found[parts["gabled"] | parts["flat"]].mean() < 0.01


@pytest.mark.parametrize(("pitch_deg", "eave_m"), [(25.0, 1.5), (40.0, 1.5), (35.0, 1.25)])
def test_low_hipped_and_conical_roofs_are_no_land(pitch_deg: float, eave_m: float) -> None:
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, EDGE_M, (2, int(8 * EDGE_M**2)))
    hipped = np.minimum(6.0 - np.abs(x - 35), 9.0 - np.abs(y - 35))
    cone = 7.0 - np.hypot(x - 75, y - 70)
    inside = np.maximum(hipped, cone)
    roof = eave_m + np.tan(np.radians(pitch_deg)) * inside
    z = 0.03 * x + np.where(inside > 0, roof, 0.0) + rng.normal(0, 0.03, len(x))
    columns = [np.rint(1000 * v).astype(np.int64) for v in (x, y, z)]
    table = PointTable(dict(zip("xyz", columns, strict=True)))
    found = ground_mask(table, np.ones(len(table), dtype=np.bool_), GroundSettings())
    assert found[inside > 0.5].mean() < 0.01


def nodes(points_per_m2: float = 4.0) -> tuple[Float, Mask, NDArray[np.int64], dict[str, Mask]]:
    """Lowest nodes of the scene, which are ground where it is level, and their grid."""
    places, parts = scene(60.0, points_per_m2, 2)
    xyz = np.column_stack(places)
    grid = lowest_nodes(xyz, np.ones(len(xyz), dtype=np.bool_), 1.0)
    return xyz, xyz[:, 2] - 0.03 * xyz[:, 0] < 0.5, grid, parts


def test_where_many_cells_are_empty_nothing_is_told() -> None:
    xyz, ground, grid, _ = nodes(4.0)
    assert with_sloping_sides(xyz, grid, ground, 1.0).any()
    assert not with_sloping_sides(xyz, grid, np.ones_like(ground), 1.0).any()
    xyz, ground, grid, _ = nodes(0.8)
    assert not with_sloping_sides(xyz, grid, ground, 1.0).any()


def test_what_is_rough_as_crowns_are_is_no_land() -> None:
    xyz, ground, grid, parts = nodes(4.0)
    found = with_sloping_sides(xyz, grid, ground, 1.0)
    assert found[grid[grid >= 0]][parts["dam"][grid[grid >= 0]]].mean() > 0.9
    xyz[~ground, 2] += np.random.default_rng(3).normal(0, 0.6, int((~ground).sum()))
    assert not with_sloping_sides(xyz, grid, ground, 1.0).any()


def test_a_dam_that_ends_at_a_bridge_has_one_height_on_both_sides_of_a_cell() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, [[560], [110]], (2, 4 * 560 * 110))
    rise = np.tan(np.radians(60.0))
    sloping = np.clip(8.0 - rise * (np.abs(y - 55) - 2.0), 0.0, 8.0)
    dam = np.where(x > 330, 8.0 * (np.abs(y - 55) < 4), sloping)
    z = 0.01 * x + dam + rng.normal(0, 0.03, len(x))
    columns = [np.rint(1000 * v).astype(np.int64) for v in (x, y, z)]
    table = PointTable(dict(zip("xyz", columns, strict=True)))
    found = np.zeros((2, len(x)), np.bool_)
    for k, (first, end) in enumerate(((0, 260), (140, 560))):
        near = (x >= first) & (x < end)
        found[k, near] = ground_mask(table.take(near), np.ones(near.sum(), bool), GroundSettings())
    top = dam > 1.0
    assert found[0, top & (x < 200)].mean() > 0.9
    assert found[1, top & (x > 200) & (x < 270)].mean() > 0.9
    assert found[1, top & (x > 400) & (x < 500)].mean() < 0.1
    seam = top & (np.abs(x - 200) < 10)
    assert np.array_equal(found[0, seam], found[1, seam])


def test_forms_are_those_of_a_slow_twin() -> None:
    rng = np.random.default_rng(5)
    rows, columns = 40, 50
    grid = np.where(rng.random((rows, columns)) < 0.9, np.arange(2000).reshape(rows, columns), -1)
    place = np.mgrid[0:rows, 0:columns][::-1].reshape(2, -1).T + rng.uniform(0, 1, (2000, 2))
    xyz = np.column_stack([place, rng.normal(0, 1.2, 2000)])
    ground = rng.random(2000) < 0.15
    form = np.where(grid < 0, -1, np.where(ground[grid], -2, 0))
    facts = np.zeros((rows, columns, 5), np.int16)
    count = _forms(xyz, grid, form, facts)
    expected = _slow_forms(xyz, grid, ground)
    assert count == len(expected) > 0
    for number, (cells, known) in enumerate(expected, start=1):
        assert set(np.flatnonzero(form.ravel() == number)) == cells
        assert facts[form == number].sum(axis=0).tolist() == known


def _slow_forms(
    xyz: Float, grid: NDArray[np.int64], ground: Mask
) -> list[tuple[set[int], list[int]]]:
    """Cells of each form and what is known of it, in the order of their first cells."""
    rows, columns = grid.shape
    pairs: list[tuple[int, int, bool]] = []
    empty = np.zeros(grid.size, np.int64)
    for at in range(grid.size):
        r, c = divmod(at, columns)
        for i, j in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)):
            if not (0 <= r + i < rows and 0 <= c + j < columns):
                continue
            if grid[r + i, c + j] < 0:
                empty[at] += 1
            elif grid[r, c] >= 0:
                apart = xyz[grid[r + i, c + j]] - xyz[grid[r, c]]
                hangs = abs(apart[2]) <= STEP_M + SLOPE * np.hypot(*apart[:2])
                if hangs or apart[2] < 0:
                    pairs.append((at, (r + i) * columns + c + j, bool(hangs)))
    other = (grid >= 0).ravel() & ~ground[grid.ravel()]
    joined = [(a, b) for a, b, hangs in pairs if hangs and other[a] and other[b]]
    one, two = np.array(joined).T
    of = connected_components(
        coo_matrix((np.ones(len(one)), (one, two)), shape=(grid.size, grid.size))
    )[1]
    found = []
    for number in dict.fromkeys(of[other].tolist()):
        cells = set(np.flatnonzero(other & (of == number)).tolist())
        if len(cells) < LEAST:
            continue
        mine = [(b, hangs) for a, b, hangs in pairs if a in cells]
        down = [(a, b) for a, b, hangs in pairs if a in cells and hangs and ground[grid.ravel()[b]]]
        steps = [_slow_step(xyz, grid, ground, a, b) for a, b in down]
        across = [step for step in steps if step is not None]
        rim = [(b, hangs) for b, hangs in mine if not hangs or ground[grid.ravel()[b]]]
        inside = sorted(cells)
        hanging = sum(hangs for _, hangs in rim)
        known = [hanging, len(rim), int(empty[inside].sum()), len(across), sum(across)]
        found.append((cells, known))
    return found


def _slow_step(
    xyz: Float, grid: NDArray[np.int64], ground: Mask, edge: int, beyond: int
) -> int | None:
    """How much farther it falls to the ground than on the other side of a cell [cm]."""
    place = 2 * np.array(np.unravel_index(edge, grid.shape)) - np.unravel_index(beyond, grid.shape)
    if (place < 0).any() or (place >= grid.shape).any():
        return None
    inner = grid[tuple(place)]
    if inner < 0 or ground[inner]:
        return None
    z = [xyz[node, 2] for node in (inner, grid.ravel()[edge], grid.ravel()[beyond])]
    return round(100 * float(np.clip((z[1] - z[2]) - (z[0] - z[1]), -5, 5)))
