"""Broken files: one clear line that names value and remedy, at once, without much memory."""

import os
import struct
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest

from spl_batch.errors import InputError
from spl_batch.formats.las.reader import inspect, iter_points
from tests.io_files import patch, write_las


def fault(path: Path) -> str:
    """The message that inspecting a file ends with; it is one line and comes quickly."""
    tracemalloc.start()
    started = time.perf_counter()
    with pytest.raises(InputError) as caught:
        inspect(path)
    assert time.perf_counter() - started < 2
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def read(path: Path) -> int:
    return sum(len(t) for t in iter_points(path, channel_dimension=None, source=0))


def test_missing_folder_empty_and_foreign_files(tmp_path: Path) -> None:
    assert "no such file" in fault(tmp_path / "a.laz")
    assert "is a folder" in fault(tmp_path)
    empty, text, short = (tmp_path / n for n in ("empty.las", "text.las", "short.las"))
    empty.touch()
    text.write_text("x,y,z\n1,2,3\n" * 100)
    short.write_bytes(b"LASF" + bytes(100))
    assert "0 bytes" in fault(empty)
    assert "not a LAS or LAZ file" in fault(text)
    assert "cut off inside its header" in fault(short)
    os.mkfifo(tmp_path / "pipe.las")
    assert "not a regular file" in fault(tmp_path / "pipe.las")


HEADER_FAULTS = {
    "number of VLRs is 1069128089": (100, "I", (1069128089,)),
    "version 1.7": (25, "B", (7,)),
    "version 2.2": (24, "BB", (2, 2)),
    "header size is 17": (94, "H", (17,)),
    "offset to point data is 10": (96, "I", (10,)),
    "offset to point data is 4294967295": (96, "I", (2**32 - 1,)),
    "point format is 63": (104, "B", (63,)),
    "point record length is 3": (105, "H", (3,)),
    "number of points is 1000000": (107, "I", (10**6,)),
    "x scale 0.0": (131, "d", (0.0,)),
    "x scale nan": (131, "d", (float("nan"),)),
    "y offset inf": (163, "d", (float("inf"),)),
    "bounding box x": (179, "d", (float("nan"),)),
    "bounding box y 7000000.0 to": (203, "d", (7e6,)),
    "bounding box z": (211, "d", (1e30,)),
}


@pytest.mark.parametrize("words", HEADER_FAULTS)
def test_each_field_of_the_header(tmp_path: Path, words: str) -> None:
    path = write_las(tmp_path / "a.las", version="1.2", point_format=1, n=50)
    offset, code, values = HEADER_FAULTS[words]
    assert words in fault(patch(path, offset, code, *values))


def test_more_vlrs_than_there_are(tmp_path: Path) -> None:
    vlrs = [laspy.VLR("me", i, "", bytes(100)) for i in range(2)]
    path = write_las(tmp_path / "a.las", version="1.2", point_format=3, vlrs=vlrs)
    assert "VLR 3 of 3" in fault(patch(path, 100, "I", 3))


@pytest.mark.parametrize(
    ("offset", "code", "value", "words"),
    [
        (235, "Q", 10**12, "start of extended VLR 1 of 1 is 1000000000000"),
        (243, "I", 2**32 - 1, "number of extended VLRs"),
        (243, "I", 2, "extended VLR 2 of 2"),
        (-20 - 40, "Q", 2**63, "length of extended VLR 1 of 1 is 9223372036854775808"),
    ],
)
def test_extended_vlrs(tmp_path: Path, offset: int, code: str, value: int, words: str) -> None:
    path = write_las(tmp_path / "a.laz", evlrs=[laspy.VLR("me", 1, "", bytes(20))])
    size = path.stat().st_size
    assert words in fault(patch(path, offset if offset >= 0 else size + offset, code, value))


def test_cut_off_anywhere(tmp_path: Path) -> None:
    for suffix in (".las", ".laz"):
        content = write_las(tmp_path / f"a{suffix}", n=60_000).read_bytes()
        for share in (0.001, 0.01, 0.3, 0.9, 0.99999):
            cut = tmp_path / f"cut{suffix}"
            cut.write_bytes(content[: int(share * len(content))])
            assert "copy it again" in fault(cut)


