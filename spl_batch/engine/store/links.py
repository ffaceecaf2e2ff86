"""One store's files in another: hard links where the file system has them, else copies.

Files of a store are only renamed into place, never written there: replacing one side of a link does
not touch the other.
"""

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from spl_batch.engine.store.working_store import Store, forget_receipt, read_receipt, read_receipts
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.files.atomic import replacing, size
from spl_batch.formats.files.remote import copy_object, is_remote


def share_finished(source: Store, target: Store, kinds: Iterable[str]) -> int:
    """Make what one store has finished of some kinds of task known to another: count of tasks."""
    shared = 0
    for kind in kinds:
        for receipt in read_receipts(source, kind):
            if not receipt.failed and read_receipt(target, kind, receipt.name) != receipt:
                _share(source, target, receipt)
                shared += 1
    return shared


def _share(source: Store, target: Store, receipt: Receipt) -> None:
    """Outputs first, the receipt last: until then nothing vouches for them."""
    forget_receipt(target, receipt.kind, receipt.name)
    paths = [source.named(name) for name in receipt.outputs]
    if any(size(path) < 0 for path in paths):
        return
    for path, name in zip(paths, receipt.outputs, strict=True):
        _place(path, target.named(name))
    _place(source.receipt(receipt.kind, receipt.name), target.receipt(receipt.kind, receipt.name))


def _place(path: Path, name: Path) -> None:
    if is_remote(path):
        copy_object(path, name)
        return
    with replacing(name, durable=False) as temporary:
        if path.is_dir():
            shutil.copytree(path, temporary, copy_function=_link)
        else:
            _link(path, temporary)


def _link(path: str | Path, name: str | Path) -> None:
    try:
        os.link(path, name)
    except OSError:
        # Another file system, or one without links; a full disk shows itself here again.
        shutil.copy2(path, name)
