"""COPC: laspy's reader, which follows the octree, finds every point where it should be."""

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS

from spl_batch.formats.las.copc import octree
from spl_batch.formats.las.reader import inspect, iter_points
from spl_batch.formats.las.writer import write_points
from spl_batch.lattice.tables import PointTable


def cloud(n: int, seed: int = 0, spread: int = 100_000) -> PointTable:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, spread, size=(2, n)) + 500_000_000
    return PointTable(
        {
            "x": x,
            "y": y + 4_000_000_000,
            "z": rng.integers(0, 20_000, size=n).astype(np.int32),
            "gps_time": rng.uniform(1e8, 1e8 + 5, size=n),
            "intensity": np.arange(n).astype(np.uint16),
            "classification": rng.integers(0, 19, size=n).astype(np.uint8),
        }
    )


def rows(*columns: np.ndarray) -> np.ndarray:
    """Rows in an order that does not depend on theirs."""
    stacked = np.stack([np.asarray(c, dtype=np.float64) for c in columns], axis=1)
    return stacked[np.lexsort(stacked.T)]


def test_reader_of_copc_finds_everything(tmp_path: Path) -> None:
    table = cloud(60_000)
    path = tmp_path / "a.copc.laz"
    extra = {"height": np.arange(60_000, dtype=np.float32)}
    assert write_points(path, table, crs=CRS.from_epsg(32615), extra=extra, copc=True) == 60_000
    with laspy.CopcReader.open(path) as reader:
        points = reader.query()
        levels = [len(reader.query(level=i)) for i in range(3)]
        box = laspy.copc.Bounds(
            np.array([500_020.0, 4_500_030.0]), np.array([500_040.0, 4_500_050.0])
        )
        part = reader.query(bounds=box)
    info = struct.unpack_from("<5dQQdd", path.read_bytes(), 375 + 54)
    np.testing.assert_array_equal(info[7:], (table["gps_time"].min(), table["gps_time"].max()))
    assert info[3] == 2**17 / 1000 / 2
    np.testing.assert_allclose(info[0], table["x"].min() / 1000 + info[3], atol=1e-6)
    names = ("X", "gps_time", "intensity", "classification", "height")
    wanted = rows(
        table["x"],
        table["gps_time"],
        table["intensity"],
        table["classification"],
        extra["height"],
    )
    raw = {n: np.asarray(points[n], dtype=np.float64) for n in names}
    raw["X"] = np.rint(np.asarray(points.x) * 1000)
    np.testing.assert_array_equal(rows(*raw.values()), wanted)
    assert levels[0] > 5000
    assert levels[1] > 0
    x, y = table["x"] / 1000, table["y"] / 1000
    inside = (x >= 500_020) & (x <= 500_040) & (y >= 4_500_030) & (y <= 4_500_050)
    assert len(part) == np.count_nonzero(inside)


def test_read_as_plain_laz_and_same_bytes(tmp_path: Path) -> None:
    table = cloud(30_000)
    for name in ("a", "b"):
        write_points(tmp_path / f"{name}.copc.laz", table, crs=None, copc=True)
    path = tmp_path / "a.copc.laz"
    assert path.read_bytes() == (tmp_path / "b.copc.laz").read_bytes()
    again = list(iter_points(path, channel_dimension=None, source=0, chunk=7000))
    names = ("x", "y", "z", "gps_time", "intensity")
    got = rows(*[np.concatenate([t[k] for t in again]) for k in names])
    np.testing.assert_array_equal(got, rows(*[table[k] for k in names]))
    assert inspect(path).n_points == 30_000


@pytest.mark.parametrize("spread", [1, 50, 100_000])
def test_every_record_is_in_one_node_and_nodes_nest(spread: int) -> None:
    rng = np.random.default_rng(1)
    records = np.zeros(30_000, dtype=[("X", "i4"), ("Y", "i4"), ("Z", "i4")])
    for name in "XYZ":
        records[name] = rng.integers(-spread, spread, size=len(records))
    cube, nodes = octree(records)
    np.testing.assert_array_equal(
        np.sort(np.concatenate([n.records for n in nodes])), np.arange(len(records))
    )
    keys = {n[:4] for n in nodes}
    assert len(keys) == len(nodes)
    for level, *octant, members in nodes:
        if level:
            assert (level - 1, *(p >> 1 for p in octant)) in keys
        for axis, name in enumerate("XYZ"):
            relative = records[name][members].astype(np.int64) - cube.low[axis]
            assert np.all(relative >> (cube.log2_size - level) == octant[axis])
