"""Stages ``rate`` and ``signal``: the noise along a beam, scores by segment, and what is signal.

A segment is a run of cells. It reads the photons of its cells and of the reach of a score to
each side, and writes those of its cells, so where a track is cut does not matter.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter import chance
from spl_batch.altimetry.filter import signal as signals
from spl_batch.altimetry.filter.likelihood import ratios
from spl_batch.altimetry.filter.peer_filters import PEERS, keep
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise import windows
from spl_batch.altimetry.noise.fog import Fog, fog_told, told
from spl_batch.altimetry.noise.noise_at import below_surface
from spl_batch.altimetry.photon_table import LABELS, PHOTONS, Background, Cells, Scale
from spl_batch.altimetry.tasks.context import GROUP_PHOTONS, Context, gather, place, rows_between
from spl_batch.altimetry.water.level_water import NO_WATER
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays, writing
from spl_batch.lattice.tiles import quanta

OBSERVE_PHOTONS: Final = 500_000
"""Photons whose cells are looked at together, about [count]."""

OBSERVE_CELLS: Final = 1024
"""Cells that are looked at together, at most: a table of them by height is held [count]."""

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


def find_rate(args: Mapping[str, Any], context: Context) -> Produced:
    """Noise of every cell of a beam, the scaled axis, and the cut into segments."""
    workflow, beam = context.workflow, args["key"]
    counted = read_arrays(place(context, "places", beam, ".npz"))
    parts = [
        _observed(beam, run, context)
        for run in runs(counted["count"], OBSERVE_PHOTONS, OBSERVE_CELLS)
    ]
    cells = rates.join(parts) if parts else rates.observe(*_nothing(), workflow.rate)
    density, basis = _density(cells, args, context)
    scale = rates.scale(cells, density, workflow.rate, workflow.signal)
    path = place(context, "rate", beam, ".npz")
    far = rates.far_length_m(cells, workflow.rate)
    arrays = {f"cells_{k}": v for k, v in cells.to_arrays().items()}
    write_arrays(path, {**arrays, **scale.to_arrays(), "far_m": far})
    limits = (
        workflow.work.segment_photons,
        signals.most_cells(scale, workflow.rate, workflow.signal),
    )
    if workflow.signal.method in PEERS:
        # Their thresholds are those of a whole beam.
        limits = int(cells.count.sum()) + 1, len(cells.index) + 1
    segments = [
        [int(cells.index[a]), int(cells.index[b - 1]) + 1, int(cells.count[a:b].sum())]
        for a, b in runs(cells.count, *limits)
    ]
    facts = {
        "basis": basis,
        "segments": segments,
        "noise_photons": float(scale.noise.sum()),
        "density_per_m2": [float(v) for v in np.quantile(density, [0.05, 0.5, 0.95])]
        if len(density)
        else None,
        "gate_m": float(np.median(cells.gate_m)) if len(cells.index) else None,
        "unseen": rates.unseen(cells, workflow.rate),
        "water": float(np.mean(cells.level != NO_WATER)) if len(cells.index) else 0.0,
        "fog": fog_told(cells.index, Fog(cells.fog_low, cells.fog), workflow.rate.cell_m),
        "mist": told(cells.index, cells.mist.T.astype(np.float64), workflow.rate.cell_m),
        "length_m": len(cells.index) * workflow.rate.cell_m,
    }
    return Produced([path], facts, int(cells.count.sum()))


def runs(
    count: NDArray[np.int64], most: int, cells: int = np.iinfo(np.int64).max
) -> Iterator[tuple[int, int]]:
    """Runs of cells that hold ``most`` photons, or one cell of more: first, stop.

    Parameters
    ----------
    count : (n,) int64
        Photons of each cell, at least one in each [count].
    most, cells : int
        Photons and cells of a run, at most [count].
    """
    start = total = 0
    for i, n in enumerate(count.tolist()):
        if total and (total + n > most or i - start >= cells):
            yield start, i
            start, total = i, 0
        total += n
    if total:
        yield start, len(count)


def _nothing() -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    return np.empty(0, np.int64), np.empty(0, np.int32)


def _observed(beam: str, run: tuple[int, int], context: Context) -> Cells:
    """Cells of a run, seen with those around it."""
    settings = context.workflow.rate
    size = quanta(settings.cell_m)
    index = read_arrays(place(context, "places", beam, ".npz"))["index"]
    first, stop = int(index[run[0]]), int(index[run[1] - 1]) + 1
    reach = rates.HALO_CELLS
    table = _photons(beam, (first - reach) * size, (stop + reach) * size, context)
    cells = rates.observe(table["along"], table["height"], settings)
    mine = (cells.index >= first) & (cells.index < stop)
    return Cells(**{name: values[mine] for name, values in cells.to_arrays().items()})


def _photons(beam: str, low: int, high: int, context: Context) -> dict[str, NDArray[Any]]:
    path = place(context, "photons", beam, ".parquet")
    return gather(rows_between(path, tuple(PHOTONS), "along", low, high), PHOTONS)


def _density(
    cells: Cells, args: Mapping[str, Any], context: Context
) -> tuple[NDArray[np.float64], str]:
    """Noise density of each cell, and where it comes from."""
    workflow = context.workflow
    settings = workflow.rate
    if settings.source == "window" or not args["background"] or not len(cells.index):
        return rates.density_from_window(cells, settings), "window"
    stated = Background(**read_arrays(place(context, "background", args["key"], ".npz")))
    if settings.source == "product":
        return rates.density_from_product(cells, stated, settings), "product"
    window_m = workflow.signal.window_m
    return rates.density_from_both(cells, stated, settings, window_m), "product and window"


def read_rate(beam: str, context: Context) -> tuple[Cells, Scale, NDArray[np.float64]]:
    """Cells of a beam, its scaled axis, and the length of gate far from the surface [m]."""
    arrays = read_arrays(place(context, "rate", beam, ".npz"))
    names = [name for name in arrays if name.startswith("cells_")]
    cells = Cells(**{name.removeprefix("cells_"): arrays[name] for name in names})
    return cells, Scale.from_arrays(arrays), arrays["far_m"]


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
    table = _photons(beam, low - reach, high + reach, context)
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
            estimated = part[0, zone].sum(axis=1) - sums[zone, first:stop]
            least[:, zone, first:stop] = _least(part[:, zone], np.maximum(estimated, 0.0), context)
            for i, b in enumerate(least[0, zone, first:stop].tolist()):
                own = counts[:, zone, i, b:].sum(axis=1)
                taken[zone] += own
                every[zone] += counts[:, zone, i].sum(axis=1)
                around = part[:, 0, i, b:].sum(axis=1), part[:, 0, i].sum(axis=1)
                if zone == 0 and _like_noise(*around, workflow.signal.neighbours):
                    doubtful[:, first + i] = own[[0, 2]]
    path = place(context, "selection", beam, ".npz")
    arrays = {"window": window, "label": least[0], "ground": least[1]}
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
    around: NDArray[np.float64],
    estimated: NDArray[np.float64],
    context: Context,
) -> NDArray[np.int64]:
    """Least bins of windows of a zone, for labels and for the ground: (2, w) int64."""
    workflow = context.workflow
    if workflow.signal.method != "bayes":
        return np.ones((2, len(estimated)), np.int64)
    counts, far, noise, far_noise, _ = around
    settings, profile = workflow.signal, workflow.profile
    wanted = profile.photons_factor * estimated
    ground = signals.thresholds(counts, far, wanted, profile.false_share)
    if settings.selection == "f1":
        expected = noise / chance.SHARE_QUANTA, far, far_noise / chance.SHARE_QUANTA
        label = chance.best_thresholds(counts, *expected, estimated, settings.false_share)
    else:
        label = signals.thresholds(counts, far, estimated, settings.false_share)
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
        passed: NDArray[np.bool_] = signals.score_bins(labels["score"]) >= least
        return passed
