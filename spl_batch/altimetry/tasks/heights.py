"""Stage ``profile``: ground and canopy top of a beam, and what a reference says of it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.atl08 import find_labels, terrain_heights
from spl_batch.altimetry.formats.terrain import extent_deg, sample_terrain
from spl_batch.altimetry.formats.track_csv import read_profile
from spl_batch.altimetry.ground import over_water
from spl_batch.altimetry.ground import profile as profiles
from spl_batch.altimetry.photon_table import LABELS
from spl_batch.altimetry.settings import ProfileSettings
from spl_batch.altimetry.tasks.context import Context, gather, place, rows_between
from spl_batch.engine.findings import Finding
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


def profile_beam(args: Mapping[str, Any], context: Context) -> Produced:
    """Heights along a beam, segment by segment."""
    beam = args["key"]
    settings = profiles.for_layout(context.workflow.profile, args["layout"])
    spread = profiles.spread_m(context.workflow.profile, args["layout"])
    size = quanta(settings.cell_m)
    pieces = []
    for _, low, high in args["segments"]:
        owned = (-(-low // size), -(-high // size))
        reach = profiles.reach_cells(settings, spread) * size
        table = _labelled(args, owned[0] * size - reach, owned[1] * size + reach, context)
        if not len(table["row"]):
            continue
        pieces.append(_heights(table, owned, (settings, spread), context))
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
    facts = {
        "cells": len(ground),
        "ground_cells": int(np.count_nonzero(ground)),
        "water_cells": int(np.count_nonzero(columns["water"])),
        "floor_cells": int(np.count_nonzero(np.isfinite(columns["floor"]))),
        "canopy_cells": int(np.count_nonzero(columns["canopy_photons"])),
    }
    return Produced([path], facts, args["points"])


def _labelled(
    args: Mapping[str, Any], low: int, high: int, context: Context
) -> dict[str, NDArray[Any]]:
    """Labelled photons of a span of track, from every segment that has some."""

    def parts() -> Iterator[dict[str, NDArray[Any]]]:
        for name, first, stop in args["segments"]:
            if first < high and stop > low:
                path = place(context, "labels", name, ".parquet")
                yield from rows_between(path, tuple(LABELS), "along", low, high)

    return gather(parts(), LABELS)


def _heights(
    table: Mapping[str, NDArray[Any]],
    owned: tuple[int, int],
    settings: tuple[ProfileSettings, float],
    context: Context,
) -> dict[str, NDArray[Any]]:
    reference = context.workflow.reference
    sure, some = table["signal"] > 0, table["ground"] > 0
    photons = table["along"][some], table["height"][some], sure[some]
    level = table["level"][some].astype(np.int64)
    off_nadir_deg = context.workflow.track.off_nadir_deg
    columns = over_water.profile(photons, level, owned, settings, off_nadir_deg)
    columns["baseline_ground"] = np.full(len(columns["cell"]), np.nan)
    if reference is not None and reference.baseline:
        base = table["baseline"] > 0
        other = profiles.profile(
            table["along"][base], table["height"][base], base[base], owned, *settings
        )
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


PASS_PHOTONS: Final = 2_000_000
"""Photons whose classes are compared at once [count]."""

REFERENCE_GAP_M: Final = 200.0
"""Points of a reference that are farther apart say nothing of what lies between them [m]."""


@dataclass(frozen=True, slots=True)
class _Heights:
    """Heights of a reference along a beam."""

    at: NDArray[np.float64]  #: (m,): along-track distances at which both are compared [m].
    height: NDArray[np.float64]  #: (m,): of the reference's ground, NaN where it has none [m].
    lacks: Finding | None  #: Of a reference that has none anywhere.


def compare(args: Mapping[str, Any], context: Context) -> Produced:
    """Differences of a beam's ground from a reference, and agreement with other labels."""
    beam = args["key"]
    reference = context.workflow.reference
    if reference is None:
        return Produced()
    columns = read_columns(place(context, "profiles", beam, ".parquet"), tuple(COLUMNS))
    facts: dict[str, Any] = {"name": args["name"], "findings": []}
    truth = _reference_heights(columns, args, context)
    arrays = {"along_track": truth.at}
    for name in ("ground", "baseline_ground"):
        arrays[name] = _at(truth.at, columns["along_track"], columns[name]) - truth.height
        if reference.remove_bias and np.isfinite(arrays[name]).any():
            arrays[name] = arrays[name] - np.nanmedian(arrays[name])
        facts[name] = statistics(arrays[name])
    if args["labels"]:
        facts["labels"] = _agreement(args, context)
        if not facts["labels"]:
            facts["findings"].append(Finding("P01", {"kind": "granule"}))
    lacks = not facts["ground"]["n"] and np.isfinite(columns["ground"]).any()
    if lacks and truth.lacks and not facts["findings"]:
        facts["findings"].append(truth.lacks)
    path = place(context, "compared", beam, ".npz")
    write_arrays(path, arrays)
    return Produced([path], facts, len(columns["cell"]))


