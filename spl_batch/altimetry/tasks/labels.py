"""Stage ``signal``: labels of a segment, which is a run of whole windows."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.track import CELLS, MARGIN_M, label
from spl_batch.altimetry.photon_table import LABELS, PHOTONS
from spl_batch.altimetry.tasks.context import GROUP_PHOTONS, Context, gather, place, rows_between
from spl_batch.altimetry.water.surface import NO_WATER
from spl_batch.engine.report.run_record import Receipts
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays, writing
from spl_batch.lattice.tiles import quanta


def label_segment(args: Mapping[str, Any], context: Context) -> Produced:
    """Label the photons of a segment; those of the margin decide with them."""
    low, high = args["span"]
    margin = quanta(MARGIN_M)
    path = place(context, "photons", args["key"], ".parquet")
    found = rows_between(path, tuple(PHOTONS), "along", low - margin, high + margin)
    table = gather(found, PHOTONS)
    columns, cells = label(table["along"], table["height"], (low, high), context.workflow)
    mine = (table["along"] >= low) & (table["along"] < high)
    labels = {**{name: table[name][mine] for name in PHOTONS}, **columns}
    outputs = [
        place(context, "labels", args["segment"], ".parquet"),
        place(context, "cells", args["segment"], ".npz"),
    ]
    with writing(outputs[0], LABELS) as writer:
        for start in range(0, len(labels["row"]), GROUP_PHOTONS):
            writer.write({k: labels[k][start : start + GROUP_PHOTONS] for k in LABELS})
    write_arrays(outputs[1], cells)
    n = len(labels["row"])
    facts = {
        "signal": int(labels["signal"].sum()),
        "false": float(cells["false"].sum()),
        "photons": n,
        "wet": int(np.count_nonzero(labels["level"] != NO_WATER)),
    }
    return Produced(outputs, facts, n)


def labelled(done: Receipts, key: str) -> list[str]:
    """Labelled segments of a beam, in order."""
    spans = done["take_in"][key].facts["segments"]
    return [f"{key}/{low}" for low, *_ in spans if f"{key}/{low}" in done["label"]]


def read_cells(segments: list[str], context: Context) -> dict[str, NDArray[Any]]:
    """Cells of the segments of a beam, in order: columns as of ``CELLS``."""
    parts = [read_arrays(place(context, "cells", name, ".npz")) for name in segments]
    return {
        name: np.concatenate([np.empty(0, dtype), *(part[name] for part in parts)])
        for name, dtype in CELLS.items()
    }
