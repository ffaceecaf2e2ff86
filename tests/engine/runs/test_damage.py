"""Damage to the working store: noticed where it is read, and made good within the run."""

import contextlib
import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.lines.comparison import difference_map
from spl_batch.airborne.store.voxel_parts import read_voxels, write_voxels
from spl_batch.airborne.tasks.accuracy import compared
from spl_batch.engine.store.working_store import read_receipts
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.planning import prepare
from spl_batch.engine.verbs.progress import makers
from spl_batch.errors import DamagedError
from spl_batch.formats.verified.parquet_npz import (
    group_ranges,
    read_arrays,
    read_columns,
    write_arrays,
    writing,
)
from spl_batch.lattice.tables import VoxelPart
from tests import surveys


def columns(n: int = 60) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "x": rng.integers(0, 10**9, n),
        "channel": rng.integers(0, 25, n).astype(np.uint8),
    }


def parquet(path: Path) -> Callable[[], Any]:
    wanted = columns()
    with writing(path, {k: v.dtype for k, v in wanted.items()}) as writer:
        for rows in (slice(0, 20), slice(20, 60)):
            writer.write({k: v[rows] for k, v in wanted.items()})

    def read() -> Any:
        found = [read_columns(path, [name]) for name in wanted]
        return [np.concatenate(list(f.values())).tolist() for f in found], group_ranges(path, "x")

    return read


def npz(path: Path) -> Callable[[], Any]:
    write_arrays(path, {"a": np.arange(6.0), "b": np.array([1, 2], np.int8)})
    return lambda: {k: v.tolist() for k, v in read_arrays(path).items()}


def voxels(path: Path) -> Callable[[], Any]:
    amount = np.random.default_rng(1).integers(0, 2**40, (3, 4, 2))
    write_voxels(path, VoxelPart((5, 6, 7), amount))

    def read() -> Any:
        box = np.zeros((4, 4, 4), np.int64)
        read_voxels(path).add((5, 6, 6), {"amount": box})
        return box.tolist()

    return read


@pytest.mark.parametrize(("write", "step"), [(parquet, 1), (npz, 1), (voxels, 5)])
def test_no_bit_changes_unnoticed(tmp_path: Path, write: Callable[[Path], Any], step: int) -> None:
    read = write(tmp_path / "file")
    expected = read()
    file, noticed = tmp_path / "file", 0
    content = file.read_bytes()
    for place in range(0, len(content), step):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        file.write_bytes(damaged)
        found = None
        with contextlib.suppress(DamagedError):
            found = read()
        assert found in (None, expected), f"byte {place}"
        noticed += found is None
    file.write_bytes(content)
    assert read() == expected
    assert noticed > 100


@pytest.mark.parametrize("write", [parquet, npz, voxels])
def test_nothing_is_cut_off_or_lost_unnoticed(tmp_path: Path, write: Callable[[Path], Any]) -> None:
    read = write(tmp_path / "file")
    file = tmp_path / "file"
    content = file.read_bytes()
    for damaged in (b"", b"PAR1 but no more", content[: len(content) // 2], content[:-1], None):
        file.unlink()
        if damaged is not None:
            file.write_bytes(damaged)
        with pytest.raises(DamagedError) as caught:
            read()
        assert str(file) in str(caught.value)
        assert "\n" not in str(caught.value)


# Whole runs


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


def files_of(receipt: Receipt, output: Path) -> list[Path]:
    """Files of the store that a task wrote, one of each sort."""
    sorts: dict[str, Path] = {}
    for name in sorted(receipt.outputs):
        path = output / name
        inside = sorted(p for p in path.rglob("c/**/*") if p.is_file())
        if name.startswith("store/"):
            sorts[name.split("/")[1]] = inside[0] if path.is_dir() else path
    return list(sorts.values())


SORTS = {
    *("index", "trajectory.parquet", "points", "observed", "lines", "scatter", "voxels"),
    *("fired", "tiles", "denoise", "ground", "surface", "rasters"),
}
"""Names in the store that tasks read from."""


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("damage")
    line = surveys.flightline(shots=60, seed=1)
    surveys.write_cloud(folder / "lines" / "1.laz", line)
    surveys.write_trajectory(folder / "trajectory.csv")
    return surveys.write_workflow(folder)


@pytest.fixture(scope="module")
def expected(survey: Path) -> dict[str, bytes]:
    return surveys.results(surveys.run(survey, until="deliver").output)


@pytest.mark.parametrize("harm", [flip, Path.unlink])
def test_what_is_damaged_while_a_run_goes_on_is_made_again_in_it(
    survey: Path,
    expected: dict[str, bytes],
    monkeypatch: pytest.MonkeyPatch,
    harm: Callable[[Path], None],
) -> None:
    harmed: set[str] = set()
    noise = survey.parent / "out/store/noise.tif"
    run_task, noise_map = runner.run_task, noise.read_bytes()

    def harming(*args: Any) -> Receipt:
        receipt = run_task(*args)
        for path in files_of(receipt, survey.parent / "out"):
            sort = path.relative_to(survey.parent / "out" / "store").parts[0]
            if sort in SORTS - harmed and (receipt.points or receipt.kind == "trajectory"):
                harmed.add(sort)
                harm(path)
        return receipt

    monkeypatch.setattr(runner, "run_task", harming)
    result = surveys.run(survey, until="deliver", fresh=True)
    assert harmed == SORTS
    assert result.exit_status == 0
    assert surveys.results(result.output) == expected
    assert noise.read_bytes() == noise_map


def test_delivered_files_are_looked_at_closely_where_they_were_written_to(
    survey: Path, expected: dict[str, bytes]
) -> None:
    path = survey.parent / "out" / "laz" / "lines" / "1.laz"
    flip(path)
    assert surveys.results(surveys.run(survey, until="deliver").output) == expected


@pytest.mark.parametrize(
    ("kind", "pattern", "look"),
    [
        ("strip_pairs", "overlaps/map.npz", lambda _, context: difference_map(context)),
        ("accuracy", "accuracy/*.npz", compared),
    ],
)
def test_who_meets_damage_for_the_report_leaves_its_maker_known(
    tiny_output: Path, tmp_path: Path, kind: str, pattern: str, look: Callable[..., Any]
) -> None:
    prepared = prepare(tiny_output.parent / "workflow.yaml", ["outputs.diagnostics=true"])
    context, ledger = dataclasses.replace(prepared.context, output=tmp_path), prepared.ledger
    shutil.copytree(tiny_output / "store", tmp_path / "store")
    for name in ("dtm.tif", "dsm.tif"):
        shutil.copy(tiny_output / name, tmp_path)
    for made in ("reference", kind):
        for receipt in read_receipts(context.store, made):
            ledger.of(made).put(receipt)
    for path in (tmp_path / "store").glob(pattern):
        flip(path)
    with pytest.raises(DamagedError) as met:
        look(ledger.done, context)
    again = makers(context.store, ledger.done, [context.store.name_of(met.value.path)])
    assert [maker[0] for maker in again.values()] == [kind]
