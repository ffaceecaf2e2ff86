"""A header whose number of points is too small hides points: the file is refused, in one line."""

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from spl_batch.errors import InputError, grouped
from spl_batch.formats.las.reader import inspect, iter_points
from spl_batch.formats.las.writer import write_points
from spl_batch.lattice.tables import PointTable
from tests.io_files import patch, write_las

COUNT_AT = 247
"""Where a header of LAS 1.4 has its number of points."""


def counted(path: Path, n: int) -> Path:
    """The file with another number of points in its header."""
    if path.read_bytes()[25] >= 4:
        patch(path, COUNT_AT, "Q", n)
        n = 0
    return patch(path, 107, "I", n)


def looked_at_and_read(path: Path) -> int:
    """Points of the file, if a plan and a run take it."""
    n = inspect(path).n_points
    assert sum(len(t) for t in iter_points(path, channel_dimension=None, source=0)) == n
    return n


def refusal(path: Path) -> str:
    """What the file is refused with, when it is looked at or else when it is read."""
    with pytest.raises(InputError) as caught:
        looked_at_and_read(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "number of points" in message
    assert "\n" not in message
    assert len(message) - len(str(path)) < 300
    return message


@pytest.mark.parametrize(("version", "point_format"), [("1.2", 1), ("1.3", 4), ("1.4", 6)])
@pytest.mark.parametrize("n", [0, 60, 99])
def test_records_beyond_the_count(tmp_path: Path, version: str, point_format: int, n: int) -> None:
    path = write_las(tmp_path / "a.las", version=version, point_format=point_format, n=100)
    with pytest.raises(InputError) as caught:
        inspect(counted(path, n))
    (fault,) = caught.value.faults
    assert f"its header counts {n} points" in fault
    assert "room for 100" in fault
    assert "number of points" in refusal(path)
    assert inspect(counted(path, 100)).n_points == 100


@pytest.mark.parametrize("n", [0, 60, 100])
def test_extended_records_are_no_points(tmp_path: Path, n: int) -> None:
    path = write_las(tmp_path / "a.las", n=100, evlrs=[laspy.VLR("me", 1, "", bytes(range(200)))])
    counted(path, n)
    if n == 100:
        assert looked_at_and_read(path) == 100
    else:
        assert "room for 100" in refusal(path)


@pytest.mark.parametrize("point_format", [1, 6])
def test_compressed_points_beyond_the_count(tmp_path: Path, point_format: int) -> None:
    path = write_las(tmp_path / "a.laz", point_format=point_format, n=50_100)
    for n, there in (
        (0, "bytes of compressed points"),
        (50_000, f"2 LAZ chunks hold {grouped(50_001)} to {grouped(100_000)}"),
        (50_095, "its last LAZ chunk holds more" if point_format < 6 else "hold 50 100"),
    ):
        message = refusal(counted(path, n))
        assert f"its header counts {grouped(n)} points" in message
        assert there in message
    assert looked_at_and_read(counted(path, 50_100)) == 50_100


@pytest.mark.parametrize("offset", [-1, 0])
def test_a_compressor_that_never_came_to_its_chunk_table(tmp_path: Path, offset: int) -> None:
    path = write_las(tmp_path / "a.laz", n=1000)
    start = struct.unpack_from("<I", path.read_bytes(), 96)[0]
    table = struct.unpack_from("<q", path.read_bytes(), start)[0]
    path.write_bytes(path.read_bytes()[:table])
    patch(path, start, "q", offset)
    assert "its header counts 0 points" in refusal(counted(path, 0))


def test_chunks_of_any_size_beyond_the_count(tmp_path: Path) -> None:
    points = {k: np.arange(9000).astype(t) for k, t in {"x": "i8", "y": "i8", "z": "i4"}.items()}
    path = tmp_path / "a.copc.laz"
    write_points(path, PointTable(points), crs=None, copc=True)
    assert inspect(path).n_points == 9000
    for n in (0, 8999):
        assert "its header counts" in refusal(counted(path, n))


@pytest.mark.parametrize(
    ("point_format", "n"), [(0, 1), (0, 3000), (1, 2), (1, 50_001), (2, 3), (3, 50_000)]
)
def test_a_right_count_is_never_refused(tmp_path: Path, point_format: int, n: int) -> None:
    path = write_las(tmp_path / "a.laz", version="1.2", point_format=point_format, n=n)
    assert looked_at_and_read(path) == n