def _reference_heights(
    columns: Mapping[str, NDArray[Any]], args: Mapping[str, Any], context: Context
) -> _Heights:
    """Reference ground: at each cell, or at each height that ATL08 fits."""
    reference = context.workflow.reference
    at = columns["along_track"]
    ground = np.isfinite(columns["ground"])
    if reference is not None and reference.points is not None:
        known = read_profile(context.resolve(reference.points))
        ends = [[v.min(), v.max()] if len(v) else [np.nan] * 2 for v in (known[:, 0], at[ground])]
        from_km, to_km, first_km, last_km = (np.ravel(ends) / 1000).tolist()
        values = {
            "kind": "points", "name": reference.points, "from_km": from_km, "to_km": to_km,
            "first_km": first_km, "last_km": last_km,
        }  # fmt: skip
        far = Finding("P01", values)
        return _Heights(at, between(at, known), far)
    if reference is not None and reference.dtm is not None:
        path = context.resolve(reference.dtm)
        where = columns["latitude"], columns["longitude"]
        off = _off_raster(reference.dtm, path, [values[ground] for values in where])
        return _Heights(at, sample_terrain(path, *where), off)
    files = _label_files(args)
    fitted = terrain_heights(Path(args["path"]), files, args["beam"])
    lacks = Finding("P01", {"kind": "terrain"}) if files else None
    return _Heights(fitted[:, 0], fitted[:, 1], lacks)


def _off_raster(name: str, path: Path, where: list[NDArray[np.float64]]) -> Finding:
    """A raster that has no height along a beam."""
    known = np.isfinite(where).all(axis=0)
    if not known.any():
        return Finding("P01", {"kind": "unplaced ground", "name": name})
    latitude, longitude = (values[known] for values in where)
    box = [float(v) for ends in ("min", "max") for v in (getattr(longitude, ends)(),
                                                         getattr(latitude, ends)())]  # fmt: skip
    return Finding(
        "P01", {"kind": "dtm", "name": name, "dtm": list(extent_deg(path)), "ground": box}
    )


def _at(
    wanted: NDArray[np.float64], at: NDArray[np.float64], height: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Heights of a profile at places [m]; at its own cells they are what they are."""
    if wanted is at:
        return height
    known = np.isfinite(height)
    if not known.any():
        return np.full(len(wanted), np.nan)
    return between(wanted, np.column_stack([at[known], height[known]]))


def between(at: NDArray[np.float64], known: NDArray[np.float64]) -> NDArray[np.float64]:
    """Heights at places, NaN beyond those known and where these are far apart [m]."""
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
    theirs = find_labels(Path(args["path"]), _label_files(args), args["beam"])
    if theirs is None:
        return {}
    reference = context.workflow.reference
    methods = ["ours", "mdbscan"] if reference is not None and reference.baseline else ["ours"]
    # By method: neither, there only, here only, both.
    counts = np.zeros((len(methods), 4), np.int64)
    low, high = theirs.rows
    for first in range(low, high, PASS_PHOTONS):
        stop = min(first + PASS_PHOTONS, high)
        signal = theirs.signal(first, stop)
        for name, _, _ in args["segments"]:
            path = place(context, "labels", name, ".parquet")
            for rows in rows_between(path, tuple(LABELS), "row", first, stop):
                there = signal[rows["row"] - first]
                for k, method in enumerate(methods):
                    here = rows["signal" if method == "ours" else "baseline"] > 0
                    counts[k] += np.bincount(2 * here + there, minlength=4)
    names = ("neither", "only_there", "only_here", "both")
    return {
        method: dict(zip(names, row.tolist(), strict=True))
        for method, row in zip(methods, counts, strict=True)
    }


def _label_files(args: Mapping[str, Any]) -> list[Path]:
    return [Path(name) for name in args["labels"]]
