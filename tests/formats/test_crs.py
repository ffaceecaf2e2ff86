"""CRS: what suits the work, what does not, and that messages give the reason."""

import re
from pathlib import Path

import numpy as np
import pytest
import rasterio
from PIL import Image
from pyproj import CRS

from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import (
    NAME,
    REPROJECT,
    compound,
    crs_from_wkt,
    crs_problems,
    in_unit,
    other_crs,
    parse_crs,
    same_crs,
    stretch_problem,
    vertical,
)
from spl_batch.formats.geotiff_keys import GEO_KEYS, crs_from_geotiff
from spl_batch.formats.heights import (
    SOME_HEIGHTS,
    completed,
    heights_fault,
    heights_ratio,
    same_heights,
    with_vertical,
)
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.units import COMMON, US_FOOT, Units
from tests.io_files import geo_keys


@pytest.mark.parametrize(
    "text",
    ["EPSG:32615", "EPSG:2154", "EPSG:32615+5773", "EPSG:25832", "EPSG:3994",
    "EPSG:3413", "EPSG:2263", "EPSG:32615+6360", "EPSG:2992+8228"],
)  # fmt: skip
def test_projected_crs_in_metres_or_feet_is_fine(text: str) -> None:
    assert crs_problems(CRS.from_user_input(text)) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("EPSG:4326", "geographic (degrees)"),
        ("EPSG:4979", "geographic (degrees)"),
        ("+proj=utm +zone=15 +units=km", "is in kilometre"),
        ("+proj=utm +zone=15 +to_meter=0.3047", "no unit of metres or feet"),
        ("EPSG:3857", "1/cos(latitude)"),
        ("EPSG:3395", "1/cos(latitude)"),
        ("EPSG:3857+5703", "1/cos(latitude)"),
        ("EPSG:4978", "must be projected"),
        ("EPSG:32615+5612", "counts Depth down"),
        ("EPSG:2053", "counts Westing west"),
    ],
)
def test_refused(text: str, words: str) -> None:
    for remedy in (REPROJECT, NAME):
        problems = crs_problems(CRS.from_user_input(text), remedy)
        assert words in problems[0]
        assert f": {remedy} " in problems[0]
        assert (REPROJECT in problems[0]) == (remedy == REPROJECT)
        assert "survey.crs" not in problems[0] or remedy == REPROJECT
        assert all("\n" not in p for p in problems)


@pytest.mark.parametrize(
    ("text", "heights", "fault"),
    [
        ("EPSG:5703", False, "is a CRS of heights alone; write .* EPSG:32615.5703"),
        ("EPSG:32615+5703", True, "is no vertical CRS"),
        ("EPSG:32615", True, "is no vertical CRS"),
        ("EPSG:1234567", False, "is not a known CRS; write e.g. EPSG:32615"),
        ("EPSG:1234567", True, "is not a known CRS; write e.g. EPSG:5703"),
    ],
)
def test_a_key_names_coordinates_or_heights(text: str, fault: str, *, heights: bool) -> None:
    with pytest.raises(WorkflowError, match=f"^key: .*{fault}"):
        parse_crs(text, "key", heights=heights)


@pytest.mark.parametrize(
    ("text", "point_m", "times"),
    [
        ("EPSG:32615+5703", (500_000, 5_000_000), None),
        ("EPSG:3627", (300_000, 60_000), None),
        ("EPSG:2154", (1_200_000, 7_100_000), None),
        ("EPSG:3413", (1_000_000, -1_000_000), None),
        ("EPSG:4087", (500_000, 5_000_000), "1.41"),
        ("EPSG:6933", (500_000, 5_000_000), "1.18"),
        ("EPSG:5880", (7_000_000, 9_150_000), None),
        ("EPSG:22700", (500_000, 300_000), None),
        ("EPSG:32615", (4_500_000, 5_000_000), "1.20"),
        ("EPSG:2278", (900_000, 4_200_000), None),
    ],
)
def test_a_projection_that_stretches_lengths_there(
    text: str, point_m: tuple[float, float], times: str | None
) -> None:
    found = stretch_problem(CRS.from_user_input(text), [point_m, (1e30, 1e30)])
    assert [f"by {times}," in one for one in found] == [True] * (times is not None)


def test_same_crs() -> None:
    utm = CRS.from_epsg(32615)
    assert same_crs(utm, CRS.from_user_input("EPSG:32615+5773"))
    assert same_crs(utm, CRS.from_wkt(utm.to_wkt("WKT1_GDAL")))
    assert same_crs(utm, CRS.from_wkt(utm.to_wkt("WKT1_ESRI")))
    assert not same_crs(utm, CRS.from_epsg(32616))
    assert not same_crs(utm, CRS.from_epsg(4326))


