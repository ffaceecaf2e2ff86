"""A survey in feet: the same labels and the same terrain as of its twin in metres."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
import yaml
from pyproj import CRS

from spl_batch import api
from spl_batch.airborne.report import summarise
from spl_batch.constants import NODATA
from spl_batch.engine.findings import Finding
from spl_batch.errors import grouped
from spl_batch.formats.units import METRES, US_FOOT, Units
from tests import surveys

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
FEET, US_M = "EPSG:2278+6360", 1200 / 3937
HEIGHTS = ("dtm", "dsm", "chm", "dtm_quality")


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Outputs of a run in metres and of one on its exact conversion to feet."""
    metres, feet = tmp_path_factory.mktemp("metres"), tmp_path_factory.mktemp("feet")
    surveys.small_survey(metres)
    surveys.write_trajectory(metres / "trajectory.csv")
    for path in sorted((metres / "lines").iterdir()):
        surveys.in_feet(path, feet / "lines" / path.name, FEET, [US_M] * 3)
    rows = np.loadtxt(metres / "trajectory.csv", delimiter=",", skiprows=1)
    rows[:, 1:] = np.round(rows[:, 1:] / US_M, 7)
    for folder, unit_m in ((metres, 1.0), (feet, US_M)):
        # The same numbers to the last bit: a beam that meets the corner of a cell meets it in both.
        flown = rows * [1.0, *[US_M if unit_m == 1.0 else 1.0] * 3]
        head = "gps_time,x,y,z"
        np.savetxt(folder / "trajectory.csv", flown, "%.17g", ",", header=head, comments="")
        x, y = np.add(surveys.ORIGIN_M, (3.2, 0.7)) / unit_m
        text = f"id,x,y,z,accuracy_m\nA,{x:.6f},{y:.6f},{20.2 / unit_m:.6f},0.01\n"
        (folder / "checkpoints.csv").write_text(text)
    outputs = {"tiles": "copc", "crs": FEET, "cell": 3}
    # A client of the metric survey wants feet: tiles with edges at whole ones.
    x, y = np.rint(np.divide(surveys.ORIGIN_M, US_M))
    tiles = [shapely.box(x - 60, y - 60, x + 6, y + 60), shapely.box(x + 6, y - 60, x + 18, y + 60)]
    drawn = shapely.transform(tiles, lambda xy: xy * US_M)
    surveys.write_shapes(metres / "tiles.gpkg", drawn, name=["A", "B"])
    in_metres = surveys.write_workflow(
        metres,
        reference={"checkpoints": "checkpoints.csv"},
        outputs={"units": "us-ft", "cell": 3, "client_tiles": {"polygons": "tiles.gpkg"}},
    )
    in_feet = surveys.write_workflow(
        feet, reference={"checkpoints": "checkpoints.csv"}, outputs=outputs
    )
    return surveys.run(in_metres).output, surveys.run(in_feet).output


def test_labels_and_raw_coordinates_are_the_same(twins: tuple[Path, Path]) -> None:
    surveys.assert_same_labels(*map(surveys.delivered, twins))


def test_rasters_are_the_same_to_a_tenth_of_a_millimetre(twins: tuple[Path, Path]) -> None:
    for name in surveys.PRODUCTS:
        with (
            rasterio.open(twins[0] / f"{name}.tif") as a,
            rasterio.open(twins[1] / f"{name}.tif") as b,
        ):
            ours, theirs = a.read(1).astype(float), b.read(1).astype(float)
            np.testing.assert_array_equal(ours == NODATA, theirs == NODATA)
            theirs[theirs != NODATA] *= US_M if name in HEIGHTS else 1.0
            np.testing.assert_allclose(theirs, ours, atol=1e-4, err_msg=name)
            assert b.units[0] == ("US survey foot" if name in HEIGHTS else a.units[0])
            assert b.transform.c * US_M == pytest.approx(a.transform.c, abs=1e-6)
            assert CRS.from_wkt(b.crs.to_wkt()).to_epsg() == 8782


