"""Points of several clouds in one: other scales, offsets, formats and extra bytes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from spl_batch.errors import InputError
from spl_batch.formats.las.cut import Piece, write_cut


def write(
    path: Path,
    x: list[float],
    *,
    point_format: int = 6,
    scale: float = 0.01,
    offset: float = 0.0,
    extra: Mapping[str, Any] | None = None,
    adjusted: bool = True,
) -> Path:
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.scales, header.offsets = np.full(3, scale), np.array([offset, offset, 0.0])
    kinds = laspy.header.GpsTimeType
    header.global_encoding.gps_time_type = kinds.STANDARD if adjusted else kinds.WEEK_TIME
    for name, values in (extra or {}).items():
        header.add_extra_dim(laspy.ExtraBytesParams(name, np.asarray(values).dtype))
    las = laspy.LasData(header)
    las.x, las.y, las.z = x, np.array(x) + 1.0, np.full(len(x), 0.1)
    las.gps_time, las.point_source_id = np.arange(len(x)) + 0.5, np.arange(len(x)) + 7
    if point_format > 6:
        las.red = np.arange(len(x)) + 100
    for name, values in (extra or {}).items():
        las[name] = values
    las.write(path)
    return path


def whole(*paths: Path) -> list[Piece]:
    return [Piece(path, [(0, len(laspy.read(path).points))]) for path in paths]


def everywhere(x: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.ones(len(x), bool)


def test_clouds_that_differ(tmp_path: Path) -> None:
    a = write(tmp_path / "a.laz", [1.01, 2.02], extra={"grade": np.array([3, 4], np.uint8)})
    b = write(
        tmp_path / "b.laz", [5.005], point_format=7, scale=0.001, offset=5.0,
        extra={"other": np.array([2.5])},
    )  # fmt: skip
    assert write_cut(tmp_path / "cut.laz", whole(a, b), everywhere) == 3
    cut = laspy.read(tmp_path / "cut.laz")
    assert cut.header.point_format.id == 7
    assert list(cut.x) == pytest.approx([1.01, 2.02, 5.005], abs=1e-9)
    assert list(cut.y) == pytest.approx([2.01, 3.02, 6.005], abs=1e-9)
    assert cut.gps_time.tolist() == [0.5, 1.5, 0.5]
    assert cut.point_source_id.tolist() == [7, 8, 7]
    assert cut.red.tolist() == [0, 0, 100]
    assert cut["grade"].tolist() == [3, 4, 0]
    assert cut["other"].tolist() == [0.0, 0.0, 2.5]


def test_alike_clouds_keep_their_raw_coordinates_and_ranges_count(tmp_path: Path) -> None:
    a = write(tmp_path / "a.laz", [1.0, 2.0, 3.0, 4.0], offset=0.1)
    pieces = [Piece(a, [(0, 1), (2, 4)])]
    assert write_cut(tmp_path / "cut.laz", pieces, lambda x, _: x < 3.5) == 2
    given, cut = laspy.read(a), laspy.read(tmp_path / "cut.laz")
    assert cut.X.tolist() == given.X[[0, 2]].tolist()
    assert cut.header.offsets.tolist() == given.header.offsets.tolist()
    assert write_cut(tmp_path / "none.laz", whole(a), lambda x, _: x < 0) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"extra": {"grade": np.array([1.0])}}, "'grade' is of another type"),
        ({"adjusted": False}, "gps_time"),
        ({"offset": 1e8, "scale": 0.001}, "too far from the offset"),
    ],
)
def test_clouds_that_do_not_go_together(
    tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    a = write(tmp_path / "a.laz", [1.0], extra={"grade": np.array([1], np.uint8)})
    b = write(tmp_path / "b.laz", [options.get("offset", 1.0)], **options)
    with pytest.raises(InputError, match=words) as fault:
        write_cut(tmp_path / "cut.laz", whole(a, b), everywhere)
    assert "b.laz" in str(fault.value)
    assert not (tmp_path / "cut.laz").exists()
