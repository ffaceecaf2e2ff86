"""Owner of an output folder: a run writes only where nothing of somebody else's can be lost.

An output belongs to the survey that the last run there worked on. Two runs work on the same survey
if they have an input in common: a file at the same path, or one anywhere of the same size that
begins alike. The name does not count: names are copied with workflows.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import REPORT_FILES
from spl_batch.engine.store.deliveries import RECORD, Deliveries
from spl_batch.engine.store.output_lock import refuse_lost, refuse_unwritable
from spl_batch.engine.store.store_owner import refuse_claimed
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.errors import WorkflowError, named

_HEAD_BYTES: Final = 1 << 16
"""Bytes at the beginning of an input that tell it from others of its size [byte]."""

_NO_DATA: Final = frozenset(
    {"reference", "checkpoints", "aoi", "water", "breaklines", "geoid", "trajectory"}
)
"""Roles of files that several surveys may share."""

Input = tuple[str, int, str]
"""Path of an input, its size [byte] and a hash of its first bytes; -1 and empty if unknown."""


def usable(prepared: Prepared[Any, Any]) -> Deliveries:
    """What earlier runs have left in the output folder of a run that may work there.

    Everything for which a run refuses its output is found here, so that a plan refuses the same.

    Raises
    ------
    WorkflowError
        If nothing can be written there, or something of somebody else's could be lost.
    StoppedError
        If the disk is full, or a store elsewhere cannot be reached.
    """
    context = prepared.context
    refuse_unwritable(context.output)
    refuse_lost(context.output, f"output: {context.output}", context.base)
    refuse_claimed(context.store)
    deliveries = Deliveries(context)
    refuse_foreign(prepared, deliveries)
    return deliveries


def refuse_foreign(prepared: Prepared[Any, Any], deliveries: Deliveries) -> None:
    """Refuse an output folder in which a run could replace what is not its own.

    ``deliveries``: what earlier runs have left in it.

    Raises
    ------
    WorkflowError
        If another survey's results are there, or files that no run has recorded.
    """
    output = prepared.context.output
    if not output.is_dir():
        return
    survey = deliveries.survey or _reported(output)
    if survey is None:
        _refuse_unknown(prepared, deliveries)
    elif _something_there(output, deliveries) and not _in_common(survey["inputs"], prepared):
        inputs = [Path(path).name for path, *_ in survey["inputs"]]
        raise WorkflowError(
            f"output: {output} holds the results of another survey, {survey['name']!r}, made of "
            f"{named(inputs, 2)}, no input of this one; name another output, or delete that folder"
        )


def this_survey(prepared: Prepared[Any, Any]) -> dict[str, Any]:
    """Name and inputs of a run's survey, to be recorded in its output."""
    inputs = [[str(path), *_head(path)] for path in _paths(prepared)]
    return {"name": _name(prepared), "inputs": inputs}


def gone_inputs(prepared: Prepared[Any, Any], deliveries: Deliveries) -> Iterator[Finding]:
    """Say which inputs of the run before are not among this one's; their results go."""
    if deliveries.survey is None:
        return
    # By their names alone, as a survey may have been moved.
    here = {path.name for path in _paths(prepared)}
    gone = [path for path, *_ in deliveries.survey["inputs"] if Path(path).name not in here]
    if gone and len(gone) < len(deliveries.survey["inputs"]):
        yield Finding("E01", {"kind": "gone", "files": [Path(p).name for p in gone]})


def _name(prepared: Prepared[Any, Any]) -> str:
    content = prepared.context.workflow.model_dump(mode="json")
    sections = (value for value in content.values() if isinstance(value, dict))
    return next((str(s["name"]) for s in sections if "name" in s), "survey")


def _paths(prepared: Prepared[Any, Any]) -> list[Path]:
    """Every input that the workflow names, those that cannot be used included."""
    inputs = prepared.ledger.inputs
    found = [source.path for source in inputs.sources]
    found += [Path(bad.path) for bad in inputs.bad]
    return sorted(dict.fromkeys(found))


def _head(path: Path) -> tuple[int, str]:
    """Size of an input [byte] and a hash of how it begins; of a folder, of the names in it."""
    try:
        if path.is_dir():
            files = sorted(p for p in path.rglob("*") if p.is_file())
            sizes = [(p.relative_to(path).as_posix(), p.stat().st_size) for p in files]
            content, size = json.dumps(sizes).encode(), sum(n for _, n in sizes)
        elif not path.is_file():  # missing, or a pipe, which would wait for its other end
            return -1, ""
        else:
            size = path.stat().st_size
            with path.open("rb") as stream:
                content = stream.read(_HEAD_BYTES)
    except OSError:  # it cannot be read, which the run says of it
        return -1, ""
    return size, hashlib.blake2b(content, digest_size=16).hexdigest()


def _in_common(earlier: Iterable[Sequence[Any]], prepared: Prepared[Any, Any]) -> bool:
    """Whether an input of an earlier run is one of this run's."""
    known: list[Input] = [(str(path), int(size), str(head)) for path, size, head in earlier]
    here = _paths(prepared)
    if {path for path, _, _ in known} & {str(path) for path in here}:
        return True
    for path in here:
        size, head = _head(path)
        for other, its_size, its_head in known:
            alike = its_head == head if its_head else Path(other).name == path.name
            if size >= 0 and size == its_size and alike:
                return True
    return False


def _reported(output: Path) -> dict[str, Any] | None:
    """Survey of the report in an output; None where there is none of ours."""
    try:
        report = json.loads((output / REPORT_FILES[0]).read_bytes())
        inputs = report["provenance"]["inputs"]
        data = [f for f in inputs if f["role"] not in _NO_DATA]
        content = report["provenance"]["parameters"]
        name = next(v["name"] for v in content.values() if isinstance(v, dict) and "name" in v)
        return {"name": name, "inputs": [(f["path"], f["size"], "") for f in data]}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, StopIteration):
        return None


def _something_there(output: Path, deliveries: Deliveries) -> bool:
    """Whether anything of the earlier runs is left that could be lost.

    Finished tasks count as well as results: a run that was stopped early has delivered nothing.
    """
    names = [*REPORT_FILES, *deliveries.files, *deliveries.begun, "store/receipts"]
    return any((output / name).exists() for name in names)


def _refuse_unknown(prepared: Prepared[Any, Any], deliveries: Deliveries) -> None:
    """Refuse files that have names of results where no run has recorded any."""
    output = prepared.context.output
    found = [
        path.relative_to(output).as_posix()
        for pattern in (*prepared.receiver.delivered, *REPORT_FILES)
        for path in sorted(output.glob(pattern))
        if path.is_file()
    ]
    unknown = [name for name in found if name not in deliveries.files]
    store = output / "store"
    own = any((store / name).exists() for name in ("lock", "receipts"))
    here = prepared.context.store.url is None  # one that lies elsewhere has a mark of its own
    if here and store.is_dir() and not own and any(store.iterdir()):
        unknown.append("store/")
    if unknown:
        raise WorkflowError(
            f"output: {output} holds {named(unknown, 3)}, and no run has recorded there ({RECORD}) "
            "that it wrote them; name another output, or move them away"
        )
