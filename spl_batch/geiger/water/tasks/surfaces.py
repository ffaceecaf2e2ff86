"""Tasks of the water surface: count frames, calibrate, make surfaces."""

from collections.abc import Iterator, Mapping
from dataclasses import astuple
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.tasks.context import Produced, RunContext
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.errors import InputError
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.geiger.water.accuracy import (
    PIXEL_SUMS,
    floor_error,
    middle,
    pixel_sums,
    surface_error,
)
from spl_batch.geiger.water.formats import FrameTruth, inspect_frames, iter_frames, read_truth
from spl_batch.geiger.water.pixel_geometry import View, view_of
from spl_batch.geiger.water.ranges import (
    SUMS,
    Calibration,
    Gate,
    Hits,
    add_up,
    dead_pixels,
    faults_of,
    find_gate,
    fit,
    histogram,
    observation,
    used_pixels,
)
from spl_batch.geiger.water.settings import CalibrationSettings, WaterWorkflow
from spl_batch.geiger.water.surface import Surface, make_surface

WaterContext = RunContext[WaterWorkflow]


def count_frames(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Read a file once from end to end: its histogram, its gate, what its pixels add up to."""
    workflow, path, frames = context.workflow, Path(args["path"]), int(args["frames"])
    camera, used = workflow.camera, used_pixels(workflow.camera)
    with unchanged(path, args["stamp"]):
        digest = checksum(path)
        inspect_frames(path, camera.rows, camera.cols)
        counts = np.zeros(camera.bins + 1, dtype=np.int64)
        for _, piece in iter_frames(path, 0, frames, camera.bins):
            counts += histogram(piece, used, camera.bins)
        # A target stands at a distance of its own: its gate is where its peak is.
        given = {"centre_bin": None} if args["role"] == "target" else {}
        gate = find_gate(counts, workflow.gate.model_copy(update=given))
        if gate is None:
            raise InputError(str(path), "no pixel has a hit in any frame; leave the file out")
        (whole,) = _add_up(path, (0, frames), frames, gate, camera.bins)
    out = context.store.path("counts", f"{args['source']}.npz")
    write_arrays(out, {"histogram": counts, **{k: getattr(whole, k) for k in SUMS}})
    facts = {
        "name": args["name"],
        "role": args["role"],
        "path": str(path),
        "hash": digest,
        "size": args["stamp"][0],
        "frames": frames,
        "gate": [gate.low, gate.high],
        "hits": int(whole.hits.sum()),
        "outside": int(whole.outside[used].sum()),
    }
    return Produced([out], facts, frames, {str(path): args["stamp"]})


def _add_up(path: Path, frames: tuple[int, int], per: int, gate: Gate, bins: int) -> Iterator[Hits]:
    """What each acquisition of ``per`` frames adds up to; their number is a multiple of it."""
    parts: list[Hits] = []
    for start, piece in iter_frames(path, *frames, bins):
        first = start
        while first < start + len(piece):
            last = min((first // per + 1) * per, start + len(piece))
            parts.append(add_up(piece[first - start : last - start], gate))
            if last % per == 0:
                yield reduce(add, parts)
                parts = []
            first = last


def calibrate(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Find dead pixels, and fit the laws from frames of targets where there are some."""
    workflow, camera = context.workflow, context.workflow.camera
    used, counted = used_pixels(camera), []
    for source in args["sources"]:
        sums = read_arrays(context.store.path("counts", f"{source['source']}.npz"))
        gate = Gate(*source["gate"])
        counted.append(Hits(source["frames"], gate, *(sums[k] for k in SUMS)))
    dead = dead_pixels(reduce(add, counted), used, workflow.pixels)
    made = Calibration(workflow.calibration, np.zeros(used.shape))
    if args["distances_m"]:
        norm = view_of(camera, workflow.mount).norm
        seen = [
            observation(hits, dead, norm, distance, camera.bin_ns)
            for hits, distance in zip(counted, args["distances_m"], strict=True)
        ]
        if faults := faults_of(seen, workflow.calibration):
            raise InputError("calibration", faults)
        made = fit(seen, workflow.calibration)
    out = context.store.path("calibration.npz")
    write_arrays(out, {"pixel_ns": made.pixel_ns, "dead": dead})
    facts = {
        "settings": made.settings.model_dump(mode="json", exclude={"frames"}),
        "residual_ns": made.residual_ns,
        "dead": int((dead & used).sum()),
        "used": int(used.sum()),
        "fitted": bool(args["distances_m"]),
    }
    return Produced([out], facts)


def make_surfaces(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Surfaces of some acquisitions of a file, and their errors where truth is known."""
    workflow, path = context.workflow, Path(args["path"])
    camera = workflow.camera
    view = view_of(camera, workflow.mount)
    fitted = read_arrays(context.store.path("calibration.npz"))
    settings = CalibrationSettings.model_validate(args["calibration"])
    calibration = Calibration(settings, fitted["pixel_ns"], args["residual_ns"])
    gate, per = Gate(*args["gate"]), workflow.surface.frames_per_acquisition
    first, last = args["acquisitions"]
    with unchanged(path, args["stamp"]):
        surfaces = [
            make_surface(
                hits, fitted["dead"], calibration, view, camera, workflow.pixels, workflow.surface
            )
            for hits in _add_up(path, (first * per, last * per), per, gate, camera.bins)
        ]
        truth = _truth(args, context, view, path)
    out = context.store.path("surfaces", f"{args['name']}.npz")
    arrays: dict[str, NDArray[Any]] = {
        "places_m": np.stack([s.places_m for s in surfaces]),
        "normals": np.stack([s.normals for s in surfaces]).astype(np.float32),
        "range_m": np.stack([s.range_m for s in surfaces]),
        "intensity": np.stack([s.intensity for s in surfaces]).astype(np.float32),
        "half_windows": np.stack([s.half_windows for s in surfaces]).astype(np.int16),
    }
    write_arrays(out, arrays)
    outputs = [out]
    if truth is not None:
        outputs.append(context.store.path("errors", f"{args['name']}.npz"))
        write_arrays(outputs[1], _errors(surfaces, truth, view, workflow))
    known = int(np.isfinite(arrays["places_m"][..., 2]).sum())
    facts = {"acquisitions": last - first, "known": known, "truth": truth is not None}
    return Produced(outputs, facts, (last - first) * per)


def _truth(
    args: Mapping[str, Any], context: WaterContext, view: View, path: Path
) -> FrameTruth | None:
    """Truth beside the frames, or the level surface that the workflow names; None without both."""
    workflow = context.workflow
    first, last = args["acquisitions"]
    if args["truth_frames"] == workflow.surface.frames_per_acquisition:
        return read_truth(path, first, last)
    if workflow.level is None:
        return None
    shape = last - first, *view.x.shape
    up = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (*shape, 3))
    return FrameTruth(np.full(shape, workflow.level.down_m), up)


def _errors(
    surfaces: list[Surface], truth: FrameTruth, view: View, workflow: WaterWorkflow
) -> dict[str, NDArray[Any]]:
    """Errors of each surface and of the ends of its rays (a, 6); sums of the pixels' errors."""
    rows, floors = [], []
    sums = np.zeros((len(PIXEL_SUMS), *view.x.shape))
    block = middle(view.x.shape, workflow.path.beam_pixels)
    for surface, down, normals in zip(surfaces, truth.down_m, truth.normals, strict=True):
        made, error, angle = surface_error(surface.places_m, surface.normals, down, normals)
        sums += pixel_sums(error, angle)
        rows.append(astuple(made))
        true = view.places((down - view.origin_m[2]) / view.look[..., 2])
        floor = floor_error(
            view.look[block],
            (surface.places_m[block], surface.normals[block]),
            (true[block], normals[block]),
            workflow.path.in_water_m,
            workflow.path.index_water,
        )
        floors.append(astuple(floor))
    return {"errors": np.array(rows), "floor": np.array(floors), "pixels": sums}
