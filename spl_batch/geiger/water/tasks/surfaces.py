"""Tasks of the water surface: count frames, calibrate, make surfaces."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
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
    FloorError,
    PixelSums,
    floor_error,
    middle,
    surface_error,
)
from spl_batch.geiger.water.formats import FrameTruth, inspect_frames, iter_frames, read_truth
from spl_batch.geiger.water.pixel_geometry import View, view_of
from spl_batch.geiger.water.ranges.bin_sums import add_histogram
from spl_batch.geiger.water.ranges.calibration import Calibration, faults_of, fit, observation
from spl_batch.geiger.water.ranges.hits import (
    Gate,
    Hits,
    add_up,
    dead_pixels,
    find_gate,
    used_pixels,
)
from spl_batch.geiger.water.ranges.silence import too_many_empty
from spl_batch.geiger.water.settings import CalibrationSettings, WaterWorkflow
from spl_batch.geiger.water.surface.pixel_surface import Surface, make_surface

WaterContext = RunContext[WaterWorkflow]


@dataclass(frozen=True, slots=True)
class Counted:
    """What a file of frames adds up to."""

    histogram: NDArray[np.int64]  #: (bins + 1,): hits of each bin.
    silent: int  #: Frames without a hit [count].
    lit: int  #: Hits of all pixels, used or not [count].
    whole: Hits  #: Sums within its gate.


def read_through(path: Path, frames: int, workflow: WaterWorkflow, *, target: bool) -> Counted:
    """Read a file from end to end, which no look at its header can stand for.

    ``path``: file of ``frames`` frames. ``target``: whether it is for calibration.

    Raises
    ------
    InputError
        If a part of it cannot be read, a value is no bin of the camera, or no pixel has a hit.
    """
    camera = workflow.camera
    used = used_pixels(camera)
    # A target stands at a distance of its own: its gate is where its peak is.
    settings = workflow.gate.model_copy(update={"centre_bin": None}) if target else workflow.gate
    counts = np.zeros(camera.bins + 1, dtype=np.int64)
    silent = hits = 0
    for _, piece in iter_frames(path, 0, frames, camera.bins):
        add_histogram(piece, used, counts)
        lit = np.count_nonzero(piece, axis=(1, 2))
        silent += int(np.count_nonzero(lit == 0))
        hits += int(lit.sum())
    gate = find_gate(counts, settings)
    if gate is None:
        raise InputError(str(path), "no pixel has a hit in any frame; leave the file out")
    (whole,) = _add_up(path, (0, frames), frames, gate, camera.bins)
    return Counted(counts, silent, hits, whole)


def count_frames(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Read a file once from end to end: its histogram, its gate, what its pixels add up to."""
    workflow, path = context.workflow, Path(args["path"])
    camera = workflow.camera
    with unchanged(path, args["stamp"]):
        digest = checksum(path)
        inspect_frames(path, camera.rows, camera.cols)
        found = read_through(path, args["frames"], workflow, target=args["role"] == "target")
    whole, gate = found.whole, found.whole.gate
    out = context.store.path("counts", f"{args['source']}.npz")
    sums = {k: getattr(whole, k) for k in ("hits", "total", "square", "outside")}
    write_arrays(out, {"histogram": found.histogram, **sums})
    facts = {
        "name": args["name"],
        "role": args["role"],
        "path": str(path),
        "hash": digest,
        "size": args["stamp"][0],
        "frames": whole.frames,
        "gate": [gate.low, gate.high],
        "hits": int(whole.hits.sum()),
        "outside": int(whole.outside[used_pixels(camera)].sum()),
        "silent": found.silent,
        "silent_beyond_chance": too_many_empty(found.silent, args["frames"], found.lit),
    }
    return Produced([out], facts, args["frames"], {str(path): args["stamp"]})


