"""A delivery by tile holds the returns of one by flightline."""

from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from pyproj import Transformer

from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.file_writers import PointFiles
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
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
                kind = rng.integers(0, 9, POINTS).astype(np.uint8)
                files.write(run, columns, {"kind": kind, "parent": kind, "parent_row": parent})
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


def test_a_delivery_may_tell_less(tmp_path):
    write(tmp_path, point_source_id=False, channel_dimension="user_data", time_step_us=10,
          scale_m=0.01)  # fmt: skip
    for las, _ in read(tmp_path, "flightlines").values():
        assert not np.any(las.point_source_id)
        assert "channel" not in las.point_format.dimension_names
        assert set(np.unique(las.user_data)) <= set(range(1, 101))
        steps = np.asarray(las.gps_time) / 1e-5
        assert np.allclose(steps, np.rint(steps), rtol=0, atol=0.01)
        assert len(np.unique(las.gps_time)) > 250
        assert np.allclose(las.header.scales, 0.01)


def test_tiles_too_many_to_be_open_are_refused():
    with pytest.raises(WorkflowError, match=r"more than 400 files; choose larger tiles"):
        parse_scene({**SCENE, "delivery": {"tile_m": 2}}, "here")


def test_flightlines_may_be_recorded_each_in_its_own_way(tmp_path):
    """The same two flights plain, and with a roll and a longer gate, or in another zone."""
    flights = [
        {"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
        {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110, "altitude_agl_m": 1500},
    ]
    calm = {"extent_m": [20, 20], "terrain": {"relief_m": 0}, "sky": {"background_per_m3": 0.02},
            "acquisition": {"prf_hz": 20_000, "gate_m": 120}}  # fmt: skip
    unlike = [{"boresight_roll_deg": 0.02}, {"crs": "EPSG:32616", "gate_m": 200}]
    found = {}
    for name, more in (("plain", [{}, {}]), ("unlike", unlike)):
        own = [{**flight, **extra} for flight, extra in zip(flights, more, strict=True)]
        simulate(parse_scene({**calm, "flights": own}, "here"), tmp_path / name)
        found[name] = read(tmp_path / name, "flightlines")
    turned, plain = (found[name]["line_01"][0] for name in ("unlike", "plain"))
    # Northwards starboard is east: there beams are turned down, and all of them to the west.
    angle = np.radians(0.02)
    np.testing.assert_allclose(turned.x - plain.x, -2500 * angle, atol=150 * angle)
    starboard = plain.x - (272_010 + 300)
    np.testing.assert_allclose(turned.z - plain.z, -starboard * angle, atol=0.02)
    other, truth = found["unlike"]["line_02"]
    assert other.header.parse_crs().to_epsg() == 32616
    moved = Transformer.from_crs(32616, 32615, always_xy=True).transform(other.x, other.y)
    middle = [np.mean(values[truth["kind"] == 1]) for values in moved]
    np.testing.assert_allclose(middle, [272_010, 3_290_010], atol=5)
    reach = [np.ptp(found[name]["line_02"][0].z) for name in ("plain", "unlike")]
    assert reach == pytest.approx([120, 200], abs=8)
    gates = [
        yaml.safe_load((tmp_path / name / "workflow.yaml").read_text())["acquisition"].get("gate_m")
        for name in found
    ]
    assert gates == [120, None]
