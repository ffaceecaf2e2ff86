"""Feet: what is read is metres, what is written is the CRS's unit, and nothing is guessed."""

from collections.abc import Iterator
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from pyproj.datadir import append_data_dir, get_data_dir, set_data_dir

from spl_batch.constants import FOOT_M, NODATA, QUANTUM_M
from spl_batch.errors import InputError, WorkflowError
from spl_batch.formats import reprojection
from spl_batch.formats.crs import (
    above_ellipsoid,
    compound,
    horizontal,
    in_unit,
    same_crs,
    vertical,
)
from spl_batch.formats.geoid import Geoid
from spl_batch.formats.heights import SOME_HEIGHTS, is_above_ellipsoid, names_datum, with_vertical
from spl_batch.formats.las.reader import inspect, iter_points
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.rasters.parts import overview_frame, read_overview, read_part
from spl_batch.formats.reprojection import Reprojection
from spl_batch.formats.trajectory.positions import PointExtent, gathering
from spl_batch.formats.transformations import best_transformer, lacks
from spl_batch.formats.units import COMMON, METRES, NAMES, US_FOOT, Units
from tests import surveys
from tests.formats.test_geoid import write_grid

US_M = 1200 / 3937
TEXAS, OREGON, MIXED = "EPSG:2278+6360", "EPSG:2992+8228", "EPSG:2278+5703"
IN_FEET = [(TEXAS, US_M, US_M), (OREGON, FOOT_M, FOOT_M), (MIXED, US_M, 1.0)]


@pytest.mark.parametrize(
    ("text", "units"),
    [
        ("EPSG:32615+5703", METRES),
        ("EPSG:4326", METRES),
        (MIXED, Units(US_FOOT, US_M)),
        ("EPSG:32615+8228", Units(vertical="foot", vertical_m=FOOT_M)),
        ("EPSG:2992", Units("foot", FOOT_M, "foot", FOOT_M)),
        ('LOCAL_CS["x",UNIT["Foot_US",0.3048006]]', Units(US_FOOT, US_M, US_FOOT, US_M)),
    ],
)
def test_units_of_a_crs(text: str, units: Units) -> None:
    assert Units.of(CRS.from_user_input(text)) == units
    assert Units.of(None) == METRES


@pytest.mark.parametrize(("text", "flat_m", "height_m"), IN_FEET)
def test_points_in_feet_are_those_in_metres_and_are_written_in_feet(
    tmp_path: Path, text: str, flat_m: float, height_m: float
) -> None:
    path, crs = tmp_path / "m.laz", CRS.from_user_input(text)
    surveys.write_cloud(path, surveys.flightline(shots=20), scale=0.01)
    feet = surveys.in_feet(path, tmp_path / "ft.laz", text, (flat_m, flat_m, height_m))
    units = Units.of(crs)
    (table,) = iter_points(path, channel_dimension="channel", source=1)
    (read,) = iter_points(feet, channel_dimension="channel", source=1, units=units)
    for name in table.columns:
        np.testing.assert_array_equal(table[name], read[name], name)
    box = inspect(feet).in_metres(units)
    np.testing.assert_allclose(box.mins_m, inspect(path).mins_m, atol=1e-6)
    write_points(tmp_path / "tile.laz", read, crs=crs)
    written = laspy.read(tmp_path / "tile.laz")
    assert written.header.scales.tolist() == [0.001] * 3
    own_m = np.column_stack([table[axis] * QUANTUM_M for axis in "xyz"])
    off = np.abs(written.xyz * units.xyz_m - own_m)
    assert off.max() <= 0.0005 * max(units.xyz_m) + 1e-6


@pytest.mark.parametrize(("text", "flat_m", "height_m"), IN_FEET)
def test_rasters_are_written_in_the_unit_and_read_in_metres(
    tmp_path: Path, text: str, flat_m: float, height_m: float
) -> None:
    heights = np.array([[812.125, NODATA, 3], [4, 5, 6]], np.float32)
    how = {"shape": (2, 3), "origin_xy_m": (272_000.0, 3_290_002.0), "cell_m": 1.0, "crs": text}
    for name, unit in (("dtm", "m"), ("density", "1/m2")):
        write_cog(tmp_path / name, heights, description=name, unit=unit, **how)  # type: ignore[arg-type]
    with rasterio.open(tmp_path / "dtm") as source, rasterio.open(tmp_path / "density") as other:
        assert source.units[0] == ("m" if height_m == 1.0 else Units.of(CRS(text)).vertical)
        assert source.transform.a == 1.0 / flat_m
        assert source.read(1)[0, 0] == np.float32(812.125 / height_m)
        np.testing.assert_array_equal(other.read(1), heights)
    part = read_part(tmp_path / "dtm", (272_001.5, 3_290_000.5, 272_001.6, 3_290_000.6))
    assert part is not None
    np.testing.assert_allclose(part.values, heights, atol=1e-4)
    assert part.extent_m == (272_000.0, 272_003.0, 3_290_000.0, 3_290_002.0)
    assert overview_frame(tmp_path / "dtm") == (2, 3, 272_000.0, 3_290_002.0, 1.0)
    assert read_overview(tmp_path / "density").values[1, 2] == 6.0


