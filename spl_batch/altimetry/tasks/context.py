"""What every altimetry task is given, and where it finds things in the store.

::

    store/photons/SOURCE/BEAM.parquet      photons in the order of the file
    store/places/SOURCE/BEAM.npz           photons of each cell, and where its first one lies
    store/labels/SOURCE/BEAM/LOW.parquet   labels of a segment, in order along the track
    store/cells/SOURCE/BEAM/LOW.npz        noise and gate of its cells
    store/profiles/SOURCE/BEAM.parquet     ground and canopy top
    store/compared/SOURCE/BEAM.npz         differences from a reference
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from spl_batch.altimetry.photon_table import joined
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.engine.tasks.context import RunContext
from spl_batch.formats.verified.parquet_npz import ranges_of, read_groups, reading
from spl_batch.lattice.row_order import lexicographic_order

Context = RunContext[TrackWorkflow]

GROUP_PHOTONS: Final = 16_384
"""Photons of a row group [count]: a halo is read from few."""

CHUNK_PHOTONS: Final = 262_144
"""Photons read at once from an input [count]."""


def rows_between(
    path: Path, names: Sequence[str], column: str, low: int, high: int
) -> Iterator[dict[str, NDArray[Any]]]:
    """Rows with ``low <= column < high``, a row group at a time, however the file is sorted."""
    with reading(path) as file:
        for group, (least, most) in enumerate(ranges_of(file.metadata, column)):
            if least >= high or most < low:
                continue
            columns = read_groups(file, names, [group])
            inside = (columns[column] >= low) & (columns[column] < high)
            yield {name: values[inside] for name, values in columns.items()}


def gather(
    parts: Iterator[Mapping[str, NDArray[Any]]], dtypes: Mapping[str, type]
) -> dict[str, NDArray[Any]]:
    """Rows in one table, in order of distance, height and position in the file."""
    table = joined(list(parts), dtypes)
    order = lexicographic_order([table["along"], table["height"], table["row"]])
    return {name: values[order] for name, values in table.items()}
