"""A plan reads polygons: those that do not meet the survey are reported before any work."""

from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import Transformer

from tests import surveys


@pytest.mark.parametrize(("key", "status"), [("aoi", 2), ("breaklines", 0)])
@pytest.mark.parametrize("away_m", [0.0, 5000.0])
def test_polygons_beyond_the_survey(tmp_path: Path, key: str, status: int, away_m: float) -> None:
    east, north = surveys.ORIGIN_M
    box = shapely.box(east + away_m, north, east + away_m + 9, north + 9)
    shapes = np.array([shapely.force_3d(box, 20.0)], object)
    pyogrio.raw.write(
        tmp_path / "p.gpkg", shapely.to_wkb(shapes), [], [],
        geometry_type="Polygon Z", crs="EPSG:32615",
    )  # fmt: skip
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.flightline(shots=20))
    ended = surveys.command("plan", surveys.write_workflow(tmp_path, **{key: "p.gpkg"}))
    assert ended.status == (status if away_m else 0), ended.text
    assert ("meets the survey" in " ".join(ended.text.split())) == bool(away_m)


def test_an_area_with_latitude_and_longitude_swapped_is_refused(tmp_path: Path) -> None:
    degrees = Transformer.from_crs("EPSG:32615", "EPSG:4326").transform(*surveys.ORIGIN_M)
    shapes = np.array([shapely.Point(*degrees).buffer(0.001)], object)
    pyogrio.raw.write(
        tmp_path / "p.geojson", shapely.to_wkb(shapes), [], [],
        geometry_type="Polygon", crs="EPSG:4326",
    )  # fmt: skip
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.flightline(shots=20))
    ended = surveys.command("plan", surveys.write_workflow(tmp_path, aoi="p.geojson"))
    assert ended.status == 2
    assert "p.geojson" in ended.text


def test_an_area_between_the_flightlines_is_refused_once_the_points_are_read(
    tmp_path: Path,
) -> None:
    one, other = (surveys.flightline(shots=20, psid=k, start_s=surveys.START_S + k) for k in (1, 2))
    other["y"] = other["y"] + 200.0
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.join(one, other))
    east, north = surveys.ORIGIN_M
    shapes = np.array([shapely.box(east - 9, north + 90, east + 9, north + 110)], object)
    pyogrio.raw.write(
        tmp_path / "p.gpkg", shapely.to_wkb(shapes), [], [],
        geometry_type="Polygon", crs="EPSG:32615",
    )  # fmt: skip
    workflow = surveys.write_workflow(tmp_path, aoi="p.gpkg")
    ended = surveys.command("run", workflow, "--workers", 0, "--until", "shuffle")
    assert ended.status == 2
    assert "p.gpkg" in ended.text
