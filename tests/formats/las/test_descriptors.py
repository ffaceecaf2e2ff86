"""What readers do not take of a header is put in order, reported, and loses no byte of a point."""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.formats.las.chunks import RecordReader
from spl_batch.formats.las.convert import conversion
from spl_batch.formats.las.header import read_header
from spl_batch.formats.las.records import record_layout
from spl_batch.formats.las.writer import added_dimensions, write_classified
from tests.io_files import write_las

SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 8, 8: 8, 9: 4, 10: 8}
POINTS = 20


def descriptor(
    code: int = 1,
    options: int = 0,
    name: bytes = b"a",
    text: bytes = b"",
    scale: float = 1.0,
    offset: float = 0.0,
) -> bytes:
    numbers = struct.pack("<6d", scale, 1.0, 1.0, offset, 0.0, 0.0)
    return struct.pack("<2sBB32s76s48s32s", b"", code, options, name, b"", numbers, text)


def described(folder: Path, *descriptors: bytes, point_format: int = 6) -> Path:
    """A file whose extra bytes have these descriptors."""
    sizes = [SIZES[d[2]] if d[2] else d[3] for d in descriptors]
    extra = {f"e{k}": "u1" for k in range(sum(sizes))}
    values = {name: (np.arange(POINTS) * 7 + k).astype(np.uint8) for k, name in enumerate(extra)}
    path = write_las(
        folder / "a.las", n=POINTS, point_format=point_format, extra=extra, values=values
    )
    content = path.read_bytes()
    offset = content.index(b"LASF_Spec") - 2
    data = b"".join(descriptors)
    before = 54 + struct.unpack_from("<H", content, offset + 20)[0]
    head = bytearray(content[:offset] + content[offset : offset + 54] + data)
    struct.pack_into("<H", head, offset + 20, len(data))
    (start,) = struct.unpack_from("<I", head, 96)
    struct.pack_into("<I", head, 96, start + 54 + len(data) - before)
    evlrs = struct.unpack_from("<Q", head, 235)[0]
    assert not evlrs
    path.write_bytes(bytes(head) + content[offset + before :])
    return path


def labels(start: int, stop: int) -> Mapping[str, NDArray[Any]]:
    return dict.fromkeys(("classification", "noise_class"), np.zeros(stop - start, np.uint8))


def copied(path: Path) -> tuple[laspy.LasData, list[str]]:
    """A copy as laspy reads it and writes it again, and what is described anew."""
    target = path.with_name("copy.laz")
    write_classified(path, target, labels=labels, diagnostics=False, crs=None)
    found = laspy.read(target)
    for name in found.point_format.dimension_names:
        assert len(found[name]) == POINTS
    layout = record_layout(read_header(path))
    return found, list(conversion(layout, added_dimensions(layout, diagnostics=False)).mended)


def extra_bytes(path: Path, but: int = 0) -> NDArray[np.uint8]:
    """Bytes of the extra dimensions of each point, without the last ones."""
    with RecordReader(read_header(path)) as reader:
        records = np.ascontiguousarray(reader.read(0, POINTS))
        size = sum(d.dtype.itemsize for d in reader.layout.extra)
    raw = records.view(np.uint8).reshape(POINTS, -1)
    return raw[:, raw.shape[1] - size : raw.shape[1] - but]


CASES = {
    "name twice": ([{"name": b"k"}, {"name": b"k"}], ["k", "k_2"]),
    "name of the record": ([{"name": b"gps_time"}], ["gps_time_2"]),
    "bits of the record": ([{"name": b"bit_fields"}], ["bit_fields_2"]),
    "long name twice": ([{"name": b"k" * 32}] * 2, ["k" * 32, "k" * 30 + "_2"]),
    "no text": ([{"name": b"a\xff"}], ["a"]),
    "text that is cut": ([{"name": b"a" + "é".encode() * 16}], ["a" + "é" * 15]),
    "no name": ([{"name": b""}, {"name": b"\xff"}], ["unnamed", "unnamed_2"]),
    "description": ([{"text": b"\xff\xfe"}], ["a"]),
    "scale": ([{"options": 8, "scale": np.inf}], ["a"]),
    "scale of zero": ([{"options": 24, "scale": 0.0}], ["a"]),
    "offset": ([{"options": 31, "offset": np.nan}], ["a"]),
}


