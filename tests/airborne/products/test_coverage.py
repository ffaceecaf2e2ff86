"""Area and density: of all pieces of a survey, whatever the raster cells are."""

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from spl_batch.airborne.products.footprint import SQUARE_M2, Covered, Within, footprint
from spl_batch.airborne.settings import ProductSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests import surveys

SIDE_M = 120.0
ORIGIN_M = (400_013.3, 3_290_007.7)
SETTINGS = ProductSettings()


def plain(path: Path, per_m2: float, side_m: float = SIDE_M, east_m: float = 0.0) -> int:
    """Write a square of even ground without gps_time; how many points."""
    rng = np.random.default_rng(7)
    n = round(per_m2 * side_m**2)
    x, y = rng.uniform(0, side_m, (2, n))
    columns = {
        "x": ORIGIN_M[0] + east_m + x,
        "y": ORIGIN_M[1] + y,
        "z": 50.0 + 0.01 * x + rng.normal(0, 0.02, n),
        "return_number": np.ones(n, np.uint8),
        "number_of_returns": np.ones(n, np.uint8),
        "intensity": np.full(n, 9, np.uint16),
        "classification": np.full(n, 2, np.uint8),
    }
    surveys.write_cloud(path, columns, point_format=6, channel=False)
    assert laspy.read(path).header.point_count == n
    return n


def linear(folder: Path, cell_m: float, output: str, **sections: Any) -> dict[str, Any]:
    """Report of a run that filters nothing."""
    surveys.write_workflow(
        folder,
        survey={"channel_dimension": None},
        output=output,
        acquisition=None,
        filter={"method": "none"},
        afterpulse={"enabled": False},
        products={"cell_m": cell_m},
        ground={"cell_m": 100, "buffer_m": 20},  # a square lies on four of them
        **sections,
    )
    surveys.run(folder / "workflow.yaml")
    report: dict[str, Any] = json.loads((folder / output / "report.json").read_text())
    return report


def raster(path: Path) -> NDArray[np.float64]:
    with rasterio.open(path) as source:
        values: NDArray[np.float64] = source.read(1).astype(np.float64)
    return values


def test_plots_far_apart_count_and_the_console_says_so(tmp_path: Path) -> None:
    n = 0
    for k, per_m2 in enumerate((8.0, 2.0, 5.0)):
        n += plain(tmp_path / f"lines/{k}.laz", per_m2, 60.0, east_m=k * 60_000.0)
        plain(tmp_path / f"reference/{k}.laz", 0.2, 60.0, east_m=k * 60_000.0)
    report = linear(tmp_path, 1.0, "out", reference={"points": "reference/*.laz"})
    assert report["survey"]["area_km2"] * 1e6 == pytest.approx(3 * 60.0**2, rel=0.02)
    assert report["density"]["mean_per_m2"] == pytest.approx(n / (3 * 60.0**2), rel=0.02)
    compared = report["accuracy"]["dtm"]["all"]["n"]
    assert 0.85 * 3 * 720 < compared <= 3 * 720, "ground of the reference on every piece"
    ended = surveys.command("report", tmp_path / "out")
    assert f"{report['density']['mean_per_m2']:.3g}" in ended.text


def table(x: NDArray[np.int64], y: NDArray[np.int64]) -> PointTable:
    n = len(x)
    return PointTable({"x": x, "y": y, "z": np.zeros(n, np.int32), "ground": np.ones(n, np.uint8)})


def squares(
    points: PointTable, cell: Bounds, settings: ProductSettings, within: Within | None = None
) -> int:
    """Squares that returns cover [count]."""
    return int(np.count_nonzero(footprint(points, cell, settings, within)))


def test_ground_cells_share_the_area_among_them() -> None:
    rng = np.random.default_rng(3)
    points = rng.integers(0, 90_000, (2, 30_000))
    points = points[:, np.hypot(*(points - 45_000)) < 44_000]
    sparse = points[:, :300]
    for x, y in (points, sparse):
        found = table(x, y)
        whole = squares(found, Bounds(-100_000, -100_000, 300_000, 300_000), SETTINGS)
        cells = [Bounds(i, j, i + 37_100, j + 37_100) for i in range(-111_300, 200_000, 37_100)
                 for j in range(-111_300, 200_000, 37_100)]  # fmt: skip
        # the mean spacing of sparse ones is that around each cell
        shared = sum(squares(found, cell, SETTINGS) for cell in cells)
        assert shared == pytest.approx(whole, rel=0 if len(x) > 1000 else 0.02)
    assert squares(table(*points), cells[0], SETTINGS) == 0
    whole = squares(table(*points), Bounds(0, 0, 90_000, 90_000), SETTINGS)
    assert whole * SQUARE_M2 == pytest.approx(np.pi * 44.0**2, rel=0.02)


def test_what_coarse_squares_tell_is_what_all_squares_tell(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(4)
    found = table(*rng.integers(-80_000, 180_000, (2, 40_000)))
    cell = Bounds(0, 0, 100_000, 100_000)
    soon = squares(found, cell, SETTINGS)
    monkeypatch.setattr(Covered, "_all_is_near", lambda _: False)
    assert squares(found, cell, SETTINGS) == soon == 100_000**2 // 250**2


def test_a_wide_gap_is_not_covered_and_a_refused_square_not_counted() -> None:
    x, y = np.meshgrid(np.arange(0, 100_000, 250), np.arange(0, 50_000, 250))
    x, y = x.ravel(), y.ravel()
    beside = (x < 20_000) | (x >= 70_000)
    found = table(x[beside], y[beside])
    cell = Bounds(0, 0, 100_000, 50_000)
    assert squares(found, cell, SETTINGS) * SQUARE_M2 == pytest.approx(50 * 50, rel=0.01)
    west = squares(found, cell, SETTINGS, lambda east, north: (east < 20_000) & (north > 25_000))
    assert west * SQUARE_M2 == pytest.approx(20 * 25, rel=0.02)
    assert squares(table(x[:0], y[:0]), cell, SETTINGS) == 0
