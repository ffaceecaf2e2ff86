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
from spl_batch.altimetry.tasks.context import CHUNK_PHOTONS, GROUP_PHOTONS, Context, place
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.input_changes import as_indexed, unchanged
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.verified.parquet_npz import write_arrays, writing
from spl_batch.lattice.tiles import quanta


def index_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Take the checksum of a file, so that the report can say which one was read."""
    del context
    path = Path(args["path"])
    with unchanged(path, args["stamp"]):
        digest = checksum(path)
    facts = {"hash": digest, "name": args["name"], "size": args["stamp"][0]}
    return Produced([], facts, 0, {str(path): args["stamp"]})


class _Cells:
    """Photons of each cell, and the first one's place."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.parts: list[tuple[NDArray[np.int64], ...]] = []
        self.places: list[NDArray[np.float64]] = []
        self.ends: list[int] = []

    def add(self, photons: Photons) -> None:
        """Count a chunk in."""
        cell, first, count = np.unique(
            photons.along // self.size, return_index=True, return_counts=True
        )
        self.parts.append((cell, count.astype(np.int64)))
        self.ends += [int(photons.along.min()), int(photons.along.max())]
        self.places.append(np.stack([photons.latitude[first], photons.longitude[first]]))

    def length_m(self) -> float:
        """Length of track that holds photons [m]: that of all, or of the cells that hold some."""
        if not self.ends:
            return 0.0
        cells = np.unique(np.concatenate([p[0] for p in self.parts]))
        span = max(self.ends) - min(self.ends)
        return float(min(span, len(cells) * self.size) / QUANTA_PER_M)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Cells in order."""
        cells = np.concatenate([np.empty(0, np.int64), *(p[0] for p in self.parts)])
        counts = np.concatenate([np.empty(0, np.int64), *(p[1] for p in self.parts)])
        places = np.concatenate([np.empty((2, 0)), *self.places], axis=1)
        index, first, at = np.unique(cells, return_index=True, return_inverse=True)
        count = np.zeros(len(index), np.int64)
        np.add.at(count, at, counts)
        return {
            "index": index,
            "count": count,
            "latitude": places[0, first],
            "longitude": places[1, first],
        }


def look_through(path: Path, layout: Layout, beam: str, cell_m: float) -> None:
    """Read a beam to its end, as :func:`take_in` does, and keep nothing.

    Raises
    ------
    InputError
        What a run would raise of it.
    """
    cells, placed = _Cells(quanta(cell_m)), 0
    for photons in iter_photons(path, layout, beam, CHUNK_PHOTONS):
        placed += len(photons.row)
        if len(photons.row):
            cells.add(photons)
    if layout == "csv":
        check_unit(path, placed, cells.length_m())


def take_in(args: Mapping[str, Any], context: Context) -> Produced:
    """Read a beam once from end to end: photons and rate in the store's form."""
    path, beam = Path(args["path"]), args["beam"]
    workflow = context.workflow
    cells = _Cells(quanta(workflow.rate.cell_m))
    read = placed = 0
    target = place(context, "photons", args["key"], ".parquet")
    with (
        unchanged(path, as_indexed("index_file", args, context)),
        writing(target, PHOTONS) as writer,
    ):
        for photons in iter_photons(path, args["layout"], beam, CHUNK_PHOTONS):
            read += photons.read
            placed += len(photons.row)
            for start in range(0, len(photons.row), GROUP_PHOTONS):
                rows = slice(start, start + GROUP_PHOTONS)
                writer.write({name: getattr(photons, name)[rows] for name in PHOTONS})
            if len(photons.row):
                cells.add(photons)
    outputs = [target, place(context, "places", args["key"], ".npz")]
    counted = cells.arrays()
    write_arrays(outputs[1], counted)
    if args["layout"] == "csv":
        check_unit(path, placed, cells.length_m())
    facts = {
        "points": read,
        "placed": placed,
        "segments": list(segments(counted["index"], counted["count"], workflow)),
    }
    return Produced(outputs, facts, read)


def segments(
    index: NDArray[np.int64], count: NDArray[np.int64], workflow: TrackWorkflow
) -> Iterator[tuple[int, int, int]]:
    """Runs of windows of ``work.segment_photons`` at most, or one window: ends [quanta], photons.

    Parameters
    ----------
    index, count : (n,) int64
        Cells that hold photons, in order, and how many.
    workflow : TrackWorkflow
        Cells, windows, photons of a segment.
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
