"""Terrain models of several runs: how often they differ from the first one's, and where most."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.product_table import is_piece
from spl_batch.airborne.report.profile_strips import best_strip, strip_sums
from spl_batch.constants import NODATA
from spl_batch.formats.rasters.parts import Part, read_overview, windows
from spl_batch.lattice.tiles import Bounds

OFF_M: Final = 0.5
"""Terrain that differs by more is told [m]."""

_MOST_M: Final = 5.0
"""A difference counts up to this, so that one spike is no place to show [m]."""

_ROWS: Final = 256
"""Rows of a raster that are read at once [count]."""


@dataclass(frozen=True, slots=True)
class TerrainContrast:
    """Terrain models against the first of them."""

    #: (k,): cells of each that lie more than :data:`OFF_M` off the first one's, over those that
    #: both have, 0..1; NaN where there are none.
    off_share: NDArray[np.float64]
    strip: Bounds | None  #: Strip in which they differ most; None where none differs.


def terrain_contrast(outputs: Sequence[Path]) -> TerrainContrast:
    """Compare the terrain models in several output folders.

    Parameters
    ----------
    outputs : sequence of Path
        Folders with ``dtm.tif``, and ``dtm_2.tif`` and so on of a survey in pieces, of runs on the
        same inputs; the first is what others differ from.

    Raises
    ------
    DamagedError
        If a raster cannot be read: it can be made again.
    """
    off, both = (np.zeros(len(outputs), np.int64) for _ in range(2))
    most, strip = 0.0, None
    for path in sorted(outputs[0].glob("dtm*.tif")):
        others = [folder / path.name for folder in outputs]
        if not is_piece(path.stem, "dtm") or not all(other.exists() for other in others):
            continue
        for first, *rest in _read(others):
            known = first > NODATA
            for k, values in enumerate(rest, start=1):
                shared = known & (values > NODATA)
                both[k] += np.count_nonzero(shared)
                off[k] += np.count_nonzero(np.abs(values - first)[shared] > OFF_M)
        place, differs = _strip([read_overview(other) for other in others])
        if differs > most:
            most, strip = differs, place
    share = np.where(both > 0, off / np.maximum(both, 1), np.nan)
    return TerrainContrast(share, strip)


def _read(paths: Sequence[Path]) -> Iterator[list[NDArray[np.float32]]]:
    """The same rows of several rasters, from north to south; none where they differ in place."""
    with ExitStack() as stack:
        rasters = [stack.enter_context(windows(path)) for path in paths]
        if len({(r.shape, r.left_m, r.top_m, r.cell_m) for r in rasters}) > 1:
            return
        rows, columns = rasters[0].shape
        for row in range(0, rows, _ROWS):
            yield [r.read(row, min(row + _ROWS, rows), 0, columns) for r in rasters]


def _strip(models: Sequence[Part]) -> tuple[Bounds | None, float]:
    """Strip along the easting with the largest sum of differences, and that sum [m]."""
    first, *rest = models
    total = np.zeros(first.values.shape)
    for other in rest:
        if other.values.shape != total.shape:
            return None, 0.0
        known = (first.values > NODATA) & (other.values > NODATA)
        differs = np.abs(other.values - first.values, dtype=np.float64)
        total += np.where(known & (differs > OFF_M), np.minimum(differs, _MOST_M), 0.0)
    return best_strip(first, strip_sums(first, total))
