"""What a client asks for: tiles by polygons, heights above ground, contours, dropped points."""

import json
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any, NamedTuple

import laspy
import numpy as np
import numpy.lib.recfunctions as rfn
import pyogrio
import pytest
import rasterio
import shapely
from contourpy import contour_generator
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import CRS
from scipy.interpolate import RegularGridInterpolator

from spl_batch.airborne.catalogue.catalogues import in_units
from spl_batch.airborne.report.verdicts import screen_summary
from spl_batch.airborne.tasks import client_tiles, delivered_points, index
from spl_batch.errors import grouped
from spl_batch.formats.las.cut import Piece, write_cut
from spl_batch.formats.las.header import read_header
from spl_batch.formats.named_areas import lies_in, read_named_areas
from spl_batch.formats.rasters import parts
from spl_batch.formats.units import Units
from tests import surveys

EAST, NORTH = surveys.ORIGIN_M
TILES = {
    "A": shapely.box(EAST - 20, NORTH - 30, EAST + 3, NORTH + 30),
    # A slanted edge, and the corner that both share lies on points' coordinates.
    "B-2": shapely.Polygon(
        [
            (EAST + 3, NORTH - 30), (EAST + 6, NORTH - 30),
            (EAST + 5, NORTH + 30), (EAST + 3, NORTH + 30),
        ]
    ),
    "c": shapely.box(EAST + 6.1, NORTH - 30, EAST + 6.4, NORTH + 30),
    "far away": shapely.box(EAST + 500, NORTH, EAST + 600, NORTH + 100),
}  # fmt: skip
KEYS = ("X", "Y", "Z", "gps_time", "channel", "user_data", "point_source_id", "classification")
OUTPUTS: dict[str, Any] = {
    "height_above_ground": True,
    "drop": ["noise", "withheld", "outside"],
    "client_tiles": {"polygons": "tiles.gpkg", "name": "tile"},
    "contour_interval": 0.1,
    "tiles": "laz",
}
FEET = "EPSG:2278+6360"
SURVEY = {"organisation": "Survey <Ltd>", "contact": "maps@example.org", "licence": "CC-BY-4.0"}


def write_tiles(path: Path, tiles: dict[str, Any], crs: str = surveys.CRS_NAME) -> Path:
    return surveys.write_shapes(path, tiles.values(), crs, tile=tiles)


class Runs(NamedTuple):
    plain: Path
    asked: Path
    report: Any
    other: Path  #: The same with other tiles of work, short chunks, and octrees.


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    found = {}
    for name, outputs, tile_m in (
        ("plain", {}, 100),
        ("asked", OUTPUTS, 100),
        ("other", {**OUTPUTS, "client_tiles": {**OUTPUTS["client_tiles"], "format": "copc"}}, 7),
    ):
        folder = tmp_path_factory.mktemp(name)
        write_tiles(folder / "tiles.gpkg", TILES)
        area = shapely.box(EAST - 50, NORTH - 50, EAST + 6.5, NORTH + 50)
        write_tiles(folder / "aoi.gpkg", {"aoi": area})
        workflow = surveys.small_survey(
            folder,
            survey=SURVEY,
            aoi="aoi.gpkg",
            classes={"withheld": True},
            tiling={"tile_m": tile_m},
            outputs=outputs,
        )
        for k, path in enumerate(sorted((folder / "lines").glob("*.laz"))):
            las = laspy.read(path)
            las.withheld[:20] = 1
            las.x[40:60] = EAST + 3  # on the edge that two tiles share
            if k:  # another offset, and a dimension that the first file lacks
                las.add_extra_dim(laspy.ExtraBytesParams("grade", np.uint16))
                las.grade = np.arange(len(las.points)) + 1
                las.change_scaling(offsets=[EAST, NORTH, 0.0])
            las.write(path)
        with pytest.MonkeyPatch.context() as patched:
            for module in (index, delivered_points, client_tiles) * (name == "other"):
                patched.setattr(module, "CHUNK_POINTS", 500)
            patched.setattr(parts, "BLOCK", 3 if name == "other" else 1024)
            found[name] = surveys.run(workflow)
        assert found[name].exit_status == 0, found[name].report.failures
    asked = found["asked"]
    return Runs(found["plain"].output, asked.output, asked.report, found["other"].output)


