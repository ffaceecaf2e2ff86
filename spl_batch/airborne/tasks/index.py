"""Stage ``index``: what is in each input file, its points by time; the trajectory in one piece."""

import hashlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.airborne.context import Context
from spl_batch.airborne.tasks.file_tally import (
    SPANS_FEW,
    Counted,
    facts_of,
    merge,
    observe,
    spans_of,
)
from spl_batch.airborne.tasks.stretches import KEPT_COLUMNS, add_points
from spl_batch.engine.findings import Finding
from spl_batch.engine.store.working_store import forget_receipt
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.errors import InputError, named
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.gps_clock import contradicted_bit
from spl_batch.formats.las.frame import Extent
from spl_batch.formats.las.layers import GIVEN, given_of
from spl_batch.formats.las.reader import (
    SAMPLE_POINTS,
    LasFacts,
    Numbers,
    inspect,
    iter_points,
    read_ends,
)
from spl_batch.formats.las.records import RecordLayout
from spl_batch.formats.trajectory.positions import PointExtent, gathering, write_trajectory
from spl_batch.formats.trajectory.records import Records
from spl_batch.formats.verified.parquet_npz import GroupWriter, read_arrays, write_arrays, writing
from spl_batch.lattice.tables import COLUMNS

POSITIONS_S = 64
"""Span of the trajectory that has one hash [s]: what reads of it is done again if that changes."""

CHUNK_POINTS = 1 << 18
"""Points read at once from an input file [count]."""

BOXES = "boxes"
"""Name of the array of a file's index with the box of each chunk [quanta]."""

PART_CHUNKS = 4
"""Chunks of a part of a file: several workers index a large one, a part each [count]."""


