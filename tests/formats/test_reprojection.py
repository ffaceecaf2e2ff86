"""Clouds and rasters in another CRS or unit: by PROJ or an exact factor, heights too."""

from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from pyproj.datadir import append_data_dir, get_data_dir, set_data_dir

from spl_batch.constants import FOOT_M, NODATA
from spl_batch.errors import WorkflowError
from spl_batch.formats import reprojection
from spl_batch.formats.crs import (
    above_ellipsoid,
    compound,
    in_unit,
    same_crs,
    vertical,
)
from spl_batch.formats.heights import is_above_ellipsoid, with_vertical
from spl_batch.formats.las.reader import inspect, iter_points
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.reprojection import Reprojection
from spl_batch.formats.transformations import best_transformer, lacks
from spl_batch.formats.units import COMMON, NAMES, US_FOOT, Units
from tests import surveys
from tests.formats.test_units import MIXED, TEXAS, US_M, one_cell

WITHOUT_TWIN = ["EPSG:32615", "EPSG:25832+5783", "EPSG:2193+7839", "EPSG:2992+8228", MIXED]

WITH_TWIN = ["EPSG:6588", "EPSG:6587", "EPSG:2225+6360", TEXAS]
"""Their false northings differ by 0.1 mm from those of the twin."""


@pytest.mark.parametrize("unit", NAMES)
@pytest.mark.parametrize("text", [*WITHOUT_TWIN, *WITH_TWIN])
def test_another_unit_is_an_exact_factor_that_every_file_states(
    tmp_path: Path, text: str, unit: str
) -> None:
    survey = CRS.from_user_input(text)
    there, own = Reprojection(survey, None, unit), Units.of(survey)
    made = Units.of(there.crs)
    assert made == Units(NAMES[unit], COMMON[NAMES[unit]], NAMES[unit], COMMON[NAMES[unit]])
    assert there.moves_points == (made != own)
    low, high = (1_600_000.0, 5_200_000.0, -50.0), (1_700_000.0, 5_300_000.0, 900.0)
    points = np.random.default_rng(1).uniform(low, high, (100, 3))
    factor = np.divide(own.xyz_m, made.xyz_m)
    np.testing.assert_array_equal(there.coordinates(points), points * factor)
    cell = one_cell(tmp_path / "dtm", there.crs.to_wkt())
    assert Units.of(cell.crs) == made
    assert cell.unit == (made.vertical if made.vertical_m != 1.0 else "m")
    assert cell.value == np.float32(812.5 / made.vertical_m)


@pytest.mark.parametrize(("text", "unit"), [("EPSG:6588", "m"), ("EPSG:6587", "us-ft")])
def test_a_raster_in_another_unit_has_the_cells_of_its_original(
    tmp_path: Path, text: str, unit: str
) -> None:
    plane = np.add.outer(-16.0 * np.arange(192), 2.0 * np.arange(60)).astype(np.float32)
    write_cog(
        tmp_path / "dtm", plane, shape=plane.shape, origin_xy_m=(900_000.0, 4_200_000.0),
        cell_m=1.0, crs=text, description="", unit="m",
    )  # fmt: skip
    there = Reprojection(CRS(text), None, unit)
    how = {"cell": there.in_units(1.0), "above_datum": True, "meaning": "", "unit": "m"}
    there.raster(tmp_path / "dtm", tmp_path / "b", **how)  # type: ignore[arg-type]
    with rasterio.open(tmp_path / "b") as source:
        assert source.shape == plane.shape
        values = source.read(1).astype(float) * Units.of(there.crs).vertical_m
    # The slope is 16: a shift by 0.1 mm would be 1.6 mm.
    np.testing.assert_allclose(values[1:-1, 1:-1], plane[1:-1, 1:-1], atol=5e-4)