@pytest.mark.parametrize("named", [None, TEXAS])
def test_a_trajectory_in_the_surveys_feet_is_read_in_metres(tmp_path: Path, named) -> None:
    path = tmp_path / "t.csv"
    path.write_text("gps_time,x,y,z\n1,3000000,13000000,6000\n2,3000100,13000000,6000\n")
    crs = CRS.from_user_input(TEXAS)
    with gathering([path], survey_crs=crs, trajectory_crs=named) as found:
        ((_, xyz),) = found
    np.testing.assert_allclose(xyz[1], np.array([3_000_100, 13_000_000, 6000]) * US_M, atol=1e-6)
    points = PointExtent((1.0, 2.0), (0.0, 13_000_000 * US_M, 100.0, 13_000_000 * US_M))
    told = r"x 3000050, y 13000000 ft is 2 999 672 ft \(914 302 m\) from the points"
    with (
        pytest.raises(InputError, match=told),
        gathering([path], survey_crs=crs, trajectory_crs=named, points=points) as found,
    ):
        list(found)


def test_a_geoid_below_a_survey_in_feet(tmp_path: Path) -> None:
    name = write_grid(tmp_path / "a.gtx")
    utm, feet = CRS.from_epsg(26915), CRS.from_epsg(2278)
    x, y = np.array([272_000.0]), np.array([3_290_000.0])
    there = Transformer.from_crs(utm, feet, always_xy=True).transform(x, y)
    geoid = Geoid(name, tmp_path / name, feet)
    above = geoid.heights(there[0] * US_M, there[1] * US_M)
    np.testing.assert_allclose(above, Geoid(name, tmp_path / name, utm).heights(x, y), atol=1e-6)
    assert Units.of(geoid.crs_above("EPSG:6360")).vertical == US_FOOT
    with pytest.raises(WorkflowError, match="is not in US survey feet"):
        geoid.crs_above("EPSG:5703")
    heights = 'VERT_CS["Ellipsoid (metre)",VERT_DATUM["Ellipsoid",2002],UNIT["metre",1]]'
    mixed = Geoid(name, tmp_path / name, compound(feet, CRS.from_wkt(heights)))
    assert Units.of(mixed.crs_above("EPSG:5703")).vertical_m == 1.0
    with pytest.raises(WorkflowError, match="heights are in metres, eastings in US survey feet"):
        mixed.crs_above(None)


@pytest.mark.parametrize(
    ("text", "unit", "twin"),
    [
        ("EPSG:6588", "m", "EPSG:6587"),
        ("EPSG:6587", "us-ft", "EPSG:6588"),
        ("EPSG:2225+6360", "m", "EPSG:26941+5703"),
        ("EPSG:26941+5703", "us-ft", "EPSG:2225+6360"),
        ("EPSG:2991+5703", "ft", "EPSG:2992+8228"),
        (MIXED, "us-ft", TEXAS),
    ],
)
def test_a_crs_in_another_unit_is_epsgs_twin(text: str, unit: str, twin: str) -> None:
    found, known = in_unit(CRS.from_user_input(text), NAMES[unit]), CRS.from_user_input(twin)
    assert [part.to_epsg() for part in (horizontal(found), vertical(found)) if part] == [
        part.to_epsg() for part in (horizontal(known), vertical(known)) if part
    ]


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
    places = np.random.default_rng(1).uniform(low, high, (100, 3))
    factor = np.divide(own.xyz_m, made.xyz_m)
    np.testing.assert_array_equal(there.places(places), places * factor)
    heights = np.array([[812.5]], np.float32)
    write_cog(
        tmp_path / "dtm", heights, shape=(1, 1), origin_xy_m=(4.0, 9.0), crs=there.crs.to_wkt(),
        description="", unit="m",
    )  # fmt: skip
    with rasterio.open(tmp_path / "dtm") as source:
        assert Units.of(CRS.from_wkt(source.crs.to_wkt())) == made
        stated = made.vertical if made.vertical_m != 1.0 else "m"
        assert source.units == (stated,)
        assert source.read(1)[0, 0] == np.float32(812.5 / made.vertical_m)
    part = read_part(tmp_path / "dtm", (4.1, 8.1, 4.2, 8.2))
    assert part is not None
    np.testing.assert_allclose(part.values, heights, rtol=1e-6)


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
        with pytest.raises(WorkflowError, match=r"nothing says what .* survey\.vertical_crs"):
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
    ((_, _, z),) = there.places(np.array([[x, y, 100.0]]))
    assert z == pytest.approx(height, abs=2e-4)
    assert header_names_ellipsoid(tmp_path, there)


