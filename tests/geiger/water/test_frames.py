"""Files of frames: what is written is read, what is wrong is refused in one line."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import zarr

from spl_batch.errors import InputError
from spl_batch.geiger.water import formats
from spl_batch.geiger.water.formats import (
    FrameTruth,
    inspect_frames,
    iter_frames,
    read_truth,
    write_frames,
)

ROWS, COLS = 6, 5


def some_frames(n: int = 12) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 400, (n, ROWS, COLS)).astype(np.uint16)


def read_frames(path: Path, first: int, last: int, bins: int) -> np.ndarray:
    """Frames in one array; their pieces lie beside each other."""
    pieces = list(iter_frames(path, first, last, bins))
    ends = np.cumsum([first, *(len(p) for _, p in pieces)])
    assert [at for at, _ in pieces] == ends[:-1].tolist()
    return np.concatenate([piece for _, piece in pieces])


def some_truth() -> FrameTruth:
    rng = np.random.default_rng(2)
    return FrameTruth(rng.normal(size=(3, ROWS, COLS)), rng.normal(size=(3, ROWS, COLS, 3)))


@pytest.mark.parametrize("suffix", [".h5", ".hdf5", ".zarr"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    path, frames, truth = tmp_path / f"a{suffix}", some_frames(), some_truth()
    write_frames(path, frames, {"bin_ns": 0.25}, truth, 4)
    facts = inspect_frames(path, ROWS, COLS)
    assert (facts.frames, facts.truth_frames) == (12, 4)
    assert (facts.chunk_frames, facts.missing_chunks) == (12, 0)
    np.testing.assert_array_equal(read_frames(path, 0, 12, 8000), frames)
    np.testing.assert_array_equal(read_frames(path, 3, 7, 8000), frames[3:7])
    found = read_truth(path, 1, 3)
    np.testing.assert_allclose(found.down_m, truth.down_m[1:3], rtol=1e-6)
    np.testing.assert_allclose(found.normals, truth.normals[1:3], rtol=1e-6)


def stored(path: Path, frames: np.ndarray, chunks: tuple[int, ...] | None = None) -> None:
    if path.suffix == ".h5":
        with h5py.File(path, "w") as group:
            group.create_dataset("frames", data=frames, chunks=chunks)
    else:
        group = zarr.open_group(path, mode="w")
        group.create_array("frames", data=frames, chunks=chunks or "auto")


def cut(path: Path) -> None:
    write_frames(path, some_frames(), {})
    path.write_bytes(path.read_bytes()[:-200])


def spoiled(change: Callable[[h5py.File], object]) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        write_frames(path, some_frames(), {}, some_truth(), 4)
        with h5py.File(path, "r+") as group:
            change(group)

    return make


UNFIT = (
    (np.zeros((4, ROWS, COLS + 1), np.uint16), "camera.rows"),
    (np.zeros((4, ROWS), np.uint16), r"\(4, 6\)"),
    (np.zeros((0, ROWS, COLS), np.uint16), "no frame"),
    (np.zeros((4, ROWS + 1, COLS), np.float32), "camera.cols.*; .*float32"),
)


@pytest.mark.parametrize(
    ("name", "make", "fault"),
    [
        ("text.h5", lambda path: path.write_text("no frames at all"), "is no HDF5 file"),
        ("cut.h5", cut, "damaged HDF5"),
        ("frames.npy", lambda path: np.save(path, some_frames()), "frames are HDF5"),
        ("gone.h5", lambda _: None, "no such file"),
        ("gone.zarr", lambda _: None, "no such file"),
        ("a.h5", spoiled(lambda group: group.pop("frames")), "no array 'frames'"),
        ("b.h5", spoiled(lambda g: (g.pop("frames"), g.create_group("frames"))), "is a group"),
        ("c.h5", spoiled(lambda group: group.pop("truth/normals")), "truth/normals"),
        ("d.h5", spoiled(lambda g: g["truth"].attrs.pop("frames_per_acquisition")), "attribute"),
        *(
            (f"e{suffix}", partial(stored, frames=content), fault)
            for content, fault in UNFIT
            for suffix in (".h5", ".zarr")
        ),
    ],
)
def test_what_cannot_be_used_is_refused_in_a_line(
    tmp_path: Path, name: str, make: Callable[[Path], object], fault: str
) -> None:
    make(tmp_path / name)
    with pytest.raises(InputError, match=fault) as caught:
        inspect_frames(tmp_path / name, ROWS, COLS)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)


def test_bins_that_the_camera_has_not_and_damage_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    for value in (-3, 70_000, 401):
        frames = some_frames().astype(np.int32)
        frames[7, 2, 2] = value
        stored(path, frames)
        read_frames(path, 0, 7, 400)
        with pytest.raises(InputError, match=f"bin {value}, "):
            read_frames(path, 7, 12, 400)
    with pytest.raises(InputError, match="ends before frame 20"):
        read_frames(path, 0, 20, 80_000)
    write_frames(path, some_frames(), {})
    with h5py.File(path, "r") as group:
        at = group["frames"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[at.byte_offset + at.size // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(InputError, match="damaged HDF5"):
        read_frames(path, 0, 12, 8000)


@pytest.mark.parametrize("chunk", [None, 1, 9, 40])
@pytest.mark.parametrize("suffix", [".h5", ".zarr"])
def test_frames_come_in_pieces_of_whole_chunks(
    tmp_path: Path, suffix: str, chunk: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(formats, "PIECE_VALUES", 8 * ROWS * COLS + 3)
    path, frames = tmp_path / f"a{suffix}", some_frames(40).astype(np.int32)
    stored(path, frames, None if chunk is None else (chunk, ROWS, COLS))
    chunk = chunk or (40 if suffix == ".zarr" else 1)
    most = max(8 // chunk, 1) * chunk
    np.testing.assert_array_equal(read_frames(path, 3, 31, 8000), frames[3:31])
    pieces = list(iter_frames(path, 3, 31, 8000))
    assert max(len(piece) for _, piece in pieces) <= most
    assert all(at % most == 0 for at, _ in pieces[1:]), "no chunk is decoded twice"
    held = most * ROWS * COLS * (4 + 4 + 2 + formats.SUM_BYTES)
    assert inspect_frames(path, ROWS, COLS).piece_bytes == held


def test_missing_chunks_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    stored(path, some_frames(), (4, ROWS, COLS))
    (path / "frames" / "c" / "1" / "0" / "0").unlink()
    assert inspect_frames(path, ROWS, COLS).missing_chunks == 1
    with h5py.File(tmp_path / "a.h5", "w") as group:
        made = group.create_dataset("frames", (12, ROWS, COLS), "u2", chunks=(5, ROWS, COLS))
        made[:5] = 1
    assert inspect_frames(tmp_path / "a.h5", ROWS, COLS).missing_chunks == 2