def rows(path: Path) -> np.ndarray:
    """Points of a cloud by what identifies them, x, y, z first [mm]."""
    las = laspy.read(path)
    xyz = np.rint(las.xyz * 1000)
    return np.column_stack([xyz, *(np.asarray(las[name], float) for name in KEYS[3:])])


def together(paths: Any) -> np.ndarray:
    found = np.concatenate([rows(path) for path in paths])
    return found[np.lexsort(found.T)]


def test_every_point_is_delivered_or_counted_as_dropped(runs: Runs) -> None:
    counts = runs.report.counts
    assert counts.points_in == counts.points_out + sum(counts.dropped.values())
    assert sum(counts.classes.values()) == counts.points_out
    whole = surveys.delivered(runs.plain)
    left = surveys.delivered(runs.asked)
    tally = dict.fromkeys(OUTPUTS["drop"], 0)
    for name, columns in whole.items():
        noise = np.isin(columns["classification"], (7, 18))
        withheld = ~noise & (columns["withheld"] == 1)
        given = laspy.read(runs.plain / "laz" / name)
        outside = ~noise & ~withheld & (np.asarray(given.x) >= EAST + 6.5)
        for kind, mask in zip(tally, (noise, withheld, outside), strict=True):
            tally[kind] += int(mask.sum())
        kept = ~(noise | withheld | outside)
        for key in KEYS:
            assert np.array_equal(columns[key][kept], left[name][key]), key
    assert counts.dropped == tally
    assert min(tally.values()) > 0
    classes = np.concatenate([c["classification"] for c in left.values()])
    assert counts.classes == {str(k): int(n) for k, n in enumerate(np.bincount(classes)) if n}


def test_tiles_of_work_are_without_dropped_points(runs: Runs) -> None:
    for output in (runs.asked, runs.other):
        tiles = [laspy.read(path) for path in (output / "tiles").glob("*.laz")]
        assert sum(map(len, tiles)) == runs.report.counts.points_out
        assert not any(np.any(tile.withheld) for tile in tiles)


def test_a_point_lies_in_one_tile_or_in_none(runs: Runs) -> None:
    folder = runs.asked / "client_tiles"
    assert sorted(p.name for p in folder.glob("*.laz")) == ["A.laz", "B-2.laz", "c.laz"]
    whole = together((runs.asked / "laz").rglob("*.laz"))
    x, y = whole[:, 0] / 1000, whole[:, 1] / 1000
    in_a = x < EAST + 3
    in_b = ~in_a & shapely.contains_xy(TILES["B-2"], x + 1e-5, y)
    in_c = (x >= EAST + 6.1) & (x < EAST + 6.4)
    in_none = ~(in_a | in_b | in_c)
    assert min(in_a.sum(), in_b.sum(), in_c.sum(), in_none.sum(), (x == EAST + 3).sum()) > 0
    assert np.array_equal(together([folder / "A.laz"]), whole[in_a])
    assert np.array_equal(together([folder / "B-2.laz"]), whole[in_b])
    assert np.array_equal(together([folder / "c.laz"]), whole[in_c])
    tiles = {one.name: one.points for one in runs.report.client_tiles}
    assert tiles == {"A": in_a.sum(), "B-2": in_b.sum(), "c": in_c.sum(), "far away": 0}
    assert runs.report.counts.in_no_client_tile == in_none.sum()
    shown = dict(screen_summary(runs.report))["client tiles"]
    beside = f"{grouped(in_none.sum())} points lie in none"
    assert shown == f"4, 1 of them without points (far away); {beside}"
    cut = laspy.read(folder / "A.laz")
    first, second = (cut.points[cut.point_source_id == k] for k in (1, 2))
    assert not np.any(first["grade"])
    assert np.all(second["grade"] > 0)


