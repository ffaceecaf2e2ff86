"""Feet: what is read is metres, what is written is the CRS's unit, and nothing is guessed."""

from pathlib import Path
from typing import NamedTuple

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer

from spl_batch.constants import FOOT_M, NODATA, QUANTUM_M
from spl_batch.errors import InputError, WorkflowError
from spl_batch.formats.crs import (
    compound,
    horizontal,
    in_unit,
    vertical,
)
from spl_batch.formats.geoid import Geoid
from spl_batch.formats.heights import SOME_HEIGHTS, names_datum
from spl_batch.formats.las.reader import inspect, iter_points
from spl_batch.formats.las.writer import write_points
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.rasters.parts import overview_frame, read_overview, read_part
from spl_batch.formats.trajectory.positions import PointExtent, gathering
from spl_batch.formats.units import METRES, NAMES, US_FOOT, Units
from tests import surveys
from tests.formats.test_geoid import write_grid

US_M = 1200 / 3937
TEXAS, OREGON, MIXED = "EPSG:2278+6360", "EPSG:2992+8228", "EPSG:2278+5703"
IN_FEET = [(TEXAS, US_M, US_M), (OREGON, FOOT_M, FOOT_M), (MIXED, US_M, 1.0)]


class Cell(NamedTuple):
    """What a raster of one cell states of itself."""

    crs: CRS
    unit: str
    value: float


def one_cell(path: Path, crs: str) -> Cell:
    """Write a raster of one height."""
    height = np.array([[812.5]], np.float32)
    layout = {"shape": (1, 1), "origin_xy_m": (4.0, 9.0)}
    write_cog(path, height, crs=crs, description="", unit="m", **layout)  # type: ignore[arg-type]
    part = read_part(path, (4.1, 8.1, 4.2, 8.2))
    assert part is not None
    np.testing.assert_allclose(part.values, height, rtol=1e-6)
    with rasterio.open(path) as source:
        return Cell(CRS.from_wkt(source.crs.to_wkt()), source.units[0], source.read(1)[0, 0])


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
    message = r"x 3000050, y 13000000 ft is 2 999 672 ft \(914 302 m\) from the points"
    with (
        pytest.raises(InputError, match=message),
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


def test_a_raster_of_heights_above_the_ellipsoid_has_its_crs(tmp_path: Path) -> None:
    made = one_cell(tmp_path / "dtm", CRS("EPSG:6588").to_3d().to_wkt())
    assert (made.crs.to_epsg(), made.unit) == (6588, "m")


@pytest.mark.parametrize("version", ["WKT2_2019", "WKT1_GDAL"])
@pytest.mark.parametrize(
    ("text", "codes"),
    [(TEXAS, [2278, 6360]), ("EPSG:8782", [2278, 6360]), ("EPSG:5972", [25832, 5941])],
)
def test_a_raster_names_the_parts_of_a_crs_with_a_code_of_its_own(
    tmp_path: Path, text: str, version: str, codes: list[int]
) -> None:
    found = CRS.from_user_input(text)
    for _ in range(2):  # as a client's tile is cut out of another raster
        found = one_cell(tmp_path / "dtm", found.to_wkt(version)).crs
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
    found = in_unit(CRS.from_user_input(text), NAMES[unit])
    for _ in range(2):
        found = one_cell(tmp_path / "dtm", found.to_wkt()).crs
        assert vertical(found).datum.name == datum
        assert Units.of(found).vertical == NAMES[unit]


@pytest.mark.parametrize("name", ["unknown", "World Geodetic System 1984"])
def test_a_raster_names_no_datum_that_heights_have_not(tmp_path: Path, name: str) -> None:
    heights = in_unit(CRS(SOME_HEIGHTS.to_wkt().replace("unknown", name)), US_FOOT)
    found = one_cell(tmp_path / "dtm", compound(CRS("EPSG:2278"), heights).to_wkt()).crs
    assert not names_datum(found)
    assert Units.of(found).vertical == US_FOOT