def test_the_parameter_that_differs_is_named() -> None:
    right = CRS("EPSG:2992").to_wkt("WKT1_GDAL")
    wrong = CRS(right.replace("1312335.958", "400000"))
    message = other_crs(wrong, CRS(right))
    assert "has other parameters than the survey's of that name" in message
    assert "(Easting at false origin 400000 foot against 1312335.958 foot)" in message
    assert "against" not in other_crs(CRS(right), CRS("EPSG:2992"))


def test_a_named_vertical_crs_completes_that_of_the_files(tmp_path: Path) -> None:
    flat = CRS.from_epsg(32615)
    whole = with_vertical(flat, "EPSG:5703", "survey.vertical_crs")
    assert vertical(whole).to_epsg() == 5703
    assert same_crs(whole, flat)
    assert with_vertical(whole, "EPSG:5703", "key") is whole
    layout = {"origin_xy_m": (272_000.0, 3_290_000.0), "cell_m": 1.0, "description": "height"}
    values = np.ones((3, 4), np.float32)
    write_cog(tmp_path / "a.tif", values, shape=(3, 4), crs=whole.to_wkt(), **layout)  # type: ignore[arg-type]
    with rasterio.open(tmp_path / "a.tif") as source:
        read = CRS.from_wkt(source.crs.to_wkt())
    assert vertical(read).to_epsg() == 5703
    assert same_crs(read, flat)


@pytest.mark.parametrize(
    ("crs", "text", "fault"),
    [
        ("EPSG:32615", "EPSG:32615", "is no vertical CRS"),
        ("EPSG:32615+6360", "EPSG:5703", "the files state 'NAVD88 height .ftUS"),
        ("EPSG:32615", "EPSG:5612", "counts Depth down"),
        ("EPSG:32615+5703", "EPSG:5773", "the files state 'NAVD88 height'"),
        (None, "EPSG:5703", "no CRS that it could complete"),
    ],
)
def test_what_is_no_vertical_crs_of_the_files_is_refused(
    crs: str | None, text: str, fault: str
) -> None:
    given = None if crs is None else CRS.from_user_input(crs)
    with pytest.raises(WorkflowError, match=f"key: .*{fault}"):
        with_vertical(given, text, "key")


def _keys(*keys: tuple[int, int]) -> CRS | None:
    return crs_from_geotiff(geo_keys(*keys), b"", b"")


@pytest.mark.parametrize(
    ("keys", "unit", "fits", "other"),
    [
        ([(4096, 6360), (4099, 9003)], US_FOOT, 6360, 5703),
        ([(4099, 9003)], US_FOOT, 6360, 5703),
        ([(4096, 5703), (4099, 9003)], US_FOOT, 6360, 5703),
        ([(4096, 5703), (4099, 9001)], "metre", 5703, 5773),
        ([(4099, 9001)], "metre", 5703, 6360),
    ],
)
def test_heights_of_geotiff_keys_are_in_the_unit_that_they_state(
    keys: list[tuple[int, int]], unit: str, fits: int, other: int
) -> None:
    crs = _keys((1024, 1), (3072, 32615), *keys)
    assert Units.of(crs) == Units(vertical=unit, vertical_m=COMMON[unit])
    assert (vertical(crs) is None) == (keys == [(4099, 9001)]), "a metre alone is no vertical CRS"
    named = with_vertical(crs, f"EPSG:{fits}", "survey.vertical_crs")
    assert vertical(named).to_epsg() == fits
    if vertical(crs) is not None:
        with pytest.raises(WorkflowError):
            with_vertical(crs, f"EPSG:{other}", "survey.vertical_crs")


@pytest.mark.parametrize(("unit", "code", "name"), [(9002, 8228, "ft"), (9003, 6360, "ftUS")])
def test_a_vertical_crs_of_geotiff_keys_keeps_its_name_in_their_unit(
    unit: int, code: int, name: str
) -> None:
    for flat in ((3072, 32615), (3072, 2278)):
        heights = vertical(_keys((1024, 1), flat, (4096, 5703), (4099, unit)))
        assert heights.name == f"NAVD88 height ({name})"
        assert heights.datum.name == "North American Vertical Datum 1988"
        assert same_heights(heights, CRS.from_epsg(code))


@pytest.mark.parametrize(("unit", "name"), [(9001, "metre"), (9002, "foot"), (9003, US_FOOT)])
@pytest.mark.parametrize("code", [5102, 5103, 5702, 6360])
def test_every_unit_of_geotiff_keys_counts_more_than_that_of_the_code(
    code: int, unit: int, name: str
) -> None:
    found = _keys((1024, 1), (3072, 26915), (4096, code), (4099, unit))
    assert Units.of(found).vertical == name
    datum = "North American Vertical Datum 1988", "National Geodetic Vertical Datum 1929"
    assert vertical(found).datum.name == datum[code in {5102, 5702}]