def test_heights_above_the_ellipsoid_of_another_datum_are_transformed() -> None:
    there = Reprojection(CRS("EPSG:28355").to_3d(), "EPSG:7855")
    place = np.array([[500_000.0, 6_000_000.0, 100.0]])
    ends = CRS("EPSG:4939"), CRS("EPSG:7843")  # GDA94 and GDA2020, moved and turned
    degrees = Transformer.from_crs("EPSG:28355", ends[0], always_xy=True)
    x, y = degrees.transform(*place[0, :2])
    *_, height = Transformer.from_crs(*ends, always_xy=True).transform(x, y, 100.0)
    assert abs(height - 100.0) > 0.05
    assert there.places(place)[0, 2] == pytest.approx(height, abs=1e-4)


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
    survey, place = above_ellipsoid(CRS("EPSG:6588"), US_FOOT), in_texas(100.0)
    there = Reprojection(survey, "EPSG:6588+6360", unit)
    there.check(place)
    made_m = COMMON[NAMES[unit]]
    assert vertical(there.crs).datum.name == "North American Vertical Datum 1988"
    ((x, y, z),) = there.places(place) * made_m
    np.testing.assert_allclose([x, y], place[0, :2] * US_M, atol=2e-4)
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
        there.places(np.array([[800_000.0, 900_000.0, 10.0]]))
    assert len(built) == 1


@pytest.mark.parametrize("unit", NAMES)
def test_a_crs_that_is_bound_to_another_is_in_another_unit(unit: str) -> None:
    bound = CRS("+proj=utm +zone=10 +ellps=GRS80 +towgs84=0,0,0 +units=us-ft +type=crs")
    assert bound.is_bound
    for crs in (bound, compound(bound, CRS("EPSG:6360"))):
        assert Units.of(in_unit(crs, NAMES[unit])).horizontal == NAMES[unit]
    place = np.array([[1_800_000.0, 14_000_000.0, 100.0]])
    there = Reprojection(bound, None, unit)
    np.testing.assert_allclose(there.places(place), place * US_M / COMMON[NAMES[unit]])


def test_a_raster_of_heights_above_the_ellipsoid_has_its_crs(tmp_path: Path) -> None:
    deep = CRS("EPSG:6588").to_3d()
    write_cog(
        tmp_path / "dtm", np.array([[812.5]], np.float32), shape=(1, 1), origin_xy_m=(4.0, 9.0),
        crs=deep.to_wkt(), description="", unit="m",
    )  # fmt: skip
    with rasterio.open(tmp_path / "dtm") as source:
        assert source.crs.to_epsg() == 6588
        assert source.units == ("m",)
    part = read_part(tmp_path / "dtm", (4.1, 8.1, 4.2, 8.2))
    assert part is not None
    np.testing.assert_allclose(part.values, 812.5, rtol=1e-6)


@pytest.mark.parametrize("version", ["WKT2_2019", "WKT1_GDAL"])
@pytest.mark.parametrize(
    ("text", "codes"),
    [(TEXAS, [2278, 6360]), ("EPSG:8782", [2278, 6360]), ("EPSG:5972", [25832, 5941])],
)
def test_a_raster_names_the_parts_of_a_crs_with_a_code_of_its_own(
    tmp_path: Path, text: str, version: str, codes: list[int]
) -> None:
    crs, path = CRS.from_user_input(text).to_wkt(version), tmp_path / "dtm"
    for _ in range(2):  # as a client's tile is cut out of another raster
        write_cog(
            path, np.array([[812.5]], np.float32), shape=(1, 1), origin_xy_m=(4.0, 9.0), crs=crs,
            description="", unit="m",
        )  # fmt: skip
        with rasterio.open(path) as source:
            crs = source.crs.to_wkt()
        found = CRS.from_wkt(crs)
        assert [part.to_epsg() for part in (horizontal(found), vertical(found))] == codes