def test_the_report_states_the_units(twins: tuple[Path, Path]) -> None:
    metres, feet = map(surveys.report, twins)
    for one in (metres, feet):
        assert one["survey"]["units"]["vertical"] == US_FOOT
        assert one["survey"]["units"]["horizontal_m"] == US_M
    (ours,), (theirs,) = (found["checkpoints"]["points"] for found in (metres, feet))
    assert theirs["error_m"] == pytest.approx(ours["error_m"], abs=1e-4)
    assert theirs["x_m"] == pytest.approx(ours["x_m"], abs=1e-5)
    assert not [one for one in feet["findings"] if one["code"] in {"C01", "I08"}]


def test_a_report_written_again_keeps_the_unit_and_all_is_listed(twins: tuple[Path, Path]) -> None:
    listed = dict(api.report(twins[0]).results)
    for label, name in (("reprojected", "reprojected"), ("client tiles", "client_tiles")):
        assert listed[label] == [twins[0] / name]
        assert (twins[0] / name).is_dir()
    survey = surveys.report(twins[0])["survey"]
    assert survey["units"]["vertical"] == US_FOOT
    assert survey["crs_name"] == "WGS 84 / UTM zone 15N"
    assert survey["reprojected_crs_name"] == "WGS 84 / UTM zone 15N (ftUS)"


