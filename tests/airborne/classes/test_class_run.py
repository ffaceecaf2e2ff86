"""Classes and flags of a run, against the delivered points and terrain; whatever the tiles."""

from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio

from spl_batch.airborne.classes.point_classes import _surface_below
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.constants import NODATA, NOISE_SIGNAL
from spl_batch.errors import WorkflowError
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests import surveys
from tests.surveys import Columns

ALL = {
    "vegetation": {"low": 0.3, "medium": 0.7, "high": 3.0},
    "building": True,
    "overlap": True,
    "withheld": True,
}


def delivered(output: Path) -> dict[str, Columns]:
    """Every dimension of every delivered cloud, and x, y, z [m], by name."""
    found = {}
    for path in (output / "laz").rglob("*.laz"):
        las = laspy.read(path)
        found[path.name] = {**surveys.cloud(path), **dict(zip("xyz", las.xyz.T, strict=True))}
    return found


def heights(output: Path, points: Columns) -> np.ndarray:
    """Height of points above the delivered terrain, NaN where it is void."""
    with rasterio.open(output / "dtm.tif") as source:
        dtm, transform = source.read(1, masked=True).filled(np.nan), source.transform
    column = ((points["x"] - transform.c) // transform.a).astype(int)
    row = ((points["y"] - transform.f) // transform.e).astype(int)
    return points["z"] - dtm[row, column]


def covered_twice(files: dict[str, Columns]) -> set[tuple[int, int]]:
    """Squares of 5 m with a first signal return of two flightlines, by loops."""
    seen: dict[tuple[int, int], set[int]] = {}
    for points in files.values():
        pulses: dict[tuple[float, int], int] = {}
        for k in np.flatnonzero(points["noise_class"] == 0):
            pulse = points["gps_time"][k], points["channel"][k]
            if pulse not in pulses or points["Z"][pulses[pulse]] < points["Z"][k]:
                pulses[pulse] = k
        for k in pulses.values():
            square = int(points["x"][k] // 5), int(points["y"][k] // 5)
            seen.setdefault(square, set()).add(int(points["point_source_id"][k]))
    return {square for square, lines in seen.items() if len(lines) > 1}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, found = tmp_path_factory.mktemp("classes"), {}
    for name, tile_m in (("a", 100), ("b", 30)):
        workflow = surveys.small_survey(folder / name, classes=ALL, tiling={"tile_m": tile_m})
        result = surveys.run(workflow)
        assert result.exit_status == 0, result.report.failures
        found[name] = result.output
    return found


def test_no_tiling_changes_a_class_or_a_flag(runs: dict[str, Path]) -> None:
    assert surveys.results(runs["a"]) == surveys.results(runs["b"])


def test_classes_follow_heights_and_flags_places(runs: dict[str, Path]) -> None:
    files = delivered(runs["a"])
    squares = covered_twice(files)
    assert squares
    for points in files.values():
        kind, noise = points["classification"], np.isin(points["noise_class"], (1, 2))
        assert np.array_equal(points["withheld"] != 0, np.isin(kind, (7, 18)))
        assert np.array_equal(np.isin(kind, (7, 18)), noise)
        places = zip((points["x"] // 5).astype(int), (points["y"] // 5).astype(int), strict=True)
        assert [place in squares for place in places] == (points["overlap"] != 0).tolist()
        height, open_to = heights(runs["a"], points), np.isin(kind, (1, 3, 4, 5))
        wanted = np.select([height >= 3.0, height >= 0.7, height >= 0.3], [5, 4, 3], 1)
        assert np.array_equal(kind[open_to], wanted[open_to])


def test_where_the_terrain_is_void_signal_in_the_middle_is_the_surface() -> None:
    z = np.array([5_000, 7_000, 9_000, 90_000])  # the last is noise
    noise = np.array([NOISE_SIGNAL] * 3 + [NOISE_SIGNAL + 1], np.uint8)
    at = np.arange(4) * 1_000
    table = PointTable({"x": at, "y": at, "z": z, "noise_class": noise})
    dtm = np.array([[NODATA, NODATA], [4.0, NODATA]], np.float32)
    surface, void = _surface_below(table, Bounds(0, 0, 4_000, 4_000), dtm)
    assert void.tolist() == [False, False, True, True]
    assert surface.tolist() == [4.0, 4.0, 7.0, 7.0]


def test_heights_that_do_not_rise_are_refused(tmp_path: Path) -> None:
    workflow = surveys.small_survey(tmp_path, classes={"vegetation": {"low": 1.0}})
    with pytest.raises(WorkflowError, match=r"classes\.vegetation.* do not rise"):
        load_workflow(workflow)


def test_counts_are_of_the_classes_that_are_delivered(small: Path) -> None:
    for path in sorted((small.parent / "lines").glob("*.laz")):
        given = laspy.read(path)
        given.classification = np.full(len(given), 12, np.uint8)
        given.write(path)
    result = surveys.run(small, "outputs.classes=noise")
    report, kinds = result.report, [p["classification"] for p in delivered(result.output).values()]
    overlap = np.count_nonzero(np.concatenate(kinds) == 12)
    assert overlap == report.counts.signal > 0
    (row,) = [one for one in report.requirements if one.name == "Overlap by flag"]
    assert row.verdict == "fail"
    assert "".join(filter(str.isdigit, row.found)) == str(overlap)
    assert report.counts.ground > 0
