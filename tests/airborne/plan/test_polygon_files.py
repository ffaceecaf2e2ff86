"""A plan reads polygons: those that do not meet the survey are reported before any work."""

from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely

from tests import surveys


@pytest.mark.parametrize(("key", "status"), [("aoi", 2), ("water", 0)])
@pytest.mark.parametrize("away_m", [0.0, 5000.0])
def test_polygons_beyond_the_survey(tmp_path: Path, key: str, status: int, away_m: float) -> None:
    east, north = surveys.ORIGIN_M
    shapes = np.array([shapely.box(east + away_m, north, east + away_m + 9, north + 9)], object)
    pyogrio.raw.write(
        tmp_path / "p.gpkg", shapely.to_wkb(shapes), [], [],
        geometry_type="Polygon", crs="EPSG:32615",
    )  # fmt: skip
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.flightline(shots=20))
    ended = surveys.command("plan", surveys.write_workflow(tmp_path, **{key: "p.gpkg"}))
    assert ended.status == (status if away_m else 0), ended.text
    assert ("meets the survey" in " ".join(ended.text.split())) == bool(away_m)
