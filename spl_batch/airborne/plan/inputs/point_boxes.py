"""Where the points of files lie, for what a run costs: boxes that hold points all over.

The header of a file tells one box. A single point astray makes it hundreds of kilometres wide, and
nearly all of it is empty. Of such a file some points are read, and each group of them has a box.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.plan.inputs.file_positions import FAR_M, too_wide
from spl_batch.airborne.plan.inputs.survey_inputs import Source
from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import InputError
from spl_batch.formats.las.reader import iter_points
from spl_batch.lattice.density import Box
from spl_batch.lattice.tiles import Bounds, far_apart, quanta

SAMPLES: Final = 64
"""Places of a wide file at which points are read, evenly from its begin to its end [count]."""

SAMPLE_POINTS: Final = 4096
"""Points that are read at each of them [count]."""

LOOKED_INTO: Final = 3
"""Wide files of which points are read [count]: each takes up to a second."""


def point_boxes(sources: Sequence[Source]) -> list[Box]:
    """Boxes that hold the points of a survey's files.

    Returns
    -------
    list of Box
        One for each file. A file whose points lie too thinly in the box of its header, as some of
        them are astray, has one for each group of its points instead.
    """
    held = [source for source in sources if source.facts.n_points]
    wide = set(too_wide([source.facts for source in held])[:LOOKED_INTO])
    boxes = []
    for k, source in enumerate(held):
        found = _groups(source) if k in wide else []
        boxes.extend(found or [_header_box(source)])
    return boxes


def _header_box(source: Source) -> Box:
    west, south = (math.floor(v * QUANTA_PER_M) for v in source.facts.mins_m[:2])
    east, north = (math.floor(v * QUANTA_PER_M) + 1 for v in source.facts.maxs_m[:2])
    return Box(Bounds(west, south, east, north), source.facts.n_points)


def _groups(source: Source) -> list[Box]:
    """A box around each group of points of a file; none where it cannot be read."""
    try:
        places = np.concatenate(list(_sampled(source)))
    except InputError:  # the run names it, and no other part of a plan needs its points
        return []
    share = source.facts.n_points / len(places)
    boxes = []
    for rows in far_apart(places, quanta(FAR_M)):
        west, south = places[rows].min(axis=0).tolist()
        east, north = places[rows].max(axis=0).tolist()
        boxes.append(Box(Bounds(west, south, east + 1, north + 1), len(rows) * share))
    return boxes


def _sampled(source: Source) -> Iterator[NDArray[np.int64]]:
    """Easting and northing of some points, (n, 2) [quanta]."""
    points = source.facts.n_points
    starts = np.unique(np.linspace(0, max(points - SAMPLE_POINTS, 0), SAMPLES).astype(int))
    for start in starts.tolist():
        stop = min(start + SAMPLE_POINTS, points)
        for table in iter_points(
            source.path, channel_dimension=None, source=source.key, start=start, stop=stop
        ):
            yield np.stack([table["x"], table["y"]], axis=1).astype(np.int64)
