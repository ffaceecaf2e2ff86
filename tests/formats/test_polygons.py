"""Polygons of areas of interest and water."""

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from spl_batch.errors import InputError
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.transformations import kept_degrees, shape_transformers
from spl_batch.formats.vector_files import (
    check_polygons,
    contains,
    read_polygons,
    shapes_keep_degrees,
)

UTM = CRS.from_epsg(32615)


def write(path: Path, shapes: list[Any], crs: str | None = "EPSG:32615", **given: Any) -> Path:
    kind = given.pop("kind", "Polygon")
    pyogrio.raw.write(
        path,
        geometry=np.array([shapely.to_wkb(s) for s in shapes], dtype=object),
        field_data=[],
        fields=[],
        geometry_type=kind,
        crs=crs,
        **given,
    )
    return path


def quanta(*metres: float) -> np.ndarray[Any, np.dtype[np.int64]]:
    return (np.array(metres) * 1000).round().astype(np.int64)


def test_points_in_several_polygons(tmp_path: Path) -> None:
    holed = shapely.box(0, 0, 10, 10).difference(shapely.box(4, 4, 6, 6))
    path = write(tmp_path / "a.gpkg", [holed, shapely.box(20, 0, 30, 10)])
    area = read_polygons(path, UTM)
    inside = contains(area, quanta(5, 1, 25, 15, 0.001, -0.001), quanta(5, 1, 5, 5, 5, 5))
    assert inside.tolist() == [False, True, True, False, True, False]


def test_reprojected(tmp_path: Path) -> None:
    square = shapely.box(500_000, 4_000_000, 500_100, 4_000_100)
    back = Transformer.from_crs(UTM, "EPSG:4326", always_xy=True)
    degrees = shapely.transform(square, lambda c: np.column_stack(back.transform(*c.T)))
    for name, options in (("a.gpkg", {"crs": "EPSG:4326"}), ("a.geojson", {"crs": "EPSG:4326"})):
        area = read_polygons(write(tmp_path / name, [degrees], **options), UTM)
        assert area.symmetric_difference(square).area < 0.01


def test_a_missing_grid_is_named_in_place_of_the_next_best_operation(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.gpkg", [shapely.box(400_000, 300_000, 401_000, 301_000)], "EPSG:27700"
    )
    with pytest.raises(InputError, match=r"pyproj sync --file uk_os_OSTN15_NTv2_OSGBtoETRS\.tif"):
        read_polygons(path, CRS.from_epsg(25830))


@pytest.mark.parametrize(
    ("degrees", "own", "wanted", "accuracy"),
    [
        ("EPSG:4269", "EPSG:4269", "EPSG:6344", "6 m"),
        ("EPSG:4269", "EPSG:26915", "EPSG:6588", "6 m"),
        ("EPSG:4152", "EPSG:4152", "EPSG:6344", "4 m"),
        ("EPSG:6318", "EPSG:6318", "EPSG:6344", ""),
        ("EPSG:4326", "EPSG:4326", "EPSG:6344", ""),
    ],
)
def test_realisations_of_a_datum_keep_their_degrees_without_a_grid(
    tmp_path: Path, degrees: str, own: str, wanted: str, accuracy: str
) -> None:
    survey = CRS(wanted)
    box = shapely.box(-94.001, 30.0, -94.0, 30.001)
    for crs in (own, wanted):
        there = Transformer.from_crs(degrees if crs == own else "EPSG:6318", crs, always_xy=True)
        moved = shapely.transform(box, lambda xy, to=there: np.column_stack(to.transform(*xy.T)))
        write(tmp_path / f"{crs[5:]}.gpkg", [moved], crs)
    name = tmp_path / f"{own[5:]}.gpkg"
    area, exact = (read_polygons(path, survey) for path in (name, tmp_path / f"{wanted[5:]}.gpkg"))
    assert area.symmetric_difference(exact).area < 1e-3 * area.length
    remarks = shapes_keep_degrees(name, survey)
    assert len(remarks) == bool(accuracy)
    assert all(f"accurate to {accuracy} by EPSG, as PROJ lacks" in text for text in remarks)
    assert all("pyproj sync --file us_noaa" in text for text in remarks)


def test_points_beside_polygons_are_not_asked_for_their_degrees(tmp_path: Path) -> None:
    survey, path = CRS.from_epsg(6344), tmp_path / "a.gpkg"
    write(path, [shapely.box(400_000, 3_300_000, 400_100, 3_300_100)], "EPSG:6344", layer="areas")
    write(path, [shapely.Point(-94, 30)], "EPSG:4269", kind="Point", layer="marks", append=True)
    assert kept_degrees(CRS.from_epsg(4269), survey)
    assert shapes_keep_degrees(path, survey) == []


