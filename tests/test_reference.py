"""Reference points in parts: what is said of a point does not depend on the cutting."""

from pathlib import Path

import numpy as np
import pytest

from spl_batch.accuracy import Raster, merge, surface_differences, terrain_differences
from spl_batch.constants import NODATA
from spl_batch.runner import reference
from spl_batch.runner.reference import read_reference
from tests import surveys

SIDE_M = 120


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ground with plants and roofs on it, in no order: 4 000 points on 120 m."""
    rng = np.random.default_rng(5)
    n = 4000
    kind = rng.choice([2, 5, 6, 9, 7], n, p=[0.6, 0.2, 0.12, 0.06, 0.02])
    columns = {
        "x": np.round(1000.0 + rng.uniform(0, SIDE_M, n), 3),
        "y": np.round(2000.0 + rng.uniform(0, SIDE_M, n), 3),
        "z": np.round(10 + rng.normal(0, 0.2, n) + np.where(kind == 2, 0, 4), 3),
        "classification": kind.astype(np.uint8),
    }
    return surveys.write_cloud(tmp_path_factory.mktemp("ref") / "r.laz", columns, channel=False)


def test_parts_say_what_the_whole_file_says(
    cloud: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(6)
    values = rng.normal(10, 1, (140, 140)).astype(np.float32)
    values[rng.random(values.shape) < 0.05] = NODATA
    raster = Raster(values, 990.0, 2130.0, 1.0)
    (whole,) = read_reference(cloud, tmp_path, 1.0)
    monkeypatch.setattr(reference, "SQUARE_POINTS", 300)
    parts = list(read_reference(cloud, tmp_path, 1.0))
    assert len(parts) > 9
    assert sum(np.count_nonzero(p.counts) for p in parts) == len(whole.xyz_m)
    assert max(len(p.xyz_m) for p in parts) < 1500, "parts are small"
    assert not list(tmp_path.iterdir()), "nothing is left behind"
    for compare in (terrain_differences, surface_differences):
        expected = compare(raster, whole)
        found = merge(compare(raster, part) for part in parts)
        assert found.keys() == expected.keys()
        assert len(expected["all"]) > 100
        for name, values_m in expected.items():
            np.testing.assert_array_equal(np.sort(found[name]), np.sort(values_m), err_msg=name)


def test_an_empty_reference_is_one_empty_part(tmp_path: Path) -> None:
    none = {k: np.empty(0) for k in ("x", "y", "z")}
    path = surveys.write_cloud(tmp_path / "e.laz", none, channel=False)
    (part,) = read_reference(path, tmp_path, 1.0)
    assert part.xyz_m.shape == (0, 3)
