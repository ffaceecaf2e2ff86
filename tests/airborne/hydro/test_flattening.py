"""Lakes and rivers in a terrain model, against loops, other libraries and a whole run."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path as Outline
from pyproj import CRS

from spl_batch.airborne.hydro.flattening import bank_findings, flatten, water_heights
from spl_batch.constants import NODATA
from spl_batch.errors import InputError
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.lattice.tiles import Bounds
from tests import surveys

UTM = CRS.from_epsg(32615)
CORE = Bounds(600_000, 4_000_000, 680_000, 4_060_000)
LAKE = shapely.Polygon(
    [(605.1, 4005.2, 12.0), (625.3, 4007.1, 12.0), (622.2, 4022.3, 12.01), (604.2, 4020.1, 12.0)],
    [[(610.1, 4010.2, 12.0), (615.3, 4010.1, 12.0), (613.2, 4015.3, 12.0)]],
)
RIVER = shapely.Polygon([(640, 3990), (650, 3990), (672, 4070), (662, 4070)])
COURSE = shapely.LineString(
    [(645, 3990, 9.0), (650, 4010, 9.4), (658, 4030, 9.1), (667, 4070, 11.0)]
)


def write(path: Path, layers: dict[str, list[shapely.Geometry]], crs: CRS | str = UTM) -> Path:
    """A GeoPackage with heights."""
    for k, (name, shapes) in enumerate(layers.items()):
        kind = shapes[0].geom_type + (" Z" if shapes[0].has_z else "")
        pyogrio.raw.write(
            path, shapely.to_wkb(np.array(shapes, object)), [], [], layer=name, append=k > 0,
            geometry_type=kind, crs=CRS.from_user_input(crs).to_wkt(),
        )  # fmt: skip
    return path


@pytest.fixture
def breaklines(tmp_path: Path) -> Path:
    return write(tmp_path / "b.gpkg", {"areas": [LAKE], "rivers": [RIVER], "lines": [COURSE]})


def centres(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid(600.5 + np.arange(shape[1]), 4059.5 - np.arange(shape[0]))


def test_lakes_are_level_and_islands_dry(breaklines: Path) -> None:
    found = water_heights(read_breaklines(breaklines, UTM), CORE, (60, 80))
    x, y = centres(found.shape)
    places = np.column_stack([x.ravel(), y.ravel()])
    inside = Outline(np.array(LAKE.exterior.coords)[:, :2]).contains_points(places)
    inside &= ~Outline(np.array(LAKE.interiors[0].coords)[:, :2]).contains_points(places)
    west = (x < 635).ravel()
    assert np.array_equal((found != NODATA).ravel()[west], inside[west])
    assert set(found[:, :35][found[:, :35] != NODATA].tolist()) == {12.0}


def test_rivers_fall_along_their_line_and_are_level_across(breaklines: Path) -> None:
    found = water_heights(read_breaklines(breaklines, UTM), CORE, (60, 80))
    x, y = centres(found.shape)
    course = np.array(COURSE.coords)[::-1]  # it falls to the south
    course[:, 2] = [11.0, 9.1, 9.1, 9.0]  # and does not rise to 9.4
    dense = np.concatenate([np.linspace(a, b, 4000) for a, b in pairwise(course)])
    wet = (found != NODATA) & (x > 635)
    assert wet.sum() > 400
    for i, j in zip(*np.nonzero(wet), strict=True):
        nearest = np.hypot(dense[:, 0] - x[i, j], dense[:, 1] - y[i, j]).argmin()
        assert found[i, j] == pytest.approx(dense[nearest, 2], abs=0.002)


@settings(max_examples=8, deadline=None)
@given(st.lists(st.floats(0, 20), min_size=2, max_size=8), st.integers(0, 79))
def test_no_river_rises_and_no_tiling_changes_it(tmp_path_factory, heights, cut) -> None:
    path = tmp_path_factory.mktemp("river") / "b.gpkg"
    y = np.linspace(3995, 4065, len(heights))
    line = shapely.LineString(np.column_stack([np.full(len(y), 640.0), y, heights]))
    area = shapely.box(630, 3990, 650, 4070)
    waters = read_breaklines(write(path, {"areas": [area], "lines": [line]}), UTM)
    whole = water_heights(waters, CORE, (60, 80))
    falls = np.diff(whole[:, 35]) * (1 if heights[0] >= heights[-1] else -1)
    assert (falls >= 0).all()
    assert np.array_equal(whole[:, 30:50], np.repeat(whole[:, 30:31], 20, axis=1))
    middle = CORE.xmin + 1000 * cut
    parts = [water_heights(waters, CORE._replace(xmax=middle), (60, cut))] if cut else []
    parts.append(water_heights(waters, CORE._replace(xmin=middle), (60, 80 - cut)))
    assert np.array_equal(whole, np.concatenate(parts, axis=1))


def test_what_rests_on_water_is_no_lower_and_banks_are_counted() -> None:
    water = np.full((4, 5), NODATA, np.float32)
    water[1:3, 1:4] = 10.0
    dtm = np.full((4, 5), 10.1, np.float32)
    dtm[0, :2] = 9.7  # two cells of a bank lie too low
    dtm[3, 4] = NODATA
    dsm = dtm + 2
    dsm[1, 1], dsm[2, 2] = NODATA, 9.0
    rasters = {"dtm": dtm, "dsm": dsm, "chm": dsm - dtm, "dtm_quality": np.full_like(dtm, 0.1)}
    rasters["density"] = np.zeros_like(dtm)
    banks = flatten(rasters, water)
    assert banks == (6, 13, 2)
    wet = water == 10.0
    assert (rasters["dtm"][wet] == 10.0).all()
    assert rasters["dsm"][1, 1] == rasters["dsm"][2, 2] == 10.0
    assert rasters["dsm"][1, 2] == pytest.approx(12.1)
    assert rasters["chm"][1, 2] == pytest.approx(2.1, abs=1e-6)
    assert (rasters["dtm_quality"][wet] == NODATA).all()
    assert np.array_equal(rasters["dtm"][~wet], dtm[~wet])
    one = next(bank_findings([banks, (0, 0, 0)]))
    assert (one.values["kind"], one.values["count"], one.values["of"]) == ("flooded", 2, 13)
    assert next(bank_findings([(0, 0, 0)])).values["kind"] == "none"
    assert not [*bank_findings([(600, 100, 5)])]
    assert not [*bank_findings([])]


def test_terrain_that_reaches_over_water_off_the_survey_is_water_too() -> None:
    # Beside the edge of a swath the TIN goes on over cells that no return says were flown.
    rasters = {k: np.full((3, 4), 12.0, np.float32) for k in ("dtm", "dsm", "chm", "dtm_quality")}
    rasters["density"] = np.zeros((3, 4), np.float32)
    rasters["density"][:, 2:] = NODATA
    rasters["dtm"][:, 3] = rasters["dsm"][:, 2:] = rasters["chm"][:, 2:] = NODATA
    flatten(rasters, np.full((3, 4), 10, np.float32))
    assert (rasters["dtm"][:, :3] == 10).all()
    assert (rasters["dtm_quality"][:, :3] == NODATA).all()
    assert (rasters["dsm"][:, :2] == 12).all()
    assert (rasters["dsm"][:, 2] == 10).all()
    assert (rasters["chm"][:, 2] == 0).all()
    assert (rasters["dtm"][:, 3] == NODATA).all()


def test_water_that_nobody_flew_stays_void() -> None:
    rasters = {k: np.full((3, 4), NODATA, np.float32) for k in ("dtm", "dsm", "chm", "dtm_quality")}
    rasters["density"] = np.zeros((3, 4), np.float32)
    rasters["density"][:, 2:] = NODATA
    assert flatten(rasters, np.full((3, 4), 10, np.float32)) == (6, 0, 0)
    for name in ("dtm", "dsm", "chm"):
        assert ((rasters[name] == NODATA) == (rasters["density"] == NODATA)).all()


@pytest.mark.parametrize(
    ("layers", "crs", "said"),
    [
        ({"a": [shapely.force_2d(LAKE)]}, UTM, "a 1: has no height"),
        ({"a": [shapely.Polygon([(0, 0, 1), (9, 0, 2), (9, 9, 1)])]}, UTM, "differ by 1.00 m"),
        ({"a": [RIVER], "b": [shapely.force_2d(COURSE)]}, UTM, "vertices without heights"),
        ({"b": [COURSE]}, UTM, "lines alone"),
        ({"a": [shapely.Point(1, 2, 3)]}, UTM, "holds no polygons"),
        ({"a": [LAKE]}, "EPSG:32615+5773", "its heights are 'EGM96 height'"),
        ({"a": [LAKE]}, "EPSG:32615+6360", "heights are in US survey feet .* survey's in metres"),
        ({"a": [LAKE]}, "EPSG:2277", "states no unit of heights.* ogr2ogr -a_srs EPSG:2277"),
    ],
)
def test_faults_are_told_in_one_line(tmp_path: Path, layers, crs, said: str) -> None:
    ours = CRS.from_user_input("EPSG:32615+5703")
    with pytest.raises(InputError, match=said) as told:
        read_breaklines(write(tmp_path / "b.gpkg", layers, crs), ours)
    assert "\n" not in str(told.value)


def test_breaklines_of_a_survey_in_feet_are_read_in_metres(tmp_path: Path) -> None:
    foot_m, crs = np.array([1200 / 3937] * 3), CRS.from_user_input("EPSG:2278+6360")
    in_feet = shapely.transform(LAKE, lambda xyz: xyz / foot_m, include_z=True)
    (lake,) = read_breaklines(write(tmp_path / "b.gpkg", {"a": [in_feet]}, "EPSG:2278"), crs)
    assert lake.level_m == pytest.approx(12.0)
    assert lake.area.equals_exact(shapely.force_2d(LAKE), 1e-6)


def test_breaklines_of_one_survey_in_feet_may_be_in_none_of_its_heights(tmp_path: Path) -> None:
    path = write(tmp_path / "b.gpkg", {"a": [LAKE]}, "EPSG:2278")
    with pytest.raises(InputError, match=r"states no unit of heights, the survey's .* metres"):
        read_breaklines(path, CRS("EPSG:2278+5703"))
    uneven = shapely.Polygon([(0, 0, 1), (9, 0, 2), (9, 9, 1)])
    path = write(tmp_path / "c.gpkg", {"a": [uneven]}, "EPSG:2278+6360")
    with pytest.raises(InputError, match=r"differ by 1\.00 ft \(0\.30 m\)"):
        read_breaklines(path, CRS("EPSG:2278+6360"))


def test_a_field_gives_the_height_and_another_crs_is_transformed(tmp_path: Path) -> None:
    ring = shapely.Polygon([(-93.0, 45.0), (-92.99, 45.0), (-92.99, 45.01), (-93.0, 45.0)])
    path = tmp_path / "lakes.geojson"
    surveys.write_shapes(path, [ring], "EPSG:4326", Elevation=[211.5])
    (lake,) = read_breaklines(path, UTM)
    assert lake.level_m == 211.5
    assert shapely.get_coordinates(lake.area)[0] == pytest.approx((500_000, 4_982_950), abs=1)


@pytest.mark.parametrize(("field", "clash"), [(211.5, True), (0.01, False), (np.nan, False)])
def test_a_field_does_not_contradict_the_vertices(tmp_path: Path, field, clash) -> None:
    lake = shapely.force_3d(shapely.box(0, 0, 9, 9), 0.0)
    path = surveys.write_shapes(tmp_path / "lakes.gpkg", [lake], UTM, z=[field])
    if clash:
        with pytest.raises(InputError, match=r"lie at 0\.00 m to 0\.00 m, its field .* 211\.50 m"):
            read_breaklines(path, UTM)
    else:
        assert read_breaklines(path, UTM)[0].level_m == 0.0


def test_a_run_is_flattened(tmp_path: Path) -> None:
    x, y = surveys.ORIGIN_M
    lake = shapely.box(x + 2, y - 3, x + 7, y + 4)
    write(tmp_path / "breaklines.gpkg", {"lakes": [shapely.force_3d(lake, 31.25)]})
    result = surveys.run(surveys.small_survey(tmp_path, breaklines="breaklines.gpkg"))
    assert result.exit_status == 0, result.report.failures
    with rasterio.open(result.output / "dtm.tif") as source:
        rows, columns = np.indices(source.shape)
        east, north = rasterio.transform.xy(source.transform, rows.ravel(), columns.ravel())
        wet = shapely.contains_xy(lake, east, north).reshape(source.shape)
        dtm = source.read(1)
    assert wet.sum() == 35
    assert set(dtm[wet].tolist()) == {31.25}
    assert 31.25 not in dtm[~wet]
    assert surveys.found(result.report.findings, "G04", "flooded")
    assert "breaklines" in {item.role for item in result.report.provenance.inputs}
