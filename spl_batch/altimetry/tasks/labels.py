"""Stage ``signal``: labels of a segment, which is a run of whole windows."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from spl_batch.altimetry.filter.track import MARGIN_M, label
from spl_batch.altimetry.photon_table import LABELS, PHOTONS
from spl_batch.altimetry.tasks.context import GROUP_PHOTONS, Context, gather, rows_between
from spl_batch.altimetry.water.surface import NO_WATER
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.verified.parquet_npz import write_arrays, writing
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
