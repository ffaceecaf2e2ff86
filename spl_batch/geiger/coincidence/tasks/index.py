"""Stage ``index``: frames and detections into the working store, in order, a part at a time."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

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
from spl_batch.geiger.coincidence.tables import Attitudes, Detections, Frames
from spl_batch.numerics.attitude import rotations

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
    path = Path(args["path"])
    target = frames_path(context.store, args["source"])
    tally = _FrameTally(context.workflow.array)
    with unchanged(path, args["stamp"]):
        found = l1_files.frames_in_order(path, context.store.local)
        stored.store_frames(target, map(tally.see, found))
        digest = checksum(path)
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "frames": tally.frames,
        "numbers": tally.numbers,
        "places_m": [*_ends(tally.low_m, tally.high_m, 0), *_ends(tally.low_m, tally.high_m, 1)]
        if tally.frames
        else [],
        "reach_m": tally.reach_m,
    }
    return Produced([target], facts, 0, {args["path"]: args["stamp"]})


class _FrameTally:
    """Facts of a file's frames, gathered part by part in their order."""

    def __init__(self, array: ArraySettings) -> None:
        self._array = array
        self.frames = 0
        self.numbers: list[int] = []
        self.low_m, self.high_m = np.full(3, np.inf), np.full(3, -np.inf)
        self._steepest = 1.0

    def see(self, part: Attitudes) -> Frames:
        """Count a part in; gives its frames with their directions."""
        heading, roll, pitch = part.attitude_rad.T
        frames = Frames(part.number, part.origin_m, rotations(heading, roll, pitch))
        self.frames += len(frames)
        self.numbers = _joined(self.numbers, part.number)
        self.low_m = np.minimum(self.low_m, part.origin_m.min(axis=0))
        self.high_m = np.maximum(self.high_m, part.origin_m.max(axis=0))
        self._steepest = min(self._steepest, float(frames.turn[:, 2, 2].min()))
        return frames

    @property
    def reach_m(self) -> float:
        """How far sideways a look comes from its sensor, at most [m]."""
        if not self.frames:
            return 0.0
        array = self._array
        # The array's axis and half a diagonal of its field of view.
        half = 0.5 * float(np.hypot(array.rows, array.columns)) * array.ifov_rad
        slant = float(np.arccos(np.clip(self._steepest, -1.0, 1.0))) + half
        return float(array.gate_stop_m * np.sin(min(slant, 0.5 * np.pi)))


def _joined(span: list[int], numbers: NDArray[np.int64]) -> list[int]:
    """First and last of all numbers so far, which increase."""
    return [span[0] if span else int(numbers[0]), int(numbers[-1])]


def _ends(low: NDArray[np.float64], high: NDArray[np.float64], axis: int) -> list[float]:
    """Smallest and largest coordinate."""
    return [float(low[axis]), float(high[axis])]


def index_file(args: Mapping[str, Any], context: CoincidenceContext) -> Produced:
    """Check a detections file, keep it in order, and count its detections by tile."""
    path, workflow = Path(args["path"]), context.workflow
    target = detections_path(context.store, args["source"])
    tally = _DetectionTally(args, context)
    with unchanged(path, args["stamp"]):
        rows = l1_files.inspect(path, l1_files.DETECTION_COLUMNS)
        tally.middle = rows // 2
        found = l1_files.detections_in_order(path, workflow.array, context.store.local)
        stored.store_detections(target, tally.checked(found))
        digest = checksum(path)
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        "points": tally.detections,
        "numbers": tally.numbers,
        "bounds": tally.bounds,
        "tiles": {f"{i}_{j}": n for (i, j), n in sorted(tally.tiles.items())},
        "findings": _sight_findings(args, context, target, tally.frame),
    }
    return Produced([target], facts, tally.detections, {args["path"]: args["stamp"]})


class _DetectionTally:
    """Facts of a file's detections, gathered part by part in their order."""

    def __init__(self, args: Mapping[str, Any], context: CoincidenceContext) -> None:
        self._args, self._context = args, context
        self.detections = self.middle = self.frame = 0
        self.numbers: list[int] = []
        self.bounds: list[int] = []
        self.tiles: dict[tuple[int, int], int] = {}
        self._unknown, self._first = 0, -1

    def checked(self, parts: Iterable[Detections]) -> Iterator[Detections]:
        """Parts as they come; once all have, frames are refused that are not known."""
        for part in parts:
            self._count(part)
            self._look_up(part)
            yield part
        if self._unknown:
            raise InputError(self._args["path"], self._reason())

    def _count(self, part: Detections) -> None:
        if self.detections <= self.middle < self.detections + len(part):
            self.frame = int(part.frame[self.middle - self.detections])
        self.detections += len(part)
        self.numbers = _joined(self.numbers, part.frame)
        low, high = part.xyz.min(axis=0), part.xyz.max(axis=0)
        if self.bounds:
            low, high = np.minimum(low, self.bounds[:3]), np.maximum(high, self.bounds[3:])
        self.bounds = [*low.tolist(), *high.tolist()]
        cells = part.xyz[:, :2] // self._context.workflow.tile_q
        found, count = np.unique(cells, axis=0, return_counts=True)
        for (i, j), n in zip(found.tolist(), count.tolist(), strict=True):
            self.tiles[i, j] = self.tiles.get((i, j), 0) + n

    def _look_up(self, part: Detections) -> None:
        numbers, count = np.unique(part.frame, return_counts=True)
        known = np.zeros(len(numbers), np.bool_)
        for key in self._args["frames"]:
            known |= stored.known_frames(frames_path(self._context.store, key), numbers)
        if not known.all():
            if not self._unknown:
                self._first = int(numbers[~known][0])
            self._unknown += int(count[~known].sum())

    def _reason(self) -> str:
        found = counted(self._unknown, "detections", "are")
        said = f"{found} of frames that no frames file has, the first is "
        unread = self._args["unread_frames"]
        if unread:
            return (
                f"{said}{self._first}; {' and '.join(unread)} could not be read: mend what its "
                "failure says, these detections are then taken in by the next run"
            )
        return f"{said}{self._first}; name the file with it in survey.frames"


def _sight_findings(
    args: Mapping[str, Any], context: CoincidenceContext, target: Path, number: int
) -> list[Finding]:
    """Warn where detections do not lie where their detectors look."""
    paths = (frames_path(context.store, key) for key in args["frames"])
    frames = Frames.joined([stored.frames_around(path, number) for path in paths])
    near = np.abs(frames.number - number) <= SIGHT_FRAMES // 2
    frames = frames.take(near)
    detections = stored.stored_detections(target, frames.number)
    off = coincide.sight_error(frames, detections, context.workflow.array)
    if off < FAR_OFF:
        return []
    return [Finding("K02", {"fields": float(off)}, badness=float(off))]
