"""Stage ``signal``: scores by segment, and what is signal.

A segment is a run of cells. It reads the photons of its cells and of the reach of a score to
each side, and writes those of its cells, so where a track is cut does not matter.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter import chance
from spl_batch.altimetry.filter import signal as signals
from spl_batch.altimetry.filter.likelihood import ratios
from spl_batch.altimetry.filter.peer_filters import PEERS, keep
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise import windows
from spl_batch.altimetry.noise.noise_at import below_surface
from spl_batch.altimetry.photon_table import LABELS, PHOTONS
from spl_batch.altimetry.tasks.context import GROUP_PHOTONS, Context, place
from spl_batch.altimetry.tasks.rate import photons_of, read_rate
from spl_batch.altimetry.water.level_water import NO_WATER
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays, writing
from spl_batch.lattice.tiles import quanta

SELECT_WINDOWS: Final = 256
"""Windows whose photons are held by score at once: 20 MB [count]."""

COUNTED: Final = ("counts", "far", "noise", "far_noise", "told")
"""What segments count by window and score: photons, those far off, noise expected of both, and the
noise that a reader is told of."""

_PLACES: Final = {
    "along": np.int64, "score": np.float32, "noise": np.int64, "told": np.int64, "far": np.uint8,
    "below": np.uint8,
}  # fmt: skip
"""Places where noise may be: along the track, score, noise that each stands for, where it lies."""

ZONES: Final = 2
"""Below a water surface, and elsewhere: each has its own threshold [count]."""

_SURE: Final = np.float32(-30.0)
"""Score of what a method without scores calls signal."""


def score(args: Mapping[str, Any], context: Context) -> Produced:
    """Score the photons of a segment, and count them by score."""
    workflow, beam = context.workflow, args["key"]
    cells, scale, _ = read_rate(beam, context)
    size = quanta(workflow.rate.cell_m)
    low, high = args["cells"][0] * size, args["cells"][1] * size
    wanted = workflow.reference is not None and workflow.reference.baseline
    baseline = workflow.signal.method == "mdbscan" or wanted
    reach_m = workflow.signal.reach_m
    if baseline:
        reach_m = max(reach_m, signals.baseline_reach_m(scale, workflow.signal.mdbscan))
    reach = math.ceil((reach_m + 1.0) * QUANTA_PER_M)
    table = photons_of(beam, low - reach, high + reach, context)
    mine = (table["along"] >= low) & (table["along"] < high)
    labels = {name: table[name][mine] for name in PHOTONS}
    labels["far"] = rates.far(labels["along"], labels["height"], cells, workflow.rate)
    cell = np.searchsorted(cells.index, labels["along"] // size)
    labels["below"] = below_surface(cell, labels["height"], scale).astype(np.uint8)
    labels["baseline"] = np.zeros(len(labels["row"]), np.uint8)
    if baseline:
        mean = signals.mean_density(cells, scale, workflow.rate, workflow.signal)
        dense = signals.mdbscan(
            table["along"], table["height"], scale, mean, workflow.rate, workflow.signal.mdbscan
        )
        labels["baseline"] = dense[mine].astype(np.uint8)
    noise = {name: np.empty(0, dtype) for name, dtype in _PLACES.items()}
    if workflow.signal.method != "bayes":
        kept = labels["baseline"] > 0
        if workflow.signal.method in PEERS:
            beam_m = (labels[name] / QUANTA_PER_M for name in ("along", "height"))
            kept = keep(workflow.signal.method, *beam_m)
        labels["score"] = np.where(kept, _SURE, np.float32(0.0))
    else:
        prior = signals.log_prior(cells, scale, workflow.rate, workflow.signal.window_m)
        photons, rest = (table["along"], table["height"]), (workflow.rate, workflow.signal)
        labels["score"] = signals.score(*photons, mine, scale, prior, *rest)
        if workflow.signal.selection == "f1":
            owned = (cells.index >= args["cells"][0]) & (cells.index < args["cells"][1])
            along, height, each, told = chance.places(cells, scale, owned, workflow.rate)
            likelihoods = ratios(workflow.signal.neighbours, workflow.signal.contrast_max)
            at = along, height
            found = chance.score_places(at, photons, scale, prior, rest, likelihoods)
            cell = np.searchsorted(cells.index, along // size)
            noise = {
                "along": along,
                "score": found,
                "noise": each,
                "told": told,
                "far": rates.far(along, height, cells, workflow.rate),
                "below": below_surface(cell, height, scale).astype(np.uint8),
            }
    outputs = [
        place(context, "scores", args["segment"], ".parquet"),
        place(context, "counts", args["segment"], ".npz"),
    ]
    with writing(outputs[0], LABELS) as writer:
        for start in range(0, len(labels["row"]), GROUP_PHOTONS):
            writer.write({k: labels[k][start : start + GROUP_PHOTONS] for k in LABELS})
    write_arrays(outputs[1], _counted(labels, noise, context))
    return Produced(outputs, {"photons": len(labels["row"])}, len(labels["row"]))


def _counted(
    labels: Mapping[str, NDArray[Any]], noise: Mapping[str, NDArray[Any]], context: Context
) -> dict[str, NDArray[Any]]:
    """What :data:`COUNTED` names, of a segment by zone, window and score."""
    window = np.unique(_windows(labels["along"], context))

    def table(at: Mapping[str, NDArray[Any]], value: NDArray[np.int64]) -> NDArray[np.int64]:
        bins = signals.SCORE_BINS
        counts = np.zeros((ZONES, len(window), bins), np.int64)
        row = np.searchsorted(window, _windows(at["along"], context)) + at["below"] * len(window)
        # One index: numpy takes five times as long for three.
        np.add.at(counts.reshape(-1), row * bins + signals.score_bins(at["score"]), value)
        return counts

    far = labels["far"].astype(np.int64)
    return {
        "window": window,
        "counts": table(labels, np.ones_like(far)),
        "far": table(labels, far),
        "noise": table(noise, noise["noise"]),
        "far_noise": table(noise, noise["noise"] * noise["far"]),
        "told": table(noise, noise["told"]),
    }


def _windows(along: NDArray[np.int64], context: Context) -> NDArray[np.int64]:
    """Window of each place along the track."""
    workflow = context.workflow
    cell = along // quanta(workflow.rate.cell_m)
    return windows.window_of(cell, workflow.rate, workflow.signal.window_m)


def select(args: Mapping[str, Any], context: Context) -> Produced:
    """Least score that is signal in each window of a beam."""
    workflow, beam = context.workflow, args["key"]
    cells, scale, _ = read_rate(beam, context)
    values = np.stack([scale.noise - scale.below, scale.below, scale.level != NO_WATER])
    index = windows.window_of(scale.index, workflow.rate, workflow.signal.window_m)
    window, at = np.unique(index, return_inverse=True)
    noise = np.bincount(at, scale.noise, len(window)).astype(np.float64)
    _, sums = windows.of_window(scale.index, values, workflow.rate, workflow.signal.window_m)
    least = np.empty((2, ZONES, len(window)), np.int64)
    far_too = np.ones((ZONES, len(window)), np.bool_)
    taken, every = (np.zeros((ZONES, len(COUNTED))) for _ in range(2))
    doubtful = np.zeros((2, len(window)))
    for first in range(0, len(window), SELECT_WINDOWS):
        stop = min(first + SELECT_WINDOWS, len(window))
        # Each window is decided with the two beside it.
        low, high = max(first - 1, 0), min(stop + 1, len(window))
        counts = _of_segments(window[low:high], args["segments"], context).astype(np.float64)
        running = windows.running(window[low:high], np.moveaxis(counts, 2, 3))
        mine = slice(first - low, stop - low)
        counts, part = counts[:, :, mine], np.moveaxis(running, 2, 3)[:, :, mine]
        noise_q = part[2, 0] / chance.SHARE_QUANTA
        seen = chance.noise_seen(part[0, 0], noise_q, sums[2, first:stop])
        sums[0, first:stop] *= seen
        noise[first:stop] *= seen
        for table in (counts, part):
            table[2:, 0] *= seen[:, None]
        for zone in range(ZONES):
            wanted = np.maximum(part[0, zone].sum(axis=1) - sums[zone, first:stop], 0.0)
            least[:, zone, first:stop] = _least(part[:, zone], wanted, context)
            far_too[zone, first:stop] = _far_too(part[:, zone], least[0, zone, first:stop], context)
            for i, b in enumerate(least[0, zone, first:stop].tolist()):
                own = _taken(counts[:, zone, i, b:], far_too=far_too[zone, first + i])
                taken[zone] += own
                every[zone] += counts[:, zone, i].sum(axis=1)
                passed = _taken(part[:, 0, i, b:], far_too=far_too[0, first + i])
                around = passed, part[:, 0, i].sum(axis=1)
                if zone == 0 and _like_noise(*around, workflow.signal.neighbours):
                    doubtful[:, first + i] = own[[0, 2]]
    if workflow.signal.method == "bayes" and taken[1, 0] < chance.LEAST_PHOTONS:
        # A handful of photons below a surface is no floor.
        least[:, 1], taken[1] = signals.SCORE_BINS, 0.0
    path = place(context, "selection", beam, ".npz")
    arrays = {"window": window, "label": least[0], "ground": least[1], "far": far_too}
    write_arrays(path, arrays)
    told = float(taken[:, 4].sum()) / chance.SHARE_QUANTA
    unsure = _like_noise(taken[1], every[1], workflow.signal.water_neighbours)
    facts = {
        "signal": int(taken[:, 0].sum()),
        "doubtful": _stretches(window, doubtful, context),
        "doubtful_floor": taken[1, [0, 2]].tolist() if unsure else [0, 0],
        "estimated": float(max(cells.count.sum() - noise.sum(), 0.0)),
        "far_signal": int(taken[:, 1].sum()),
        "false_signal": told or None,
    }
    return Produced([path], facts, int(cells.count.sum()))


def _far_too(
    around: NDArray[np.float64], least: NDArray[np.int64], context: Context
) -> NDArray[np.bool_]:
    """Windows of a zone in which photons far from the surface may be signal, (w,) bool.

    Where noise explains all of them that pass, they are noise.
    """
    if context.workflow.signal.method != "bayes" or context.workflow.signal.selection != "f1":
        return np.ones(len(least), np.bool_)
    counts, far, noise, far_noise, _ = around
    expected = noise / chance.SHARE_QUANTA, far, far_noise / chance.SHARE_QUANTA
    return chance.more_far_than_noise(counts, *expected, least)


def _taken(table: NDArray[np.float64], *, far_too: bool) -> NDArray[np.float64]:
    """What is taken of photons by score, (5,) counts as of COUNTED."""
    own: NDArray[np.float64] = table.sum(axis=1)
    # Far from any surface the noise that is told is that which is expected.
    return own if far_too else own - own[[1, 1, 3, 3, 3]]


def _like_noise(taken: NDArray[Any], every: NDArray[Any], neighbours: int) -> bool:
    """Whether noise alone could give the photons taken; (4,) counts each as of COUNTED.

    Other methods and selections tell no noise, and of them nothing is said.
    """
    if not taken[0] or not every[2]:
        return False
    noise, all_noise = taken[2] / chance.SHARE_QUANTA, every[2] / chance.SHARE_QUANTA
    alone = chance.noise_alone(float(taken[0]), noise, all_noise / every[0], neighbours)
    return alone > chance.LIKE_NOISE


def _stretches(
    window: NDArray[np.int64], doubtful: NDArray[np.float64], context: Context
) -> dict[str, float]:
    """Doubtful photons of all windows, and where these lie [m]."""
    own = np.flatnonzero(doubtful[0])
    length_m = context.workflow.rate.cell_m
    length_m *= max(round(context.workflow.signal.window_m / length_m), 1)
    return {
        "photons": float(doubtful[0].sum()),
        "noise": float(doubtful[1].sum()) / chance.SHARE_QUANTA,
        "length_m": len(own) * length_m,
        "from_m": float(window[own[0]] * length_m) if len(own) else 0.0,
        "to_m": float((window[own[-1]] + 1) * length_m) if len(own) else 0.0,
    }


def _of_segments(
    window: NDArray[np.int64], segments: list[tuple[str, int, int]], context: Context
) -> NDArray[np.int64]:
    """What segments have counted of zones and windows by score: (5, ZONES, w, bins) int64."""
    workflow = context.workflow
    counts = np.zeros((len(COUNTED), ZONES, len(window), signals.SCORE_BINS), np.int64)
    size = quanta(workflow.rate.cell_m)
    for name, low, high in segments:
        ends = np.array([low // size, high // size - 1])
        covered = windows.window_of(ends, workflow.rate, workflow.signal.window_m)
        if covered[0] > window[-1] or covered[1] < window[0]:
            continue
        part = read_arrays(place(context, "counts", name, ".npz"))
        mine = np.isin(part["window"], window)
        at = np.searchsorted(window, part["window"][mine])
        for i, kind in enumerate(COUNTED):
            counts[i][:, at] += part[kind][:, mine]
    return counts


def _least(
    around: NDArray[np.float64], wanted: NDArray[np.float64], context: Context
) -> NDArray[np.int64]:
    """Least bins of windows of a zone, for labels and for the ground: (2, w) int64.

    ``wanted``: photons of signal estimated [count].
    """
    workflow = context.workflow
    if workflow.signal.method != "bayes":
        return np.ones((2, len(wanted)), np.int64)
    counts, far, noise, far_noise, _ = around
    settings, profile = workflow.signal, workflow.profile
    more = profile.photons_factor * wanted
    ground = signals.thresholds(counts, far, more, profile.false_share)
    if settings.selection == "f1":
        expected = noise / chance.SHARE_QUANTA, far, far_noise / chance.SHARE_QUANTA
        label = chance.best_thresholds(counts, *expected, wanted, settings.false_share)
    else:
        label = signals.thresholds(counts, far, wanted, settings.false_share)
    return np.stack([label, np.minimum(ground, label)])


class Selection:
    """What is signal, by window and score."""

    def __init__(self, beam: str, context: Context) -> None:
        self.arrays = read_arrays(place(context, "selection", beam, ".npz"))
        self.workflow = context.workflow

    def __call__(self, labels: Mapping[str, NDArray[Any]], which: str) -> NDArray[np.bool_]:
        """Photons that pass the threshold ``label`` or ``ground``, (n,) bool."""
        settings = self.workflow
        cell = labels["along"] // quanta(settings.rate.cell_m)
        window = windows.window_of(cell, settings.rate, settings.signal.window_m)
        at = np.searchsorted(self.arrays["window"], window)
        least = self.arrays[which][labels["below"], at]
        far_too = self.arrays["far"][labels["below"], at]
        passed: NDArray[np.bool_] = signals.score_bins(labels["score"]) >= least
        passed &= far_too | (labels["far"] == 0)
        return passed
