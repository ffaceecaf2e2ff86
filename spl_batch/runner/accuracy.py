"""Compare the delivered rasters with reference points, part by part."""

import os
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from spl_batch.accuracy import (
    Differences,
    Raster,
    Reference,
    accuracy_report,
    difference_raster,
    merge,
    surface_differences,
    terrain_differences,
)
from spl_batch.errors import InputError
from spl_batch.io.raster_parts import Part, read_overview, read_part
from spl_batch.runner.context import Context
from spl_batch.runner.reference import read_reference

SAMPLE = 500_000
"""Differences that the histogram is drawn from, at most [count]."""

THREADS = 4
"""Parts of the reference that are compared side by side, at most [count]: memory grows with it."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """What the reference says.

    Parameters
    ----------
    statistics : mapping
        As ``report.json`` holds them.
    differences_m : (n,) float32
        An even sample of DTM minus reference [m].
    difference : Raster
        Mean difference by cell [m].
    points : int
        Reference points read [count].
    unreadable : list of InputError
        Reference files that could not be read to their end.
    """

    statistics: dict[str, Any]
    differences_m: np.ndarray[Any, np.dtype[np.float32]]
    difference: Raster
    points: int
    unreadable: list[InputError]


def compare(paths: Iterable[Path], context: Context) -> Comparison | None:
    """Compare DTM and DSM with reference points; None without reference or rasters."""
    dtm_path, dsm_path = context.output / "dtm.tif", context.output / "dsm.tif"
    reference = context.workflow.reference
    if reference is None or not dtm_path.exists() or not dsm_path.exists():
        return None
    overview = _raster(read_overview(dtm_path))
    total = np.zeros(overview.values.shape)
    count = np.zeros(overview.values.shape, np.int64)
    dtm: list[Differences] = []
    dsm: list[Differences] = []
    points = 0
    unreadable: list[InputError] = []
    for path in paths:
        try:
            for part in _parts(path, overview, context):
                points += part.points
                dtm += part.terrain
                dsm += part.surface
                seen = part.difference.values > -9000
                total[seen] += part.difference.values[seen]
                count[seen] += 1
        except InputError as error:
            unreadable.append(error)
    mean = np.where(count > 0, total / np.maximum(count, 1), -9999.0).astype(np.float32)
    merged = merge(dtm)
    every = merged.get("all", np.empty(0, np.float32))
    return Comparison(
        accuracy_report(merged, merge(dsm), remove_bias=reference.remove_bias),
        every[:: max(1, len(every) // SAMPLE)],
        Raster(mean, overview.left_m, overview.top_m, overview.cell_m),
        points,
        unreadable,
    )


@dataclass(frozen=True, slots=True)
class _Part:
    """What one part of the reference says; no differences where the rasters do not reach it."""

    points: int
    terrain: tuple[Differences, ...]
    surface: tuple[Differences, ...]
    difference: Raster


def _parts(path: Path, overview: Raster, context: Context) -> Iterator[_Part]:
    """Parts of a reference file in their order, some of them compared side by side."""
    threads = min(os.cpu_count() or 1, THREADS)
    waiting: deque[Future[_Part]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for known in read_reference(path, context.store.local, overview.cell_m):
            waiting.append(pool.submit(_part, known, overview, context))
            if len(waiting) > threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def _part(known: Reference, overview: Raster, context: Context) -> _Part:
    """Compare one part of the reference with the rasters."""
    bounds = _bounds(known)
    rasters = [read_part(context.output / f"{n}.tif", bounds) for n in ("dtm", "dsm", "chm")]
    terrain, surface, height = (r if r is None else _raster(r) for r in rasters)
    points, difference = int(np.count_nonzero(known.counts)), difference_raster(overview, known)
    if terrain is None or surface is None:
        return _Part(points, (), (), difference)
    return _Part(
        points,
        (terrain_differences(terrain, known, chm=height),),
        (surface_differences(surface, known),),
        difference,
    )


def _bounds(reference: Reference) -> tuple[float, float, float, float]:
    if not len(reference.xyz_m):
        return (0.0, 0.0, -1.0, -1.0)
    low, high = reference.xyz_m.min(axis=0), reference.xyz_m.max(axis=0)
    return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def _raster(part: Part) -> Raster:
    return Raster(part.values, part.left_m, part.top_m, part.cell_m)
