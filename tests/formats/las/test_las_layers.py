"""Copied layers: the same as decoding and compressing all of a file again."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest

from spl_batch.formats.las.chunks import RecordReader
from spl_batch.formats.las.frame import Extent
from spl_batch.formats.las.header import read_header
from spl_batch.formats.las.layers import can_be_copied, given_of
from spl_batch.formats.las.writer import Decoded, write_classified, write_points
from spl_batch.lattice.tables import PointTable
from tests.formats.las.test_las_write import labels
from tests.io_files import write_las

EXTRA = {"height": "f8", "beam": "u1", "pair": "2i4"}


def decoded(src: Path) -> tuple[Decoded, bool]:
    """What the index would keep of a file, and whether its layers can be copied."""
    with RecordReader(read_header(src)) as reader:
        records = reader.read(0, reader.header.n_points)
        extent = Extent()
        extent.add(records)
        kept = (
            given_of(records, reader.layout)
            if reader.layout.point_format >= 6
            else np.empty(0, np.uint32)
        )
        stored = Extent.from_arrays(extent.to_arrays())
        return Decoded(lambda a, b: kept[a:b], stored), can_be_copied(reader)


def twice(src: Path, folder: Path, *, diagnostics: bool = True) -> tuple[Path, Path, bool]:
    """A file written by copying layers and by compressing all; whether layers can be copied."""
    known, copied = decoded(src)
    pair = folder / "copied.laz", folder / "whole.laz"
    for path, found in zip(pair, (known, None), strict=True):
        classes = np.zeros((2, 256), np.int64)
        write_classified(
            src, path, labels=labels, diagnostics=diagnostics, crs=None, decoded=found,
            classes=classes,
        )  # fmt: skip
        written = laspy.read(path)
        for counted, chosen in zip(
            classes, (written.noise_class == 255, written.noise_class < 255), strict=True
        ):
            of_them = np.asarray(written.classification)[chosen]
            assert np.array_equal(counted, np.bincount(of_them, minlength=256))
    return *pair, copied


@pytest.mark.parametrize(
    ("point_format", "extra", "channels"),
    [(6, {}, 1), (6, EXTRA, 4), (7, EXTRA, 1), (8, EXTRA, 4)],
)
def test_same_bytes_as_compressing_all_again(
    tmp_path: Path, point_format: int, extra: dict[str, str], channels: int
) -> None:
    n = 50_100  # two chunks
    values = {"scanner_channel": 3 - np.arange(n) % channels}
    src = write_las(tmp_path / "a.laz", point_format=point_format, n=n, extra=extra, values=values)
    copied, whole, can = twice(src, tmp_path, diagnostics=bool(extra))
    assert can
    assert copied.read_bytes() == whole.read_bytes()


@pytest.mark.parametrize("point_format", [6, 8])
def test_flags_are_set_beside_those_of_the_input(tmp_path: Path, point_format: int) -> None:
    n = 50_100
    number = np.arange(n)
    values = {
        "scanner_channel": number % 4,
        "withheld": number % 5 == 0,
        "overlap": number % 7 == 0,
        "synthetic": number % 11 == 0,
        "edge_of_flight_line": number % 3 == 0,
        "scan_direction_flag": number % 2,
        "scan_angle": number % 100 - 50,
        "point_source_id": number % 9,
        "user_data": number % 101,
    }
    src = write_las(tmp_path / "a.laz", point_format=point_format, n=n, extra=EXTRA, values=values)
    known, _ = decoded(src)
    set_flags = np.random.default_rng(3).choice([0, 4, 8, 12], n).astype(np.uint8)

    def flagged(start: int, stop: int) -> dict[str, Any]:
        return {**labels(start, stop), "set_flags": set_flags[start:stop]}

    read = []
    for name, found in (("copied.laz", known), ("whole.laz", None)):
        write_classified(
            src, tmp_path / name, labels=flagged, diagnostics=False, flags=True, crs=None,
            decoded=found,
        )  # fmt: skip
        read.append((tmp_path / name).read_bytes())
    assert read[0] == read[1]
    before, after = laspy.read(src), laspy.read(tmp_path / "copied.laz")
    assert np.array_equal(after.withheld, np.asarray(before.withheld) | ((set_flags & 4) > 0))
    assert np.array_equal(after.overlap, np.asarray(before.overlap) | ((set_flags & 8) > 0))
    changed = {"classification", "withheld", "overlap"}
    for name in set(before.point_format.dimension_names) - changed:
        assert np.array_equal(after[name], before[name]), name


def test_chunks_of_any_size(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    columns: dict[str, Any] = {
        axis: rng.integers(0, 50_000, 30_000).astype(dtype)
        for axis, dtype in {"x": np.int64, "y": np.int64, "z": np.int32}.items()
    }
    columns["return_number"] = rng.integers(1, 4, 30_000).astype(np.uint8)
    write_points(tmp_path / "a.laz", PointTable(columns), crs=None, copc=True)
    with RecordReader(read_header(tmp_path / "a.laz")) as reader:
        sizes = {stop - start for start, stop, _ in reader.packed_chunks()}
    copied, whole, can = twice(tmp_path / "a.laz", tmp_path)
    assert can
    assert len(sizes) > 1
    ours, theirs = laspy.read(copied), laspy.read(whole)
    assert ours.points.array.tobytes() == theirs.points.array.tobytes()
    with RecordReader(read_header(copied)) as reader:
        assert {stop - start for start, stop, _ in reader.packed_chunks()} == sizes


@pytest.mark.parametrize(
    ("name", "point_format"), [("a.las", 6), ("a.laz", 3), ("a.las", 1), ("a.laz", 0)]
)
def test_other_files_are_compressed_anew(tmp_path: Path, name: str, point_format: int) -> None:
    src = write_las(tmp_path / name, version="1.4", point_format=point_format)
    copied, whole, can = twice(src, tmp_path)
    assert not can
    assert copied.read_bytes() == whole.read_bytes()
