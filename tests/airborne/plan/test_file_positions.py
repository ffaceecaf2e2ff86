"""Files that lie where those of one survey do not: far apart, astray, in degrees."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray

from spl_batch import api
from spl_batch.airborne.plan.inputs.file_positions import extent, far_positions, saved_again
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.plan.inputs.findings import points_astray
from spl_batch.airborne.plan.inputs.survey_inputs import gather_inputs
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.constants import NODATA
from spl_batch.engine.findings import Finding
from spl_batch.formats.crs import look_like_degrees
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.units import Units
from spl_batch.lattice.density import Box, from_boxes
from spl_batch.lattice.tiles import Bounds, far_apart
from tests import surveys

FAR_M = 1_500_000.0
TINY = 60
"""Shots of the flightlines here."""


def facts(name: str, box: tuple[float, float, float, float], points: int = 10_000_000) -> LasFacts:
    return LasFacts(
        path=Path(name),
        size_bytes=1,
        n_points=points,
        version=(1, 4),
        point_format=6,
        scales=(0.001, 0.001, 0.001),
        offsets=(0.0, 0.0, 0.0),
        mins_m=(box[0], box[1], 0.0),
        maxs_m=(box[2], box[3], 50.0),
        crs=None,
        adjusted_standard_bit=True,
        has_gps_time=True,
        dimensions=(),
        warnings=(),
        rounding=(),
        layers_can_be_copied=True,
    )


def raster(path: Path) -> NDArray[np.float32]:
    with rasterio.open(path) as source:
        values: NDArray[np.float32] = source.read(1)
    return values


def listed(*usable: LasFacts) -> Files:
    files = Files()
    files.usable = [*usable]
    return files


def far(**boxes: tuple[float, float, float, float]) -> list[Finding]:
    return list(far_positions(listed(*(facts(name, box) for name, box in boxes.items()))))


def test_a_file_far_from_two_corridors_that_meet_at_a_corner_is_named() -> None:
    """No empty column or row lies between it and them."""
    east = {f"e{k}": (k * 2000.0, 0.0, (k + 1) * 2000.0, 2000.0) for k in range(20)}
    north = {f"n{k}": (0.0, k * 2000.0, 2000.0, (k + 1) * 2000.0) for k in range(1, 20)}
    found = far(**{**east, **north, "stray": (30e3, 30e3, 32e3, 32e3)})
    assert [(f.code, f.subject, round(f.values["km"])) for f in found] == [("I05", "stray", 28)]


def test_files_of_one_point_have_a_distance() -> None:
    found = far(a=(0, 0, 0, 0), b=(100, 0, 100, 0), c=(50_000, 0, 50_000, 0))
    assert [(f.subject, f.values["km"]) for f in found] == [("c", pytest.approx(49.9))]


def test_a_file_saved_again_by_another_scale_is_named() -> None:
    one = facts("a", (500_000.2, 0.0, 500_150.0, 150.0))
    coarse = replace(one, scales=(0.01, 0.01, 0.01), maxs_m=(500_150.004, 150.0, 50.0))
    elsewhere = replace(coarse, mins_m=(500_000.3, 0.0, 0.0))
    named = {"a": one, "b": coarse, "c": elsewhere, "d": one}
    files = listed(*(replace(like, path=Path(name)) for name, like in named.items()))
    found = list(saved_again(files))
    assert [(f.code, f.subject, f.values["kind"]) for f in found] == [
        ("I03", "b and a", "saved"), ("I03", "d and b", "saved"),
    ]  # fmt: skip


def test_a_stray_point_makes_a_plan_of_no_more_tiles_than_there_are_points() -> None:
    whole = Bounds(0, 0, 1_500_000_000, 1_500_000_000)
    (piece,) = from_boxes([Box(whole, 30_000)], 100_000)
    assert piece.points.size <= 30_000
    assert piece.points.sum() == pytest.approx(30_000)
    assert piece.units(100_000) <= 60_000


def test_places_far_apart_are_found_however_they_lie() -> None:
    places = np.array([[0, 0], [90, 5], [5, 800], [0, 805], [95, 0]])
    groups = sorted(sorted(rows.tolist()) for rows in far_apart(places, 50))
    assert groups == [[0], [1, 4], [2, 3]]
    assert list(far_apart(np.empty((0, 2), np.int64), 50)) == []


def test_of_two_plots_far_apart_that_with_most_points_has_rasters(tmp_path: Path) -> None:
    near = surveys.flightline(shots=TINY)
    far = surveys.flightline(
        shots=TINY // 2, psid=2, start_s=surveys.START_S + 500, seed=1,
        origin_m=(surveys.ORIGIN_M[0] + FAR_M, surveys.ORIGIN_M[1] + FAR_M),
    )  # fmt: skip
    surveys.write_cloud(tmp_path / "lines/near.laz", near)
    surveys.write_cloud(tmp_path / "lines/wrong.laz", far)
    workflow = surveys.write_workflow(tmp_path)
    for verb, options in (("plan", ()), ("run", ("--workers", 0))):
        ended = surveys.command(verb, workflow, *options)
        assert ended.status == 0, ended.text
        flat = " ".join(ended.text.split())
        assert "I05 lines/wrong.laz: 2121 km from the rest of the survey (lines/near.laz)" in flat
    shown = flat.partition("rasters")[2].partition("clouds")[0].split()
    names = [Path(name).name for name in shown if name.endswith(".tif")]
    assert names == ["dtm.tif", "dsm.tif"]
    assert raster(tmp_path / "out/dtm.tif").size < 20_000, "the plot with most points"


def test_a_stray_point_costs_nothing_and_its_file_is_named(tmp_path: Path) -> None:
    cloud = surveys.flightline(shots=TINY)
    for axis in "xy":
        cloud[axis][7] += FAR_M
    surveys.write_cloud(tmp_path / "lines/astray.laz", cloud)
    workflow = surveys.write_workflow(tmp_path)
    ended = surveys.command("plan", workflow)
    assert ended.status == 0
    assert "I05 lines/astray.laz" in ended.text
    planned = api.plan(workflow)
    assert planned.points == len(cloud["x"])
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 0, ended.text
    flat = " ".join(ended.text.split())
    assert "span 1500 km; some of them must lie astray" in flat
    assert surveys.report(tmp_path / "out")["counts"]["points_out"] == len(cloud["x"])
    values = raster(tmp_path / "out/dtm.tif")
    assert np.count_nonzero(values > NODATA) > 10, "the piece with most points comes first"


def test_the_farthest_part_is_told_first_and_by_its_files() -> None:
    found = far(
        a=(0, 0, 1000, 1000), b=(1000, 0, 2000, 1000), c=(0, 1000, 1000, 2000),
        d=(90_000, 0, 91_000, 1000), e=(900_000, 0, 901_000, 1000), f=(900_000, 999, 901_000, 1999),
    )  # fmt: skip
    assert {one.subject: round(one.values["km"]) for one in found} == {"e": 898, "f": 898, "d": 88}
    assert {one.values["main"] for one in found} == {"a and 2 more"}


def test_a_file_too_wide_for_its_points_is_named_and_hides_no_other() -> None:
    found = far(
        a=(0, 0, 1000, 1000), b=(1000, 0, 2000, 1000), c=(0, 0, 250_000, 250_000),
        d=(700_000, 0, 701_000, 1000),
    )  # fmt: skip
    assert [(one.subject, one.values["kind"]) for one in found] == [("c", "wide"), ("d", "far")]


def degrees(folder: Path, crs: str | None = None) -> Path:
    """A survey of two files in degrees."""
    for k in (1, 2):
        cloud = surveys.flightline(shots=TINY, psid=k, start_s=surveys.START_S + 3 * k, seed=k)
        cloud["x"] = 11.5 + (cloud["x"] - surveys.ORIGIN_M[0]) / 7e4
        cloud["y"] = 48.1 + (cloud["y"] - surveys.ORIGIN_M[1]) / 1.1e5
        path = folder / f"lines/{k}.laz"
        surveys.write_cloud(path, cloud, crs=crs, scale=1e-7)
    return surveys.write_workflow(folder)


@pytest.mark.parametrize("verb", ["plan", "run"])
def test_degrees_without_a_crs_are_refused(tmp_path: Path, verb: str) -> None:
    ended = surveys.command(verb, degrees(tmp_path))
    assert ended.status == 2, ended.text
    whole = ended.err.replace("\n  ", " ")  # what is too long for the screen goes on below
    (line,) = (x for x in whole.splitlines() if x.startswith("spl-batch: "))
    remedies = (
        "reproject the files to a CRS in metres, e.g. EPSG:32632",
        "set survey.crs=EPSG:...",
    )
    for word in ("lines/1.laz", "lines/2.laz", "look like degrees: if they are", *remedies):
        assert word in line
    assert line.count("look like degrees") == 1, "once for both files"
    begun = api.init(tmp_path, force=True)
    assert "coordinates look like degrees" in dict(begun.unknown)["crs"], "not taken as metres"
    assert "2" not in dict(begun.found)["flightlines"].partition("points")[2], "nor has it an area"
    assert not (tmp_path / "out").exists()


def test_a_file_in_degrees_among_others_is_set_aside(tmp_path: Path) -> None:
    workflow = degrees(tmp_path)
    surveys.write_cloud(tmp_path / "lines/good.laz", surveys.flightline(shots=TINY, psid=7))
    inputs = gather_inputs(load_workflow(workflow), tmp_path, tmp_path / "out")
    assert [source.name for source in inputs.sources] == ["lines/good.laz"]
    assert [Path(fault.path).name for fault in inputs.bad] == ["1.laz", "2.laz"]


def test_a_reference_in_degrees_is_refused(tmp_path: Path) -> None:
    degrees(tmp_path / "other")
    surveys.write_cloud(tmp_path / "lines/good.laz", surveys.flightline(shots=TINY))
    workflow = surveys.write_workflow(tmp_path, reference={"points": "other/lines/1.laz"})
    ended = surveys.command("plan", workflow)
    assert ended.status == 2, ended.text
    assert "look like degrees" in ended.err
    assert "set reference.crs=EPSG" in " ".join(ended.err.split())


def test_small_tiles_of_a_large_scene_in_local_metres_are_no_degrees() -> None:
    assert look_like_degrees((11.5, 48.1), (11.6, 48.2))
    assert look_like_degrees((355.0, -10.0, 1e4), (356.0, -9.0, 2e4))
    assert not look_like_degrees((11.5, 48.1), (11.6, 48.2), [(0.0, 0.0), (90.0, 80.0)])
    assert not look_like_degrees((0.0, 0.0), (5.0, 3.0)), "an extent of five"
    assert not look_like_degrees((500.0, 20.0), (501.0, 21.0))
    assert not look_like_degrees((100.0, 91.0), (101.0, 92.0))


@pytest.mark.parametrize(
    ("counts", "found"),
    [
        ({(0, 0): 9_000, (0, 1): 8_000, (70, 3): 1, (3, 70): 2}, [(3, 7.0)]),
        ({(0, 0): 9_000, (0, 1): 8_000, (70, 3): 900}, []),  # another plot
        ({(0, 0): 9_000, (9, 9): 8_000, (4, 5): 1, (10, 9): 2}, []),  # the rim of a swath
        ({(0, 0): 5}, []),
    ],
)
def test_points_astray_are_few_and_make_rasters_much_larger(
    counts: dict[tuple[int, int], int], found: list[tuple[int, float]]
) -> None:
    (i, east), (j, north) = ((min(ends), max(ends)) for ends in zip(*counts, strict=True))
    bounds = [100_000 * i, 100_000 * j, 0, 100_000 * east + 99_999, 100_000 * north + 99_999, 0]
    survey: Any = SimpleNamespace(counts=counts, bounds=bounds, tile_q=100_000)
    values = [one.values for one in points_astray(survey)]
    assert [(one["count"], one["km"]) for one in values] == found


def test_points_on_the_edge_of_the_next_tile_are_not_astray() -> None:
    counts = {(0, 0): 9_000, (1, 0): 5, (0, 1): 4}
    survey: Any = SimpleNamespace(
        counts=counts, bounds=[0, 0, 0, 100_000, 100_000, 0], tile_q=100_000
    )
    assert not [*points_astray(survey)]


def test_an_extent_is_in_the_unit_of_the_survey_with_metres_beside() -> None:
    places = [(304.8, 609.6), (3048.0, 914.4)]
    assert extent(places) == "305 to 3 048 m E, 610 to 914 m N"
    assert extent(places, Units("foot", 0.3048, "foot", 0.3048)) == (
        "1 000 to 10 000 ft E, 2 000 to 3 000 ft N (305 to 3 048 m E, 610 to 914 m N)"
    )
