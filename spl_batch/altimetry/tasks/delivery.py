"""Stage ``deliver``: photon labels and profiles as tables, and labels back into HDF5."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.formats.hdf5 import add_dataset, labelled_copy
from spl_batch.altimetry.formats.track_csv import to_text
from spl_batch.altimetry.photon_table import LABELS, NOT_ASSESSED
from spl_batch.altimetry.tasks.context import GROUP_PHOTONS, Context, rows_between
from spl_batch.altimetry.tasks.heights import COLUMNS
from spl_batch.altimetry.water.surface import NO_WATER, SURFACE_M, refracted
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.input_changes import as_indexed, unchanged
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.formats.verified.parquet_npz import read_columns, writing

PASS_PHOTONS: Final = 2_000_000
"""Photons whose labels are held at once [count]."""

DELIVERED: Final = {
    "along_track": np.float64,
    "height": np.float64,
    "signal": np.uint8,
    "confidence": np.float32,
    "water": np.uint8,
}
"""Columns of a photon table: [m], [m], 0 noise, 1 signal, 255 not assessed, 0..1, see below."""

REFRACTED: Final = "height_refracted"
"""Column of heights corrected for refraction, where that is asked for [m]."""

SURFACE, FLOOR, COLUMN = 41, 40, 45
"""Where water is seen: signal at its surface, signal below it, and what else lies below it."""

_KEPT: Final = {"baseline_ground", "floor_refracted"}
_PROFILE: Final = tuple(n for n in COLUMNS if n not in _KEPT)
_DATASETS: Final[Mapping[str, tuple[type, float, str]]] = {
    "spl_signal": (np.uint8, NOT_ASSESSED, "0 noise, 1 signal, 255 not assessed"),
    "spl_confidence": (np.float32, math.nan, "confidence that the photon is signal, 0..1"),
}


def deliver_beam(args: Mapping[str, Any], context: Context) -> Produced:
    """Write a beam's photons in the order of the file, and its profile."""
    photons = context.output / "photons" / f"{args['delivered']}.parquet"
    counts, water = np.zeros(256, np.int64), np.zeros(COLUMN + 1, np.int64)
    refraction = context.workflow.outputs.refraction
    columns_of = DELIVERED | ({REFRACTED: np.float64} if refraction else {})
    with writing(photons, columns_of, durable=True, rows=GROUP_PHOTONS) as writer:
        for _, part in _passes(args, context):
            counts += np.bincount(part["signal"], minlength=256)
            water += np.bincount(part["water"], minlength=COLUMN + 1)
            writer.write(part)
    names = (*_PROFILE, *(("floor_refracted",) if refraction else ()))
    columns = read_columns(context.store.table("profiles", args["key"]), names)
    profile = context.output / "profiles" / f"{args['delivered']}.csv"
    write_bytes(profile, to_text(columns))
    facts = {
        "points": int(counts.sum()),
        "labels": {str(k): int(v) for k, v in enumerate(counts) if v},
        "surface": int(water[SURFACE]),
        "floor": int(water[FLOOR]),
    }
    return Produced([photons, profile], facts, int(counts.sum()))


def _passes(
    args: Mapping[str, Any], context: Context
) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
    """Labels of a beam in the order of its file, a pass at a time: first photon, columns."""
    for first in range(0, args["points"], PASS_PHOTONS):
        n = min(PASS_PHOTONS, args["points"] - first)
        part: dict[str, NDArray[Any]] = {
            "along_track": np.full(n, np.nan),
            "height": np.full(n, np.nan),
            "signal": np.full(n, NOT_ASSESSED, np.uint8),
            "confidence": np.full(n, np.nan, np.float32),
            "water": np.zeros(n, np.uint8),
            REFRACTED: np.full(n, np.nan),
        }
        for segment, _, _ in args["segments"]:
            path = context.store.table("labels", segment)
            for rows in rows_between(path, tuple(LABELS), "row", first, first + n):
                at = rows["row"] - first
                part["along_track"][at] = rows["along"] / QUANTA_PER_M
                part["height"][at] = rows["height"] / QUANTA_PER_M
                part["signal"][at] = rows["signal"]
                off_nadir_deg = context.workflow.track.off_nadir_deg
                part["water"][at], up_m = _in_water(rows, off_nadir_deg)
                part[REFRACTED][at] = part["height"][at] + up_m
                part["confidence"][at] = -np.expm1(rows["score"])
        yield first, part


def _in_water(
    rows: Mapping[str, NDArray[Any]], off_nadir_deg: float
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Part of the water that photons lie in, 0 for none, and what refraction lifts them by [m]."""
    signal, level = rows["signal"] > 0, rows["level"].astype(np.int64)
    wet = level != NO_WATER
    depth_m = np.where(wet, (level - rows["height"]) / QUANTA_PER_M, 0.0)
    below = wet & (depth_m > SURFACE_M)
    kind = np.where(below, np.where(signal, FLOOR, COLUMN), 0)
    kind[wet & signal & (np.abs(depth_m) <= SURFACE_M)] = SURFACE
    return kind.astype(np.uint8), refracted(np.where(below, depth_m, 0.0), off_nadir_deg)


def deliver_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Write an HDF5 input again with the labels of its beams in it."""
    source = Path(args["path"])
    target = context.output / "hdf5" / args["delivered"]
    points = sum(beam["points"] for beam in args["beams"])
    with (
        unchanged(source, as_indexed("index_file", args, context)),
        labelled_copy(source, target) as file,
    ):
        for beam in args["beams"]:
            group = file[beam["group"]]
            made = {
                name: add_dataset(group, name, beam["points"], fill, {"description": text}, dtype)
                for name, (dtype, fill, text) in _DATASETS.items()
            }
            for first, part in _passes(beam, context):
                rows = slice(first, first + len(part["signal"]))
                made["spl_signal"][rows] = part["signal"]
                made["spl_confidence"][rows] = part["confidence"]
    return Produced([target], {"points": points}, points)
