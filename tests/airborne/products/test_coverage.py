"""Area and density of all pieces of a survey."""

import json
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from tests import surveys

SIDE_M = 120.0
ORIGIN_M = (400_013.3, 3_290_007.7)


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


def test_plots_far_apart_count_and_the_console_says_so(tmp_path: Path) -> None:
    n = 0
    for k, per_m2 in enumerate((8.0, 2.0, 5.0)):
        n += plain(tmp_path / f"lines/{k}.laz", per_m2, 60.0, east_m=k * 15_000.0)
        plain(tmp_path / f"reference/{k}.laz", 0.2, 60.0, east_m=k * 15_000.0)
    report = linear(tmp_path, 1.0, "out", reference={"points": "reference/*.laz"})
    assert report["survey"]["area_km2"] * 1e6 == pytest.approx(3 * 60.0**2, rel=0.02)
    assert report["density"]["mean_per_m2"] == pytest.approx(n / (3 * 60.0**2), rel=0.02)
    compared = report["accuracy"]["dtm"]["all"]["n"]
    assert 0.85 * 3 * 720 < compared <= 3 * 720, "ground of the reference on every piece"
    ended = surveys.command("report", tmp_path / "out")
    assert f"{report['density']['mean_per_m2']:.3g}" in ended.text
