"""Without a trajectory the sensor is where lines of sight meet, and tiles do not matter."""

from pathlib import Path

import numpy as np
import pytest

from spl_batch.formats.trajectory.positions import read_slice
from tests.surveys import (
    HEIGHT_M,
    ORIGIN_M,
    SPEED_M_S,
    START_S,
    assert_same_labels,
    copy_of,
    labels,
    report,
    run,
    small_survey,
)


@pytest.mark.slow
def test_labels_are_the_same_for_two_sizes_of_tiles(tmp_path: Path) -> None:
    # Short intervals, so that a tenth of a second gives lines of sight enough.
    first = small_survey(tmp_path / "a", noise={"interval_shots": 5})
    second = copy_of(first, tmp_path / "b")
    run(first, "tiling.tile_m=50")
    run(second, "tiling.tile_m=200")
    found = labels(tmp_path / "a" / "out")
    assert_same_labels(found, labels(tmp_path / "b" / "out"))
    classes = np.concatenate([columns["classification"] for columns in found.values()])
    assert len(np.unique(classes)) > 1
    sensor_was_found_by_intersection(tmp_path / "a" / "out")


def sensor_was_found_by_intersection(output: Path) -> None:
    """The report says so of both flightlines, and the paths are those that were flown."""
    lines = report(output)["survey"]["flightlines"]
    assert [line["beam_basis"] for line in lines] == ["intersection"] * 2
    paths = sorted((output / "store" / "paths").glob("*.parquet"))
    for start_s, path in zip((START_S, START_S + 3.0), paths, strict=True):
        # A knot a second; the pass is over after the first.
        sensor = read_slice(path, start_s, start_s + 0.12)
        at_start, _ = sensor.position(np.array([start_s]))
        np.testing.assert_allclose(at_start, [[*ORIGIN_M, HEIGHT_M]], atol=0.6)  # 1 mrad
        speed = np.diff(sensor.xyz_m[:, :2], axis=0) / np.diff(sensor.time_s)[:, None]
        np.testing.assert_allclose(speed, [[SPEED_M_S, 0.0]], atol=0.6)