@pytest.mark.parametrize("name", ["unknown", "unknown height", "User-Defined", "County heights"])
def test_heights_of_which_the_unit_alone_is_known_are_above_nothing_that_is_named(
    name: str,
) -> None:
    unit = f'VERT_CS["{name}",VERT_DATUM["unknown",2005],UNIT["US survey foot",{US_M!r}]]'
    survey = compound(CRS("EPSG:2278"), CRS(unit))
    for named in (TEXAS, "EPSG:32140+5703", CRS("EPSG:2278").to_3d().to_wkt()):
        with pytest.raises(WorkflowError, match=r"nothing states what .* survey\.vertical_crs"):
            Reprojection(survey, named)
    stated = with_vertical(survey, "EPSG:6360", "survey.vertical_crs")
    assert Reprojection(stated, TEXAS).crs == CRS(TEXAS)
    assert Units.of(Reprojection(survey, None, "m").crs).are_metres
    assert Units.of(Reprojection(survey, "EPSG:32140").crs).vertical == US_FOOT
    with pytest.raises(WorkflowError, match=r"heights are in US survey feet, .* in metres"):
        with_vertical(survey, "EPSG:5703", "survey.vertical_crs")


@pytest.mark.parametrize(
    ("survey", "named", "unit", "height"),
    [
        ("EPSG:6344", "EPSG:6588", None, 100.0),
        ("EPSG:6344", "EPSG:6588", "us-ft", 100.0 / US_M),
        ("EPSG:6588", "EPSG:6344", None, 100.0),
        ("EPSG:6344", "EPSG:6344", None, 100.0),
        ("EPSG:6344", None, "ft", 100.0 / FOOT_M),
        # The ellipsoids of both differ by 0.1 mm.
        ("EPSG:6344", "EPSG:32615", None, 100.0),
    ],
)
def test_heights_above_the_ellipsoid_are_so_in_a_crs_that_names_none(
    tmp_path: Path, survey: str, named: str | None, unit: str | None, height: float
) -> None:
    there = Reprojection(CRS(survey).to_3d(), named, unit)
    assert same_crs(there.crs, CRS(named or survey)) == (unit != "ft")
    assert is_above_ellipsoid(there.crs)
    assert Units.of(there.crs).vertical == NAMES[unit or "m"]
    x, y = Transformer.from_crs("EPSG:6344", survey, always_xy=True).transform(5e5, 3.3e6)
    ((_, _, z),) = there.coordinates(np.array([[x, y, 100.0]]))
    assert z == pytest.approx(height, abs=2e-4)
    assert header_names_ellipsoid(tmp_path, there)


def test_heights_above_the_ellipsoid_of_another_datum_are_transformed() -> None:
    there = Reprojection(CRS("EPSG:28355").to_3d(), "EPSG:7855")
    point = np.array([[500_000.0, 6_000_000.0, 100.0]])
    ends = CRS("EPSG:4939"), CRS("EPSG:7843")  # GDA94 and GDA2020, moved and turned
    degrees = Transformer.from_crs("EPSG:28355", ends[0], always_xy=True)
    x, y = degrees.transform(*point[0, :2])
    *_, height = Transformer.from_crs(*ends, always_xy=True).transform(x, y, 100.0)
    assert abs(height - 100.0) > 0.05
    assert there.coordinates(point)[0, 2] == pytest.approx(height, abs=1e-4)


@pytest.fixture
def undulation(tmp_path: Path) -> Iterator[float]:
    """Height of a geoid above the ellipsoid, by a flat grid in place of NOAA's [m]."""
    folders, height = get_data_dir(), -27.5
    corner = rasterio.Affine(0.5, 0.0, -95.25, 0.0, -0.5, 31.25)
    profile = {"driver": "GTiff", "width": 5, "height": 5, "count": 1, "dtype": "float32"}
    with rasterio.open(
        tmp_path / "us_noaa_g2018u0.tif", "w", crs="EPSG:6318", transform=corner, **profile
    ) as grid:
        grid.write(np.full((1, 5, 5), height, np.float32))
        grid.set_band_description(1, "geoid_undulation")
        grid.update_tags(TYPE="VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL", AREA_OR_POINT="Point")
    caches = lacks, best_transformer
    append_data_dir(str(tmp_path))
    for cache in caches:
        cache.cache_clear()
    yield height
    set_data_dir(folders)
    for cache in caches:
        cache.cache_clear()