@pytest.mark.parametrize("case", CASES)
def test_what_laspy_refuses_is_described_anew(tmp_path: Path, case: str) -> None:
    parts, names = CASES[case]
    path = described(tmp_path, *(descriptor(**part) for part in parts))  # type: ignore[arg-type]
    found, mended = copied(path)
    found.write(path.with_name("again.laz"))
    got = [*found.point_format.extra_dimension_names]
    assert got == [*names, "input_classification", "noise_class"]
    assert mended[-1] == names[-1]
    assert np.array_equal(extra_bytes(path), extra_bytes(path.with_name("copy.laz"), but=2))


def test_a_block_without_a_type_is_bytes(tmp_path: Path) -> None:
    found, _ = copied(path := described(tmp_path, descriptor(0, 9, b"b")))
    assert [*found.point_format.extra_dimension_names][:2] == ["undescribed_0", "undescribed_1"]
    assert np.array_equal(extra_bytes(path), extra_bytes(path.with_name("copy.laz"), but=2))


def test_what_is_in_order_stays(tmp_path: Path) -> None:
    sound = [descriptor(7, 31, "é".encode() * 16, b"text", 0.5, -3.0), descriptor(10, name=b"X Y")]
    path = described(tmp_path, *sound)
    found, remarks = copied(path)
    assert remarks == []
    assert read_header(path.with_name("copy.laz")).raw[26:58] == read_header(path).raw[26:58]
    assert b"".join(sound) in path.with_name("copy.laz").read_bytes()
    assert np.isfinite(found["é" * 16]).all()


def test_a_name_that_the_copy_needs_is_its_own(tmp_path: Path) -> None:
    path = described(tmp_path, descriptor(name=b"noise_class"), descriptor(name=b"noise_class\xff"))
    found, remarks = copied(path)
    names = ["noise_class_2", "noise_class_3", "input_classification", "noise_class"]
    assert [*found.point_format.extra_dimension_names] == names
    assert len(remarks) == 2
    assert not found["noise_class"].any()
    assert np.array_equal(extra_bytes(path), extra_bytes(path.with_name("copy.laz"), but=2))


@pytest.mark.parametrize(("offset", "content"), [(26, b"\xffme"), (90, b"\xff\xff\x0f\x27")])
def test_system_and_day_that_readers_fail_at(tmp_path: Path, offset: int, content: bytes) -> None:
    path = described(tmp_path, descriptor())
    made = bytearray(path.read_bytes())
    made[offset : offset + len(content)] = content
    path.write_bytes(made)
    found, mended = copied(path)
    assert mended == []
    found.write(path.with_name("again.laz"))


BYTES = st.binary(max_size=32).map(lambda b: b.ljust(32, b"\0"))


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0, *SIZES]), st.integers(0, 64), BYTES, BYTES,
            st.floats(width=32), st.floats(width=32),
        ),
        min_size=1, max_size=4,
    ),
    st.sampled_from([1, 6, 7]),
)  # fmt: skip
def test_any_descriptors(
    tmp_path_factory: pytest.TempPathFactory, parts: list[Any], point_format: int
) -> None:
    folder = tmp_path_factory.mktemp("any")
    made = [descriptor(), *(descriptor(*part) for part in parts)]
    path = described(folder, *made, point_format=point_format)
    found, _ = copied(path)
    names = list(found.point_format.dimension_names)
    assert len(set(names)) == len(names)
    assert np.array_equal(extra_bytes(path), extra_bytes(path.with_name("copy.laz"), but=2))
