"""What tasks hold in memory, and which of them cannot fit into a worker.

A task's need is that of a worker that has loaded its kernels and the points that the
task holds at once times the bytes of each; `benchmarks/memory.py` measures them.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.airborne.steps import STEPS
from spl_batch.engine.plan.worker_memory import (
    LOADED_BASE_BYTES,
    USABLE_SHARE,
    enough_mib,
    usable_bytes,
)
from spl_batch.errors import grouped
from spl_batch.lattice.tiles import quanta

BYTES_PER_POINT: Final[Mapping[str, int]] = MappingProxyType(
    {
        **{name: step.bytes_per_point for name, step in STEPS.items() if step.bytes_per_point},
        "denoise_air": 90,
        "surface_held": 225,
    }
)
"""Peak memory of a task by each of the points that it holds at once [byte]. A worker keeps what it
frees, in pieces: a task holds more in it than by itself, of a surface cell 166 bytes, not 150."""

LEAST_PART_Q: Final = quanta(12.5)
"""Least side of a part that a block is cut into where memory is short [quanta]: smaller ones would
read little but their halo."""

STRETCH_POINTS: Final = 2_000_000
"""Points that a stretch holds on average, where memory allows [count]."""

LEAST_STRETCH_POINTS: Final = 125_000
"""The same in the smallest worker [count]."""

UNEVEN: Final = 2
"""A stretch is a span of time: where much returns, it holds more than the average, up to this."""


def task_bytes(kind: str, points: float) -> int:
    """Memory of a task that holds so many points, its worker included [byte]."""
    return LOADED_BASE_BYTES + int(points * BYTES_PER_POINT[kind])


def stretch_bytes(points: int) -> int:
    """Memory of a task on the fullest stretch, where they hold so many points on average [byte]."""
    return task_bytes("scatter", UNEVEN * points)


def points_within(kind: str, limit: int) -> int:
    """Points that a task can hold within a worker's memory limit [count]."""
    return max(usable_bytes(limit) - LOADED_BASE_BYTES, 0) // BYTES_PER_POINT[kind]


def part_bytes(held: float, near: float) -> int:
    """Memory of a part of a denoise block, its worker included [byte].

    Parameters
    ----------
    held : float
        Points that it reads: for air it looks at all of them, with few columns [count].
    near : float
        Those among them that the filter looks at [count].
    """
    return max(task_bytes("denoise_air", held), task_bytes("denoise", near))


def stretch_points(limit: int) -> int:
    """Points that a stretch should hold on average under a memory limit [count].

    Halved as long as a full one does not fit, so that a run that is continued with a
    little more memory finds its stretches again.
    """
    points = STRETCH_POINTS
    while points > LEAST_STRETCH_POINTS and UNEVEN * points > points_within("scatter", limit):
        points //= 2
    return points


NAMES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "build_tile": "a tile",
        "denoise": "a denoise block",
        "ground": "a ground cell",
        "strip_patches": "a ground cell whose flightlines are compared",
        "surface": "a surface cell",
        "accuracy": "a square of the reference",
        "deliver_copc": "an octree of a cloud",
    }
)
"""What a kind of task is called, in words."""


def refusal(kind: str, points: float, limit: int, needed: int | None = None) -> str:
    """Why a task cannot be started, and what helps; empty if it can.

    Parameters
    ----------
    limit : int
        Memory limit of a worker [byte].
    needed : int, optional
        What it needs, where that is not told by its points alone [byte].
    """
    needed = task_bytes(kind, points) if needed is None else needed
    if needed <= usable_bytes(limit):
        return ""
    return (
        f"{NAMES[kind]} with {grouped(points)} points in reach needs about "
        f"{grouped(needed / 2**20)} MiB, more than {100 * USABLE_SHARE:.0f} % of --memory "
        f"{grouped(limit / 2**20)} MiB; raise it to {enough_mib(needed)}MiB or {STEPS[kind].remedy}"
    )
