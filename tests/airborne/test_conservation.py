"""Every point in is a point out, whatever the files look like."""

import itertools
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import surveys
from tests.surveys import Columns

IDENTITY = ("X", "Y", "Z", "gps_time", "channel", "intensity", "user_data", "point_source_id")


def run_clouds(
    clouds: dict[str, Columns], *, report: bool = False, **sections: Any
) -> tuple[Any, dict[str, Columns]]:
    """Run clouds through; check each output against its input, in order.

    Gives the counts of the report, where one is asked for, and the delivered clouds.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name, columns in clouds.items():
            surveys.write_cloud(Path(folder) / "lines" / f"{name}.laz", columns)
        workflow = surveys.write_workflow(Path(folder), **sections)
        result = surveys.run(workflow, until=None if report else "deliver")
        given_clouds = {
            f"lines/{n}.laz": surveys.cloud(Path(folder) / "lines" / f"{n}.laz") for n in clouds
        }
        found = surveys.delivered(result.output)
    assert result.exit_status == 0
    assert found.keys() == given_clouds.keys()
    for name, given_cloud in given_clouds.items():
        for key, values in given_cloud.items():
            back = found[name]["input_classification" if key == "classification" else key]
            assert values.tobytes() == back.tobytes(), f"{name}: {key}"
    if result.report is not None:
        counts = result.report.counts
        total = sum(len(c["x"]) for c in clouds.values())
        assert counts.points_in == counts.points_out == total
        parts = ("signal", "background", "afterpulse", "not_assessed")
        assert sum(getattr(counts, k) for k in parts) == total
    return result.report, found


def unassessed(clouds: dict[str, Columns]) -> int:
    return sum(int(np.count_nonzero(c["noise_class"] == 255)) for c in clouds.values())


def all_rows(clouds: dict[str, Columns]) -> bytes:
    names = (*IDENTITY, "noise_class", "classification")
    return bytes(np.sort(np.concatenate([surveys.point_rows(c, names) for c in clouds.values()])))


@pytest.mark.parametrize(
    ("cuts", "shuffled", "lift", "shift_m"),
    [
        ([700, 1500], True, True, (0.0, 0.0)),
        ([1], False, False, (-272_000.0, -3_290_000.0)),
    ],
)
def test_cut_shuffled_lifted_and_negative(
    cuts: list[int], *, shuffled: bool, lift: bool, shift_m: tuple[float, float]
) -> None:
    origin = (surveys.ORIGIN_M[0] + shift_m[0] - 1.5, surveys.ORIGIN_M[1] + shift_m[1])
    line = surveys.flightline(shots=60, origin_m=origin)
    if lift:
        later = surveys.flightline(shots=40, origin_m=origin, start_s=surveys.START_S + 200, seed=3)
        line = surveys.join(line, later)
    if shuffled:
        line = surveys.take(line, np.random.default_rng(len(cuts)).permutation(len(line["x"])))
    edges = sorted({0, len(line["x"]), *(c for c in cuts if c < len(line["x"]))})
    clouds = {
        # Names are not in the order of the pieces.
        f"{'cab'[k % 3]}{k}": surveys.take(line, slice(a, b))
        for k, (a, b) in enumerate(itertools.pairwise(edges))
    }
    _, found = run_clouds(clouds)
    assert unassessed(found) == 0
    _, whole = run_clouds({"all": line})
    assert all_rows(found) == all_rows(whole), "files do not matter to the labels"


def test_points_on_tile_edges() -> None:
    tile_m, corner_m, seed = 5.0, (-20.0, 10.0), 1
    line = surveys.flightline(shots=40, origin_m=corner_m, seed=seed)
    rng = np.random.default_rng(seed)
    some = rng.random(len(line["x"])) < 0.5
    for axis in "xy":
        # Half of the points are put on an edge, or a millimetre to its left.
        on_edge = np.round(line[axis][some] / tile_m) * tile_m
        line[axis][some] = on_edge - rng.integers(0, 2, on_edge.shape) * 0.001
    _, found = run_clouds({"edges": line}, tiling={"tile_m": tile_m})
    _, whole = run_clouds({"edges": line}, tiling={"tile_m": 100.0})
    assert all_rows(found) == all_rows(whole)


def test_withheld_and_vendor_flagged_points_are_carried_and_counted() -> None:
    line = surveys.flightline(shots=60)
    rng = np.random.default_rng(1)
    withheld = rng.random(len(line["x"])) < 0.05
    noise = (rng.random(len(line["x"])) < 0.05) & ~withheld
    line["withheld"] = withheld.astype(np.uint8)
    line["classification"][noise] = 7
    report, found = run_clouds({"flags": line}, report=True)
    counts = report.counts
    assert counts.withheld == np.count_nonzero(withheld)
    assert counts.vendor_flagged == np.count_nonzero(noise)
    got = found["lines/flags.laz"]
    assert np.all(got["noise_class"][withheld | noise] == 255)
    assert np.all(got["noise_class"][~(withheld | noise)] != 255)
    assert np.all(got["classification"][noise] == 7)
    _, clean = run_clouds({"flags": surveys.take(line, ~(withheld | noise))})
    kept = surveys.take(got, ~(withheld | noise))
    assert np.array_equal(kept["noise_class"], clean["lines/flags.laz"]["noise_class"]), (
        "they take part in nothing"
    )
