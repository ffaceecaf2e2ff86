"""Dimensions of point records that hold small whole numbers, as beamlet numbers are."""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.formats.las.records import RecordLayout, dimension

MOST: Final = 255
"""Largest number of a beamlet."""

_FREE: Final = ("user_data", "intensity")
"""Standard dimensions that deliveries use for beamlet numbers; others mean what LAS says."""


class Numbers(NamedTuple):
    """What a dimension holds in some points."""

    low: int
    high: int
    different: int
    points: int  #: Points that were looked at [count].
    most: int  #: Points that share the most frequent value [count].


def small_numbers(records: NDArray[Any], layout: RecordLayout) -> dict[str, Numbers]:
    """Dimensions whose values are whole numbers from 0 to 255, by name.

    ``records``: (n,) structured, point records of this layout.
    """
    found: dict[str, Numbers] = {}
    if not len(records):
        return found
    for name in (*_FREE, *(extra.name for extra in layout.extra)):
        values = dimension(records, layout, name)
        if values.ndim > 1 or values.dtype.kind not in "ui":
            continue
        low, high = int(values.min()), int(values.max())
        if low >= 0 and high <= MOST:
            counts = np.bincount(values.astype(np.int64))
            different = int(np.count_nonzero(counts))
            found[name] = Numbers(low, high, different, len(values), int(counts.max()))
    return found
