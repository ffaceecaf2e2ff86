"""The working store: where things lie, and the receipts of what is finished.

What receivers put there is described in ``docs/formats.md``. ::

    store/receipts/KIND/NAME.json      what is done, what failed and why

Always on the file system, wherever the store lies::

    store/lock                         held by the run at work
    store/run.json                     what the report is written from
    store/rest.json                    the state of a finished run
"""

import dataclasses
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import DamagedError, StoppedError, reason_of
from spl_batch.formats.files.atomic import (
    json_digest,
    names_in,
    read_bytes,
    remove,
    sync_folder,
    write_bytes,
)
from spl_batch.formats.files.remote import is_remote, remote_path

_DIGEST: Final = "blake2b"


@dataclasses.dataclass(frozen=True, slots=True)
class Store:
    """Names of everything below ``output``."""

    output: Path
    url: str | None = None  #: Where the working store lies, for fsspec; None for ``output/store``.

    @property
    def root(self) -> Path:
        """The working store."""
        return remote_path(self.url) if self.url else self.local

    @property
    def local(self) -> Path:
        """What client and workers see beside the results, wherever the store lies."""
        return self.output / "store"

    def path(self, *parts: str) -> Path:
        """Path below the working store."""
        return self.root.joinpath(*parts)

    def table(self, kind: str, name: str) -> Path:
        """A table of some kind, such as the points or the labels of a work unit."""
        return self.path(kind, f"{name}.parquet")

    def name_of(self, path: Path | str) -> str:
        """What receipts call a file of the store or of the output folder."""
        below = str(path).removeprefix(f"{self.root}/")
        if below != str(path):
            return f"store/{below}"
        name = os.path.relpath(path, self.output)
        return f"./{name}" if name.startswith("store/") else name

    def named(self, name: str) -> Path:
        """File that receipts call so."""
        if name.startswith("store/"):
            return self.root.joinpath(*name.split("/")[1:])
        return self.output / name

    def clear(self) -> None:
        """Forget everything that is finished; what was delivered stays known."""
        for path in self.local.iterdir():
            if path.name != "lock":
                remove(path)
        if self.url:
            remove(self.root)

    def receipt(self, kind: str, name: str) -> Path:
        """Receipt of a task."""
        return self.path("receipts", kind, f"{name.replace('/', '~')}.json")


def write_json(path: Path, content: Mapping[str, Any], *, durable: bool = True) -> None:
    """Write plain JSON values with a hash of themselves, atomically."""
    whole = {**content, _DIGEST: json_digest(content)}
    text = json.dumps(whole, sort_keys=True, allow_nan=False)
    write_bytes(path, text.encode(), durable=durable)


def read_json(path: Path) -> dict[str, Any]:
    """What :func:`write_json` wrote.

    Raises
    ------
    DamagedError
        If it is missing or not what was written.
    """
    try:
        content: dict[str, Any] = json.loads(read_bytes(path))
        sound = content.pop(_DIGEST) == json_digest(content)
    except OSError as error:
        raise DamagedError(path, error) from error
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise DamagedError(path, "it is not what was written") from error
    if not sound:
        raise DamagedError(path, "it does not fit its hash")
    return content


def write_receipt(store: Store, receipt: Receipt) -> None:
    """Leave a receipt; the last thing that a task does."""
    path = store.receipt(receipt.kind, receipt.name)
    content = {field.name: getattr(receipt, field.name) for field in dataclasses.fields(receipt)}
    write_json(path, content, durable=False)


def forget_receipt(store: Store, kind: str, name: str) -> None:
    """Take a receipt away, so that nothing vouches for outputs about to be overwritten."""
    path = store.receipt(kind, name)
    if is_remote(path) or path.exists():
        remove(path)
        sync_folder(path.parent)


def read_receipt(store: Store, kind: str, name: str) -> Receipt | None:
    """Read a task's receipt; None when there is none or it cannot be trusted."""
    try:
        return Receipt(**read_json(store.receipt(kind, name)))
    except (DamagedError, TypeError):
        return None


def read_receipts(store: Store, kind: str) -> Iterator[Receipt]:
    """All receipts of one kind, by name."""
    names = names_in(store.path("receipts", kind), ".json")
    made = (read_receipt(store, kind, name.replace("~", "/")) for name in names)
    return (receipt for receipt in made if receipt is not None)


def append_log(output: Path, event: Mapping[str, Any]) -> None:
    """Add one line to ``log.jsonl``; StoppedError if it cannot be written."""
    path = output / "log.jsonl"
    try:
        with path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(event, allow_nan=False) + "\n")
    except OSError as error:
        raise StoppedError(f"{path}: cannot be written: {reason_of(error)}; run again") from error
