"""A complete workflow: nothing lost, nothing done twice, and always the same result."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import laspy
import numpy as np
import pytest
import rasterio
import shapely

from spl_batch import api
from spl_batch.airborne.noise import line_statistics
from spl_batch.airborne.simulate.file_writers import write_polygons
from spl_batch.constants import NODATA
from spl_batch.engine.store.output_lock import locked
from spl_batch.engine.verbs import planning
from spl_batch.engine.watch.events import PhaseStarted, TaskEnded
from tests import surveys

SCHEMAS = Path(__file__).parents[2] / "schemas"
RENAMED = {"classification": "input_classification"}


class Watcher:
    """Collects what a run tells."""

    def __init__(self) -> None:
        self.events: list[Any] = []

    def __call__(self, event: Any) -> None:
        self.events.append(event)

    @property
    def done(self) -> dict[str, int]:
        """Tasks that were done, by kind; kinds without any are left out."""
        counts: dict[str, int] = {}
        for event in self.events:
            if isinstance(event, TaskEnded):
                counts[event.kind] = counts.get(event.kind, 0) + 1
        return counts


def watched(workflow: Path, *overrides: str, **options: Any) -> tuple[api.RunResult, Watcher]:
    watcher = Watcher()
    return surveys.run(workflow, *overrides, listener=watcher, **options), watcher


# What is delivered


def test_every_point_comes_back_once_in_order_with_all_attributes(
    tiny_survey: Path, tiny_output: Path
) -> None:
    clouds = surveys.delivered(tiny_output)
    inputs = sorted((tiny_survey.parent / "flightlines").glob("*.laz"))
    assert list(clouds) == [f"flightlines/{p.name}" for p in inputs]
    for path in inputs:
        given, got = surveys.cloud(path), clouds[f"flightlines/{path.name}"]
        for name, values in given.items():
            assert values.tobytes() == got[RENAMED.get(name, name)].tobytes(), name
        with laspy.open(path) as a, laspy.open(tiny_output / "laz/flightlines" / path.name) as b:
            assert list(a.header.scales) == list(b.header.scales)
            assert list(a.header.offsets) == list(b.header.offsets)
            assert a.header.parse_crs() == b.header.parse_crs()
            assert str(b.header.version) == "1.4"


def test_labels_are_classes_of_the_contract(tiny_output: Path) -> None:
    for columns in surveys.labels(tiny_output).values():
        noise, classes = columns["noise_class"], columns["classification"]
        assert set(np.unique(noise)) <= {0, 1, 2, 255}
        assert set(np.unique(classes)) <= {1, 2, 6, 7, 9, 18}
        assert np.array_equal(np.isin(noise, (1, 2)), np.isin(classes, (7, 18)))
        assert np.all(noise[classes == 2] == 0)
        assert (noise == 0).mean() > 0.5
        p_value = columns["p_value"]
        assert np.all(np.isnan(p_value) | ((p_value >= 0) & (p_value <= 1)))
        density = columns["noise_density"]
        assert np.all(np.isfinite(density[noise != 255]))
        assert 0.02 < np.median(density) < 0.08, "the scene has 0.04 per m3"


def test_the_report_is_what_its_schema_says(tiny_output: Path) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    text = (tiny_output / "report.json").read_text(encoding="utf-8")
    report = json.loads(text, parse_constant=refuse)
    schema = json.loads((SCHEMAS / "report.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(schema).validate(report)
    counts = report["counts"]
    clouds = surveys.labels(tiny_output).values()
    noise = np.concatenate([c["noise_class"] for c in clouds])
    classes = np.concatenate([c["classification"] for c in clouds])
    assert counts["points_in"] == counts["points_out"] == len(noise)
    for name, value in (("signal", 0), ("background", 1), ("afterpulse", 2), ("not_assessed", 255)):
        assert counts[name] == np.count_nonzero(noise == value), name
    assert counts["ground"] == np.count_nonzero(classes == 2)
    for line in report["survey"]["flightlines"]:
        fired = (line["end_s"] - line["start_s"]) * line["prf_hz"] + 1
        assert line["shots"] == pytest.approx(fired, abs=0.5)
    density = report["density"]
    area_m2 = report["survey"]["area_km2"] * 1e6
    assert density["ground_per_m2"] == pytest.approx(counts["ground"] / area_m2)
    assert density["mean_per_m2"] == pytest.approx(counts["signal"] / area_m2, rel=1e-3)
    assert report["failures"] == []
    assert set(report["accuracy"]["dtm"]["all"]) >= {"n", "rmse", "nmad", "p95", "min", "max"}
    assert report["accuracy"]["dtm"]["open_ground"]["rmse"] < 0.1
    assert set(report["performance"]["stages"]) >= {"index", "shots", "shuffle", "denoise"}
    assert "<html" in (tiny_output / "report.html").read_text(encoding="utf-8")[:200].lower()


def test_rasters_are_aligned_and_cloud_optimised(tiny_output: Path) -> None:
    transforms = set()
    for product in surveys.PRODUCTS:
        with rasterio.open(tiny_output / f"{product}.tif") as source:
            assert source.dtypes == ("float32",)
            assert source.nodata == NODATA
            assert source.crs.to_epsg() == 32615
            assert source.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
            assert source.transform.c % 1.0 == 0
            assert source.transform.f % 1.0 == 0
            assert (source.transform.a, source.transform.e) == (1.0, -1.0)
            values = source.read(1)
            assert np.all(np.isfinite(values))
            assert (values != NODATA).mean() > 0.3
            assert source.units == ({"density": "1/m2", "intensity": "1"}.get(product, "m"),)
            transforms.add((source.transform, source.shape))
    assert len(transforms) == 1


def test_the_log_is_one_event_a_line(tiny_output: Path) -> None:
    events = [json.loads(line) for line in (tiny_output / "log.jsonl").read_text().splitlines()]
    assert {"PhaseStarted", "TaskEnded"} <= {e["event"] for e in events}
    assert all("time" in e for e in events)
    status = {s.stage: s for s in api.status(tiny_output).stages.values()}
    assert status["denoise"].done == status["denoise"].total > 0
    assert sum(s.failed + s.left for s in status.values()) == 0


# Doing nothing twice


def test_what_does_not_wait_for_each_other_is_done_at_once(small: Path) -> None:
    result, watcher = watched(small, "outputs.tiles=laz", until="deliver")
    tiles = [laspy.read(path) for path in (result.output / "tiles").glob("*.laz")]
    assert all((tile.number_of_returns == tile.return_number).all() for tile in tiles)
    left: dict[str, int] = {}
    beside: set[str] = set()
    for event in watcher.events:
        if isinstance(event, PhaseStarted):
            beside |= {event.kind} if any(left.values()) else set()
            left[event.kind] = event.tasks
        elif isinstance(event, TaskEnded):
            left[event.kind] -= 1
    assert beside >= {"deliver_tile", "mosaic"}
    assert not beside & {"index", "shots", "tile", "denoise"}, "they wait for those before"
    assert not any(left.values())


def test_a_report_stands_until_it_would_say_something_else(small: Path) -> None:
    output = surveys.run(small).output

    def written() -> tuple[int, bytes]:
        page = output / "report.html"
        return page.stat().st_mtime_ns, page.read_bytes()

    first = written()
    again = surveys.run(small)
    assert written() == first
    *rows, (label, value) = again.screen
    assert tuple(rows) == surveys.run(small).screen[:-1] != ()
    assert (label, value[:19]) == ("now", "nothing was left to")
    (output / "report.html").unlink()
    surveys.run(small)
    second = written()
    (output / "report.json").write_text("{}")
    surveys.run(small)
    assert written()[0] > second[0]
    assert surveys.report(output)["counts"]["points_in"] > 0


CHANGES = [
    ("survey.name=other", {"index_file", "deliver_file", "mosaic"}, ""),
    ("products.cell_m=0.5", {"observe", "scatter", "denoise", "ground"}, "surface"),
    ("ground.method=smrf", {"observe", "scatter", "build_tile", "denoise"}, "ground"),
    ("filter.alpha=0.05", {"index_file", "observe", "fit_line", "scatter"}, "denoise"),
    ("tiling.tile_m=40", {"index_file", "observe", "fit_line"}, "scatter"),
    ("noise.buffer_m=20", {"index_file"}, "observe"),
]


def test_a_change_redoes_what_depends_on_it(small: Path) -> None:
    """One change after another, each deeper in the graph."""
    surveys.run(small, until="deliver")
    made: list[str] = []
    for change, untouched, touched in CHANGES:
        made.append(change)
        result, watcher = watched(small, *made, until="deliver")
        assert result.exit_status == 0
        assert not untouched & set(watcher.done), change
        assert touched in watcher.done or not touched
    clean = surveys.run(surveys.copy_of(small, small.parent / "clean"), *made, until="deliver")
    assert surveys.results(result.output) == surveys.results(clean.output), "nothing stale is left"


def test_until_stops_after_a_stage_and_continues(small: Path, small_output: Path) -> None:
    done: set[str] = set()
    for stage in ("index", "shots", "shuffle", "denoise", "ground", "surfaces"):
        result, watcher = watched(small, until=stage)
        assert (result.exit_status, result.report) == (0, None)
        stages = [e.stage for e in watcher.events if isinstance(e, PhaseStarted)]
        assert stages[-1] == stage
        assert not (result.output / "laz").exists()
        assert watcher.done
        assert not done & set(watcher.done), "what is finished is not done again"
        done |= set(watcher.done)
    result, watcher = watched(small, until="deliver")
    assert not done & set(watcher.done)
    assert surveys.results(result.output) == surveys.results(small_output)


def test_a_survey_that_grows_and_shrinks_is_as_if_it_had_always_been_so(
    tiny_survey: Path, tiny_output: Path, tmp_path: Path
) -> None:
    """A flightline arrives after the first run, and is taken away again."""
    workflow = surveys.copy_of(tiny_survey, tmp_path)
    late, elsewhere = tmp_path / "flightlines" / "line_02.laz", tmp_path / "line_02.laz"
    late.rename(elsewhere)
    first = surveys.run(workflow, "outputs.diagnostics=true", until="deliver")
    fewer = surveys.results(first.output)
    elsewhere.rename(late)
    grown = surveys.run(workflow, "outputs.diagnostics=true", until="deliver")
    assert grown.exit_status == 0
    assert surveys.results(grown.output) == surveys.results(tiny_output)
    late.rename(elsewhere)
    shrunk = surveys.run(workflow, "outputs.diagnostics=true", until="deliver")
    assert shrunk.exit_status == 0
    assert surveys.results(shrunk.output) == fewer


def test_no_two_runs_in_one_output(small: Path) -> None:
    with locked(small.parent / "out"):
        ended = surveys.command("run", small, "--workers", 0)
    assert ended.status == 2
    assert "another run is working" in ended.text


# Always the same result; tests/engine/runs/test_equivalence.py has the ways of running


IDENTITY = ("X", "Y", "Z", "gps_time", "channel", "intensity", "return_number")
LABELS = ("classification", "noise_class", "noise_density", "p_value")


def labelled(output: Path) -> Any:
    """All labelled points as one sorted array of records, whatever file they are in."""
    parts = [surveys.point_rows(c, IDENTITY + LABELS) for c in surveys.delivered(output).values()]
    return np.sort(np.concatenate(parts)).tobytes()


def split(path: Path) -> None:
    """Cut a file into two, the points dealt out in turns."""
    las = laspy.read(path)
    for k in (0, 1):
        part = laspy.LasData(las.header, las.points[np.arange(k, len(las.points), 2)])
        part.write(path.with_name(f"{path.stem}_{k}.laz"))
    path.unlink()


def halve(path: Path) -> None:
    """Cut a file into two in the middle of a shot."""
    las = laspy.read(path)
    middle = len(las.points) // 2 + 1
    for k, part in enumerate((slice(0, middle), slice(middle, None))):
        laspy.LasData(las.header, las.points[part]).write(path.with_name(f"{path.stem}_{k}.laz"))
    path.unlink()


def shuffle(path: Path) -> None:
    """Put a file's points into another order."""
    las = laspy.read(path)
    order = np.random.default_rng(5).permutation(len(las.points))
    laspy.LasData(las.header, las.points[order]).write(path)


