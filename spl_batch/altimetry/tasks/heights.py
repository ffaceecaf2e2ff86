"""Stage ``profile``: ground and canopy top of a beam, and what a reference says of them."""

import glob
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.atl08 import find_labels
from spl_batch.altimetry.formats.terrain import sample_terrain
from spl_batch.altimetry.formats.track_csv import read_profile
from spl_batch.altimetry.ground import over_water
from spl_batch.altimetry.ground import profile as profiles
from spl_batch.altimetry.ground.lost_floor import lost_floor
from spl_batch.altimetry.ground.under_crowns import doubt_told
from spl_batch.altimetry.photon_table import LABELS, Scale
from spl_batch.altimetry.settings import ProfileSettings
from spl_batch.altimetry.tasks.context import Context, gather, place, rows_between
from spl_batch.altimetry.tasks.photons import Selection
from spl_batch.altimetry.tasks.rate import read_rate
from spl_batch.altimetry.water.level_water import NO_WATER
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, read_columns, write_arrays, writing
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.error_statistics import statistics

COLUMNS: Final = {
    **over_water.COLUMNS,
    "latitude": np.float64,
    "longitude": np.float64,
    "baseline_ground": np.float64,
}
"""Columns of a profile in the store; the last one is mDBSCAN's ground."""

PASS_PHOTONS: Final = 2_000_000
"""Photons whose classes are compared at once [count]."""

REFERENCE_GAP_M: Final = 200.0
"""Points of a reference that are farther apart say nothing of what lies between them [m]."""


