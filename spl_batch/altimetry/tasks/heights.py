"""Stage ``profile``: ground and canopy top of a beam."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.ground import over_water
from spl_batch.altimetry.ground import profile as profiles
from spl_batch.altimetry.photon_table import LABELS
from spl_batch.altimetry.settings import ProfileSettings
from spl_batch.altimetry.tasks.context import Context, gather, place, rows_between
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.verified.parquet_npz import read_arrays, writing
from spl_batch.lattice.tiles import quanta

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