def test_keys_that_are_padded_are_read_as_far_as_they_are_counted() -> None:
    crs = crs_from_geotiff(geo_keys((1024, 1), (3072, 32615), (4099, 9003)) + bytes(16), b"", b"")
    assert Units.of(crs) == Units(vertical=US_FOOT, vertical_m=1200 / 3937)


@pytest.mark.parametrize(("unit", "name"), [(9001, "metre"), (9002, "foot"), (9003, US_FOOT)])
def test_a_local_crs_of_geotiff_keys_has_their_unit(unit: int, name: str) -> None:
    assert Units.of(_keys((1024, 1), (3072, 32767), (3076, unit))).horizontal == name


def test_a_code_of_metres_beside_keys_in_feet_is_not_taken() -> None:
    feet, metres = CRS("EPSG:2255"), CRS("EPSG:26995")
    text = feet.to_wkt("WKT1_GDAL").replace('["EPSG","2255"]', '["EPSG","26995"]')
    found = crs_from_wkt(text.encode())
    assert found is not None
    assert same_crs(found, feet)
    assert not same_crs(found, metres)
    assert 'AUTHORITY["EPSG","2255"]' in found.to_wkt("WKT1_GDAL")
    odd = crs_from_wkt(text.replace("2296583.333", "2296000").encode())
    assert odd is not None
    assert odd.to_json_dict().get("id") is None
    own = feet.to_wkt("WKT1_GDAL").encode()
    assert crs_from_wkt(own) == CRS.from_wkt(own.decode())


def test_heights_above_an_ellipsoid_are_in_the_unit_of_their_key() -> None:
    found = Units.of(_keys((1024, 1), (3072, 2278), (4096, 5030), (4099, 9003)))
    assert (found.horizontal, found.vertical) == (US_FOOT, US_FOOT)
    assert Units.of(_keys((1024, 1), (3072, 2278), (4096, 5030))).vertical == "metre"


def test_keys_with_numbers_and_names_of_their_own(tmp_path: Path) -> None:
    own = CRS.from_user_input(
        "+proj=tmerc +lat_0=12.5 +lon_0=-91.25 +k=0.99985 +x_0=345678 +units=m"
    )
    write_cog(
        tmp_path / "a.tif", np.ones((2, 2), np.float32), shape=(2, 2), origin_xy_m=(7.0, 9.0),
        cell_m=1.0, crs=own.to_wkt(), description="",
    )  # fmt: skip
    with Image.open(tmp_path / "a.tif") as image:
        keys, numbers, text = (image.tag_v2[number] for _, number in GEO_KEYS)  # type: ignore[attr-defined]
    directory, doubles = np.array(keys, "<u2").tobytes(), np.array(numbers, "<f8").tobytes()
    found = crs_from_geotiff(directory, doubles, str(text).encode())
    assert found is not None
    assert found.coordinate_operation == own.coordinate_operation
    bare = crs_from_geotiff(directory, b"", b"")
    assert bare is None or bare.coordinate_operation != own.coordinate_operation


@pytest.mark.parametrize(
    ("found", "survey", "ratio"),
    [
        ("EPSG:2278+6360", "EPSG:32615+5703", 1200 / 3937),
        ("EPSG:2278+6360", "EPSG:32615", 1200 / 3937),
        ("EPSG:4979", "EPSG:2992+8228", 1 / 0.3048),
        ("EPSG:4326", "EPSG:32615", 1.0),
        ("EPSG:4326", "EPSG:2992", None),
        ("EPSG:2278", "EPSG:2278+6360", 1.0),
        ("EPSG:2278", "EPSG:2278+5703", None),
        ("EPSG:2278", "EPSG:32140+6360", 1.0),
        ("EPSG:32140", "EPSG:2278+5703", 1.0),
        ("EPSG:32140", "EPSG:32140+6360", None),
        ("EPSG:2278", "EPSG:32615+5703", None),
        ("EPSG:2992", "EPSG:2278", None),
    ],
)
def test_heights_are_in_a_unit_that_is_stated_or_the_surveys(
    found: str, survey: str, ratio: float | None
) -> None:
    assert heights_ratio(*map(CRS.from_user_input, (found, survey))) == ratio


NAMELESS_FT = compound(
    CRS("EPSG:2278"),
    CRS(f'VERT_CS["unknown height",VERT_DATUM["unknown",2005],UNIT["ft",{1200 / 3937!r}]]'),
).to_wkt()