def profile_beam(args: Mapping[str, Any], context: Context) -> Produced:
    """Heights along a beam, segment by segment."""
    beam = args["key"]
    settings = profiles.for_layout(context.workflow.profile, args["layout"])
    spread = profiles.spread_m(context.workflow.profile, args["layout"])
    size = quanta(settings.cell_m)
    chosen, (cells, scale, _) = Selection(beam, context), read_rate(beam, context)
    pieces = []
    for _, low, high in args["segments"]:
        owned = (-(-low // size), -(-high // size))
        reach = profiles.reach_cells(settings, spread) * size
        table = _labelled(args, owned[0] * size - reach, owned[1] * size + reach, context)
        if not len(table["row"]):
            continue
        pieces.append(_heights(table, (chosen, scale), owned, (settings, spread), context))
    columns = {
        name: np.concatenate([np.empty(0, dtype), *(p[name] for p in pieces)])
        for name, dtype in COLUMNS.items()
        if name not in {"latitude", "longitude"}
    }
    columns |= _where(beam, columns["along_track"], context)
    path = place(context, "profiles", beam, ".parquet")
    with writing(path, COLUMNS) as writer:
        writer.write(columns)
    ground = np.isfinite(columns["ground"])
    rate_m = context.workflow.rate.cell_m
    at_m = (cells.index[np.isfinite(cells.floor[:, 0])] + 0.5) * rate_m
    shown = np.floor(at_m / settings.cell_m).astype(np.int64)
    wet = columns["water"] == 1
    floor = np.isfinite(columns["floor"])
    lost = lost_floor(columns["cell"][wet], floor[wet], shown, settings.cell_m)
    facts = {
        "cells": len(ground),
        "ground_cells": int(np.count_nonzero(ground)),
        "water_cells": int(np.count_nonzero(columns["water"])),
        "floor_cells": int(np.count_nonzero(floor)),
        "lost_floor": list(lost),
        "doubt": doubt_told(columns, settings.cell_m),
        "canopy_cells": int(np.count_nonzero(columns["canopy_photons"])),
    }
    return Produced([path], facts, args["points"])


def _labelled(
    args: Mapping[str, Any], low: int, high: int, context: Context
) -> dict[str, NDArray[Any]]:
    """Scored photons of a span of track, from every segment that has some."""

    def parts() -> Iterator[dict[str, NDArray[Any]]]:
        for name, first, stop in args["segments"]:
            if first < high and stop > low:
                path = place(context, "scores", name, ".parquet")
                yield from rows_between(path, tuple(LABELS), "along", low, high)

    return gather(parts(), LABELS)


def _heights(
    table: Mapping[str, NDArray[Any]],
    beam: tuple[Selection, Scale],
    owned: tuple[int, int],
    settings: tuple[ProfileSettings, float],
    context: Context,
) -> dict[str, NDArray[Any]]:
    reference = context.workflow.reference
    chosen, scale = beam
    sure = chosen(table, "label")
    some = chosen(table, "ground")
    photons = table["along"][some], table["height"][some], sure[some]
    cell = np.searchsorted(scale.index, photons[0] // quanta(context.workflow.rate.cell_m))
    level = np.where(scale.calm, scale.level, NO_WATER)[cell].astype(np.int64)
    off_nadir_deg = context.workflow.track.off_nadir_deg
    columns = over_water.profile(photons, level, owned, settings, off_nadir_deg)
    columns["baseline_ground"] = np.full(len(columns["cell"]), np.nan)
    if reference is not None and reference.baseline:
        base = table["baseline"] > 0
        other = profiles.profile(
            table["along"][base], table["height"][base], base[base], owned, *settings
        ).columns
        _, mine, theirs = np.intersect1d(columns["cell"], other["cell"], return_indices=True)
        columns["baseline_ground"][mine] = other["ground"][theirs]
    return columns


def _where(
    beam: str, along_m: NDArray[np.float64], context: Context
) -> dict[str, NDArray[np.float64]]:
    """Latitude and longitude of places along a beam, between the first photons of its cells."""
    places = read_arrays(place(context, "places", beam, ".npz"))
    known = np.isfinite(places["latitude"]) & np.isfinite(places["longitude"])
    if not known.any():
        unknown = np.full(len(along_m), np.nan)
        return {"latitude": unknown, "longitude": unknown}
    at = places["index"][known] * context.workflow.rate.cell_m
    # Unwrapped, so that nothing is interpolated through Greenwich at the date line.
    longitude = np.interp(along_m, at, np.unwrap(places["longitude"][known], period=360.0))
    return {
        "latitude": np.interp(along_m, at, places["latitude"][known]),
        "longitude": (longitude + 180.0) % 360.0 - 180.0,
    }


def compare(args: Mapping[str, Any], context: Context) -> Produced:
    """Differences of a beam's ground from a reference, and agreement with other labels."""
    beam = args["key"]
    reference = context.workflow.reference
    if reference is None:
        return Produced()
    columns = read_columns(place(context, "profiles", beam, ".parquet"), tuple(COLUMNS))
    facts: dict[str, Any] = {}
    truth = _reference_heights(columns, context)
    arrays = {"along_track": columns["along_track"]}
    for name in ("ground", "baseline_ground"):
        arrays[name] = columns[name] - truth
        if reference.remove_bias and np.isfinite(arrays[name]).any():
            arrays[name] = arrays[name] - np.nanmedian(arrays[name])
        facts[name] = statistics(arrays[name])
    if reference.labels is not None and args["layout"] == "atl03":
        facts["labels"] = _agreement(args, context)
    path = place(context, "compared", beam, ".npz")
    write_arrays(path, arrays)
    return Produced([path], facts, len(columns["cell"]))


def _reference_heights(
    columns: Mapping[str, NDArray[Any]], context: Context
) -> NDArray[np.float64]:
    """Reference ground at each cell, NaN where there is none [m]."""
    reference = context.workflow.reference
    at = columns["along_track"]
    unknown = np.full(len(at), np.nan)
    if reference is None:
        return unknown
    if reference.points is not None:
        return between(at, read_profile(context.resolve(reference.points)))
    if reference.dtm is not None:
        path = context.resolve(reference.dtm)
        return sample_terrain(path, columns["latitude"], columns["longitude"])
    return unknown


def between(at: NDArray[np.float64], known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights of a reference at places, NaN beyond it and where its points are far apart [m]."""
    heights: NDArray[np.float64] = np.interp(
        at, known[:, 0], known[:, 1], left=np.nan, right=np.nan
    )
    if len(known) > 1:
        after = np.clip(np.searchsorted(known[:, 0], at), 1, len(known) - 1)
        low, high = known[after - 1, 0], known[after, 0]
        heights[(high - low > REFERENCE_GAP_M) & (low < at) & (at < high)] = np.nan
    return heights


def _agreement(args: Mapping[str, Any], context: Context) -> dict[str, dict[str, int]]:
    """Photons that are signal here and there, by method: true and false, positive and negative.

    Counts add up, so photons are looked at in passes of a bounded number.
    """
    theirs = find_labels(Path(args["path"]), _label_files(context), args["beam"])
    if theirs is None:
        return {}
    chosen = Selection(args["key"], context)
    reference = context.workflow.reference
    methods = ["ours", "mdbscan"] if reference is not None and reference.baseline else ["ours"]
    # By method: neither, there only, here only, both.
    counts = np.zeros((len(methods), 4), np.int64)
    low, high = theirs.rows
    for first in range(low, high, PASS_PHOTONS):
        stop = min(first + PASS_PHOTONS, high)
        signal = theirs.signal(first, stop)
        for name, _, _ in args["segments"]:
            path = place(context, "scores", name, ".parquet")
            for rows in rows_between(path, tuple(LABELS), "row", first, stop):
                there = signal[rows["row"] - first]
                for k, method in enumerate(methods):
                    here = chosen(rows, "label") if method == "ours" else rows["baseline"] > 0
                    counts[k] += np.bincount(2 * here + there, minlength=4)
    names = ("neither", "only_there", "only_here", "both")
    return {
        method: dict(zip(names, row.tolist(), strict=True))
        for method, row in zip(methods, counts, strict=True)
    }


def _label_files(context: Context) -> list[Path]:
    reference = context.workflow.reference
    if reference is None or reference.labels is None:
        return []
    pattern = str(context.base / reference.labels)
    return sorted(Path(p) for p in glob.glob(pattern))  # noqa: PTH207 - patterns may be absolute
