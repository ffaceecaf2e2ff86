"""Catalogues of one delivery: schemas offline, every link there, every number counted again."""

import datetime as dt
import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from jsonschema import Draft7Validator
from jsonschema.validators import validator_for
from pyproj import CRS
from pyproj.datadir import get_data_dir
from pystac.validation.local_validator import get_local_schema_cache
from referencing import Registry, Resource
from referencing.jsonschema import DRAFT7

from spl_batch.airborne.catalogue.catalogues import Layer, write_catalogues, write_layers
from spl_batch.airborne.settings import SurveySettings
from spl_batch.formats.crs import in_unit, same_crs
from spl_batch.formats.units import FOOT, METRE, US_FOOT, Units
from tests import surveys
from tests.formats.test_geoid import by_hand, write_grid

PROJJSON = json.loads(Path(get_data_dir(), "projjson.schema.json").read_text(encoding="utf-8"))
EXTENSIONS = {
    # As their projects publish them, Apache License 2.0; PROJ brings its own.
    **{
        content["$id"].rstrip("#"): content
        for path in (Path(__file__).parent / "schemas").glob("*.json")
        for content in [json.loads(path.read_text(encoding="utf-8"))]
    },
    **{f"https://proj.org/schemas/v0.{k}/projjson.schema.json": PROJJSON for k in (5, 7)},
}


def schema(uri: str) -> Draft7Validator:
    known = {**get_local_schema_cache(), **EXTENSIONS}
    found = known[uri]
    registry = Registry().with_resources(
        [(key, Resource.from_contents(content, default_specification=DRAFT7))
         for key, content in known.items()]
    )  # fmt: skip
    return validator_for(found, Draft7Validator)(found, registry=registry)


CORE = "https://schemas.stacspec.org/v1.1.0/{0}-spec/json-schema/{0}.json"


def faults(content: dict[str, Any]) -> list[str]:
    kind = {"Feature": "item", "Collection": "collection"}[content["type"]]
    uris = [CORE.format(kind), *content.get("stac_extensions", [])]
    return [error.message for uri in uris for error in schema(uri).iter_errors(content)]


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("catalogued")
    workflow = surveys.small_survey(
        folder,
        outputs={
            "copc": True,
            "crs": "EPSG:2278",
            "geoid": {"grid": write_grid(folder / "a.gtx"), "crs": "EPSG:5703"},
        },
        reference={"checkpoints": "checkpoints.csv"},
    )
    x, y = (value for value in surveys.ORIGIN_M)
    lines = ["id,x,y,z,surface,accuracy_m"]
    lines += [f"P{k},{x + 2 + k},{y},{20.0 + 0.05 * (2 + k)},open,0.01" for k in range(6)]
    lines += ["AWAY,0,0,0,open,0.01"]
    (folder / "checkpoints.csv").write_text("\n".join(lines) + "\n")
    result = surveys.run(workflow)
    assert result.exit_status == 0
    return result.output


