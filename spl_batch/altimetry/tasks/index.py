"""Stage ``index``: prove that a file can be read, and bring its beams into one form."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.track import window_quanta
from spl_batch.altimetry.formats.photons import Layout, Photons, iter_photons
from spl_batch.altimetry.formats.track_csv import check_unit
from spl_batch.altimetry.photon_table import PHOTONS
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.altimetry.tasks.context import CHUNK_PHOTONS, GROUP_PHOTONS, Context
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.input_changes import as_indexed, unchanged
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.verified.parquet_npz import write_arrays, writing
from spl_batch.lattice.tiles import quanta


def index_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Take the checksum of a file, so that the report can name the one that was read."""
    del context
    path = Path(args["path"])
    with unchanged(path, args["stamp"]):
        digest = checksum(path)
    facts = {"hash": digest, "name": args["name"], "size": args["stamp"][0]}
    return Produced([], facts, 0, {str(path): args["stamp"]})


class _Cells:
    """Photons of each cell, and where its first one lies."""

    def __init__(self, size: int) -> None:
        self.size = size
        #: Number of each cell, photons, latitude and longitude, of each chunk.
        self.parts: list[NDArray[np.float64]] = []
        self.ends: list[int] = []

    def add(self, photons: Photons) -> None:
        """Count a chunk in."""
        if not len(photons.row):
            return
        cell, first, count = np.unique(
            photons.along // self.size, return_index=True, return_counts=True
        )
        where = photons.latitude[first], photons.longitude[first]
        self.parts.append(np.stack([cell, count, *where]))
        self.ends += [int(photons.along.min()), int(photons.along.max())]

    def length_m(self) -> float:
        """Length of track that holds photons [m]: that of all, or of the cells that hold some."""
        span = max(self.ends, default=0) - min(self.ends, default=0)
        return min(span, len(self.arrays()["index"]) * self.size) / QUANTA_PER_M

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Cells in order."""
        cell, count, latitude, longitude = np.concatenate([np.empty((4, 0)), *self.parts], axis=1)
        index, first, at = np.unique(cell, return_index=True, return_inverse=True)
        return {
            "index": index.astype(np.int64),
            "count": np.bincount(at, count, len(index)).astype(np.int64),
            "latitude": latitude[first],
            "longitude": longitude[first],
        }


def _read(path: Path, layout: Layout, beam: str, cells: _Cells) -> Iterator[Photons]:
    """Photons of a beam, counted by cell; a table that is not in metres is refused at its end."""
    for photons in iter_photons(path, layout, beam, CHUNK_PHOTONS):
        cells.add(photons)
        yield photons
    if layout == "csv":
        check_unit(path, int(cells.arrays()["count"].sum()), cells.length_m())


def look_through(path: Path, layout: Layout, beam: str, cell_m: float) -> None:
    """Read a beam to its end, as :func:`take_in` does, and keep nothing.

    Raises
    ------
    InputError
        What a run would raise of it.
    """
    for _ in _read(path, layout, beam, _Cells(quanta(cell_m))):
        pass


def take_in(args: Mapping[str, Any], context: Context) -> Produced:
    """Read a beam once from end to end: photons and rate in the store's form."""
    path, workflow, read = Path(args["path"]), context.workflow, 0
    cells = _Cells(quanta(workflow.rate.cell_m))
    outputs = [
        context.store.table("photons", args["key"]),
        context.store.path("places", f"{args['key']}.npz"),
    ]
    with (
        unchanged(path, as_indexed("index_file", args, context)),
        writing(outputs[0], PHOTONS, rows=GROUP_PHOTONS) as writer,
    ):
        for photons in _read(path, args["layout"], args["beam"], cells):
            read += photons.read
            writer.write({name: getattr(photons, name) for name in PHOTONS})
    counted = cells.arrays()
    write_arrays(outputs[1], counted)
    facts = {
        "points": read,
        "placed": int(counted["count"].sum()),
        "segments": list(segments(counted["index"], counted["count"], workflow)),
    }
    return Produced(outputs, facts, read)


def segments(
    index: NDArray[np.int64], count: NDArray[np.int64], workflow: TrackWorkflow
) -> Iterator[tuple[int, int, int]]:
    """Runs of windows of ``work.segment_photons`` at most, or one window: ends [quanta], photons.

    ``index``, ``count``: (n,), cells that hold photons, in order, and how many.
    """
    size = window_quanta(workflow)
    window, at = np.unique(index * quanta(workflow.rate.cell_m) // size, return_inverse=True)
    photons = np.bincount(at, count, len(window)).astype(np.int64).tolist()
    first, total = 0, 0
    for i, (number, n) in enumerate(zip(window.tolist(), photons, strict=True)):
        gap = i > first and number != window[i - 1] + 1
        if total and (gap or total + n > workflow.work.segment_photons):
            yield int(window[first]) * size, (int(window[i - 1]) + 1) * size, total
            first, total = i, 0
        total += n
    if total:
        yield int(window[first]) * size, (int(window[-1]) + 1) * size, total
