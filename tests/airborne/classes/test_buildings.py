"""Roofs, crowns and conductors; planes against a solver; seams and order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.classes.buildings import (
    FEWEST,
    FLAT_M,
    REACH_M,
    STANDS_M,
    STEEPEST,
    WIDE,
    Floor,
    _planes,
    buildings,
)
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, inside, quanta

EDGE_M = 100
GROUND, ROOF, CROWN, WIRE = range(4)


def terrain(x, y):
    return 0.15 * x - 0.1 * y + 1.5 * np.sin(x / 20)


def found_in(points: PointTable, usable):
    """Which points are of buildings."""
    return buildings(points, usable, Floor(REGION, points, usable))


def scene(seed: int, per_m2: float = 12.0):
    """A gable, a flat roof and crowns, one of which leans over the gable: places [m], kinds."""
    rng = np.random.default_rng(seed)
    n = round(per_m2 * EDGE_M**2)
    x, y = rng.uniform(0, EDGE_M - 0.001, (2, n))
    z, kind = terrain(x, y), np.full(n, GROUND)
    gable = (np.abs(x - 30) < 6) & (np.abs(y - 40) < 9)
    z[gable] = terrain(30, 40) + 8 - 0.7 * np.abs(x[gable] - 30)
    flat = (np.abs(x - 70.3) < 10) & (np.abs(y - 65.2) < 7)
    z[flat] = terrain(70, 65) + 6
    kind[gable | flat] = ROOF
    for at_x, at_y, r in ((60, 20, 5), (15, 75, 6), (50, 88, 4), (38, 48, 4), (85, 30, 3)):
        away = np.hypot(x - at_x, y - at_y) / r
        crown = (away < 1) & (rng.random(n) < 0.7) & (kind == GROUND)
        depth = rng.exponential(1.2, np.count_nonzero(crown))
        top = 4 + 1.5 * r * np.sqrt(1 - away[crown] ** 2)
        z[crown] = terrain(at_x, at_y) + np.maximum(top - depth, 1.0)
        kind[crown] = CROWN
    z += rng.normal(0, 0.05, n)
    return np.column_stack([x, y, z]), kind


def table(xyz, kind) -> PointTable:
    q = np.rint(1000 * xyz).astype(np.int64) + np.array([5_000_000, -3_000_000, 0])
    return PointTable(
        {
            "x": q[:, 0],
            "y": q[:, 1],
            "z": q[:, 2].astype(np.int32),
            "ground": (kind == GROUND).astype(np.uint8),
        }
    )


REGION = Bounds(5_000_000, -3_000_000, 5_100_000, -2_900_000)


@pytest.mark.parametrize(("per_m2", "least"), [(12.0, 0.97), (2.0, 0.93), (0.5, 0.85)])
def test_roofs_are_found_and_crowns_are_not(per_m2: float, least: float) -> None:
    xyz, kind = scene(1, per_m2)
    found = found_in(table(xyz, kind), np.ones(len(kind), np.bool_))
    right = np.count_nonzero(found & (kind == ROOF))
    f1 = 2 * right / (np.count_nonzero(found) + np.count_nonzero(kind == ROOF))
    assert f1 > least
    assert not found[kind == GROUND].any()
    assert found[kind == CROWN].mean() < 0.06


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_neither_order_nor_noise_nor_a_seam_matters(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xyz, kind = scene(seed, 1.0)
    points, usable = table(xyz, kind), rng.random(len(kind)) < 0.9
    whole = found_in(points, usable)
    assert not whole[~usable].any()
    order = rng.permutation(len(kind))
    assert np.array_equal(whole[order], found_in(points.take(order), usable[order]))
    # Ground is known around all of what stands: what is read beyond the reach changes nothing.
    core = Bounds(5_030_000, -2_970_000, 5_060_000, -2_940_000)
    near = core.xmin - quanta(REACH_M), core.ymin - quanta(REACH_M)
    part = Bounds(*near, core.xmax + quanta(REACH_M), core.ymax + quanta(REACH_M))
    held = inside(points["x"], points["y"], part) | (kind == GROUND)
    mine = inside(points["x"], points["y"], core)
    parts = found_in(points.take(held), usable[held])
    assert np.array_equal(whole[mine], parts[mine[held]])


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_planes_are_those_of_a_solver(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, edge = 120, 1000
    xyz = np.column_stack([rng.integers(0, 5 * edge, (n, 2)), rng.integers(0, 40, n)])
    xyz[:, 2] += np.rint(xyz[:, :2] @ rng.normal(0, 1.0, 2)).astype(np.int64)
    number = xyz[:, 1] // edge * 5 + xyz[:, 0] // edge
    planes = _planes(xyz.astype(np.int32), number, (5, 5), edge)
    for row in range(5):
        for column in range(5):
            at = np.abs(xyz[:, :2] // edge - (column, row)).max(axis=1) <= 1
            held = xyz[at].astype(float)
            assert planes.returns[row, column] == len(held)
            if len(held) < FEWEST:
                assert not planes.roof[row, column]
                continue
            design = np.column_stack([held[:, :2], np.ones(len(held))])
            plane, left, *_ = np.linalg.lstsq(design, held[:, 2], rcond=None)
            sigma = np.sqrt(left[0] / (len(held) - 3))
            wide = np.sqrt(np.linalg.eigvalsh(np.cov(held[:, :2].T, bias=True))[0])
            roof = (np.hypot(*plane[:2]) <= STEEPEST) & (sigma <= 1000 * FLAT_M)
            assert planes.roof[row, column] == (roof & (wide >= 3 * WIDE * edge))
            if planes.roof[row, column]:
                assert planes.sigma[row, column] == pytest.approx(sigma, rel=1e-6)
                slopes = planes.east[row, column], planes.north[row, column]
                assert slopes == pytest.approx(plane[:2], abs=1e-6)


def test_conductors_side_by_side_are_no_roof() -> None:
    rng = np.random.default_rng(5)
    n = 12 * EDGE_M**2
    x, y = rng.uniform(0, EDGE_M - 0.001, (2, n))
    along, conductor = rng.uniform(0, EDGE_M - 0.001, 1200), rng.integers(0, 3, 1200)
    wires = np.column_stack([along, 50.0 + conductor, np.full(1200, 9.0)])
    xyz = np.concatenate([np.column_stack([x, y, np.zeros(n)]), wires])
    xyz[:, 2] += rng.normal(0, 0.05, len(xyz))
    kind = np.repeat([GROUND, WIRE], [n, 1200])
    found = found_in(table(xyz, kind), np.ones(len(kind), np.bool_))
    assert found.mean() == 0


def test_what_is_low_and_what_has_no_ground_is_none() -> None:
    xyz, kind = scene(3, 4.0)
    low = kind == ROOF
    xyz[low, 2] = terrain(*xyz[low, :2].T) + STANDS_M - 1.4
    everything = np.ones(len(kind), np.bool_)
    assert not found_in(table(xyz, kind), everything)[low].any()
    alone = np.full(len(kind), ROOF)
    assert not found_in(table(xyz, alone), everything).any()
    nothing = table(xyz[:0], kind[:0])
    assert not len(found_in(nothing, everything[:0]))