def read(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def test_stac_keeps_to_its_schemas(output: Path) -> None:
    items = read(output / "stac" / "items.json")["features"]
    assert len(items) == 14 + 2 * len([*(output / "laz").rglob("*.laz")])
    assert faults(read(output / "stac" / "collection.json")) == []
    assert [fault for item in items for fault in faults(item)] == []
    broken = {**items[0], "properties": {**items[0]["properties"], "pc:count": -1}}
    assert faults(broken) != [], "the check finds something"
    assert faults({**items[0], "bbox": [0]}) != []
    shape = {**items[-1], "properties": {**items[-1]["properties"], "proj:shape": [1, 2, 3]}}
    assert faults(shape) != []


def test_models_come_above_the_geoid_in_a_crs_that_says_so(output: Path) -> None:
    items = {item["id"]: item for item in read(output / "stac" / "items.json")["features"]}
    for model in ("dtm", "dsm"):
        with rasterio.open(output / f"{model}.tif") as source:
            plain, transform, nodata = source.read(1), source.transform, source.nodata
        with rasterio.open(output / f"{model}_geoid.tif") as source:
            above = source.read(1)
            assert source.transform == transform
            assert CRS.from_wkt(source.crs.to_wkt()).sub_crs_list[1].to_epsg() == 5703
        known = plain != nodata
        assert np.array_equal(above != nodata, known)
        place = rasterio.transform.xy(transform, *np.nonzero(known))
        np.testing.assert_allclose(plain[known] - above[known], by_hand(*place), atol=2e-4)
        assert "NAVD88" in items[f"{model}_geoid"]["properties"]["proj:wkt2"]
        assert "NAVD88" not in items[model]["properties"]["proj:wkt2"]
    files = read(output / "report.json")["provenance"]["inputs"]
    assert [file["path"] for file in files if file["role"] == "geoid"] == ["a.gtx"]


def test_what_lies_in_another_crs_is_listed_in_it(output: Path) -> None:
    items = {item["id"]: item for item in read(output / "stac" / "items.json")["features"]}
    moved = [name for name in items if name.startswith("reprojected-")]
    assert len(moved) == 6 + len([*(output / "laz").rglob("*.laz")])
    for name in moved:
        found = items[name]
        same = items[name.removeprefix("reprojected-").replace("laz-", "copc-")]
        assert "Texas South Central" in found["properties"]["proj:wkt2"]
        assert found["properties"]["proj:bbox"][0] > 2e6, "in feet"
        corners = (np.reshape(one["bbox"], (2, -1))[:, :2] for one in (found, same))
        ours, theirs = (shapely.box(*corner.ravel()) for corner in corners)
        assert ours.intersection(theirs).area > 0.5 * theirs.area
        assert found["properties"].get("pc:count") == same["properties"].get("pc:count")


def test_every_link_of_stac_leads_somewhere(output: Path) -> None:
    folder = output / "stac"
    pages = [read(path) for path in folder.glob("*.json") if path.name != "items.json"]
    targets = [link["href"] for page in pages for link in page["links"]]
    targets += [asset["href"] for page in pages for asset in page.get("assets", {}).values()]
    assert len(targets) > 10
    assert [t for t in targets if t.startswith(("/", "http"))] == []
    assert [t for t in targets if not (folder / t).resolve().is_file()] == []
    listed = [link["href"] for link in read(folder / "collection.json")["links"]
              if link["rel"] == "item"]  # fmt: skip
    assert len(listed) == len(pages) - 1


def test_items_hold_what_the_files_do(output: Path) -> None:
    for item in read(output / "stac" / "items.json")["features"]:
        path = output / "stac" / item["assets"]["data"]["href"]
        found = item["properties"]
        if path.suffix == ".tif":
            with rasterio.open(path) as source:
                assert found["proj:shape"] == list(source.shape)
                assert found["proj:bbox"] == list(source.bounds)
                assert found["proj:transform"] == list(source.transform)[:6]
            continue
        cloud = laspy.read(path)
        assert found["pc:count"] == len(cloud)
        low, high = np.min(cloud.xyz, axis=0), np.max(cloud.xyz, axis=0)
        np.testing.assert_allclose(found["proj:bbox"], [*low, *high], atol=1e-6)
        assert [one["name"] for one in found["pc:schemas"]] == list(
            cloud.point_format.dimension_names
        )
        first = dt.datetime.fromisoformat(found["start_datetime"])
        # adjusted standard time of 2024 and before is 18 leap seconds ahead of UTC
        seconds = (first - dt.datetime(1980, 1, 6, tzinfo=dt.UTC)).total_seconds()
        assert seconds - 1e9 + 18 == pytest.approx(np.min(cloud.gps_time), abs=1e-3)
        west, south, _, east, north, _ = item["bbox"]
        assert -96 < west < east < -95
        assert 29 < south < north < 30


def test_the_virtual_cloud_is_what_its_readers_want(output: Path) -> None:
    content = read(output / "survey.vpc")
    assert content["type"] == "FeatureCollection"
    clouds = {}
    for feature in content["features"]:
        assert feature["stac_version"] == "1.0.0"
        for uri in feature["stac_extensions"]:
            assert [error.message for error in schema(uri).iter_errors(feature)] == []
        path = output / next(iter(feature["assets"].values()))["href"]
        with laspy.open(path) as reader:
            clouds[path.name] = reader.header.point_count
            bounds = [*reader.header.mins, *reader.header.maxs]
        assert feature["properties"]["pc:count"] == clouds[path.name]
        assert feature["properties"]["proj:bbox"] == pytest.approx(bounds)
        assert feature["properties"]["proj:wkt2"].startswith("PROJCRS")
        assert feature["properties"]["proj:geometry"]["type"] == "Polygon"
    assert all(name.endswith(".copc.laz") for name in clouds)
    assert len(clouds) == len([*(output / "laz").rglob("*.laz")])


def test_copc_holds_the_same_points(output: Path) -> None:
    for path in sorted((output / "laz").rglob("*.laz")):
        twin = output / "copc" / path.relative_to(output / "laz").with_suffix(".copc.laz")
        plain = laspy.read(path)
        with laspy.CopcReader.open(twin) as reader:
            octree = reader.query()
        names = list(plain.point_format.dimension_names)
        assert names == list(octree.point_format.dimension_names)
        rows = [
            np.column_stack([np.asarray(cloud[name], np.float64) for name in names])
            for cloud in (plain, octree)
        ]
        sorted_rows = [np.array(sorted(map(tuple, np.nan_to_num(r, nan=-1.0)))) for r in rows]
        np.testing.assert_array_equal(*sorted_rows)


def test_the_index_counts_what_is_there(output: Path) -> None:
    layers = {name for name, _ in pyogrio.list_layers(output / "index.gpkg")}
    assert layers == {"checkpoints", "flightlines", "files"}
    columns: dict[str, Any] = {}
    places: dict[str, Any] = {}
    for layer in layers:
        meta, _, shapes, values = pyogrio.raw.read(output / "index.gpkg", layer=layer)
        columns[layer] = dict(zip(meta["fields"], values, strict=True))
        places[layer] = shapes
        assert len(shapes)
        assert "32615" in str(meta["crs"])
    points = sum(len(laspy.read(path)) for path in (output / "laz").rglob("*.laz"))
    for layer in ("files", "flightlines"):
        assert columns[layer]["points"].sum() == points
        if layer == "flightlines":
            continue
        areas = shapely.area(shapely.from_wkb(places[layer]))
        per_m2 = columns[layer]["points"] / areas
        np.testing.assert_allclose(columns[layer]["per_m2"], per_m2, rtol=1e-6)
    lines = shapely.from_wkb(places["flightlines"])
    drawn = dict(zip(columns["flightlines"]["id"], lines, strict=True))
    report = read(output / "report.json")
    swaths = {one["id"]: one for one in report["swaths"]}
    for name, area, density in zip(
        *(columns["flightlines"][key] for key in ("id", "area_m2", "per_m2")), strict=True
    ):
        assert area == swaths[name]["area_m2"]
        assert density == pytest.approx(swaths[name]["pulses"] / area)
        # by the delivered cloud: pulses of its signal, and squares of 5 m that hold any
        cloud = laspy.read(output / "laz" / "lines" / f"line_{int(name[:5])}.laz")
        signal = np.asarray(cloud["noise_class"]) == 0
        sent = np.column_stack([cloud.gps_time, cloud["channel"]])[signal]
        share = swaths[name]["pulses"] / len(np.unique(sent, axis=0))
        assert 0.92 < share <= 1.0, "all but those on squares that its rim cuts"
        held = np.unique(np.floor(cloud.xyz[signal, :2] / 5), axis=0)
        shape = drawn[name]
        centres = shapely.points(5 * held + 2.5)
        assert shapely.distance(shape, centres).max() < 5.1, "each return lies in the outline"
        corners = shapely.get_coordinates(shapely.convex_hull(shapely.union_all(centres)))
        assert shapely.distance(shape, shapely.points(corners)).max() < 5.1
        assert shape.area < area + 8 * shape.length
        assert 15 * len(held) < area <= 25 * len(held), "all but squares that the rim cuts"
    errors = {one["id"]: one["error_m"] for one in report["checkpoints"]["points"]}
    told = dict(zip(columns["checkpoints"]["id"], columns["checkpoints"]["error_m"], strict=True))
    assert set(told) == set(errors)
    for name, error in errors.items():
        assert told[name] == error or (np.isnan(told[name]) and error is None)


@pytest.mark.parametrize("unit", [METRE, FOOT, US_FOOT])
@pytest.mark.parametrize(
    "name", ["EPSG:32615", "EPSG:32715", "EPSG:26915", "EPSG:26715", "EPSG:6344", "EPSG:32615+5703"]
)
def test_a_geopackage_is_in_the_unit_of_its_crs(tmp_path: Path, name: str, unit: str) -> None:
    crs = in_unit(CRS(name), unit)
    for wanted in (crs, crs.to_3d()) if not crs.is_compound else (crs,):
        layers = [Layer(k, [shapely.Point(1, 2)], {"n": [1]}) for k in "ab"]
        path = write_layers(tmp_path / "a.gpkg", layers, wanted.to_wkt())
        for layer in "ab":
            found = CRS.from_user_input(pyogrio.read_info(path, layer=layer)["crs"])
            assert same_crs(found, wanted)
            assert Units.of(found).horizontal == unit
        once = path.read_bytes()
        assert write_layers(tmp_path / "a.gpkg", layers, wanted.to_wkt()).read_bytes() == once


def test_checkpoint_errors_are_those_of_the_raster(output: Path) -> None:
    with rasterio.open(output / "dtm.tif") as source:
        values, transform = source.read(1).astype(float), source.transform
    report = read(output / "report.json")["checkpoints"]
    inside = [one for one in report["points"] if one["error_m"] is not None]
    assert len(inside) == 6
    for one in inside:
        col, row = ~transform @ (one["x_m"], one["y_m"])
        c, r = int(np.floor(col - 0.5)), int(np.floor(row - 0.5))
        u, v = col - 0.5 - c, row - 0.5 - r
        square = values[r : r + 2, c : c + 2]
        height = np.array([1 - v, v]) @ square @ np.array([1 - u, u])
        assert one["error_m"] == pytest.approx(height - one["z_m"], abs=1e-6)
    assert report["statement"].startswith("Insufficient for a statement: 6 of the 30")


def test_a_run_owns_its_catalogues(output: Path) -> None:
    owned = set(read(output / "delivered.json")["files"])
    there = {
        path.relative_to(output).as_posix()
        for pattern in (
            "stac/*",
            "copc/**/*.laz",
            "survey.vpc",
            "index.gpkg",
        )
        for path in output.glob(pattern)
    }
    assert there <= owned


SITE = (
    'ENGCRS["Site grid",EDATUM["Site"],CS[Cartesian,2],AXIS["easting",east,ORDER[1]],'
    'AXIS["northing",north,ORDER[2]],LENGTHUNIT["metre",1]]'
)
"""CRS of a building site: metres from a peg."""


def nothing_but(name: str) -> dict[str, Any]:
    """Arguments of a catalogue of one cloud alone."""
    names = ("rasters", "reprojected", "flightlines", "checkpoints")
    lists: dict[str, Any] = {key: [] for key in names}
    clouds = [{"href": name, "span_s": None}]
    return {**lists, "clouds": clouds}


@pytest.mark.parametrize(
    ("crs", "shots", "reason", "srs_id"),
    [
        (None, 5, "without a CRS nothing shows", -1),
        (SITE, 5, "the CRS 'Site grid' does not show where on earth", 100_000),
        ("EPSG:32615", 0, "no delivered cloud holds a point", 32615),
    ],
)
def test_what_has_no_place_on_earth_is_not_listed(
    tmp_path: Path, crs: str | None, shots: int, reason: str, srs_id: int
) -> None:
    line = {key: values[:shots] for key, values in surveys.flightline(shots=5).items()}
    surveys.write_cloud(tmp_path / "a.laz", line, crs=None)
    known = None if crs is None else CRS.from_user_input(crs)
    survey = SurveySettings(flightlines="a.laz")
    written, remarks = write_catalogues(tmp_path, survey, known, nothing_but("a.laz"), {})
    assert len(remarks) == 1
    assert remarks[0].startswith(reason)
    assert ("survey.crs" in remarks[0]) is (crs is None)
    assert {path.name for path in written} == {"index.gpkg"}
    with closing(sqlite3.connect(tmp_path / "index.gpkg")) as database:
        assert database.execute("SELECT srs_id FROM gpkg_contents").fetchall() == [(srs_id,)]