def test_tiles_do_not_depend_on_the_tiles_of_work(runs: Runs) -> None:
    for path in sorted((runs.asked / "client_tiles").glob("*.tif")):
        assert path.read_bytes() == (runs.other / "client_tiles" / path.name).read_bytes()
    for name in ("A", "B-2", "c"):
        octree = runs.other / "client_tiles" / f"{name}.copc.laz"
        assert np.array_equal(together([runs.asked / "client_tiles" / f"{name}.laz"]),
                              together([octree]))  # fmt: skip
    assert surveys.results(runs.asked) == surveys.results(runs.other)


def test_rasters_of_tiles_are_those_of_the_survey(runs: Runs) -> None:
    assert not list((runs.asked / "client_tiles").glob("far*"))
    for product in surveys.PRODUCTS:
        with rasterio.open(runs.asked / f"{product}.tif") as source:
            for name in ("A", "B-2"):
                with rasterio.open(runs.asked / "client_tiles" / f"{name}_{product}.tif") as cut:
                    values = cut.read(1)
                    window = rasterio.windows.from_bounds(*cut.bounds, source.transform)
                    whole = source.read(1, window=window)
                    inside = ~rasterio.features.geometry_mask(
                        [TILES[name]], cut.shape, cut.transform
                    )
                    assert np.array_equal(values, np.where(inside, whole, source.nodata))
                    assert (cut.crs, cut.units) == (source.crs, source.units)


