"""Labels of a stretch of track, window by window: pure functions of photons and their margin.

Beside ours there are the filters of [W17] as published, on a window and its margin for a channel.
mDBSCAN [W17 3.1.2] takes photons in the ellipse of one whose own holds four times what ellipses at
random points of the gate hold in the mean. The posterior [W17 4.1] is that of circles on an axis
stretched by the noise rate, and the n_s photons least like noise are signal, n_s being all photons
less the noise expected. Both take the noise rate from ours, the source from its product.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spl_batch.altimetry.filter.neighbours import columns, log_areas
from spl_batch.altimetry.filter.posterior import noise_posterior, ratios, with_prior
from spl_batch.altimetry.filter.window import Assessed, assess
from spl_batch.altimetry.photon_table import LABELS, PHOTONS, joined
from spl_batch.altimetry.settings import BaselineSettings, SignalSettings, TrackWorkflow
from spl_batch.altimetry.water.surface import NO_WATER
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

NEIGHBOURS: Final = 20
"""Largest k of the source [count]."""

ELLIPSES: Final = 100
"""Random ellipses of a window that give the mean; the source takes several [count]."""

_STRETCH_LEAST: Final = 0.05
"""Shortest that a night may press its track to [m/m]."""


def _stretched(
    along: NDArray[np.int64], known: Assessed, cell_m: float, *, scaled: bool
) -> tuple[NDArray[np.float64], float]:
    """Photons on the axis scaled by the noise rate, and the area of the window there [m, m2]."""
    density = known.expected / np.maximum(known.gate_m * cell_m, 1e-9)
    there = known.gate_m > 0.0
    middle = max(float(np.median(density[there])), 1e-9)
    stretch = np.maximum(density / middle, _STRETCH_LEAST) if scaled else np.ones(len(density))
    stretch = np.where(there, stretch, 1.0)
    start = np.concatenate([[0.0], np.cumsum(stretch * cell_m)[:-1]])
    inside_m = along / QUANTA_PER_M - known.index[known.cell] * cell_m
    area_m2 = float(np.sum(known.gate_m * cell_m * stretch))
    return start[known.cell] + inside_m * stretch[known.cell], area_m2


def mdbscan(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    known: Assessed,
    cell_m: float,
    settings: BaselineSettings,
) -> NDArray[np.bool_]:
    """Signal by mDBSCAN, (n,) bool: in the ellipse of a photon that has enough in its own.

    ``along``, ``height``: photons of a window and its margin, in order along the track [quanta];
    ``known``: their cells, gates and noise; ``cell_m``: length of a cell [m].
    """
    z_m = height / QUANTA_PER_M
    s_m, _ = _stretched(along, known, cell_m, scaled=settings.scaled)
    semi_m = np.array([settings.along_m, settings.height_m])
    plane = np.stack([s_m, z_m], axis=1) / semi_m
    tree = cKDTree(plane)
    inside = tree.query_ball_point(plane, 1.0, return_length=True)
    # The number of photons alone seeds the draw, so that no cut of the track changes it.
    rng = np.random.default_rng(len(along))
    at = rng.integers(len(along), size=ELLIPSES)
    low = np.full(len(known.index), np.inf)
    np.minimum.at(low, known.cell, z_m)
    there = known.cell[at]
    points = np.stack([s_m[at], low[there] + rng.random(ELLIPSES) * known.gate_m[there]], axis=1)
    mean = tree.query_ball_point(points / semi_m, 1.0, return_length=True).mean()
    # Where all drawn ellipses are empty a photon of its own is no multiple of them.
    core: NDArray[np.bool_] = np.asarray(inside >= settings.factor * max(mean, 1.0))
    if not core.any():
        return core
    nearest, _ = cKDTree(plane[core]).query(plane, distance_upper_bound=np.nextafter(1.0, 2.0))
    signal: NDArray[np.bool_] = np.asarray(nearest <= 1.0)
    return signal


def posterior(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    known: Assessed,
    cell_m: float,
    settings: SignalSettings,
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Signal by the posterior of [W17 4.1], (n,) bool, and mean ln P(noise), (n,) float32.

    Parameters are those of :func:`mdbscan`.
    """
    s_m, area_m2 = _stretched(along, known, cell_m, scaled=True)
    z_m = height / QUANTA_PER_M
    n, noise = len(along), float(known.expected.sum())
    shape = NEIGHBOURS, 1.0, settings.reach_m
    near = log_areas(columns(s_m, z_m), (s_m, z_m), np.zeros(n), shape, own=True)
    share = np.clip(noise / n, 0.01, 0.999)
    score = noise_posterior(
        near,
        np.pi * settings.reach_m**2,
        np.full(n, noise / max(area_m2, 1e-9)),
        with_prior(ratios(NEIGHBOURS, settings.contrast_max), float(np.log((1.0 - share) / share))),
    )
    kept = np.zeros(n, np.bool_)
    kept[np.argsort(score, kind="stable")[: max(round(n - noise), 0)]] = True
    return kept, score.astype(np.float32)


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

    ``along``, ``height``: (n,), photons in order along the track, of the span and of
    :data:`MARGIN_M` to each side [quanta]; ``span``: its ends, whole windows [quanta].
    """
    photons, cells = [], []
    window, size, margin = window_quanta(settings), quanta(settings.rate.cell_m), quanta(MARGIN_M)
    low, high = np.searchsorted(along, span)
    for number in np.unique(along[low:high] // window).tolist():
        start, stop = number * window, (number + 1) * window
        first, end = np.searchsorted(along, (start - margin, stop + margin))
        found, known = _window(along[first:end], height[first:end], settings)
        mine = slice(*(np.searchsorted(along, (start, stop)) - first).tolist())
        photons.append({name: found[name][mine] for name in COLUMNS})
        own = (known.index * size // window == number) & (known.gate_m > 0.0)
        cells.append({name: getattr(known, name)[own] for name in CELLS})
    return joined(photons, COLUMNS), joined(cells, CELLS)


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
        # As sure as a method without scores can be.
        score = np.where(kept, np.float32(-30.0), np.float32(0.0))
    return {
        "score": score,
        "signal": kept.astype(np.uint8),
        "ground": ground.astype(np.uint8),
        "level": level[known.cell].astype(np.int32),
        "baseline": baseline.astype(np.uint8),
    }, known