def in_texas(height: float) -> np.ndarray:
    x, y = Transformer.from_crs("EPSG:6318", "EPSG:6588", always_xy=True).transform(-94.5, 30.3)
    return np.array([[x, y, height]])


@pytest.mark.parametrize("unit", NAMES)
def test_heights_above_the_ellipsoid_are_transformed_to_those_of_a_geoid(
    undulation: float, unit: str
) -> None:
    survey, point = above_ellipsoid(CRS("EPSG:6588"), US_FOOT), in_texas(100.0)
    there = Reprojection(survey, "EPSG:6588+6360", unit)
    there.check(point)
    made_m = COMMON[NAMES[unit]]
    assert vertical(there.crs).datum.name == "North American Vertical Datum 1988"
    ((x, y, z),) = there.coordinates(point) * made_m
    np.testing.assert_allclose([x, y], point[0, :2] * US_M, atol=2e-4)
    assert z == pytest.approx(100.0 * US_M - undulation, abs=1e-4)


def test_a_geoid_that_proj_lacks_is_named_where_heights_are_above_the_ellipsoid() -> None:
    survey = above_ellipsoid(CRS("EPSG:6588"), US_FOOT)
    there = Reprojection(survey, "EPSG:6588+6360")
    with pytest.raises(WorkflowError, match=r"pyproj sync --file us_noaa_g2018u0\.tif"):
        there.check(in_texas(100.0))


def header_names_ellipsoid(folder: Path, there: Reprojection) -> bool:
    """Whether a cloud that is delivered there says that its heights are above the ellipsoid."""
    cloud = surveys.write_cloud(folder / "a.laz", surveys.flightline(shots=5), crs="EPSG:6344")
    there.cloud(cloud, folder / "b.laz")
    found = inspect(folder / "b.laz").crs
    return found is not None and is_above_ellipsoid(found) and found == there.crs


def test_a_grid_is_asked_for_where_points_move_and_not_for_a_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    built = []

    def counted(source: CRS, target: CRS) -> Transformer:
        built.append((source, target))
        return Transformer.from_crs(source, target, always_xy=True)

    monkeypatch.setattr(reprojection, "best_transformer", counted)
    there = Reprojection(CRS("EPSG:2994"), "EPSG:2992")
    assert there.moves_points
    assert there.crs.to_epsg() == 2992
    assert not built
    for _ in range(2):
        there.coordinates(np.array([[800_000.0, 900_000.0, 10.0]]))
    assert len(built) == 1


@pytest.mark.parametrize("unit", NAMES)
def test_a_crs_that_is_bound_to_another_is_in_another_unit(unit: str) -> None:
    bound = CRS("+proj=utm +zone=10 +ellps=GRS80 +towgs84=0,0,0 +units=us-ft +type=crs")
    assert bound.is_bound
    for crs in (bound, compound(bound, CRS("EPSG:6360"))):
        assert Units.of(in_unit(crs, NAMES[unit])).horizontal == NAMES[unit]
    point = np.array([[1_800_000.0, 14_000_000.0, 100.0]])
    there = Reprojection(bound, None, unit)
    np.testing.assert_allclose(there.coordinates(point), point * US_M / COMMON[NAMES[unit]])


def test_another_unit_needs_a_crs() -> None:
    with pytest.raises(WorkflowError, match=r"outputs\.units: the survey has no CRS"):
        Reprojection(None, None, "us-ft")
    with pytest.raises(WorkflowError, match=r"outputs\.cell: the survey has no CRS"):
        Reprojection(None, None)


def test_a_named_crs_in_a_named_unit() -> None:
    found = Reprojection(CRS.from_user_input(TEXAS), "EPSG:26915", "us-ft")
    metres = Reprojection(CRS.from_user_input(TEXAS), "EPSG:26915+5703")
    assert Units.of(found.crs) == Units.of(CRS.from_user_input(TEXAS))
    point = np.array([[3_000_000.0, 13_000_000.0, 100.0]])
    np.testing.assert_allclose(
        found.coordinates(point) * US_M, metres.coordinates(point), atol=1e-6
    )