def _add_up(path: Path, frames: tuple[int, int], per: int, gate: Gate, bins: int) -> Iterator[Hits]:
    """What each acquisition of ``per`` frames adds up to; their number is a multiple of it."""
    whole: Hits | None = None
    for start, piece in iter_frames(path, *frames, bins):
        first = start
        while first < start + len(piece):
            last = min((first // per + 1) * per, start + len(piece))
            made = add_up(piece[first - start : last - start], gate)
            whole = made if whole is None else _together(whole, made)
            if last % per == 0:
                yield whole
                whole = None
            first = last


def _together(a: Hits, b: Hits) -> Hits:
    return Hits(
        a.frames + b.frames,
        a.gate,
        a.hits + b.hits,
        a.total + b.total,
        a.square + b.square,
        a.outside + b.outside,
    )


def _counted(args: Mapping[str, Any], context: WaterContext) -> Hits:
    """What :func:`count_frames` left of a file."""
    sums = read_arrays(context.store.path("counts", f"{args['source']}.npz"))
    low, high = args["gate"]
    parts = (sums[k] for k in ("hits", "total", "square", "outside"))
    return Hits(args["frames"], Gate(low, high), *parts)


def calibrated(
    counted: Sequence[Hits], distances_m: Sequence[float], workflow: WaterWorkflow
) -> tuple[Calibration, NDArray[np.bool_]]:
    """Laws fitted to frames of targets, or as the workflow gives them; and dead pixels.

    Raises
    ------
    InputError
        If the targets do not tell the laws.
    """
    camera, settings = workflow.camera, workflow.calibration
    used = used_pixels(camera)
    whole = counted[0]
    for more in counted[1:]:
        whole = _together(whole, more)
    dead = dead_pixels(whole, used, workflow.pixels)
    if not distances_m:
        return Calibration(settings, np.zeros(used.shape)), dead
    norm = view_of(camera, workflow.mount).norm
    seen = [
        observation(hits, dead, norm, distance, camera.bin_ns)
        for hits, distance in zip(counted, distances_m, strict=True)
    ]
    faults = faults_of(seen, settings)
    if faults:
        raise InputError("calibration", faults)
    return fit(seen, settings), dead


def calibrate(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Find dead pixels, and fit the laws from frames of a target where there are some."""
    workflow = context.workflow
    used = used_pixels(workflow.camera)
    counted = [_counted(source, context) for source in args["sources"]]
    made, dead = calibrated(counted, args["distances_m"], workflow)
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


def _calibration(
    args: Mapping[str, Any], context: WaterContext
) -> tuple[Calibration, NDArray[np.bool_]]:
    arrays = read_arrays(context.store.path("calibration.npz"))
    settings = CalibrationSettings.model_validate(args["calibration"])
    return Calibration(settings, arrays["pixel_ns"], args["residual_ns"]), arrays["dead"]


def make_surfaces(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Surfaces of some acquisitions of a file, and their errors where truth is known."""
    workflow, path = context.workflow, Path(args["path"])
    camera = workflow.camera
    view = view_of(camera, workflow.mount)
    calibration, dead = _calibration(args, context)
    gate, per = Gate(*args["gate"]), workflow.surface.frames_per_acquisition
    first, last = args["acquisitions"]
    with unchanged(path, args["stamp"]):
        surfaces = [
            make_surface(hits, dead, calibration, view, camera, workflow.pixels, workflow.surface)
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
    """Errors of each surface (a, 6), of each pixel, and of the ends of rays (a, 6)."""
    sums = PixelSums.empty(view.x.shape)
    rows, floors = [], []
    block = middle(view.x.shape, workflow.path.beam_pixels)
    for k, surface in enumerate(surfaces):
        down, normals = truth.down_m[k], truth.normals[k]
        made, error, angle = surface_error(surface.places_m, surface.normals, down, normals)
        sums.add(error, angle)
        rows.append(list(asdict(made).values()))
        true_range = (down - view.origin_m[2]) / view.look[..., 2]
        floor = None
        if workflow.path.in_water_m > 0:
            floor = floor_error(
                view.look[block],
                (surface.places_m[block], surface.normals[block]),
                (view.places(true_range)[block], normals[block]),
                workflow.path.in_water_m,
                workflow.path.index_water,
            )
        floors.append(list(asdict(floor or FloorError(*(float("nan"),) * 6)).values()))
    pixels = {f"pixel_{k}": v for k, v in asdict(sums).items()}
    return {"errors": np.array(rows), "floor": np.array(floors), **pixels}
