"""Declarations of a file about itself: integers in bounds, and sizes that its bytes can hold.

Counts, shapes and lengths come before the data that they describe. A damaged or hostile one makes a
library allocate without bound, loop for hours, or overflow. So each is checked before anything is
read by it.
"""

import operator
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from spl_batch.errors import InputError, grouped, storage

DAMAGED: Final = "the file is damaged, copy it again"

BOMB_RATIO: Final = 1200
"""Bytes that a byte of a file may expand to: deflate reaches 1032; returns of a survey take a tenth
of their size, a column of zeros a hundredth."""

SMALL_BYTES: Final = 512 << 20
"""Size up to which data may be packed to any density [byte]."""


def bounded(
    path: Path | str, what: str, value: Any, *, least: int = 0, most: int, remedy: str = DAMAGED
) -> int:
    """An integer that a file declares, if it can be.

    Parameters
    ----------
    what : str
        What the integer is, with its unit where it has one.
    remedy : str
        What helps.

    Raises
    ------
    InputError
        If it is no integer, or not from ``least`` to ``most``.
    """
    try:
        whole = operator.index(value)
    except TypeError:
        raise InputError(str(path), f"{what} is {value!r}, no whole number: {remedy}") from None
    if not least <= whole <= most:
        allowed = f"allowed {least} to {most}" if most < 10**15 else f"allowed {least} and more"
        shown = whole if abs(whole) < 10**20 else f"{whole:.6g}"
        raise InputError(str(path), f"{what} is {shown}; {allowed}: {remedy}")
    return whole


@contextmanager
def gathered(faults: list[str]) -> Iterator[None]:
    """Keep a file's faults, so that all are reported at once."""
    try:
        yield
    except InputError as error:
        faults += error.faults


def refuse_bomb(path: Path | str, what: str, declared_bytes: int, stored_bytes: int) -> None:
    """Refuse data that would unpack to far more than their bytes can hold of a survey.

    Parameters
    ----------
    declared_bytes, stored_bytes : int
        Size once it is unpacked, and as it lies in the file [byte].

    Raises
    ------
    InputError
        If it is more than :data:`SMALL_BYTES`, and more than :data:`BOMB_RATIO` times as much.
    """
    if declared_bytes > max(SMALL_BYTES, BOMB_RATIO * stored_bytes):
        raise InputError(
            str(path),
            f"{what} would unpack to {storage(declared_bytes)} from {grouped(stored_bytes)} bytes:"
            " no survey packs so well, the file is damaged or made to fill memory and disk",
        )
