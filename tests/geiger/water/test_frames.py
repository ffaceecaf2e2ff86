"""Files of frames: what is written is read, what is wrong is told in one line."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import zarr

from spl_batch.errors import InputError
from spl_batch.geiger.water import formats
from spl_batch.geiger.water.formats import (
    FrameFacts,
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
    assert [at for at, _ in pieces] == np.cumsum([first, *(len(p) for _, p in pieces)])[
        :-1
    ].tolist()
    return np.concatenate([piece for _, piece in pieces])


def some_truth() -> FrameTruth:
    rng = np.random.default_rng(2)
    return FrameTruth(rng.normal(size=(3, ROWS, COLS)), rng.normal(size=(3, ROWS, COLS, 3)))


@pytest.mark.parametrize("suffix", [".h5", ".hdf5", ".zarr"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    path, frames, truth = tmp_path / f"a{suffix}", some_frames(), some_truth()
    write_frames(path, frames, {"bin_ns": 0.25}, truth, 4)
    facts = inspect_frames(path, ROWS, COLS)
    assert (facts.frames, facts.rows, facts.cols, facts.truth_frames) == (12, ROWS, COLS, 4)
    assert facts.chunk_frames == 12
    np.testing.assert_array_equal(read_frames(path, 0, 12, 8000), frames)
    np.testing.assert_array_equal(read_frames(path, 3, 7, 8000), frames[3:7])
    found = read_truth(path, 1, 3)
    np.testing.assert_allclose(found.down_m, truth.down_m[1:3], rtol=1e-6)
    np.testing.assert_allclose(found.normals, truth.normals[1:3], rtol=1e-6)
    write_frames(path, frames[:5], {})
    held = 5 * ROWS * COLS * (2 + 2 + 2)
    assert inspect_frames(path, ROWS, COLS) == FrameFacts(5, ROWS, COLS, 0, 5, held)


@pytest.mark.parametrize("suffix", [".h5", ".zarr"])
@pytest.mark.parametrize(
    ("content", "says"),
    [
        (np.zeros((4, ROWS, COLS + 1), np.uint16), "the camera (n, 6, 5); correct camera.rows"),
        (np.zeros((4, ROWS), np.uint16), "has the shape (4, 6)"),
        (np.zeros((0, ROWS, COLS), np.uint16), "holds no frame"),
        (np.zeros((4, ROWS, COLS), np.float32), "holds float32; store whole numbers"),
        (np.zeros((4, ROWS + 1, COLS), np.float64), "camera.cols, or the file; frames holds"),
    ],
)
def test_what_does_not_fit_the_camera_is_told(
    tmp_path: Path, suffix: str, content: np.ndarray, says: str
) -> None:
    path = tmp_path / f"a{suffix}"
    if suffix == ".h5":
        with h5py.File(path, "w") as group:
            group["frames"] = content
    else:
        zarr.open_group(path, mode="w").create_array("frames", data=content)
    with pytest.raises(InputError, match=re.escape(says)) as caught:
        inspect_frames(path, ROWS, COLS)
    assert str(caught.value).startswith(str(path))


def test_a_file_that_is_none_is_told(tmp_path: Path) -> None:
    text = tmp_path / "text.h5"
    text.write_text("no frames at all")
    cut = tmp_path / "cut.h5"
    write_frames(cut, some_frames(), {})
    cut.write_bytes(cut.read_bytes()[:-200])
    other = tmp_path / "frames.npy"
    np.save(other, some_frames())
    for path, says in (
        (text, "is no HDF5 file"),
        (cut, "damaged HDF5"),
        (other, "frames are HDF5"),
        (tmp_path / "gone.h5", "no such file"),
        (tmp_path / "gone.zarr", "no such file"),
    ):
        with pytest.raises(InputError, match=says) as caught:
            inspect_frames(path, ROWS, COLS)
        assert "\n" not in str(caught.value)


def test_files_without_frames_or_with_half_a_truth_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as group:
        group["other"] = [1]
    with pytest.raises(InputError, match="no array 'frames'"):
        inspect_frames(path, ROWS, COLS)
    with h5py.File(path, "w") as group:
        group.create_group("frames")
    with pytest.raises(InputError, match="is a group"):
        inspect_frames(path, ROWS, COLS)
    write_frames(path, some_frames(), {}, some_truth(), 4)
    with h5py.File(path, "r+") as group:
        del group["truth/normals"]
    with pytest.raises(InputError, match=r"truth/normals has the shape None"):
        inspect_frames(path, ROWS, COLS)
    with h5py.File(path, "r+") as group:
        del group["truth"].attrs["frames_per_acquisition"]
    with pytest.raises(InputError, match="lacks the attribute frames_per_acquisition"):
        inspect_frames(path, ROWS, COLS)


def test_bins_that_the_camera_has_not_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    for value, worst in ((-3, "-3"), (70_000, "70000"), (401, "401")):
        frames = some_frames().astype(np.int32)
        frames[7, 2, 2] = value
        with h5py.File(path, "w") as group:
            group["frames"] = frames
        read_frames(path, 0, 7, 400)
        with pytest.raises(InputError, match=f"hold the time bin {worst}, the camera has 1 to 400"):
            read_frames(path, 7, 12, 400)
    with pytest.raises(InputError, match="ends before frame 20"):
        read_frames(path, 0, 20, 8000)


def test_a_damaged_chunk_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    write_frames(path, some_frames(), {})
    with h5py.File(path, "r") as group:
        at = group["frames"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[at.byte_offset + at.size // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(InputError, match="damaged HDF5"):
        read_frames(path, 0, 12, 8000)


@pytest.mark.parametrize("chunk", [None, 1, 5, 9, 40])
@pytest.mark.parametrize("suffix", [".h5", ".zarr"])
def test_frames_come_in_pieces_of_whole_chunks(
    tmp_path: Path, suffix: str, chunk: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(formats, "PIECE_VALUES", 8 * ROWS * COLS + 3)
    path, frames = tmp_path / f"a{suffix}", some_frames(40).astype(np.int32)
    chunks = None if chunk is None else (chunk, ROWS, COLS)
    if suffix == ".h5":
        with h5py.File(path, "w") as group:
            group.create_dataset("frames", data=frames, chunks=chunks)
    else:
        zarr.open_group(path, mode="w").create_array("frames", data=frames, chunks=chunks or "auto")
        chunk = chunk or 40
    most = max(8 // (chunk or 1), 1) * (chunk or 1)
    np.testing.assert_array_equal(read_frames(path, 3, 31, 8000), frames[3:31])
    pieces = list(iter_frames(path, 3, 31, 8000))
    assert max(len(piece) for _, piece in pieces) <= most
    assert all(at % most == 0 for at, _ in pieces[1:]), "no chunk is decoded twice"
    assert inspect_frames(path, ROWS, COLS).piece_bytes == most * ROWS * COLS * (4 + 4 + 2)