@pytest.mark.parametrize("code", [5703, 5773, 6360, 8228])
@pytest.mark.parametrize(
    ("unit", "words", "fits", "how"),
    [
        ("foot", "feet", 8228, "EPSG:8228 feet"),
        (US_FOOT, "US survey feet", 6360, "EPSG:6360 states US survey feet"),
    ],
)
def test_a_datum_of_heights_in_feet_is_named_in_feet(
    unit: str, words: str, fits: int, how: str, code: int
) -> None:
    crs = compound(CRS("EPSG:2278"), in_unit(SOME_HEIGHTS, unit))
    if code == fits:
        named = vertical(with_vertical(crs, f"EPSG:{code}", "key"))
        assert named is not None
        assert named.to_epsg() == fits
        return
    with pytest.raises(WorkflowError, match=f"key: the files' heights are in {words}, ") as caught:
        with_vertical(crs, f"EPSG:{code}", "key")
    assert f"(EPSG:{code}) is in " in str(caught.value)
    assert how in str(caught.value)


@pytest.mark.parametrize(
    ("found", "stated", "wanted"),
    [
        ("EPSG:2278", None, "EPSG:2278"),
        ("EPSG:2278", "EPSG:2278+5703", "EPSG:2278+5703"),
        ("EPSG:2278+6360", "EPSG:2278+5703", "EPSG:2278+6360"),
        ("EPSG:2278", "EPSG:32140+5703", "EPSG:2278"),
        (NAMELESS_FT, "EPSG:2278+6360", "EPSG:2278+6360"),
        (NAMELESS_FT, "EPSG:2278+5703", NAMELESS_FT),
        (NAMELESS_FT, "EPSG:2278+8228", NAMELESS_FT),
    ],
)
def test_a_user_states_what_a_file_leaves_open(found: str, stated, wanted: str) -> None:
    known = completed(CRS(found), None if stated is None else CRS(stated))
    assert known == CRS(wanted)


@pytest.mark.parametrize(
    ("found", "survey", "fault"),
    [
        ("EPSG:2278", "EPSG:2278+5703", "EPSG:2278.* US survey feet .* metres: remedy EPSG:2278"),
        ("EPSG:4326", "EPSG:2278+6360", "degrees .* US survey feet: remedy EPSG:4326.6360 .*8228"),
        ("EPSG:2278+6360", "EPSG:2278+5703", "in US survey feet .* the survey's in metres"),
        ("EPSG:32615+5773", "EPSG:32615+5703", "heights are .*EPSG:5773.*transform"),
        ("EPSG:4979", "EPSG:32615+5703", "above the ellipsoid by .*4979.*: transform it"),
        ("EPSG:32615+5703", "EPSG:4979", "survey's above the ellipsoid by .*4979"),
        ("EPSG:4979", "EPSG:4979", ""),
        ("EPSG:4979", "EPSG:32615", ""),
        ("EPSG:2278", "EPSG:2278+6360", ""),
        ("EPSG:32615+5703", "EPSG:32615", ""),
        (NAMELESS_FT, "EPSG:2278+6360", ""),
        (NAMELESS_FT, "EPSG:2278+5703", "in US survey feet .* the survey's in metres"),
        (
            NAMELESS_FT.replace("unknown height", "EGM96"),
            "EPSG:2278+6360",
            "'EGM96'.*no name.*reme",
        ),
        (
            NAMELESS_FT.replace("unknown height", "EGM96"),
            NAMELESS_FT.replace("unknown height", "EGM08"),
            "heights are 'EGM96', the survey's 'EGM08': transform it$",
        ),
    ],
)
def test_heights_are_no_ones_to_guess(found: str, survey: str, fault: str) -> None:
    message = heights_fault(CRS(found), CRS(survey), "remedy")
    assert re.search(fault, message) if fault else not message


def test_heights_with_the_grid_of_a_geoid_are_those_of_their_datum() -> None:
    flat = CRS("EPSG:6588").to_wkt("WKT1_GDAL")
    text = (
        f'COMPD_CS["x",{flat},VERT_CS["NAVD88 height (ftUS)",VERT_DATUM["North American Vertical '
        'Datum 1988",2005,EXTENSION["PROJ4_GRIDS","g2012a_conus.gtx"],AUTHORITY["EPSG","5103"]],'
        'UNIT["US survey foot",0.304800609601219,AUTHORITY["EPSG","9003"]],AXIS["Up",UP],'
        'AUTHORITY["EPSG","6360"]]]'
    )
    found = vertical(CRS(text))
    assert found is not None
    assert same_heights(found, CRS("EPSG:6360"))
    assert not same_heights(found, CRS("EPSG:5703"))
    assert not same_heights(found, CRS("EPSG:5773"))
