"""A delivery by tile holds the returns of one by flightline."""

from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest

from spl_batch.airborne.simulate.file_writers import PointFiles
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.airborne.simulate.shots import POINT
from spl_batch.errors import WorkflowError

EDGE_M = 20
SCENE = {"extent_m": [50, 50], "flights": [{"heading_deg": 0}, {"heading_deg": 90}]}
POINTS = 300


def write(folder, **delivery):
    """Two flightlines, each in two pieces; every third return has the one before as parent."""
    scene = parse_scene({**SCENE, "delivery": delivery}, "here")
    with ExitStack() as stack:
        files = PointFiles(scene, folder, stack)
        for number in (1, 2):
            run: Any = SimpleNamespace(
                number=number, middle_s=3e8 + 300 * number, flight=scene.flights[number - 1]
            )
            for piece in (0, 1):
                rng = np.random.default_rng([number, piece])
                columns = {
                    **{k: v + rng.uniform(0, 50, POINTS) for k, v in
                       (("x", 272_000.0), ("y", 3_290_000.0), ("z", 40.0))},
                    "gps_time": 3e8 + 300 * number + piece + np.sort(rng.uniform(0, 0.9, POINTS)),
                    "channel": rng.integers(1, 101, POINTS).astype(np.uint8),
                    "intensity": np.arange(POINTS).astype(np.uint16),
                }  # fmt: skip
                parent = np.where(np.arange(POINTS) % 3 == 2, np.arange(POINTS) - 1, -1)
                points = np.zeros(POINTS, POINT)
                points["kind"] = points["parent"] = rng.integers(0, 9, POINTS)
                points["parent_row"] = parent
                files.write(run, columns, points)
    return scene


def read(folder, of):
    """Each file's returns and truth, by name."""
    found = {}
    for path in sorted((folder / of).glob("*.laz")):
        truth = pq.read_table(folder / "truth" / f"{path.stem}.parquet")
        found[path.stem] = laspy.read(path), {k: truth[k].to_numpy() for k in truth.column_names}
    return found


def rows(found):
    """All returns with their kinds, sorted."""
    names = ("X", "Y", "Z", "gps_time", "channel", "point_source_id", "intensity")
    parts = [
        np.rec.fromarrays([*(np.asarray(las[n]) for n in names), truth["kind"]])
        for las, truth in found.values()
    ]
    return np.sort(np.concatenate(parts))


def test_tiles_hold_the_same_returns_and_truth_as_flightlines(tmp_path):
    write(tmp_path / "a")
    write(tmp_path / "b", tile_m=EDGE_M)
    lines, tiles = read(tmp_path / "a", "flightlines"), read(tmp_path / "b", "tiles")
    assert set(lines) == {"line_01", "line_02"}
    assert len(tiles) > 4
    assert np.array_equal(rows(lines), rows(tiles))
    together = 0
    for name, (las, truth) in tiles.items():
        i, j = (int(part) for part in name.split("_")[1:])
        assert np.all(np.floor(las.x / EDGE_M) == i)
        assert np.all(np.floor(las.y / EDGE_M) == j)
        time, line = np.asarray(las.gps_time), np.asarray(las.point_source_id)
        assert np.all(np.diff(time) >= 0), "flightline after flightline, each in time order"
        child = np.flatnonzero(truth["parent_row"] >= 0)
        parent = truth["parent_row"][child]
        assert np.array_equal(
            np.asarray(las.intensity)[parent] + 1, np.asarray(las.intensity)[child]
        )
        assert np.array_equal(line[parent], line[child])
        together += len(child)
    assert 0 < together < sum(np.sum(t["parent_row"] >= 0) for _, t in lines.values())


def test_a_delivery_may_hold_less(tmp_path):
    write(tmp_path, point_source_id=False, channel_dimension="user_data", scale_m=0.01)
    for las, _ in read(tmp_path, "flightlines").values():
        assert not np.any(las.point_source_id)
        assert "channel" not in las.point_format.dimension_names
        assert set(np.unique(las.user_data)) <= set(range(1, 101))
        assert len(np.unique(las.gps_time)) > 250
        assert np.allclose(las.header.scales, 0.01)


def test_tiles_too_many_to_be_open_are_refused():
    with pytest.raises(WorkflowError, match=r"more than 400 files; choose larger tiles"):
        parse_scene({**SCENE, "delivery": {"tile_m": 2}}, "here")
