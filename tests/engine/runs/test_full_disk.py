"""A full disk, real for once: files may not grow beyond a limit."""

import contextlib
import resource
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.store.raster_cells import write_cell
from spl_batch.airborne.store.voxel_parts import write_voxels
from spl_batch.engine.store.output_lock import locked
from spl_batch.engine.store.working_store import Store, append_log, write_receipt
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import StoppedError
from spl_batch.formats.las.writer import write_classified
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.verified.parquet_npz import write_arrays, write_table
from spl_batch.lattice.tables import PointTable, VoxelPart
from spl_batch.lattice.tiles import Bounds
from tests import surveys

N = 20_000
NOISE = np.random.default_rng(0)


@contextlib.contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """No file of this process may grow beyond a size: writing fails, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_disk_that_is_full_from_the_start_is_named(tmp_path: Path) -> None:
    with files_up_to(0), pytest.raises(StoppedError) as caught, locked(tmp_path / "out"):
        pass
    assert str(caught.value).startswith(f"{tmp_path / 'out'}: ")


def table() -> PointTable:
    x, y, z = NOISE.integers(0, 10**6, (3, N))
    return PointTable({"x": x, "y": y, "z": z.astype(np.int32)})


def parquet(folder: Path) -> None:
    write_table(folder / "t.parquet", table())


def npz(folder: Path) -> None:
    write_arrays(folder / "a.npz", {"a": np.arange(N)})


def voxels(folder: Path) -> None:
    amount = NOISE.integers(0, 2**60, (30, 30, 30))
    write_voxels(folder / "v.zarr.zip", VoxelPart((0, 0, 0), amount))


def cell(folder: Path) -> None:
    core, values = Bounds(0, 0, 100_000, 100_000), NOISE.random((100, 100), np.float32)
    write_cell(Store(folder), "0_0", core, {"dtm": values})


def classified(folder: Path) -> None:
    def labels(start: int, stop: int) -> dict[str, Any]:
        zeros = np.zeros(stop - start, np.uint8)
        return {"classification": zeros, "noise_class": zeros}

    source, target = folder / "in.laz", folder / "out.laz"
    write_classified(source, target, labels=labels, diagnostics=False, crs=None)


def cog(folder: Path) -> None:
    write_cog(
        folder / "c.tif", NOISE.random((300, 300), np.float32), shape=(300, 300),
        origin_xy_m=(5e5, 4e6), cell_m=1.0, crs=None, description="dtm",
    )  # fmt: skip


def receipt(folder: Path) -> None:
    facts = {"many": list(range(2000))}
    write_receipt(Store(folder), Receipt("gather", "a", "", "", "", {}, facts, 0, 0.0, 0.0))


def log(folder: Path) -> None:
    append_log(folder, {"text": "x" * 5000})


WRITERS = [parquet, npz, voxels, cell, classified, cog, receipt, log]


@pytest.mark.parametrize("write", WRITERS, ids=lambda f: f.__name__)
def test_whatever_is_written_stops_the_run(tmp_path: Path, write: Callable[[Path], None]) -> None:
    surveys.write_cloud(tmp_path / "in.laz", surveys.flightline(shots=60))
    with files_up_to(4000), pytest.raises(StoppedError) as caught:
        write(tmp_path)
    assert str(tmp_path) in str(caught.value)
    assert not list(tmp_path.rglob(".*")), "what was begun is taken away"
    write(tmp_path)


def test_a_run_that_meets_a_full_disk_is_continued(tmp_path: Path) -> None:
    surveys.write_cloud(tmp_path / "lines" / "1.laz", surveys.flightline(shots=60))
    survey = surveys.write_workflow(tmp_path, ground={"cell_m": 200, "buffer_m": 20})
    with files_up_to(30_000):
        ended = surveys.command("run", survey, "--workers", 0, "--until", "deliver")
    assert ended.status == 3
    assert "too large for the file system" in ended.text
    result = surveys.run(survey, until="deliver")
    assert result.exit_status == 0
    clean = surveys.run(surveys.copy_of(survey, tmp_path / "clean"), until="deliver")
    assert surveys.results(result.output) == surveys.results(clean.output)
