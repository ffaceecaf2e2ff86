"""Stage ``rate``: the noise along a beam, its scaled axis, and the cut into segments."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter import signal as signals
from spl_batch.altimetry.filter.peer_filters import PEERS
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.fog import Fog, fog_told, told
from spl_batch.altimetry.photon_table import PHOTONS, Background, Cells, Scale, along_track
from spl_batch.altimetry.tasks.context import Context, gather, place, rows_between
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tiles import quanta

OBSERVE_PHOTONS: Final = 500_000
"""Photons whose cells are looked at together, about [count]."""

OBSERVE_CELLS: Final = 1024
"""Cells that are looked at together, at most: a table of them by height is held [count]."""


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
        "water": float(np.mean(cells.calm)) if len(cells.index) else 0.0,
        "maybe_river": along_track(cells.index[cells.maybe], workflow.rate.cell_m),
        "dark_water": along_track(cells.index[cells.dark], workflow.rate.cell_m),
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
    table = photons_of(beam, (first - reach) * size, (stop + reach) * size, context)
    cells = rates.observe(table["along"], table["height"], settings)
    mine = (cells.index >= first) & (cells.index < stop)
    return Cells(**{name: values[mine] for name, values in cells.to_arrays().items()})


def photons_of(beam: str, low: int, high: int, context: Context) -> dict[str, NDArray[Any]]:
    """Photons of a beam between two places, in order [quanta]."""
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