def parts_of(points: int) -> int:
    """Parts in which a file of so many points is indexed [count]."""
    return max(-(-points // (CHUNK_POINTS * PART_CHUNKS)), 1)


def part_range(points: int, part: int) -> tuple[int, int]:
    """First point of a part of a file, and the one after its last."""
    size = CHUNK_POINTS * PART_CHUNKS
    return part * size, min((part + 1) * size, points)


def part_name(source: str, part: int) -> str:
    """What the files of the store that hold a part of an input are called."""
    return f"{source}-{part}"


def index_part(args: Mapping[str, Any], context: Context) -> Produced:
    """Read a part of a file: prove that it is readable, find what is in it, keep it.

    What cannot be read is left to :func:`index_file`, which fails as a whole.
    """
    path, facts = Path(args["path"]), {"stamp": args["stamp"]}
    try:
        with unchanged(path, args["stamp"]):
            counted, outputs = _read(args, context, inspect(path), args["part"])
    except InputError as error:
        return Produced((), {**facts, "faults": error.faults})
    kept = _kept(args, context, args["part"])
    write_arrays(kept, counted)
    return Produced([kept, *outputs], facts, int(counted["counts"][0]))


def index_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Join what is known of the parts of a file, if all of them could be read."""
    path = Path(args["path"])
    with unchanged(path, args["stamp"]):
        for part in args["faults"]:  # the next run tries them again
            forget_receipt(context.store, "index_part", f"{args['source']}/{part}")
        if args["faults"]:
            faults = chain.from_iterable(args["faults"].values())
            raise InputError(str(path), [*dict.fromkeys(faults)])
        digest = checksum(path)
        header = inspect(path)
        counted, spans = merge([]), []
        for part in range(args["parts"]):
            arrays = read_arrays(_kept(args, context, part))
            # One by one: where times are in no order, each part has bins of all of them.
            counted = merge([counted, arrays])
            spans.append(spans_of(arrays))
    index = context.store.path("index", f"{args['source']}.npz")
    write_arrays(index, {k: v for k, v in counted.items() if k.startswith((BOXES, "extent/"))})
    known = facts_of(counted, context.workflow.survey.gap_s)
    clock = contradicted_bit(known["standard"], adjusted_bit=header.adjusted_standard_bit)
    findings = []
    if clock is not None:
        findings.append(Finding("I01", {"kind": "times", "stated": clock[0], "found": clock[1]}))
    facts = {
        "name": args["name"],
        "hash": digest,
        "size": args["stamp"][0],
        **known,
        "parts": spans,
        "numbers": _numbers(path, context),
        # What the header alone shows, the plan has reported.
        "findings": [*findings, *_without_time(known)],
    }
    inputs = {str(path): args["stamp"]}
    return Produced([index], facts, known["points"], inputs)


def _without_time(known: Mapping[str, Any]) -> list[Finding]:
    """That some points of a file have no usable time, if so and others have one."""
    if not known["timeless"] or not known["spans"]:
        return []
    why = "not finite, or beyond 1e10 s"
    if known["astray_s"]:
        first_s = known["astray_s"][0]
        why = (
            f"such as {first_s:.6g} s, more than a year from most"
            if first_s
            else "0 s, which is none"
        )
    if known["lone"]:
        why = f"scattered over more than {SPANS_FEW} times, with few points at each"
    count = int(known["timeless"])
    return [Finding("I02", {"kind": "points", "count": count, "what": why}, badness=count)]


def _numbers(path: Path, context: Context) -> dict[str, Numbers]:
    """Dimensions that may hold beamlet numbers, where the workflow names none."""
    if context.workflow.survey.channel_dimension is not None:
        return {}
    return read_ends(path, None, SAMPLE_POINTS).numbers


def _read(
    args: Mapping[str, Any], context: Context, header: LasFacts, part: int
) -> tuple[Counted, list[Path]]:
    """Read a part of a file, and keep its points and what delivery needs of the records.

    Gives what was counted, and the files that were written.
    """
    path, settings = Path(args["path"]), context.workflow.survey
    name, (start, stop) = part_name(args["source"], part), part_range(header.n_points, part)
    outputs = [context.store.path("points", f"{name}.parquet")]
    dtypes = {name: COLUMNS[name].dtype for name in KEPT_COLUMNS}
    chunks, extent = list[Counted](), Extent()
    with ExitStack() as stack:
        writer = stack.enter_context(writing(outputs[0], dtypes, sought=("gps_time",)))
        watch: Callable[[NDArray[Any], RecordLayout], None] | None = None
        if header.layers_can_be_copied:
            outputs.append(context.store.path("given", f"{name}.parquet"))
            beside = stack.enter_context(writing(outputs[1], {GIVEN: np.uint32}))
            watch = partial(_watch, extent, beside)
        for table in iter_points(
            path,
            channel_dimension=settings.channel_dimension,
            source=int(args["source"]),
            start=start,
            stop=stop,
            chunk=CHUNK_POINTS,
            watch=watch,
            units=context.units,
        ):
            chunks.append(observe(table, settings.gap_s))
            add_points(writer, table)
    return merge([extent.to_arrays(), *chunks]), outputs


def _watch(
    extent: Extent, beside: GroupWriter, records: NDArray[Any], layout: RecordLayout
) -> None:
    """Keep what delivery needs of records, in the order of the file."""
    extent.add(records)
    beside.write({GIVEN: given_of(records, layout)})


def _kept(args: Mapping[str, Any], context: Context, part: int) -> Path:
    """Where a part leaves what it has counted."""
    return context.store.path("index", f"{part_name(args['source'], part)}.npz")


def trajectory_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Prove that one file can be read and converted: else it fails alone, and others serve."""
    path = Path(args["path"])
    crs = context.workflow.survey.trajectory_crs
    with unchanged(path, args["stamp"]):
        check_file(path, context.crs, crs, context.store.local)
    return Produced((), {"name": path.name})


def check_file(
    path: Path, survey_crs: CRS | None, trajectory_crs: str | None, folder: Path | None = None
) -> int:
    """Records of a trajectory file, each time counted once, all of them read [count].

    Raises InputError if it cannot be used; ``folder``: where records wait for their place in time.
    """
    with gathering(
        [path], survey_crs=survey_crs, trajectory_crs=trajectory_crs, folder=folder
    ) as found:
        deque(found, maxlen=0)
    return found.records


def trajectory(args: Mapping[str, Any], context: Context) -> Produced:
    """Bring the trajectory into the survey's CRS and the points' time, in one file."""
    path, hashes = context.store.path("trajectory.parquet"), dict[int, Any]()
    with ExitStack() as stack:
        for name, stamp in zip(args["paths"], args["stamps"], strict=True):
            stack.enter_context(unchanged(Path(name), stamp))
        found = stack.enter_context(
            gathering(
                [Path(p) for p in args["paths"]],
                survey_crs=context.crs,
                trajectory_crs=context.workflow.survey.trajectory_crs,
                points=PointExtent(tuple(args["time_span_s"]), tuple(args["bounds_m"])),
                folder=context.store.local,
            )
        )
        write_trajectory(path, _hashed(found, hashes))
    facts = {
        "name": named([Path(p).name for p in args["paths"]], 3),
        "positions": {str(span): digest.hexdigest() for span, digest in hashes.items()},
        "findings": [
            *(Finding("T02", {"kind": "file", "what": text}) for text in found.warnings),
            *(Finding("E01", {"kind": "memory", "what": text}) for text in found.notes),
        ],
        "inputs": [{"path": p, "hash": checksum(Path(p))} for p in args["paths"]],
    }
    return Produced([path], facts)


def _hashed(records: Iterable[Records], hashes: dict[int, Any]) -> Iterator[Records]:
    """Records as they come; ``hashes``: gets one of the positions in each span that has some."""
    for time, xyz in records:
        span = np.floor_divide(time, POSITIONS_S).astype(np.int64)
        cuts = [0, *(np.flatnonzero(np.diff(span)) + 1).tolist(), len(span)]
        rows = np.column_stack([time, xyz])
        for a, b in pairwise(cuts):
            digest = hashes.setdefault(int(span[a]), hashlib.blake2b(digest_size=8))
            digest.update(rows[a:b].tobytes())
        yield time, xyz