def test_files_and_their_order_do_not_matter(
    tiny_survey: Path, tiny_output: Path, tmp_path: Path
) -> None:
    workflow = surveys.copy_of(tiny_survey, tmp_path)
    lines = tmp_path / "flightlines"
    shuffle(lines / "line_01.laz")
    halve(lines / "line_02.laz")
    split(lines / "line_02_1.laz")
    names = ["line_01", "line_02_0", "line_02_1_0", "line_02_1_1"]
    assert sorted(path.stem for path in lines.iterdir()) == names
    result = surveys.run(workflow, "outputs.diagnostics=true", until="deliver")
    assert result.exit_status == 0
    assert labelled(result.output) == labelled(tiny_output)
    assert surveys.rasters(result.output) == surveys.rasters(tiny_output)


# Places


def test_an_area_of_interest_is_honoured(
    tiny_survey: Path, tiny_output: Path, tmp_path: Path
) -> None:
    workflow = surveys.copy_of(tiny_survey, tmp_path)
    west, south, east, north = 272_010.0, 3_290_020.0, 272_040.0, 3_290_055.0
    write_polygons(tmp_path / "aoi.gpkg", [shapely.box(west, south, east, north)], "EPSG:32615")
    for path in sorted((tmp_path / "flightlines").glob("*.laz")):
        given = laspy.read(path)
        given.classification = np.full(len(given), 2, np.uint8)
        given.write(path)
    result = surveys.run(workflow, "aoi=aoi.gpkg", "outputs.diagnostics=true")
    assert result.exit_status == 0
    outside_points = ground = 0
    for name, got in surveys.delivered(result.output).items():
        las = laspy.read(result.output / "laz" / name)
        x, y = np.asarray(las.x), np.asarray(las.y)
        # Points on the very edge belong to whoever draws it.
        inside = (x > west) & (x < east) & (y > south) & (y < north)
        outside = (x < west) | (x > east) | (y < south) | (y > north)
        assert np.count_nonzero(inside) > 5000
        full = surveys.delivered(tiny_output)[name]
        for label in ("noise_class", "p_value", "noise_density"):
            same = got[label][inside].tobytes() == full[label][inside].tobytes()
            assert same, f"{label}: points outside are still neighbours"
        assert np.all(got["noise_class"][outside] == 255)
        assert np.array_equal(got["classification"][outside], got["input_classification"][outside])
        outside_points += int(np.count_nonzero(got["noise_class"] == 255))
        ground += int(np.count_nonzero((got["classification"] == 2) & (got["noise_class"] != 255)))
    assert result.report is not None
    assert result.report.counts.outside_aoi == outside_points
    assert result.report.counts.ground == ground > 0
    assert result.report.counts.points_out == result.report.counts.points_in
    with rasterio.open(result.output / "dtm.tif") as source:
        rows, columns = np.nonzero(source.read(1) != NODATA)
        x, y = source.xy(rows, columns)
    assert (min(x), max(x), min(y), max(y)) == (west + 0.5, east - 0.5, south + 0.5, north - 0.5)


