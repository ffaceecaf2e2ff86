"""Maps of pulses and relief against loops, analytic slopes, and another tiling of one survey."""

from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS

from spl_batch.airborne.products import hillshade
from spl_batch.airborne.pulses.pulse_coverage import SPACINGS, Coverage
from spl_batch.airborne.pulses.pulse_maps import NAMES, PulseMaps
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings import ProductSettings
from spl_batch.airborne.tasks.cells import pulses
from spl_batch.constants import NODATA
from spl_batch.lattice.tiles import Bounds
from tests import surveys

if TYPE_CHECKING:
    from spl_batch.airborne.context import Context


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(0, 200))
def test_each_cell_counts_its_own(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    core = Bounds(-4_000, 6_000, 4_000, 12_000)
    first, last = rng.integers(-6_000, 14_000, (2, n, 2))
    line = rng.integers(-1, 4, n)
    flown = rng.random((3, 4)) < 0.8
    made = PulseMaps(core, 2000)
    for south in (first[:, 1] < 8000, first[:, 1] >= 8000):
        made.add(first[south], last[south], line[south])
    judged = flown & (rng.random((3, 4)) < 0.8)
    maps = made.rasters(flown, judged)
    for row in range(3):
        for col in range(4):
            west, south = core.xmin + 2000 * col, core.ymin + 2000 * row
            held = [
                [(west <= x < west + 2000) and (south <= y < south + 2000) for x, y in places]
                for places in (first, last)
            ]
            found = {name: maps[name][2 - row, col] for name in NAMES}
            if not flown[row, col]:
                assert set(found.values()) == {np.float32(NODATA)}
                continue
            assert found["first_returns"] == sum(held[0]) / 4
            assert found["last_returns"] == sum(held[1]) / 4
            lines = {int(k) for k, there in zip(line, held[0], strict=True) if there}
            assert found["swaths"] == len(lines)
            looked = np.array([0, 1.4, 2.84, 5.64], np.float32)
            assert found["voids"] in (looked if judged[row, col] else [np.float32(NODATA)])


def test_the_map_of_voids_is_what_the_table_of_requirements_counts(tmp_path: Path) -> None:
    # Returns each 0.25 m, but in a square of 12 m, half of which is water, and beyond an edge.
    side = np.arange(125, 60_000, 250)
    x, y = (grid.ravel() for grid in np.meshgrid(side, side))
    kept = ~((abs(x - 30_000) < 6_000) & (abs(y - 30_000) < 6_000)) & (x < 50_000)
    water = shapely.to_wkb(np.array([shapely.box(30, 10, 55, 50)], object))
    pyogrio.raw.write(tmp_path / "w.gpkg", water, [], [], geometry_type="Polygon", crs="EPSG:32615")
    products = ProductSettings(maps=True)
    workflow = SimpleNamespace(
        products=products, classes=SimpleNamespace(overlap=False), water="w.gpkg", sensor=Sensor()
    )
    context = SimpleNamespace(
        workflow=workflow, crs=CRS.from_epsg(32615), resolve=lambda name: tmp_path / name
    )
    core = Bounds(0, 0, 60_000, 60_000)
    xyz = np.column_stack([x, y, np.zeros(len(x), np.int64)])[kept]
    returns = pulses.PulseReturns(xyz, xyz[:, :2], np.ones(len(xyz), np.int64))
    made = pulses.Pulses(returns, core, cast("Context", context))
    judged = made.judged(np.ones((240, 240), np.bool_))
    voids = made.rasters(np.zeros((60, 60), np.float32), judged)["voids"][::-1]
    for level, edge_m in (("QL1", 1.4), ("QL2", 2.84)):
        counted = Coverage(*made.facts(judged)[pulses.LEVELS][level])
        table_m2 = counted.void * (SPACINGS[level] / 1000) ** 2
        assert table_m2 == pytest.approx(12 * 6, rel=0.12)
        assert np.count_nonzero(voids >= np.float32(edge_m)) == pytest.approx(table_m2, rel=0.1)
    assert (voids[12:48, 31:50] == np.float32(NODATA)).all(), "water is not judged"
    assert (voids[:, 51:] == np.float32(NODATA)).all(), "nor what lies beyond all signal"
    assert (voids[:, :20] == 0).all()


def test_flightlines_at_the_same_time_count_each(tmp_path: Path) -> None:
    # Two instruments over the same ground: one starts a little later and ends a little earlier.
    for k, late_s in ((1, 0.0), (2, 0.02005)):
        start_s = surveys.START_S + late_s
        line = surveys.flightline(shots=120 - 40 * (k - 1), psid=k, start_s=start_s, seed=k)
        surveys.write_cloud(tmp_path / f"lines/line_{k}.laz", line)
    result = surveys.run(surveys.write_workflow(tmp_path, products={"maps": True}))
    assert result.exit_status == 0, result.report.failures
    with rasterio.open(result.output / "swaths.tif") as source:
        swaths = source.read(1, masked=True).filled(0)
    assert np.count_nonzero(swaths == 2) > 0.3 * np.count_nonzero(swaths >= 1)


@pytest.mark.parametrize("towards_deg", [0, 45, 135, 225, 315])
def test_a_plane_is_as_bright_as_lambert_says(towards_deg: float) -> None:
    # It falls by 1 in 2 towards a direction, clockwise from north.
    slope, cell_m = 0.5, 2.0
    y, x = np.mgrid[0:12, 0:15] * cell_m
    angle = np.radians(towards_deg)
    z = 100 - slope * (x * np.sin(angle) + (-y) * np.cos(angle))
    found = hillshade.shade(z.astype(np.float32), cell_m)
    normal = np.array([slope * np.sin(angle), slope * np.cos(angle), 1.0])
    light = np.array([-0.5, 0.5, np.sqrt(0.5)])  # north-west, 45 degrees high
    wanted = 1 + 254 * max(float(normal @ light) / float(np.linalg.norm(normal)), 0.0)
    assert found.shape == (10, 13)
    np.testing.assert_allclose(found, wanted, rtol=1e-5)


def test_relief_has_no_value_beside_a_void_and_no_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    z = rng.normal(50, 1, (23, 31)).astype(np.float32)
    z[9, 12] = NODATA
    padded = np.pad(z, 1, constant_values=NODATA)
    whole = hillshade.shade(padded, 1.0)
    assert (whole[8:11, 11:14] == NODATA).all()
    assert (whole[1:-1, 1:-1] == NODATA).sum() == 9
    monkeypatch.setattr(hillshade, "BLOCK", 7)
    again = np.empty_like(whole)
    for row, col, block in hillshade.blocks(
        lambda a, b, c, d: padded[a + 1 : b + 1, c + 1 : d + 1], z.shape, 1.0
    ):
        again[row : row + block.shape[0], col : col + block.shape[1]] = block
    np.testing.assert_array_equal(again, whole)