def test_findings_lie_where_the_cloud_does(
    twins: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    west, south = surveys.ORIGIN_M
    values = {"share": 0.1, "sigma_m": 0.5, "area_m2": 9.0}
    found = Finding("G01", values, place=(west, south, west + 3.0, south + 3.0))
    monkeypatch.setattr(summarise, "terrain_findings", lambda _: [found])
    (place,) = [one.sentence for one in api.report(twins[1]).report.findings if one.code == "G01"]
    ends = [f"{grouped(round(v / US_M))} to {grouped(round((v + 3.0) / US_M))}"
            for v in (west, south)]  # fmt: skip
    assert place.endswith(f"x {ends[0]} and y {ends[1]} ft")


def test_catalogues_lie_where_the_clouds_do(twins: tuple[Path, Path]) -> None:
    boxes, shares = [], []
    for output, unit_m in zip(twins, (1.0, US_M), strict=True):
        for layer in ("flightlines", "files", "checkpoints"):
            found = pyogrio.read_info(output / "index.gpkg", layer=layer, force_total_bounds=True)
            boxes.append(np.array(found["total_bounds"]) * unit_m)
        _, _, _, columns = pyogrio.raw.read(output / "index.gpkg", "files", columns=["per_m2"])
        shares.append(columns[0])
    np.testing.assert_allclose(boxes[:3], boxes[3:], atol=1e-3)
    np.testing.assert_allclose(*shares, rtol=1e-6)
    item = json.loads((twins[1] / "stac" / "dtm.json").read_text())
    assert item["properties"]["gsd"] == 1.0
    assert item["properties"]["proj:transform"][0] == pytest.approx(1.0 / US_M)


def test_whole_feet_and_points_by_tile(twins: tuple[Path, Path]) -> None:
    output = twins[1]
    with rasterio.open(output / "reprojected" / "dtm.tif") as source:
        assert source.transform.a == 3.0
        assert source.transform.c % 3.0 == 0.0
        values = source.read(1)
    with rasterio.open(output / "dtm.tif") as source:
        whole = source.read(1)
    means = [part[part != NODATA].mean() for part in (values, whole)]
    assert means[0] == pytest.approx(means[1], abs=0.5)
    assert not (output / "reprojected" / "laz").exists()
    tiles = sorted((output / "tiles").glob("*.copc.laz"))
    points = np.concatenate([np.asarray(surveys.laspy.read(tile).xyz) for tile in tiles])
    given = np.concatenate([surveys.laspy.read(p).xyz for p in (output / "laz").rglob("*.laz")])
    assert len(points) == len(given)
    assert np.abs(points.mean(axis=0) - given.mean(axis=0)).max() < 0.002


def test_a_metric_survey_is_delivered_in_feet_too(twins: tuple[Path, Path]) -> None:
    output, feet = twins[0], Units(US_FOOT, US_M, US_FOOT, US_M)
    for path in sorted((output / "laz").rglob("*.laz")):
        given = surveys.laspy.read(path)
        made = surveys.laspy.read(output / "reprojected" / path.relative_to(output))
        assert Units.of(given.header.parse_crs()) == METRES
        assert Units.of(made.header.parse_crs()) == feet
        assert np.abs(made.xyz - given.xyz / US_M).max() < 0.00051
        np.testing.assert_array_equal(made.classification, given.classification)
    with (
        rasterio.open(output / "dtm.tif") as metric,
        rasterio.open(output / "reprojected" / "dtm.tif") as source,
    ):
        assert (source.transform.a, source.transform.c % 3.0, source.units) == (3, 0, (US_FOOT,))
        assert Units.of(CRS.from_wkt(source.crs.to_wkt())) == feet
        rows, columns = np.nonzero(source.read(1) != NODATA)
        x, y = source.xy(rows, columns)
        heights = source.read(1)[rows, columns] * US_M
        there = np.array([v[0] for v in metric.sample(np.column_stack([x, y]) * US_M)])
    assert np.abs(heights - there)[there != NODATA].max() < 0.1
    tiles = {name: surveys.laspy.read(output / "client_tiles" / f"{name}.laz") for name in "AB"}
    middle = np.rint(surveys.ORIGIN_M[0] / US_M) + 6
    assert Units.of(tiles["A"].header.parse_crs()) == feet
    assert tiles["A"].x.max() < middle <= tiles["B"].x.min()
    made = np.concatenate([las.points["x"] for las in map(surveys.laspy.read, sorted(
        (output / "reprojected" / "laz").rglob("*.laz")))])  # fmt: skip
    assert len(tiles["A"]) == np.count_nonzero(made < middle)
    assert len(tiles["B"]) == np.count_nonzero((made >= middle) & (made < middle + 12))
    with rasterio.open(output / "client_tiles" / "A_dtm.tif") as source:
        assert (source.transform.a, source.units) == (3.0, (US_FOOT,))


def test_one_file_in_feet(twins: tuple[Path, Path], tmp_path: Path) -> None:
    source = twins[1].parent / "lines" / "line_1.laz"
    dtm = tmp_path / "dtm.tif"
    api.denoise(source, tmp_path / "clean.laz", ground=True, dtm=dtm, workers=0)
    given, made = surveys.cloud(source), surveys.cloud(tmp_path / "clean.laz")
    for axis in "XYZ":
        np.testing.assert_array_equal(given[axis], made[axis])
    with rasterio.open(dtm) as raster:
        assert raster.units[0] == "US survey foot"
    shutil.copytree(source.parent, tmp_path / "lines")
    assert surveys.command("init", tmp_path / "lines").status == 0


def test_the_workflow_of_a_us_county(twins: tuple[Path, Path], tmp_path: Path) -> None:
    crs, feet = "EPSG:6588+6360", twins[1].parent
    for path in (feet / "lines").glob("*.laz"):
        las = surveys.laspy.read(path)
        las.header.vlrs = [v for v in las.header.vlrs if v.user_id != "LASF_Projection"]
        las.header.add_crs(CRS.from_user_input(crs))
        (tmp_path / "points").mkdir(exist_ok=True)
        las.write(tmp_path / "points" / path.name)
    shutil.copy(feet / "checkpoints.csv", tmp_path)
    shutil.copy(feet / "trajectory.csv", tmp_path)
    x, y = np.array(surveys.ORIGIN_M) / US_M
    areas = {
        "A1": shapely.box(x - 50, y - 99, x + 9, y + 99),
        "A2": shapely.box(x + 9, y - 99, x + 20, y + 99),
    }
    county = [shapely.unary_union([*areas.values()])]
    surveys.write_shapes(tmp_path / "county.gpkg", county, crs)
    surveys.write_shapes(tmp_path / "county_tiles.gpkg", areas.values(), crs, tile=areas)
    content = yaml.safe_load((ROOT / "workflows" / "us_county.yaml").read_text())
    content["survey"]["trajectory"] = "trajectory.csv"
    content["ground"] = {"cell_m": 50, "buffer_m": 20}
    content["acquisition"] = {"prf_hz": surveys.PRF_HZ, "gate_m": surveys.GATE_M}
    workflow = tmp_path / "us_county.yaml"
    workflow.write_text(yaml.safe_dump(content))
    done = surveys.run(workflow)
    assert done.exit_status == 0, done.report.failures
    counts, out = done.report.counts, done.output
    assert counts.points_in == counts.points_out + sum(counts.dropped.values())
    assert done.report.survey.units.vertical == "US survey foot"
    found = done.report.requirements[0].found.replace("\N{NARROW NO-BREAK SPACE}", " ")
    assert re.fullmatch(r"RMSE_V \d\.\d{3} ft \(\d+\.\d cm\) at 1 checkpoints", found)
    tiles = [surveys.laspy.read(out / "client_tiles" / f"{name}.copc.laz") for name in areas]
    assert sum(len(tile) for tile in tiles) == counts.points_out
    for tile, area in zip(tiles, areas.values(), strict=True):
        assert shapely.contains_xy(area.buffer(0.02), tile.x, tile.y).all()
    with rasterio.open(out / "dtm.tif") as source:
        (terrain,) = source.sample([(tiles[0].x[0], tiles[0].y[0])])
    above = tiles[0].z[0] - terrain[0]
    assert tiles[0]["HeightAboveGround"][0] == pytest.approx(above, abs=0.5)
    with rasterio.open(out / "reprojected" / "dtm.tif") as source:
        assert source.transform.a == 3.0
    _, _, _, (heights,) = pyogrio.raw.read(out / "contours.gpkg", columns=["height"])
    assert set(heights % 2) == {0.0}


def test_a_clients_tiles_are_cut_out_of_clouds_and_rasters_that_are_written_again(
    twins: tuple[Path, Path], tmp_path: Path
) -> None:
    (tmp_path / "lines").mkdir()
    for path in (twins[1].parent / "lines").glob("*.laz"):
        las = surveys.laspy.read(path)
        las.change_scaling(scales=[0.001, 0.001, 0.01])
        las.write(tmp_path / "lines" / path.name)
    x, y = np.array(surveys.ORIGIN_M) / US_M
    around = shapely.box(x - 60, y - 60, x + 60, y + 60)
    surveys.write_shapes(tmp_path / "tiles.gpkg", [around], FEET, name=["A"])
    tiles = tmp_path / "out" / "client_tiles"

    def workflow(form: str, **outputs: object) -> Path:
        asked = {"polygons": "tiles.gpkg", "format": form}
        return surveys.write_workflow(tmp_path, outputs={"client_tiles": asked, **outputs})

    refused = surveys.command("plan", workflow("copc", cell=3))
    assert (refused.status, "cannot be written as copc" in refused.err) == (2, True)
    metres = surveys.run(workflow("copc", units="m"))
    assert metres.exit_status == 0, metres.report.failures
    octree = surveys.laspy.read(tiles / "A.copc.laz")
    assert len(octree) == metres.report.counts.points_out
    assert octree.header.scales.tolist() == [0.001] * 3
    assert Units.of(octree.header.parse_crs()) == METRES
    feet = surveys.run(workflow("laz", cell=3))
    assert feet.exit_status == 0, feet.report.failures
    cloud = surveys.laspy.read(tiles / "A.laz")
    assert cloud.header.scales.tolist() == [0.001, 0.001, 0.01]
    for name in surveys.PRODUCTS:
        with (
            rasterio.open(tiles / f"A_{name}.tif") as cut,
            rasterio.open(tmp_path / "out" / "reprojected" / f"{name}.tif") as whole,
        ):
            assert (cut.transform.a, cut.units, cut.crs) == (3.0, whole.units, whole.crs)
            window = rasterio.windows.from_bounds(*cut.bounds, whole.transform)
            np.testing.assert_array_equal(cut.read(1), whole.read(1, window=window))