def test_clouds_and_rasters_in_another_crs(tmp_path: Path) -> None:
    utm, texas = CRS.from_user_input("EPSG:32615+5703"), CRS.from_user_input(TEXAS)
    moved = Reprojection(utm, TEXAS)
    cloud = surveys.write_cloud(tmp_path / "cloud.laz", surveys.flightline(shots=20))
    (table,) = iter_points(cloud, channel_dimension="channel", source=1)
    heights = np.linspace(0.0, 30.0, len(table), dtype=np.float32)
    path = tmp_path / "a.laz"
    write_points(path, table.with_columns(HeightAboveGround=heights), crs=utm)
    before = laspy.read(path)
    assert moved.cloud(path, tmp_path / "b.laz") == len(before)
    after = laspy.read(tmp_path / "b.laz")
    assert after.header.parse_crs().equals(texas)
    there = Transformer.from_crs(utm, texas, always_xy=True).transform(*before.xyz.T)
    np.testing.assert_allclose(after.xyz.T, there, atol=5.1e-4)
    above = np.asarray(before["HeightAboveGround"]) / US_M
    np.testing.assert_allclose(after["HeightAboveGround"], above, rtol=1e-6)
    for name in {*before.point_format.dimension_names} - {*"XYZ", "HeightAboveGround"}:
        np.testing.assert_array_equal(before[name], after[name], name)

    plane = np.add.outer(-0.5 * np.arange(40), 0.25 * np.arange(60)).astype(np.float32) + 90
    plane[10:13, 10:13] = NODATA
    write_cog(
        tmp_path / "dtm", plane, shape=plane.shape, origin_xy_m=(272_000.0, 3_290_000.0),
        cell_m=1.0, crs=utm.to_wkt(), description="", unit="m",
    )  # fmt: skip
    moved.raster(
        tmp_path / "dtm", tmp_path / "ft", cell=3.0, above_datum=True, meaning="", unit="m"
    )
    with rasterio.open(tmp_path / "ft") as source:
        affine, values = source.transform, source.read(1).astype(float)
    assert affine.a == 3.0
    assert (affine.c % 3.0, affine.f % 3.0) == (0.0, 0.0)
    rows, cols = np.nonzero(values != NODATA)
    inverse = Transformer.from_crs(2278, 32615, always_xy=True)
    x, y = inverse.transform(*(affine * (cols + 0.5, rows + 0.5)))
    u, v = x - 272_000.5, 3_289_999.5 - y
    inner = (u > 14) & (u < 58) & (v > 1) & (v < 38)
    expected = (90 - 0.5 * v + 0.25 * u) / US_M
    np.testing.assert_allclose(values[rows, cols][inner], expected[inner], atol=1e-3)
    area_m2 = len(rows) * (3.0 * US_M) ** 2
    assert area_m2 == pytest.approx(40 * 60 - 9, rel=0.02)


