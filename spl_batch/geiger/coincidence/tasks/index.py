"""Stage ``index``: frames and detections into the working store.

Detections are sorted within each stretch of rows and found again by the frames of their row groups.
Files in the order of their frames, as sensors write them, are so in order as a whole.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.findings import Finding
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.tasks.context import Produced, RunContext
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.errors import InputError, counted
from spl_batch.formats.files.atomic import checksum
from spl_batch.geiger.coincidence.formats import l1_files, stored
from spl_batch.geiger.coincidence.settings import ArraySettings, CoincidenceWorkflow
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections, Frames

CoincidenceContext = RunContext[CoincidenceWorkflow]

FAR_OFF: Final = 2.0
"""Fields of view between a detection and its line of sight that are warned of [1/1]."""

SIGHT_FRAMES: Final = 64
"""Frames whose detections are compared with their lines of sight [count]."""


def frames_path(store: Store, key: str) -> Path:
    """Frames of an input file, in the working store."""
    return store.path("frames", f"{key}.parquet")


def detections_path(store: Store, key: str) -> Path:
    """Detections of an input file, in the working store."""
    return store.path("detections", f"{key}.parquet")


def index_frames(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a frames file and keep it with its attitudes as directions."""
    path, target = Path(args["path"]), frames_path(context.store, args["source"])
    with unchanged(path, args["stamp"]):
        frames = l1_files.read_frames(path)
        digest = checksum(path)
    stored.store(target, Frames, [frames])
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "frames": len(frames),
        "numbers": frames.number[[0, -1]].tolist() if len(frames) else [],
        # West, east, south, north.
        "places_m": [float(end(frames.origin_m[:, k])) for k in (0, 1) for end in (np.min, np.max)]
        if len(frames)
        else [],
        "reach_m": _reach_m(frames, context.workflow.array),
    }
    return Produced([target], facts, 0, {args["path"]: args["stamp"]})


def _reach_m(frames: Frames, array: ArraySettings) -> float:
    """How far sideways a look comes from its sensor, at most [m]."""
    if not len(frames):
        return 0.0
    # The array's axis and half a diagonal of its field of view.
    half = 0.5 * float(np.hypot(array.rows, array.columns)) * array.ifov_rad
    steepest = float(np.clip(frames.turn[:, 2, 2].min(), -1.0, 1.0))
    slant = float(np.arccos(steepest)) + half
    return float(array.gate_stop_m * np.sin(min(slant, 0.5 * np.pi)))


class _Seen(NamedTuple):
    """Facts of a stretch of detections."""

    points: int
    numbers: tuple[int, int]  #: First and last frame.
    #: (3,): smallest and largest coordinates [quanta].
    low: NDArray[np.int64]
    high: NDArray[np.int64]
    tiles: Counter[str]  #: Detections of each tile.
    unknown: int  #: Detections of frames that no frames file has [count].
    first_unknown: int


def index_file(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a detections file, keep it, and count its detections by tile."""
    path, target = Path(args["path"]), detections_path(context.store, args["source"])
    seen: list[_Seen] = []
    found: list[Finding] = []

    def counted_parts() -> Iterator[Detections]:
        for part in l1_files.read_detections(path, context.workflow.array):
            if not seen:
                found.extend(_sight_findings(args, context, part))
            seen.append(_see(part, args, context))
            yield part

    with unchanged(path, args["stamp"]):
        stored.store(target, Detections, counted_parts())
        digest = checksum(path)
    if any(one.unknown for one in seen):
        raise InputError(str(path), _reason(seen, args["unread_frames"]))
    tiles = sum((one.tiles for one in seen), Counter[str]())
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "points": sum(one.points for one in seen),
        "numbers": [min(s.numbers[0] for s in seen), max(s.numbers[1] for s in seen)]
        if seen
        else [],
        "bounds": [
            *np.min([one.low for one in seen], axis=0).tolist(),
            *np.max([one.high for one in seen], axis=0).tolist(),
        ]
        if seen
        else [],
        "tiles": dict(sorted(tiles.items())),
        "findings": found,
    }
    return Produced([target], facts, facts["points"], {args["path"]: args["stamp"]})


def _see(part: Detections, args: Mapping[str, Any], context: CoincidenceContext) -> _Seen:
    cells, count = np.unique(part.xyz[:, :2] // context.workflow.tile_q, axis=0, return_counts=True)
    numbers, in_frame = np.unique(part.frame, return_counts=True)
    known = np.zeros(len(numbers), np.bool_)
    for key in args["frames"]:
        known |= stored.known_frames(frames_path(context.store, key), numbers)
    return _Seen(
        len(part),
        (int(numbers[0]), int(numbers[-1])),
        part.xyz.min(axis=0),
        part.xyz.max(axis=0),
        Counter({f"{i}_{j}": n for (i, j), n in zip(cells.tolist(), count.tolist(), strict=True)}),
        int(in_frame[~known].sum()),
        int(numbers[~known][0]) if not known.all() else -1,
    )


def _reason(seen: list[_Seen], unread: list[str]) -> str:
    """Why detections cannot be used whose frames are not known."""
    found = counted(sum(one.unknown for one in seen), "detections", "are")
    first = min(one.first_unknown for one in seen if one.unknown)
    text = f"{found} of frames that no frames file has, the first is {first}; "
    if not unread:
        return f"{text}name the file with it in survey.frames"
    return (
        f"{text}{' and '.join(unread)} could not be read: mend that file, these detections are "
        "then taken in by the next run"
    )


def _sight_findings(
    args: Mapping[str, Any], context: CoincidenceContext, part: Detections
) -> Iterator[Finding]:
    """Warn where detections do not lie where their detectors look."""
    number = int(part.frame[len(part) // 2])
    paths = (frames_path(context.store, key) for key in args["frames"])
    frames = Frames.joined([stored.frames_around(path, number) for path in paths]).in_order()
    frames = frames.take(np.abs(frames.number - number) <= SIGHT_FRAMES // 2)
    off = coincide.sight_error(frames, part, context.workflow.array)
    if off >= FAR_OFF:
        yield Finding("K02", {"fields": off}, badness=off)