def _laz_offsets(content: bytes) -> tuple[int, int, int]:
    """Bytes of the LASzip record's data, of the points, of the chunk table."""
    points = struct.unpack_from("<I", content, 96)[0]
    return (
        content.index(b"laszip encoded") - 2 + 54,
        points,
        struct.unpack_from("<q", content, points)[0],
    )


LAZ_FAULTS: dict[str, Callable[[bytearray, tuple[int, int, int]], None]] = {
    "no LASzip record": lambda c, p: struct.pack_into("<H", c, p[0] - 54 + 18, 1),
    "LASzip compressor is 9": lambda c, p: struct.pack_into("<H", c, p[0], 9),
    # Its chunks are of any size then, and the table holds no numbers of points.
    "LAZ chunk table cannot be decoded": lambda c, p: struct.pack_into("<I", c, p[0] + 12, 0),
    "bytes of all LASzip items": lambda c, p: struct.pack_into("<H", c, p[0] + 36, 99),
    "it is cut off: it has ": lambda c, p: struct.pack_into("<q", c, p[1], 10**9),
    "byte of its LAZ chunk table is -5": lambda c, p: struct.pack_into("<q", c, p[1], -5),
    "number of chunks in the LAZ chunk table is 4294967295": lambda c, p: struct.pack_into(
        "<I", c, p[2] + 4, 2**32 - 1
    ),
    "number of chunks in the LAZ chunk table is 1": lambda c, p: struct.pack_into(
        "<I", c, p[2] + 4, 1
    ),
}


@pytest.mark.parametrize("words", LAZ_FAULTS)
def test_laz_structure(tmp_path: Path, words: str) -> None:
    path = write_las(tmp_path / "a.laz", n=60_000)
    content = bytearray(path.read_bytes())
    LAZ_FAULTS[words](content, _laz_offsets(bytes(content)))
    path.write_bytes(content)
    assert words in fault(path)


@pytest.mark.parametrize("point_format", [1, 6])
def test_damage_in_the_middle_never_passes_for_points(tmp_path: Path, point_format: int) -> None:
    n = 150_000
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.integers(-50, 51, size=n))
    path = write_las(
        tmp_path / "a.laz", point_format=point_format, n=n, values={"X": walk, "Y": -walk}
    )
    content = bytearray(path.read_bytes())
    record, points, table = _laz_offsets(bytes(content))
    with path.open("rb") as file:
        file.seek(points)
        laz = lazrs.LazVlr(bytes(content[record:points]))
        second = points + 8 + lazrs.read_chunk_table(file, laz)[0][1] + 40
    assert second < (points + table) // 2
    content[second : second + 2000] = b"\xff" * 2000
    path.write_bytes(content)
    inspect(path)
    with pytest.raises(InputError) as caught:
        read(path)
    numbers = [int(w) for w in str(caught.value).replace(":", " ").split() if w.isdigit()]
    assert any(50_000 <= v < 100_000 for v in numbers)
    # Damaged layer sizes, if believed, make the decoder allocate gigabytes.
    assert ("of the layers of points" in str(caught.value)) == (point_format == 6)


class PanicException(BaseException):
    """What a panic of the Rust decoder raises."""


@pytest.mark.parametrize("error", [OverflowError("int too big"), PanicException("index 9 of 3")])
def test_what_a_library_raises_over_a_file_is_that_files_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def raising(*_: object) -> None:
        raise error

    path = write_las(tmp_path / "a.laz")
    monkeypatch.setattr("spl_batch.formats.las.reader.header_crs", raising)
    assert str(error) in fault(path)
    monkeypatch.setattr("spl_batch.formats.las.reader.header_crs", interrupting)
    with pytest.raises(KeyboardInterrupt):
        inspect(path)


def interrupting(*_: object) -> None:
    raise KeyboardInterrupt
