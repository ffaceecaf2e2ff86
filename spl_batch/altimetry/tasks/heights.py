"""Stage ``profile``: ground and canopy top of a beam, and their differences from a reference."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.atl08 import find_labels, terrain_heights
from spl_batch.altimetry.formats.terrain import extent_deg, sample_terrain
from spl_batch.altimetry.formats.track_csv import read_profile
from spl_batch.altimetry.ground import over_water
from spl_batch.altimetry.ground import profile as profiles
from spl_batch.altimetry.photon_table import LABELS, joined
from spl_batch.altimetry.settings import TrackReferenceSettings
from spl_batch.altimetry.tasks.context import Context, gather, rows_between
from spl_batch.engine.findings import Finding
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, read_columns, write_arrays, writing
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.error_statistics import statistics

_WHERE: Final = {"latitude": np.float64, "longitude": np.float64}
_MADE: Final = {**over_water.COLUMNS, "baseline_ground": np.float64}

COLUMNS: Final = {**over_water.COLUMNS, **_WHERE, "baseline_ground": np.float64}
"""Columns of a profile in the store; the last one is mDBSCAN's ground."""

REFERENCE_GAP_M: Final = 200.0
"""Points of a reference that are farther apart give no height between them [m]."""


def profile_beam(args: Mapping[str, Any], context: Context) -> Produced:
    """Heights along a beam, segment by segment."""
    layers = profiles.layers_of(context.workflow.profile, args["layout"])
    size = quanta(context.workflow.profile.cell_m)
    reach = layers.reach_cells * size

    def labelled(low: int, high: int) -> Iterator[dict[str, NDArray[Any]]]:
        """Photons of a span of track, from every segment that has some."""
        for name, first, stop in args["segments"]:
            if first < high and stop > low:
                path = context.store.table("labels", name)
                yield from rows_between(path, tuple(LABELS), "along", low, high)

    pieces = []
    for _, low, high in args["segments"]:
        owned = (-(-low // size), -(-high // size))
        found = labelled(owned[0] * size - reach, owned[1] * size + reach)
        table = gather(found, LABELS)
        if len(table["row"]):
            pieces.append(_heights(table, owned, layers, context))
    columns = joined(pieces, _MADE)
    columns |= _where(args["key"], columns["along_track"], context)
    path = context.store.table("profiles", args["key"])
    with writing(path, COLUMNS) as writer:
        writer.write(columns)
    facts = {
        "cells": len(columns["cell"]),
        "ground_cells": int(np.count_nonzero(np.isfinite(columns["ground"]))),
        "canopy_cells": int(np.count_nonzero(columns["canopy_photons"])),
    }
    return Produced([path], facts, args["points"])


def _heights(
    table: Mapping[str, NDArray[Any]],
    owned: tuple[int, int],
    layers: profiles.Layers,
    context: Context,
) -> dict[str, NDArray[Any]]:
    """Columns of the cells of a piece of track."""
    reference = context.workflow.reference
    sure, some = table["signal"] > 0, table["ground"] > 0
    photons = table["along"][some], table["height"][some], sure[some]
    level = table["level"][some].astype(np.int64)
    off_nadir_deg = context.workflow.track.off_nadir_deg
    columns = over_water.profile(photons, level, owned, layers, off_nadir_deg)
    columns["baseline_ground"] = np.full(len(columns["cell"]), np.nan)
    if reference is not None and reference.baseline:
        base = table["baseline"] > 0
        other = profiles.profile(
            table["along"][base], table["height"][base], base[base], owned, layers
        )
        _, mine, theirs = np.intersect1d(columns["cell"], other["cell"], return_indices=True)
        columns["baseline_ground"][mine] = other["ground"][theirs]
    return columns


def _where(
    beam: str, along_m: NDArray[np.float64], context: Context
) -> dict[str, NDArray[np.float64]]:
    """Latitude and longitude of points along a beam, between the first photons of its cells."""
    firsts = read_arrays(context.store.path("places", f"{beam}.npz"))
    known = np.isfinite(firsts["latitude"]) & np.isfinite(firsts["longitude"])
    if not known.any():
        return dict.fromkeys(_WHERE, np.full(len(along_m), np.nan))
    at = firsts["index"][known] * context.workflow.rate.cell_m
    # Unwrapped, so that nothing is interpolated through Greenwich at the date line.
    longitude = np.interp(along_m, at, np.unwrap(firsts["longitude"][known], period=360.0))
    return {
        "latitude": np.interp(along_m, at, firsts["latitude"][known]),
        "longitude": (longitude + 180.0) % 360.0 - 180.0,
    }


def compare(args: Mapping[str, Any], context: Context) -> Produced:
    """Differences of a beam's ground from a reference, and agreement with other labels."""
    reference = context.workflow.reference
    if reference is None:
        return Produced()
    columns = read_columns(context.store.table("profiles", args["key"]), tuple(COLUMNS))
    along, ground = columns["along_track"], np.isfinite(columns["ground"])
    files = [Path(name) for name in args["labels"]]
    facts: dict[str, Any] = {"name": args["name"], "findings": []}
    arrays = {"along_track": along}
    if reference.points is None and reference.dtm is None:
        arrays["along_track"], height = terrain_heights(Path(args["path"]), files, args["beam"]).T
    else:
        height = _at_cells(columns, reference, context)
    for name in ("ground", "baseline_ground"):
        mine = columns[name]
        if arrays["along_track"] is not along:
            known = np.isfinite(mine)
            mine = between(arrays["along_track"], np.column_stack([along, mine])[known])
        arrays[name] = mine - height
        if reference.remove_bias and np.isfinite(arrays[name]).any():
            arrays[name] = arrays[name] - np.nanmedian(arrays[name])
        facts[name] = statistics(arrays[name])
    if files:
        facts["labels"] = _agreement(args, files, context)
        if not facts["labels"]:
            facts["findings"].append(Finding("P01", {"kind": "granule"}))
    if not facts["ground"]["n"] and ground.any() and not facts["findings"]:
        where = {name: columns[name][ground] for name in ("along_track", *_WHERE)}
        facts["findings"] += _nothing_near(where, files, reference, context)
    path = context.store.path("compared", f"{args['key']}.npz")
    write_arrays(path, arrays)
    return Produced([path], facts, len(along))


def _at_cells(
    columns: Mapping[str, NDArray[Any]], reference: TrackReferenceSettings, context: Context
) -> NDArray[np.float64]:
    """Heights of points or of a raster at each cell [m]."""
    if reference.points is not None:
        known = read_profile(context.resolve(reference.points))
        return between(columns["along_track"], known)
    path = context.resolve(reference.dtm or "")
    return sample_terrain(path, columns["latitude"], columns["longitude"])


def _nothing_near(
    where: Mapping[str, NDArray[np.float64]],
    files: Sequence[Path],
    reference: TrackReferenceSettings,
    context: Context,
) -> Iterator[Finding]:
    """Why a reference has no height at any ground of a beam."""
    name = reference.points or reference.dtm
    if reference.points is not None:
        known_km = read_profile(context.resolve(reference.points))[:, 0] / 1000
        found_km = where["along_track"] / 1000
        yield Finding("P01", {
            "kind": "points", "name": name, "from_km": float(known_km[0]),
            "to_km": float(known_km[-1]), "first_km": float(found_km.min()),
            "last_km": float(found_km.max()),
        })  # fmt: skip
    elif reference.dtm is not None:
        placed = [values[np.isfinite(values)] for values in (where["longitude"], where["latitude"])]
        if not all(len(values) for values in placed):
            yield Finding("P01", {"kind": "unplaced ground", "name": name})
            return
        box = [float(end(values)) for end in (np.min, np.max) for values in placed]
        dtm = list(extent_deg(context.resolve(reference.dtm)))
        yield Finding("P01", {"kind": "dtm", "name": name, "dtm": dtm, "ground": box})
    elif files:
        yield Finding("P01", {"kind": "terrain"})


def between(at: NDArray[np.float64], known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights at distances along the track [m], NaN where none is known or these are far apart."""
    if not len(known):
        return np.full(len(at), np.nan)
    along_m, values = known.T
    heights: NDArray[np.float64] = np.interp(at, along_m, values, left=np.nan, right=np.nan)
    if len(known) > 1:
        after = np.clip(np.searchsorted(along_m, at), 1, len(along_m) - 1)
        low, high = along_m[after - 1], along_m[after]
        heights[(high - low > REFERENCE_GAP_M) & (low < at) & (at < high)] = np.nan
    return heights


def _agreement(
    args: Mapping[str, Any], files: Sequence[Path], context: Context
) -> dict[str, dict[str, int]]:
    """Photons that are signal here and there, by method: true and false, positive and negative."""
    theirs = find_labels(Path(args["path"]), files, args["beam"])
    if theirs is None:
        return {}
    reference = context.workflow.reference
    methods = {"ours": "signal"}
    if reference is not None and reference.baseline:
        methods["mdbscan"] = "baseline"
    # By method: neither, there only, here only, both.
    counts = {method: np.zeros(4, np.int64) for method in methods}
    first, stop = theirs.first, theirs.first + len(theirs.signal)
    for name, _, _ in args["segments"]:
        path = context.store.table("labels", name)
        for rows in rows_between(path, tuple(LABELS), "row", first, stop):
            there = theirs.signal[rows["row"] - first]
            for method, column in methods.items():
                counts[method] += np.bincount(2 * (rows[column] > 0) + there, minlength=4)
    names = ("neither", "only_there", "only_here", "both")
    return {m: dict(zip(names, row.tolist(), strict=True)) for m, row in counts.items()}
