"""Stage ``signal``: labels of a segment, which is a run of whole windows."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.track import CELLS, MARGIN_M, label
from spl_batch.altimetry.photon_table import LABELS, PHOTONS, joined
from spl_batch.altimetry.tasks.context import GROUP_PHOTONS, Context, gather, rows_between
from spl_batch.altimetry.water.surface import NO_WATER
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays, writing
from spl_batch.lattice.tiles import quanta


def label_segment(args: Mapping[str, Any], context: Context) -> Produced:
    """Label the photons of a segment; those of the margin decide with them."""
    low, high = args["span"]
    margin = quanta(MARGIN_M)
    path = context.store.table("photons", args["key"])
    found = rows_between(path, tuple(PHOTONS), "along", low - margin, high + margin)
    table = gather(found, PHOTONS)
    columns, cells = label(table["along"], table["height"], (low, high), context.workflow)
    mine = (table["along"] >= low) & (table["along"] < high)
    outputs = [
        context.store.table("labels", args["segment"]),
        context.store.path("cells", f"{args['segment']}.npz"),
    ]
    with writing(outputs[0], LABELS, rows=GROUP_PHOTONS) as writer:
        writer.write({**{name: table[name][mine] for name in PHOTONS}, **columns})
    write_arrays(outputs[1], cells)
    n = int(np.count_nonzero(mine))
    facts = {
        "signal": int(columns["signal"].sum()),
        "false": float(cells["false"].sum()),
        "photons": n,
        "wet": int(np.count_nonzero(columns["level"] != NO_WATER)),
    }
    return Produced(outputs, facts, n)


def segments_of(
    key: str, taken: Mapping[str, Receipt], labelled: Mapping[str, Receipt]
) -> list[tuple[str, int, int]]:
    """Labelled segments of a beam, in order: name, and the span of track of each [quanta]."""
    spans = taken[key].facts["segments"]
    named = [(f"{key}/{low}", low, high) for low, high, _ in spans]
    return [segment for segment in named if segment[0] in labelled]


def read_cells(segments: Sequence[str], context: Context) -> dict[str, NDArray[Any]]:
    """Cells of the segments of a beam, in order: columns as of ``CELLS``."""
    paths = (context.store.path("cells", f"{name}.npz") for name in segments)
    return joined([read_arrays(path) for path in paths], CELLS)
