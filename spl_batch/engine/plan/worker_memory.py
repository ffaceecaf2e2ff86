"""Memory of a worker: how much of its limit a task may use, and what it needs at the least."""

import math
from typing import Final

WORKER_BASE_BYTES: Final = 600 * 2**20
"""Resident memory of a worker that has compiled its kernels, rounded up [byte]."""

LOADED_BASE_BYTES: Final = 400 * 2**20
"""Resident memory of a worker whose kernels another process has compiled [byte]."""

USABLE_SHARE: Final = 0.9
"""Part of a worker's limit that the plan uses: dask ends a worker at 95 %."""


def usable_bytes(limit: int) -> int:
    """Part of a worker's memory limit that a task may count on [byte]."""
    return int(USABLE_SHARE * limit)


def enough_mib(needed: int) -> int:
    """Smallest memory limit of a worker under which a task may hold some bytes [MiB]."""
    return math.ceil(needed / USABLE_SHARE / 2**20)