def test_heights_above_the_terrain(runs: Runs) -> None:
    with rasterio.open(runs.asked / "dtm.tif") as source:
        dtm = source.read(1, masked=True).filled(np.nan)
        place = source.transform
    east = place.c + (np.arange(dtm.shape[1]) + 0.5)
    north = place.f - (np.arange(dtm.shape[0]) + 0.5)
    terrain = RegularGridInterpolator(
        (north[::-1], east), dtm[::-1].astype(float), bounds_error=False
    )
    for path in (runs.asked / "laz").rglob("*.laz"):
        las = laspy.read(path)
        found = np.asarray(las["HeightAboveGround"])
        expected = np.asarray(las.z) - terrain(np.column_stack([las.y, las.x]))
        known = np.isfinite(expected)
        assert known.mean() > 0.7
        assert np.allclose(found[known], expected[known], atol=2e-4)
        x, y = np.asarray(las.x), np.asarray(las.y)
        cell = dtm[((place.f - y) // 1).astype(int), ((x - place.c) // 1).astype(int)]
        assert np.array_equal(np.isnan(found), np.isnan(cell))


def test_contours_lie_at_their_heights(runs: Runs) -> None:
    assert not (runs.plain / "contours.gpkg").exists()
    meta, _, shapes, (heights,) = pyogrio.raw.read(runs.asked / "contours.gpkg")
    assert meta["crs"] == surveys.CRS_NAME
    with rasterio.open(runs.asked / "dtm.tif") as source:
        dtm, place = source.read(1, masked=True).filled(np.nan).astype(float), source.transform
    whole = contour_generator(z=np.ma.masked_invalid(dtm))
    lengths = {}
    for output in (runs.asked, runs.other):
        _, _, found, (of_found,) = pyogrio.raw.read(output / "contours.gpkg")
        for line, height in zip(shapely.from_wkb(found), of_found, strict=True):
            key = output, round(height * 10)
            lengths[key] = lengths.get(key, 0.0) + line.length
    for (_, tenth), length in lengths.items():
        expected = sum(shapely.LineString(one).length for one in whole.lines(tenth * 0.1))
        assert length == pytest.approx(expected, rel=1e-6)
    assert np.allclose(heights / 0.1, np.rint(heights / 0.1))
    assert set(np.rint(heights * 10)) == {200, 201, 202}
    terrain = RegularGridInterpolator(
        (place.f - np.arange(dtm.shape[0])[::-1] - 0.5, place.c + np.arange(dtm.shape[1]) + 0.5),
        dtm[::-1],
        bounds_error=False,
    )
    for line, height in zip(shapely.from_wkb(shapes), heights, strict=True):
        corners = shapely.get_coordinates(line)
        found = terrain(corners[:, ::-1])
        assert np.nanmax(np.abs(found - height), initial=0.0) < 1e-4


def test_the_catalogue_names_who_delivers(runs: Runs) -> None:
    collection = json.loads((runs.asked / "stac" / "collection.json").read_text())
    assert collection["license"] == SURVEY["licence"]
    producer = collection["providers"][0]
    assert (producer["name"], producer["roles"]) == (SURVEY["organisation"], ["producer"])
    assert SURVEY["contact"] in producer["description"]
    assert runs.report.survey.licence == SURVEY["licence"]
    page = (runs.asked / "report.html").read_text()
    assert "Survey &lt;Ltd&gt;" in page
    assert "2 ground" in page


def test_a_tile_that_cannot_be_written_fails_alone(tmp_path: Path) -> None:
    write_tiles(tmp_path / "tiles.gpkg", TILES)
    workflow = surveys.small_survey(tmp_path, outputs={"client_tiles": OUTPUTS["client_tiles"]})
    (tmp_path / "out" / "client_tiles" / "A.laz").mkdir(parents=True)
    result = surveys.run(workflow)
    assert result.exit_status == 1
    assert ["client_tiles/A.laz" in one.reason for one in result.report.failures] == [True], (
        result.report.failures
    )
    assert [one.name for one in result.report.client_tiles] == ["B-2", "c", "far away"]


@pytest.mark.parametrize(("crs", "unit_m"), [(surveys.CRS_NAME, 1.0), (FEET, 1200 / 3937)])
def test_points_that_nothing_has_looked_at_are_outside_by_their_place(
    tmp_path: Path, crs: str, unit_m: float
) -> None:
    path = surveys.write_cloud(tmp_path / "m.laz", surveys.flightline(shots=20))
    cloud = surveys.in_feet(path, tmp_path / "ft.laz", FEET, [unit_m] * 3) if crs == FEET else path
    las = laspy.read(cloud)
    x, y = np.asarray(las.x), np.asarray(las.y)
    middle = np.median(x)
    area = shapely.box(x.min() - 1, y.min() - 1, middle, y.max() + 1)
    write_tiles(tmp_path / "aoi.gpkg", {"aoi": area}, crs=crs)
    context: Any = SimpleNamespace(
        workflow=SimpleNamespace(aoi="aoi.gpkg"),
        resolve=tmp_path.joinpath,
        crs=CRS.from_user_input(crs),
        units=Units.of(CRS.from_user_input(crs)),
    )
    records = las.points.array.copy()
    las_flags = np.zeros(len(records), np.uint8)
    records = rfn.append_fields(records[["X", "Y", "classification"]], "classification_flags",
                                las_flags, usemask=False)  # fmt: skip
    labels = {
        "flags": np.full(len(records), delivered_points.IN_NO_TILE, np.uint8),
        "classification": np.full(len(records), 255, np.uint8),
        "copied": np.zeros(len(records), bool),
    }
    labels["flags"][:3] = 0  # what a tile has is inside by its label
    header = read_header(cloud)
    outside = x > middle
    outside[:3] = False
    for kinds, kept in ((["outside"], ~outside), (["withheld"], np.ones_like(outside))):
        dropping = delivered_points.Dropping(kinds, len(records), header, context)
        assert np.array_equal(dropping(records, labels)[x != middle], kept[x != middle])
    assert outside.any()


def test_what_two_polygons_share_by_rounding_is_the_first_ones(tmp_path: Path) -> None:
    shapes = {"a": shapely.box(0, 0, 10, 10), "b": shapely.box(9.9985, 0, 20, 10)}
    path = write_tiles(tmp_path / "tiles.gpkg", shapes)
    areas = read_named_areas(path, CRS.from_user_input(surveys.CRS_NAME), "tile")
    x, y = np.array([0, 9.997, 9.998, 9.999, 10.0, 20.0]), np.full(6, 5.0)
    assert [lies_in(one.shape, x, y).tolist() for one in areas] == [
        [True, True, True, True, False, False],
        [False, False, False, False, True, False],
    ]


@pytest.mark.parametrize("crs", [FEET, "EPSG:2992+8228", surveys.CRS_NAME])
@given(
    west=st.integers(200_000, 3_500_000),
    south=st.integers(3_000_000, 9_500_000),
    edge=st.integers(1, 4),
    scale=st.sampled_from([0.01, 0.001, 0.0025]),
    before=st.sampled_from([0, 77, 1_000]),
)
@settings(max_examples=10, deadline=None)
def test_whole_units_on_an_edge_are_the_eastern_and_the_northern_tiles(
    crs: str, west: int, south: int, edge: int, scale: float, before: int
) -> None:
    known = CRS.from_user_input(crs)
    tiles = {
        f"{i}_{j}": shapely.box(*(np.array([i, j, i + 1, j + 1]) * edge + [west, south] * 2))
        for i in range(2)
        for j in range(2)
    }
    quarters = np.arange(-1, 2 * edge * 4 + 1)
    east, north = (grid.ravel() for grid in np.meshgrid(quarters, quarters))
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, scale), np.array([west - before, south - before, 0])
    las = laspy.LasData(header)
    las.x, las.y, las.z = west + east / 4, south + north / 4, np.zeros(len(east))
    las.intensity = np.arange(len(east))
    with TemporaryDirectory() as folder:
        path = write_tiles(Path(folder, "tiles.gpkg"), tiles, crs=crs)
        cloud, cut = Path(folder, "whole.laz"), Path(folder, "cut.laz")
        las.write(cloud)
        for one in read_named_areas(path, known, "tile"):
            area = in_units(one.shape, Units.of(known))
            shapely.prepare(area)
            assert write_cut(cut, [Piece(cloud, [(0, len(east))])], partial(lies_in, area))
            i, j = map(int, one.name.split("_"))
            own = (east // (4 * edge) == i) & (north // (4 * edge) == j)
            assert np.array_equal(laspy.read(cut).intensity, np.flatnonzero(own))


@pytest.mark.parametrize(
    ("tiles", "outputs", "words"),
    [
        ({"A": TILES["A"], "C": TILES["A"].buffer(-1)}, {}, ("polygons overlap: A and C",)),
        ({"A": TILES["A"], "../b": TILES["B-2"]}, {}, ("'../b'", "names of files")),
        ({"A": TILES["A"], "a": TILES["B-2"]}, {}, ("A, a name several polygons",)),
        ({"A": TILES["A"]}, {"name": "sheet"}, ("no field 'sheet'", "there is tile")),
        ({"A": TILES["far away"]}, {}, ("none of its polygons meets the survey",)),
    ],
)
def test_tiles_that_cannot_be(
    tmp_path: Path, tiles: dict[str, Any], outputs: dict[str, Any], words: tuple[str, ...]
) -> None:
    write_tiles(tmp_path / "tiles.gpkg", tiles)
    asked = {"client_tiles": {**OUTPUTS["client_tiles"], **outputs}}
    ended = surveys.command("plan", surveys.small_survey(tmp_path, outputs=asked))
    assert ended.status == 2
    assert len(ended.err.strip().splitlines()) == 1
    assert all(text in ended.err for text in ("tiles.gpkg", *words)), ended.err