def test_too_little_memory_is_refused_before_any_work(tiny_survey: Path, tmp_path: Path) -> None:
    workflow = surveys.copy_of(tiny_survey, tmp_path)
    ended = surveys.command("run", workflow, "--workers", 0, "--memory", "300MiB")
    assert ended.status == 2
    assert "more than a task may use of --memory 300 MiB (270 MiB); raise it" in ended.err
    assert not (tmp_path / "out/store/receipts").exists()


def test_a_plan_tells_whose_share_of_the_memory_is_too_little_or_too_much(
    tiny_survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workflow = surveys.copy_of(tiny_survey, tmp_path)
    monkeypatch.setattr(planning, "machine_memory", lambda: 2 * 2**30)
    ended = surveys.command("plan", workflow, "--workers", 4)
    assert ended.status == 2
    assert "the share of each of 4 workers, 256 MiB" in ended.err
    assert "use fewer workers, raise --memory to" in ended.err
    one = surveys.command("plan", workflow, "--workers", 1)
    assert "by default, as --memory is not given" in " ".join(one.out.split())
    for memory, told in (("1GiB", False), ("1.1GiB", True)):
        ended = surveys.command("plan", workflow, "--workers", 2, "--memory", memory)
        assert ended.status == 0
        assert ("warning: E01 --memory" in ended.out) == told


# Failures


def raising(function: Callable[..., Any], on_call: int) -> Callable[..., Any]:
    """The function, but one of its calls fails."""
    calls = 0

    def sometimes(*args: Any, **kwargs: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == on_call:
            raise RuntimeError("broken\non purpose")
        return function(*args, **kwargs)

    return sometimes


IN_PIECES = (
    *("tiling.tile_m=10", "tiling.block_tiles=1"),
    *("ground.cell_m=10", "ground.buffer_m=1"),
)


@pytest.fixture(scope="module")
def in_pieces(small_lines: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of a run that nothing disturbed."""
    workflow = surveys.copy_of(small_lines, tmp_path_factory.mktemp("in_pieces"))
    return surveys.run(workflow, *IN_PIECES, until="deliver").output


def test_a_failing_task_is_isolated_named_and_tried_again(
    small: Path, in_pieces: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(line_statistics, "observe", raising(line_statistics.observe, 2))
        result, watcher = watched(small, *IN_PIECES)
    assert result.exit_status == 1
    assert result.report is not None
    (failure,) = result.report.failures
    assert failure.task is not None
    assert failure.task.startswith("observe")
    assert (failure.code, failure.reason) == ("F04", "RuntimeError: broken on purpose")
    assert failure.inputs
    log = [json.loads(x) for x in (result.output / "log.jsonl").read_text().splitlines()]
    (trace,) = [x["traceback"] for x in log if x.get("code") == "F04"]
    assert "in sometimes" in trace
    counts = result.report.counts
    assert counts.points_in == counts.points_out
    assert watcher.done["observe"] >= 2
    assert 0 < counts.not_assessed < counts.points_in
    second, watcher = watched(small, *IN_PIECES)
    assert second.exit_status == 0
    assert watcher.done["observe"] == 1, "only what failed is tried again"
    assert second.report is not None
    assert second.report.failures == ()
    assert second.report.counts.not_assessed == 0
    assert surveys.results(second.output) == surveys.results(in_pieces)


def test_surfaces_lie_as_they_should(tiny_output: Path) -> None:
    values = {}
    for product in ("dtm", "dsm", "chm"):
        with rasterio.open(tiny_output / f"{product}.tif") as source:
            values[product] = source.read(1)
    both = (values["dtm"] != NODATA) & (values["dsm"] != NODATA)
    height = values["dsm"][both] - values["dtm"][both]
    assert np.percentile(height, 1) > -0.3
    assert height.max() < 15, "no cell is set by noise"
    assert np.abs(np.maximum(height, 0) - values["chm"][both]).max() < 0.5
