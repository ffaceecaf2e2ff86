"""Shares of the expected noise: what each stretch adds to the voxels, as Zarr groups."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from spl_batch.engine.store.working_store import Store
from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.verified.zarr_chunks import METADATA, Metadata, pack, read_box, read_metadata
from spl_batch.lattice.tables import VoxelPart
from spl_batch.lattice.tiles import shared_box

VOXEL_CHUNK: Final = 32
"""Voxels along one horizontal side of a Zarr chunk [count]."""


def write_voxels(path: Path, part: VoxelPart) -> None:
    """Write a stretch's share of the noise model as a Zarr group, atomically."""
    shape = part.amount.shape
    attributes = {"corner": list(part.corner)}
    group = {"zarr_format": 3, "node_type": "group", "attributes": attributes}
    with replacing(path, durable=False) as temporary:
        temporary.mkdir()
        (temporary / METADATA).write_text(json.dumps(group))
        for name in ("amount", "shots", "beamlets", "squares"):
            values: NDArray[Any] | None = getattr(part, name)
            if values is None:
                continue
            chunks = (min(VOXEL_CHUNK, shape[0]), min(VOXEL_CHUNK, shape[1]), *values.shape[2:])
            files = pack(values, chunks=chunks, attributes=attributes)
            for file, content in files.items():
                target = temporary / name / file
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(content)


class StoredVoxels:
    """A stretch's share of the expected noise, as :func:`write_voxels` has written it.

    Everything that looks into it raises DamagedError if it is missing or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._known: dict[str, Metadata] = {}

    def layers(self) -> range:
        """Absolute indices of its layers."""
        metadata = self._metadata("amount")
        first = int(metadata["attributes"]["corner"][2])
        return range(first, first + metadata["shape"][2])

    def add(self, corner: Sequence[int], totals: Mapping[str, NDArray[Any]]) -> None:
        """Add it to a box of voxels, in place, where they overlap.

        ``corner``: absolute index of the box's first voxel; ``totals``: the box by the name of the
        sum, ``amount``, ``shots``, ``beamlets``, ``squares``.
        """
        for name, total in totals.items():
            metadata = self._metadata(name)
            shape, inner = metadata["shape"][:3], metadata["shape"][3:]
            first = [int(c) for c in metadata["attributes"]["corner"]]
            of_part, of_box = shared_box(first, shape, corner, total.shape)
            if any(side.stop <= side.start for side in of_part):
                return
            whole = (*of_part, *(slice(0, n) for n in inner))
            values = read_box(self.path / name, metadata, whole)
            total[of_box] += values.astype(total.dtype, copy=False)

    def _metadata(self, name: str) -> Metadata:
        if name not in self._known:
            self._known[name] = read_metadata(self.path / name)
        return self._known[name]


def stored_by_line(store: Store, parts: Iterable[str]) -> list[list[StoredVoxels]]:
    """Shares of stretches by ``LINE/K``, a list for each flightline in the order of names."""
    lines: dict[str, list[StoredVoxels]] = {}
    for part in sorted(parts):
        stored = StoredVoxels(store.path("voxels", f"{part}.zarr"))
        lines.setdefault(part.rpartition("/")[0], []).append(stored)
    return list(lines.values())
