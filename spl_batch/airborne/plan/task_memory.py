"""What tasks hold in memory, and which of them cannot fit into a worker.

A task's need is that of a worker that has loaded its kernels and the points that the task holds
times the bytes of each; ``benchmarks/memory.py`` measures them.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.airborne.plan.halo import surface_reach_m
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.plan.worker_memory import (
    LOADED_BASE_BYTES,
    USABLE_SHARE,
    enough_mib,
    usable_bytes,
)
from spl_batch.errors import grouped
from spl_batch.lattice.tiles import Bounds, grow, quanta

RASTER_BYTES: Final = 400
"""Memory of a surface cell by each raster cell of it and its margin [byte]."""

STRETCH_POINTS: Final = 1_000_000
"""Points that a stretch holds on average [count]."""

UNEVEN: Final = 2
"""A stretch is a span of time: where much returns, it holds more than the average, up to this."""


def task_bytes(kind: str, points: float) -> int:
    """Memory of a task that holds so many points, its worker included [byte]."""
    return LOADED_BASE_BYTES + int(points * STEPS[kind].bytes_per_point)


def cell_bytes(kind: str, core: Bounds, points: float, workflow: Workflow) -> int:
    """Memory of a task of a cell: of its points, or of its raster cells [byte]."""
    needed = task_bytes(kind, points)
    if kind != "surface":
        return needed
    wide = grow(core, quanta(surface_reach_m(workflow)))
    cells = wide.area_m2 / workflow.products.cell_m**2
    return max(needed, LOADED_BASE_BYTES + int(cells * RASTER_BYTES))


def remedy(kind: str, points: float, needed: int) -> str:
    """How to make a task lighter: by its points, or by its raster cells where these are more."""
    return STEPS[kind].remedy if needed <= task_bytes(kind, points) else "raise products.cell_m"


def points_within(kind: str, limit: int) -> int:
    """Points that a task can hold within a worker's memory limit [count]."""
    return max(usable_bytes(limit) - LOADED_BASE_BYTES, 0) // STEPS[kind].bytes_per_point


NAMES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "build_tile": "a tile",
        "denoise": "a cell of denoise",
        "ground": "a ground cell",
        "recorded_patches": "a ground cell whose flightlines are compared",
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
        What it needs, where that does not follow from its points alone [byte].
    """
    needed = task_bytes(kind, points) if needed is None else needed
    if needed <= usable_bytes(limit):
        return ""
    return (
        f"{NAMES[kind]} with {grouped(points)} points in reach needs about "
        f"{grouped(needed / 2**20)} MiB, more than {100 * USABLE_SHARE:.0f} % of --memory "
        f"{grouped(limit / 2**20)} MiB; raise it to {enough_mib(needed)}MiB or "
        f"{remedy(kind, points, needed)}"
    )
