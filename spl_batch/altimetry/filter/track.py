"""Labels of a stretch of track, window by window: pure functions of photons and their margin."""

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.published import mdbscan, posterior
from spl_batch.altimetry.filter.window import Assessed, assess
from spl_batch.altimetry.photon_table import LABELS, PHOTONS
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.altimetry.water.surface import NO_WATER
from spl_batch.lattice.tiles import quanta

MARGIN_M: Final = 1000.0
"""Track to each side of a window that decides with it [m]."""

COLUMNS: Final = {name: dtype for name, dtype in LABELS.items() if name not in PHOTONS}
"""What a photon is labelled with, and its type."""

CELLS: Final = {
    "index": np.int64,
    "gate_m": np.float64,
    "expected": np.float64,
    "false": np.float64,
}
"""Number of a cell, length of its gate [m], noise expected in it and among its signal [count]."""


def window_quanta(settings: TrackWorkflow) -> int:
    """Length of a window: whole cells [quanta]."""
    cell = quanta(settings.rate.cell_m)
    return max(round(settings.signal.window_m / settings.rate.cell_m), 1) * cell


def label(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    span: tuple[int, int],
    settings: TrackWorkflow,
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Columns as of :data:`COLUMNS` and :data:`CELLS` of the photons and cells of a span.

    Parameters
    ----------
    along, height : (n,) int64, (n,) int32
        Photons in order along the track, of the span and of :data:`MARGIN_M` to each side [quanta].
    span : (int, int)
        Ends of the span: whole windows [quanta].
    settings : TrackWorkflow
        Cells, method, profile.
    """
    photons: list[dict[str, NDArray[Any]]] = [
        {name: np.empty(0, dtype) for name, dtype in COLUMNS.items()}
    ]
    cells: list[dict[str, NDArray[Any]]] = [
        {name: np.empty(0, dtype) for name, dtype in CELLS.items()}
    ]
    window, size = window_quanta(settings), quanta(settings.rate.cell_m)
    for number, mine, some in _windows(along, span, window):
        found, known = _window(along[some], height[some], settings)
        inside = slice(mine.start - some.start, mine.stop - some.start)
        photons.append({name: found[name][inside] for name in COLUMNS})
        own = (known.index * size // window == number) & (known.gate_m > 0.0)
        cells.append({name: getattr(known, name)[own] for name in CELLS})
    return tuple(  # type: ignore[return-value]
        {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        for parts in (photons, cells)
    )


def _windows(
    along: NDArray[np.int64], span: tuple[int, int], window: int
) -> Iterator[tuple[int, slice, slice]]:
    """Number of each window that holds photons, its rows, and those with its margin."""
    margin = quanta(MARGIN_M)
    low, high = np.searchsorted(along, span)
    for number in np.unique(along[low:high] // window).tolist():
        ends = number * window, (number + 1) * window
        mine = np.searchsorted(along, ends)
        some = np.searchsorted(along, (ends[0] - margin, ends[1] + margin))
        yield number, slice(*mine.tolist()), slice(*some.tolist())


def _window(
    along: NDArray[np.int64], height: NDArray[np.int32], settings: TrackWorkflow
) -> tuple[dict[str, NDArray[Any]], Assessed]:
    """Labels of all photons of a window and its margin."""
    cell_m, signal = settings.rate.cell_m, settings.signal
    known = assess(along, height, cell_m, signal, settings.profile.photons_factor)
    kept, ground, score = known.signal, known.ground, known.score
    # The source knows no water.
    level = known.level if signal.method == "likelihood" else np.full(len(known.index), NO_WATER)
    baseline = np.zeros(len(along), np.bool_)
    reference = settings.reference
    if signal.method == "mdbscan" or (reference is not None and reference.baseline):
        baseline = mdbscan(along, height, known, cell_m, signal.mdbscan)
    if signal.method == "published":
        kept, score = posterior(along, height, known, cell_m, signal)
        ground = kept
    elif signal.method == "mdbscan":
        kept = ground = baseline
        score = np.where(kept, _SURE, np.float32(0.0))
    return {
        "score": score,
        "signal": kept.astype(np.uint8),
        "ground": ground.astype(np.uint8),
        "level": level[known.cell].astype(np.int32),
        "baseline": baseline.astype(np.uint8),
    }, known


_SURE: Final = np.float32(-30.0)
"""Score of what a method without scores calls signal."""
