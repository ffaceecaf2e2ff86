"""Take away what earlier runs delivered and this one does not vouch for."""

import json
from collections.abc import Iterable
from pathlib import Path

from spl_batch.io.atomic import write_bytes
from spl_batch.plan.survey import Survey

KINDS = ("deliver_file", "deliver_tile", "mosaic")
"""Kinds of tasks whose outputs a user sees."""


def withdraw_stale(survey: Survey, output: Path) -> list[str]:
    """Unlink files that an earlier run delivered and that no finished task of this one wrote.

    A file of an input that is gone, or can no longer be read, would pass for a result.

    Parameters
    ----------
    survey : Survey
        With the deliver stage behind it.
    output : Path
        Folder of the results.

    Returns
    -------
    list of str
        What was taken away, relative to ``output``.
    """
    manifest = output / "store" / "delivered.json"
    current = sorted(
        {path for kind in KINDS for receipt in survey.of(kind).values() for path in receipt.outputs}
    )
    stale = [path for path in _read(manifest) if path not in set(current)]
    for path in stale:
        (output / path).unlink(missing_ok=True)
    write_bytes(manifest, json.dumps(current).encode())
    return stale


def _read(manifest: Path) -> Iterable[str]:
    if not manifest.exists():
        return []
    content: list[str] = json.loads(manifest.read_bytes())
    return content