@pytest.mark.parametrize("unit", NAMES)
@pytest.mark.parametrize(
    ("text", "datum"),
    [
        ("EPSG:32615+3855", "EGM2008 geoid"),
        ("EPSG:32615+5773", "EGM96 geoid"),
        ("EPSG:32619+5713", "Canadian Geodetic Vertical Datum of 1928"),
        ("EPSG:7405", "Ordnance Datum Newlyn"),
        ("EPSG:25832+5783", "Deutsches Haupthoehennetz 1992"),
        (TEXAS, "North American Vertical Datum 1988"),
    ],
)
def test_a_raster_names_the_datum_of_heights_in_any_unit(
    tmp_path: Path, text: str, datum: str, unit: str
) -> None:
    crs, path = in_unit(CRS.from_user_input(text), NAMES[unit]).to_wkt(), tmp_path / "dtm"
    for _ in range(2):
        write_cog(
            path, np.array([[812.5]], np.float32), shape=(1, 1), origin_xy_m=(4.0, 9.0), crs=crs,
            description="", unit="m",
        )  # fmt: skip
        with rasterio.open(path) as source:
            crs = source.crs.to_wkt()
        found = CRS.from_wkt(crs)
        assert vertical(found).datum.name == datum
        assert Units.of(found).vertical == NAMES[unit]


@pytest.mark.parametrize("name", ["unknown", "World Geodetic System 1984"])
def test_a_raster_names_no_datum_that_heights_have_not(tmp_path: Path, name: str) -> None:
    heights = in_unit(CRS(SOME_HEIGHTS.to_wkt().replace("unknown", name)), US_FOOT)
    crs = compound(CRS("EPSG:2278"), heights).to_wkt()
    write_cog(
        tmp_path / "dtm", np.array([[812.5]], np.float32), shape=(1, 1), origin_xy_m=(4.0, 9.0),
        crs=crs, description="", unit="m",
    )  # fmt: skip
    with rasterio.open(tmp_path / "dtm") as source:
        found = CRS.from_wkt(source.crs.to_wkt())
    assert not names_datum(found)
    assert Units.of(found).vertical == US_FOOT


def test_another_unit_needs_a_crs() -> None:
    with pytest.raises(WorkflowError, match=r"outputs\.units: the survey has no CRS"):
        Reprojection(None, None, "us-ft")
    with pytest.raises(WorkflowError, match=r"outputs\.cell: the survey has no CRS"):
        Reprojection(None, None)


def test_a_named_crs_in_a_named_unit() -> None:
    found = Reprojection(CRS.from_user_input(TEXAS), "EPSG:26915", "us-ft")
    metres = Reprojection(CRS.from_user_input(TEXAS), "EPSG:26915+5703")
    assert Units.of(found.crs) == Units.of(CRS.from_user_input(TEXAS))
    place = np.array([[3_000_000.0, 13_000_000.0, 100.0]])
    np.testing.assert_allclose(found.places(place) * US_M, metres.places(place), atol=1e-6)


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
        place, values = source.transform, source.read(1).astype(float)
    assert place.a == 3.0
    assert (place.c % 3.0, place.f % 3.0) == (0.0, 0.0)
    rows, cols = np.nonzero(values != NODATA)
    inverse = Transformer.from_crs(2278, 32615, always_xy=True)
    x, y = inverse.transform(*(place * (cols + 0.5, rows + 0.5)))
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
        ("EPSG:32615", TEXAS, "nothing says what the survey's heights"),
        (None, TEXAS, "the survey has no CRS"),
        ("EPSG:32615", "EPSG:4326", "geographic .* projected: name a projected CRS"),
        ("EPSG:32615", "EPSG:4978", "geocentric, .* projected: name a projected CRS"),
        ("EPSG:32615", "EPSG:5703", "a CRS of heights alone; write that of places"),
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


def test_rasters_and_tiles_need_a_place_there_as_points_do() -> None:
    there = Reprojection(CRS("EPSG:6344+5703"), "EPSG:6588+6360")
    place = np.array([[500_000.0, 3_300_000.0, 20.0]])
    there.check(place)
    vars(there)["_flat"] = Transformer.from_crs("EPSG:4326", "EPSG:32615", always_xy=True)
    assert np.isfinite(there.places(place)).all()
    assert not np.isfinite(there._flat.transform(*place[0, :2])).any()  # degrees that are none
    with pytest.raises(WorkflowError, match="a corner of the survey has no place there"):
        there.check(place)


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
    ((_, _, z),) = found.places(np.array([[272_000.0, 3_290_000.0, 20.0]]))
    assert z == pytest.approx(20.0 * ratio)
