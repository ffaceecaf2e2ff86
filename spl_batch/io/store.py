"""The working store: where things lie, and the receipts that say what is finished.

::

    store/receipts/KIND/NAME.json      what is done, what failed and why
    store/trajectory.parquet           positions in the survey's CRS and the points' time
    store/index/SOURCE.npz             time range of each run of points of an input file
    store/stretches/LINE/K.parquet     whole shots in time order
    store/sights/LINE/K.npz            lines of sight of a stretch, without a trajectory
    store/paths/LINE.parquet           where they meet: the path of the sensor
    store/lines/LINE.npz               line noise model of a flightline
    store/voxels/LINE/K.zarr           a stretch's share of the expected noise
    store/fired/LINE/K.npz             where a stretch's beamlets pointed, silent ones too
    store/scatter/LINE/K.parquet       the stretch's points, a row group for each tile
    store/tiles/I_J.parquet            points of a tile, in canonical order
    store/{noise,ground,classes}/      labels by work unit, a row group for each tile
    store/rasters_G_P.zarr             raster cells, for edges of ground and raster cells
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BytesCodec, ZstdCodec

from spl_batch.errors import StoppedError, StoreError
from spl_batch.io.atomic import replacing, sync_folder, write_bytes
from spl_batch.model import Receipt, VoxelPart

VOXEL_CHUNK = 32
"""Voxels along one horizontal side of a Zarr chunk [count]."""


@dataclasses.dataclass(frozen=True, slots=True)
class Store:
    """Names of everything below ``output``.

    Parameters
    ----------
    output : Path
        Folder of the results.
    """

    output: Path

    @property
    def root(self) -> Path:
        """Folder of the working store."""
        return self.output / "store"

    def path(self, *parts: str) -> Path:
        """Path below the working store."""
        return self.root.joinpath(*parts)

    def tile(self, name: str) -> Path:
        """Points of a tile."""
        return self.path("tiles", f"{name}.parquet")

    def labels(self, kind: str, name: str) -> Path:
        """Labels that a work unit gave."""
        return self.path(kind, f"{name}.parquet")

    def rasters(self, ground_cell: int, raster_cell: int) -> Path:
        """Raster cells; other cell sizes are kept apart, so that none spoils what is done.

        Parameters
        ----------
        ground_cell, raster_cell : int
            Edges of a ground cell and of a raster cell [quanta].
        """
        return self.path(f"rasters_{ground_cell}_{raster_cell}.zarr")

    def receipt(self, kind: str, name: str) -> Path:
        """Receipt of a task."""
        return self.path("receipts", kind, f"{name.replace('/', '~')}.json")


def write_receipt(store: Store, receipt: Receipt) -> None:
    """Leave a receipt; the last thing that a task does."""
    content = json.dumps(dataclasses.asdict(receipt), indent=1, sort_keys=True, allow_nan=False)
    write_bytes(store.receipt(receipt.kind, receipt.name), content.encode())


def forget_receipt(store: Store, kind: str, name: str) -> None:
    """Take a receipt away, so that nothing vouches for outputs about to be overwritten."""
    path = store.receipt(kind, name)
    if path.exists():
        path.unlink()
        sync_folder(path.parent)


def read_receipt(store: Store, kind: str, name: str) -> Receipt | None:
    """Read a task's receipt; None when there is none or it cannot be trusted."""
    try:
        content = json.loads(store.receipt(kind, name).read_bytes())
        return Receipt(**content)
    except (OSError, ValueError, TypeError):
        return None


def read_receipts(store: Store, kind: str) -> Iterator[Receipt]:
    """All receipts of one kind, by name."""
    for path in sorted(store.path("receipts", kind).glob("*.json")):
        receipt = read_receipt(store, kind, path.name.removesuffix(".json").replace("~", "/"))
        if receipt is not None:
            yield receipt


def write_voxels(path: Path, part: VoxelPart) -> None:
    """Write a stretch's share of the noise model as a Zarr group, atomically."""
    shape = part.amount.shape
    chunks = (min(VOXEL_CHUNK, shape[0]), min(VOXEL_CHUNK, shape[1]), shape[2])
    arrays: dict[str, NDArray[Any] | None] = {
        "amount": part.amount,
        "shots": part.shots,
        "beamlets": part.beamlets,
        "covered": part.covered,
    }
    with replacing(path) as temporary:
        group = zarr.create_group(str(temporary), attributes={"corner": list(part.corner)})
        for name, values in arrays.items():
            if values is None:
                continue
            array = group.create_array(
                name,
                shape=shape,
                chunks=tuple(max(c, 1) for c in chunks),
                dtype=values.dtype,
                serializer=BytesCodec(),
                compressors=ZstdCodec(level=3),
            )
            array[...] = values


def add_voxels(
    path: Path, corner: tuple[int, int, int], totals: Mapping[str, NDArray[Any]]
) -> None:
    """Add one part's share to a box of voxels, in place.

    Parameters
    ----------
    path : Path
        Group written by :func:`write_voxels`.
    corner : (3,) int
        Absolute index of the box's first voxel.
    totals : mapping of str to (nx, ny, nz) int64, or uint16 for bits
        The box by the name of the sum (``amount``, ``shots``, ``beamlets``) or of the bits
        (``covered``); the part is added, or joined by "or", where they overlap.

    Raises
    ------
    StoreError
        If the part is missing or damaged.
    """
    try:
        group: Any = zarr.open_group(str(path), mode="r")
        first = [int(c) for c in group.attrs["corner"]]
        for name, total in totals.items():
            array = group[name]
            low = [max(a, b) for a, b in zip(first, corner, strict=True)]
            high = [
                min(a + n, b + m)
                for a, n, b, m in zip(first, array.shape, corner, total.shape, strict=True)
            ]
            if any(b <= a for a, b in zip(low, high, strict=True)):
                return
            of_part = tuple(slice(a - c, b - c) for a, b, c in zip(low, high, first, strict=True))
            of_box = tuple(slice(a - c, b - c) for a, b, c in zip(low, high, corner, strict=True))
            values = np.asarray(array[of_part], dtype=total.dtype)
            if name == "covered":
                total[of_box] |= values
            else:
                total[of_box] += values
    except (OSError, KeyError, ValueError) as error:
        raise StoreError(f"{path}: damaged or missing ({error}); run again to rebuild") from error


def append_log(output: Path, event: Mapping[str, Any]) -> None:
    """Add one line to ``log.jsonl``.

    Raises
    ------
    StoppedError
        If it cannot be written.
    """
    path = output / "log.jsonl"
    try:
        with path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(event, allow_nan=False) + "\n")
    except OSError as error:
        raise StoppedError(f"{path}: cannot be written: {error.strerror}; run again") from error