@pytest.mark.parametrize(
    ("stored", "scale", "offset"),
    [("f8", None, None), ("f4", None, None), ("i2", [0.01], [5.0]), ("u2", None, None)],
)
@pytest.mark.parametrize("name", ["HeightAboveGround", "HeightAboveGround_2"])
def test_an_inputs_own_heights_above_ground_are_in_the_clouds_unit(
    tmp_path: Path, name: str, stored: str, scale: list[float] | None, offset: list[float] | None
) -> None:
    path = surveys.write_cloud(tmp_path / "m.laz", surveys.flightline(shots=20))
    las = laspy.read(surveys.in_feet(path, tmp_path / "ft.laz", TEXAS, [US_M] * 3))
    for one in (name, "AboveRoof"):
        las.add_extra_dim(
            laspy.ExtraBytesParams(
                one, stored, scales=scale and np.array(scale), offsets=offset and np.array(offset)
            )
        )
        las[one] = np.arange(len(las)) % 90
    las.write(tmp_path / "a.laz")
    moved = Reprojection(CRS(TEXAS), None, "m")
    assert moved.cloud(tmp_path / "a.laz", tmp_path / "b.laz") == len(las)
    after = laspy.read(tmp_path / "b.laz")
    np.testing.assert_allclose(after[name], np.asarray(las[name]) * US_M, rtol=1e-6)
    np.testing.assert_array_equal(after["AboveRoof"], las["AboveRoof"])
    np.testing.assert_allclose(after.z, np.asarray(las.z) * US_M, atol=5.1e-4)
    Reprojection(CRS(TEXAS), "EPSG:2279").cloud(tmp_path / "a.laz", tmp_path / "c.laz")
    described = [
        [
            bytes(one)
            for one in laspy.read(path).header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs
        ]
        for path in (tmp_path / "a.laz", tmp_path / "c.laz")
    ]
    assert described[0] == described[1]  # the same unit: nothing to convert


@pytest.mark.parametrize(
    ("survey", "named", "fault"),
    [
        ("EPSG:32615", TEXAS, "nothing states what the survey's heights"),
        (None, TEXAS, "the survey has no CRS"),
        ("EPSG:32615", "EPSG:4326", "geographic .* projected: name a projected CRS"),
        ("EPSG:32615", "EPSG:4978", "geocentric, .* projected: name a projected CRS"),
        ("EPSG:32615", "EPSG:5703", "a CRS of heights alone; write a horizontal one"),
        ("EPSG:32615+5703", "EPSG:2278+5773", "cannot be reached .* grid that it lacks"),
        ("EPSG:32615", "EPSG:32606", "stretches lengths .* name one of the region"),
        ("EPSG:27700", "EPSG:25830", "pyproj sync --file uk_os_OSTN15_NTv2_OSGBtoETRS.tif"),
        ("EPSG:2994", "EPSG:2992", "lacks what .* --file us_noaa_nadcon5_nad83_1986_nad83_harn"),
    ],
)
def test_a_crs_that_cannot_be_reached_is_refused(survey, named: str, fault: str) -> None:
    crs = None if survey is None else CRS.from_user_input(survey)
    corner = np.array([[272_000.0, 3_290_000.0, 20.0]])
    with pytest.raises(WorkflowError, match=fault):
        Reprojection(crs, named).check(corner)


def test_rasters_and_tiles_need_coordinates_there_as_points_do() -> None:
    there = Reprojection(CRS("EPSG:6344+5703"), "EPSG:6588+6360")
    point = np.array([[500_000.0, 3_300_000.0, 20.0]])
    there.check(point)
    vars(there)["_flat"] = Transformer.from_crs("EPSG:4326", "EPSG:32615", always_xy=True)
    assert np.isfinite(there.coordinates(point)).all()
    assert not np.isfinite(there._flat.transform(*point[0, :2])).any()  # degrees that are none
    with pytest.raises(WorkflowError, match="a corner of the survey has no coordinates there"):
        there.check(point)


@pytest.mark.parametrize(
    ("named", "crs", "moves", "ratio"),
    [
        ("EPSG:2278", "EPSG:2278+5703", True, 1.0),
        ("EPSG:32615+5703", "EPSG:32615+5703", False, 1.0),
        ("EPSG:32615+6360", "EPSG:32615+6360", True, 1.0 / US_M),
    ],
)
def test_heights_stay_where_none_are_named(named: str, crs: str, *, moves, ratio: float) -> None:
    found = Reprojection(CRS.from_user_input("EPSG:32615+5703"), named)
    assert found.crs.sub_crs_list[1].equals(CRS.from_user_input(crs).sub_crs_list[1])
    assert found.moves_points == moves
    ((_, _, z),) = found.coordinates(np.array([[272_000.0, 3_290_000.0, 20.0]]))
    assert z == pytest.approx(20.0 * ratio)
