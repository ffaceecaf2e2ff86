"""A plan reads polygons: those that do not meet the survey are reported before any work."""

from pathlib import Path

import pytest
import shapely
from pyproj import Transformer

from spl_batch.airborne.plan.inputs.survey_inputs import gather_inputs
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.formats import vector_files
from tests import surveys


@pytest.mark.parametrize(("key", "status"), [("aoi", 2), ("breaklines", 0)])
@pytest.mark.parametrize("away_m", [0.0, 5000.0])
def test_polygons_beyond_the_survey(tmp_path: Path, key: str, status: int, away_m: float) -> None:
    east, north = surveys.ORIGIN_M
    box = shapely.box(east + away_m, north, east + away_m + 9, north + 9)
    surveys.write_shapes(tmp_path / "p.gpkg", [shapely.force_3d(box, 20.0)])
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.flightline(shots=20))
    ended = surveys.command("plan", surveys.write_workflow(tmp_path, **{key: "p.gpkg"}))
    assert ended.status == (status if away_m else 0), ended.text
    assert ("meets the survey" in " ".join(ended.text.split())) == bool(away_m)


def test_an_area_with_latitude_and_longitude_swapped_is_refused(tmp_path: Path) -> None:
    degrees = Transformer.from_crs("EPSG:32615", "EPSG:4326").transform(*surveys.ORIGIN_M)
    area = shapely.Point(*degrees).buffer(0.001)
    surveys.write_shapes(tmp_path / "p.geojson", [area], "EPSG:4326")
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.flightline(shots=20))
    ended = surveys.command("plan", surveys.write_workflow(tmp_path, aoi="p.geojson"))
    assert ended.status == 2
    assert "p.geojson" in ended.text


def test_polygons_that_keep_their_degrees_are_told_and_read_again_with_the_grid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    east, north = surveys.ORIGIN_M
    degrees = Transformer.from_crs("EPSG:26915", "EPSG:4269", always_xy=True).transform(east, north)
    area = shapely.Point(*degrees).buffer(0.001)
    surveys.write_shapes(tmp_path / "p.gpkg", [area], "EPSG:4269")
    cloud = surveys.flightline(shots=20)
    surveys.write_cloud(tmp_path / "lines" / "a.laz", cloud, crs="EPSG:6344")
    content = {"survey": {"flightlines": "lines/*.laz"}, "aoi": "p.gpkg", "output": "out"}
    workflow = Workflow.model_validate(content)
    inputs = gather_inputs(workflow, tmp_path, tmp_path / "out")
    (one,) = surveys.found(inputs.warnings, "I05", "grid")
    assert (one.subject, one.values["key"]) == ("p.gpkg", "aoi")
    assert "accurate to 6 m" in one.values["what"]
    monkeypatch.setattr(vector_files, "kept_degrees", lambda *_: "")
    again = gather_inputs(workflow, tmp_path, tmp_path / "out")
    assert not surveys.found(again.warnings, "I05")
    assert again.checksums("aoi") != inputs.checksums("aoi")


def test_an_area_between_the_flightlines_is_refused_once_the_points_are_read(
    tmp_path: Path,
) -> None:
    one, other = (surveys.flightline(shots=20, psid=k, start_s=surveys.START_S + k) for k in (1, 2))
    other["y"] = other["y"] + 200.0
    surveys.write_cloud(tmp_path / "lines" / "a.laz", surveys.join(one, other))
    east, north = surveys.ORIGIN_M
    area = shapely.box(east - 9, north + 90, east + 9, north + 110)
    surveys.write_shapes(tmp_path / "p.gpkg", [area])
    workflow = surveys.write_workflow(tmp_path, aoi="p.gpkg")
    ended = surveys.command("run", workflow, "--workers", 0, "--until", "shuffle")
    assert ended.status == 2
    assert "p.gpkg" in ended.text
