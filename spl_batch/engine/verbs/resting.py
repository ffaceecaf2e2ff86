"""A finished run since which nothing has changed: known by stamps, without a look at its receipts.

A survey has a receipt for each tile and step; to look at each takes minutes on a million tiles. So
a run that has finished everything records what decides its results, the times of its inputs, of
what it has delivered and of the folders of its store. A later one that finds them as they were has
nothing to do. Of a file that was altered within the store who reads it says so, or ``--verify``.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.report.run_record import REPORT_FILES, report_code
from spl_batch.engine.store.deliveries import Deliveries
from spl_batch.engine.store.working_store import read_json, write_json
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.runner import RASTER
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.errors import DamagedError
from spl_batch.formats.files.atomic import remove

REST: Final = "rest.json"
"""File beside the receipts that records the state of a finished run."""


def rest(prepared: Prepared[Any, Any], deliveries: Deliveries) -> None:
    """Record that everything is finished."""
    store = prepared.context.store
    if store.url is not None:  # folders elsewhere have no times
        return
    below = (place for place, _, _ in os.walk(store.local))
    folders = sorted({str(Path(place).relative_to(store.local)) for place in below} - {"."})
    content = {"folders": folders, "state": _state(prepared, deliveries, folders)}
    write_json(store.local / REST, content)


def stir(prepared: Prepared[Any, Any]) -> None:
    """Forget that everything is finished: it may not be from here on."""
    remove(prepared.context.store.local / REST)


def at_rest(prepared: Prepared[Any, Any], deliveries: Deliveries) -> bool:
    """Whether everything is finished and as it was then."""
    try:
        kept = read_json(prepared.context.store.local / REST)
    except DamagedError:  # none, or none to be trusted: receipts tell
        return False
    return bool(kept["state"] == _state(prepared, deliveries, kept["folders"]))


def _state(prepared: Prepared[Any, Any], deliveries: Deliveries, folders: Iterable[str]) -> str:
    """Hash of what decides the results, and of the times of what is there."""
    context, ledger = prepared.context, prepared.ledger
    inputs = [*(source.path for source in ledger.inputs.sources)]
    inputs += [Path(bad.path) for bad in ledger.inputs.bad]
    # Rasters tell nobody that they are damaged.
    rasters = sorted(context.store.local.glob(f"*{RASTER}"))
    reports = (context.output / name for name in REPORT_FILES)
    parts = [
        context.workflow.model_dump(mode="json"),
        *(context.crs_wkt, context.code, report_code(context.workflow.kind)),
        ledger.memory_bytes,
        prepared.receiver.decisive(prepared),
        [[str(path), *stamp_if_there(path)] for path in (*inputs, *reports, *rasters)],
        sorted(deliveries.begun),
        [[name, *stamp_if_there(context.output / name)] for name in sorted(deliveries.files)],
        [_written_ns(context.store.local / name) for name in folders],
    ]
    return hashlib.blake2b(json.dumps(parts, sort_keys=True).encode(), digest_size=16).hexdigest()


def _written_ns(folder: Path) -> int:
    """When a folder has got or lost a name [ns since 1970]; 0 without it."""
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0