@pytest.mark.parametrize(
    ("own", "survey"), [(4267, 6344), (4301, 6677), (4313, 3812), (4314, 25832), (27700, 25830)]
)
def test_shapes_of_another_datum_do_not_keep_their_degrees(own: int, survey: int) -> None:
    ends = CRS.from_epsg(own), CRS.from_epsg(survey)
    assert not kept_degrees(*ends)
    with pytest.raises(ProjError, match="pyproj sync --file"):
        shape_transformers(*ends)


def test_every_layer_and_only_polygons(tmp_path: Path) -> None:
    path = tmp_path / "a.gpkg"
    write(path, [shapely.box(0, 0, 1, 1)], layer="one")
    write(path, [shapely.box(2, 0, 3, 1)], layer="two", append=True)
    write(path, [shapely.Point(9, 9)], layer="three", append=True, kind="Point")
    assert read_polygons(path, UTM).area == 2


def test_faults(tmp_path: Path) -> None:
    text, empty = tmp_path / "a.gpkg", tmp_path / "empty.geojson"
    text.write_text("this is no vector file")
    empty.write_text(json.dumps({"type": "FeatureCollection", "features": []}))
    square = [shapely.box(0, 0, 1, 1)]
    cases = {
        "no such file": (tmp_path / "missing.gpkg", UTM),
        "cannot be read": (text, UTM),
        "no polygons": (write(tmp_path / "p.gpkg", [shapely.Point(0, 0)], kind="Point"), UTM),
        "holds no polygons": (empty, UTM),
        "the survey has no CRS": (write(tmp_path / "s.gpkg", square), None),
    }
    for words, (path, crs) in cases.items():
        with pytest.raises(InputError) as caught:
            read_polygons(path, crs)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore:'crs' was not provided")
def test_without_a_crs(tmp_path: Path) -> None:
    path = write(tmp_path / "a.shp", [shapely.box(0, 0, 1, 1)], crs=None)
    with pytest.raises(InputError, match="has no CRS"):
        read_polygons(path, UTM)
    assert read_polygons(path, None).area == 1


SQUARE, FAR = shapely.box(0, 0, 9, 9), shapely.box(20, 0, 29, 9)
RING = struct.pack("<II", shapely.GeometryType.POLYGON, 1)
"""Type of a polygon in WKB, and the number of its rings."""


def edited(at: int, layout: str, value: float) -> Callable[[Path], Path]:
    """Two polygons in a GeoPackage, of one of which a number is another."""

    def make(path: Path) -> Path:
        content = bytearray(write(path, [SQUARE, FAR]).read_bytes())
        struct.pack_into(layout, content, content.index(RING) + at, value)
        path.write_bytes(content)
        return path

    return make


def halved(path: Path) -> Path:
    content = write(path, [SQUARE]).read_bytes()
    path.write_bytes(content[: len(content) // 2])
    return path


UNCLOSED = "feature 2: has no geometry that can be decoded"
DAMAGED = {
    "rings beyond the file": (edited(4, "<I", 2**32 - 1), UNCLOSED),
    "points beyond the file": (edited(8, "<I", 2**32 - 1), UNCLOSED),
    "a type that is none": (edited(0, "<I", 99), UNCLOSED),
    "a point": (edited(0, "<I", 1), "feature 2: is no polygon, in a layer of polygons"),
    "a ring that does not close": (edited(12, "<d", 7e300), UNCLOSED),
    "no number": (
        lambda path: write(path, [SQUARE, shapely.Polygon([(0, 0), (np.nan, 1), (2, 2)])]),
        "feature 2: has a coordinate that is no number",
    ),
    "beyond Earth": (
        lambda path: write(path, [SQUARE, shapely.box(0, 0, 9, 1e10)]),
        "feature 2: has a coordinate that is no number, or beyond 1e9",
    ),
    "none": (lambda path: write(path, [SQUARE, FAR, shapely.Polygon()][2:]), "holds no polygons"),
    "without an area": (
        lambda path: write(path, [shapely.Polygon([(0, 0), (5, 5), (9, 9)])]),
        "holds no polygons",
    ),
    "half a file": (
        halved,
        "cannot be read as shapes",
    ),
}


@pytest.mark.parametrize("case", DAMAGED)
@pytest.mark.parametrize("read", [check_polygons, read_breaklines])
@pytest.mark.filterwarnings("ignore:invalid value encountered")
def test_a_damaged_shape_among_sound_ones_is_refused_by_its_number(
    tmp_path: Path, case: str, read: Callable[[Path, CRS], Any]
) -> None:
    make, message = DAMAGED[case]
    with pytest.raises(InputError) as caught:
        read(make(tmp_path / "a.gpkg"), UTM)
    assert str(caught.value).startswith(str(tmp_path / "a.gpkg"))
    if case != "without an area" or read is check_polygons:
        assert message in str(caught.value)
