"""Area and density of all pieces of a survey."""

from pathlib import Path

import numpy as np
import pytest

from tests import surveys
from tests.airborne.lines.test_strip_run import LINEAR

SIDE_M = 60.0
ORIGIN_M = (400_013.3, 3_290_007.7)


def plain(path: Path, per_m2: float, east_m: float) -> int:
    """Write a square of even ground without gps_time; how many points."""
    rng = np.random.default_rng(7)
    n = round(per_m2 * SIDE_M**2)
    x, y = rng.uniform(0, SIDE_M, (2, n))
    columns = {
        "x": ORIGIN_M[0] + east_m + x,
        "y": ORIGIN_M[1] + y,
        "z": 50.0 + 0.01 * x + rng.normal(0, 0.02, n),
        "return_number": np.ones(n, np.uint8),
        "number_of_returns": np.ones(n, np.uint8),
        "intensity": np.full(n, 9, np.uint16),
        "classification": np.full(n, 2, np.uint8),
    }
    surveys.write_cloud(path, columns, channel=False)
    return n


def test_plots_far_apart_count_and_the_console_says_so(tmp_path: Path) -> None:
    n = 0
    for k, per_m2 in enumerate((8.0, 2.0, 5.0)):
        n += plain(tmp_path / f"lines/{k}.laz", per_m2, k * 3000.0)
        plain(tmp_path / f"reference/{k}.laz", 0.2, k * 3000.0)
    workflow = surveys.write_workflow(
        tmp_path,
        **LINEAR,
        survey={"channel_dimension": None},
        ground={"cell_m": 100, "buffer_m": 20},  # a square lies on four of them
        reference={"points": "reference/*.laz"},
    )
    report = surveys.run(workflow).report
    assert report.survey.area_km2 * 1e6 == pytest.approx(3 * SIDE_M**2, rel=0.02)
    assert report.density.mean_per_m2 == pytest.approx(n / (3 * SIDE_M**2), rel=0.02)
    compared = report.accuracy.dtm["all"].n
    assert 0.85 * 3 * 720 < compared <= 3 * 720, "ground of the reference on every piece"
    ended = surveys.command("report", tmp_path / "out")
    assert f"{report.density.mean_per_m2:.3g}" in ended.text
