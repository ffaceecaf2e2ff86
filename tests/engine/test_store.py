"""Receipts, atomic files, voxel parts: only what is whole is ever trusted."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import zarr
from zarr.storage import ZipStore

from spl_batch.airborne.store.voxel_parts import read_voxels, write_voxels
from spl_batch.engine.store.working_store import (
    Store,
    append_log,
    read_receipt,
    read_receipts,
    write_receipt,
)
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.progress import TRIES, forget_makers
from spl_batch.errors import StoppedError, WorkflowError
from spl_batch.formats.files import atomic
from spl_batch.formats.files.atomic import (
    checksum,
    is_as_written,
    owned_by,
    replacing,
    scratch_name,
    sweep,
    write_bytes,
)
from spl_batch.lattice.tables import VoxelPart


def receipt(name: str = "00001_5/3", **changes: object) -> Receipt:
    fields = {
        "kind": "gather",
        "name": name,
        "key": "k",
        "digest": "d",
        "reason": "",
        "outputs": {"store/a": "0"},
        "facts": {"points": 3, "span": [1.5, None]},
        "points": 3,
        "wall_s": 0.5,
        "peak_rss_mb": 100.0,
    }
    return Receipt(**{**fields, **changes})  # type: ignore[arg-type]


def test_receipts_come_back_by_name_and_kind(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for name in ("b/2", "a/1"):
        write_receipt(store, receipt(name))
    assert read_receipt(store, "gather", "b/2") == receipt("b/2")
    assert [r.name for r in read_receipts(store, "gather")] == ["a/1", "b/2"]
    assert list(read_receipts(store, "denoise")) == []
    assert read_receipt(store, "gather", "c") is None
    assert receipt(reason="why").failed
    assert not receipt().failed


def test_half_a_receipt_or_an_altered_one_is_none(tmp_path: Path) -> None:
    store = Store(tmp_path)
    write_receipt(store, receipt("a"))
    path = store.receipt("gather", "a")
    altered = path.read_bytes().replace(b'"wall_s": 0.5', b'"wall_s": 0.6')
    halves = b"", b"{", b"[1]", b'{"kind": "gather"}', b"\xff\xfe", b"[" * 50_000
    for content in (*halves, altered):
        path.write_bytes(content)
        assert read_receipt(store, "gather", "a") is None, content[:20]


def test_a_damaged_file_is_made_again_so_often_and_then_given_up(tmp_path: Path) -> None:
    store, known = Store(tmp_path), dict[str, int]()
    file = "store/voxels/a.zarr.zip"
    for _ in range(TRIES):
        write_receipt(store, receipt("a", outputs={file: "0"}))
        assert forget_makers(store, ["gather"], [file], known) == [file]
        assert read_receipt(store, "gather", "a") is None
    write_receipt(store, receipt("a", outputs={file: "0"}))
    assert forget_makers(store, ["gather"], [file], known) == []
    assert read_receipt(store, "gather", "a") is not None
    assert forget_makers(store, ["gather"], ["store/voxels/b"], known) == [], "nobody made it"


def test_numbers_that_json_does_not_know_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_receipt(Store(tmp_path), receipt(facts={"mean": float("nan")}))


def test_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.bin"
    write_bytes(path, b"first")

    def fail() -> None:
        with replacing(path) as temporary:
            temporary.write_bytes(b"half")
            assert path.read_bytes() == b"first"
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_bytes() == b"first"
    write_bytes(path, b"second")
    assert path.read_bytes() == b"second"
    assert [p.name for p in path.parent.iterdir()] == ["file.bin"]


def test_content_is_on_disk_before_its_name_and_the_name_before_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "deep" / "file.bin"
    steps: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda d: steps.append(Path(f"/dev/fd/{d}").resolve().name))
    rename = os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: (steps.append("rename"), rename(a, b)))
    with replacing(path) as temporary:
        temporary.write_bytes(b"content")
    assert steps == [tmp_path.name, temporary.name, "rename", "deep"]
    steps.clear()
    with replacing(path.with_name("group")) as temporary:
        (temporary / "c").mkdir(parents=True)
        (temporary / "c" / "0").write_bytes(b"chunk")
    assert sorted(steps[:3]) == sorted([temporary.name, "c", "0"])
    assert steps[3:] == ["rename", "deep"]
    steps.clear()
    with replacing(tmp_path / "store" / "file.bin", durable=False) as temporary:
        temporary.write_bytes(b"content")
    assert steps == ["rename"], "what tells by itself that it is damaged does not wait for the disk"


def test_only_what_is_unfinished_and_ours_is_swept_away(tmp_path: Path) -> None:
    foreign = [".dtm.tif.tmp", "a.spl-part", ".a.123.spl-part", ".x.0123456789abcdef.spl-part.bak"]
    for name in foreign:
        write_bytes(tmp_path / "laz" / name, b"mine")
    other = tmp_path / "compare" / "voxel"
    write_bytes(other / "store" / "lock", b"")
    scratch_name(other / "dtm.tif").write_bytes(b"another run is writing this")
    left = [
        scratch_name(tmp_path / name) for name in ("dtm.tif", "laz/a.laz", "n" * 255, "雪" * 85)
    ]
    for path in left:
        path.write_bytes(b"half")
    group = scratch_name(tmp_path / "laz" / "0.zarr")
    (group / "c").mkdir(parents=True)
    (group / "c" / "0").write_bytes(b"half")
    assert sweep(tmp_path) == (5, 20)
    assert not any(path.exists() for path in [*left, group])
    assert sorted(p.name for p in (tmp_path / "laz").iterdir()) == sorted(foreign)
    assert len(list(other.iterdir())) == 2
    assert sweep(tmp_path) == (0, 0)


def test_who_lost_a_temporary_file_stops(tmp_path: Path) -> None:
    def late() -> None:
        with replacing(tmp_path / "a") as temporary:
            temporary.write_bytes(b"slow")
            sweep(tmp_path)

    with pytest.raises(StoppedError, match="another run"):
        late()


def test_a_file_in_place_of_a_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(WorkflowError, match="cannot be written"):
        write_bytes(tmp_path / "file" / "a", b"")


def test_checksums_see_names_and_bytes(tmp_path: Path) -> None:
    for folder, name, content in (
        ("a", "x", "1"),
        ("b", "x", "1"),
        ("c", "y", "1"),
        ("d", "x", "2"),
    ):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / name).write_text(content)
    sums = [checksum(tmp_path / folder) for folder in "abcd"]
    assert sums[0] == sums[1]
    assert len(set(sums)) == 3
    assert checksum(tmp_path / "a" / "x") == checksum(tmp_path / "c" / "y")


def part(corner: tuple[int, int, int], shape: tuple[int, int, int], seed: int) -> VoxelPart:
    amount = np.random.default_rng(seed).integers(-(2**60), 2**60, shape)
    return VoxelPart(corner, amount)


def test_what_is_missing_or_has_no_known_size_is_not_as_written(tmp_path: Path) -> None:
    path = tmp_path / "a"
    assert not is_as_written(path, -1, None, "")
    assert not is_as_written(path, -1, 1, "")
    path.write_bytes(b"1")
    assert not is_as_written(path, -1, None, checksum(path))
    assert is_as_written(path, 1, None, "")
    assert is_as_written(path, 1, 1, checksum(path))
    assert not is_as_written(path, 1, 1, "")


@pytest.mark.parametrize("call", ["size", "checksum"])
def test_what_cannot_be_read_is_not_as_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def refuse(_: Path) -> int:
        raise PermissionError

    path = tmp_path / "a"
    path.write_bytes(b"1")
    content = checksum(path)
    monkeypatch.setattr(atomic, call, refuse)
    assert not is_as_written(path, 1, 1, content)


def test_voxels_are_a_zarr_group_for_any_reader(tmp_path: Path) -> None:
    known = part((-5, 0, 2), (7, 5, 3), 1)
    write_voxels(tmp_path / "a.zarr.zip", known)
    with ZipStore(tmp_path / "a.zarr.zip", mode="r") as store:
        group = zarr.open_group(store, mode="r")
        assert group.attrs["corner"] == [-5, 0, 2]
        np.testing.assert_array_equal(group["amount"][...], known.amount)


def test_voxel_parts_add_up_in_any_order(tmp_path: Path) -> None:
    parts = [part((-5, 0, 2), (7, 5, 3), 1), part((-1, 3, 0), (40, 35, 4), 2)]
    whole = np.zeros((60, 60, 20), np.int64)
    for k, p in enumerate(parts):
        write_voxels(tmp_path / f"{k}.zarr.zip", p)
        at = tuple(slice(c + 10, c + 10 + n) for c, n in zip(p.corner, p.amount.shape, strict=True))
        whole[at] += p.amount
    for order in ((0, 1), (1, 0)):
        box = np.zeros((12, 30, 3), np.int64)
        for k in order:
            read_voxels(tmp_path / f"{k}.zarr.zip").add((-3, 1, 1), {"amount": box})
        assert np.array_equal(box, whole[7:19, 11:41, 11:14])
    far = np.zeros((2, 2, 2), np.int64)
    read_voxels(tmp_path / "0.zarr.zip").add((100, 0, 0), {"amount": far})
    assert not far.any()


def test_the_same_part_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in "ab":
        write_voxels(tmp_path / name, part((0, 0, 0), (40, 3, 2), 5))
    assert checksum(tmp_path / "a") == checksum(tmp_path / "b")
    write_voxels(tmp_path / "empty", part((0, 0, 0), (0, 0, 0), 5))
    read_voxels(tmp_path / "empty").add((0, 0, 0), {"amount": np.zeros((2, 2, 2), np.int64)})


def test_the_log_has_one_line_for_each_event(tmp_path: Path) -> None:
    for k in range(3):
        append_log(tmp_path, {"event": "Note", "text": f"two\nlines {k}"})
    lines = (tmp_path / "log.jsonl").read_text().splitlines()
    assert [json.loads(line)["text"][-1] for line in lines] == ["0", "1", "2"]


def test_a_task_of_a_run_that_is_over_replaces_nothing(tmp_path: Path) -> None:
    mark, path = tmp_path / "lock", tmp_path / "labels"
    mark.write_text("first run")
    with owned_by(str(mark), "first run"):
        write_bytes(path, b"of the first run")
        mark.write_text("second run")
        with owned_by(str(mark), "second run"):
            write_bytes(path, b"of the second run")
        with pytest.raises(StoppedError, match="another run has begun here"):
            write_bytes(path, b"late")
    assert path.read_bytes() == b"of the second run"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["labels", "lock"]
