"""What tasks read around a cell and hold in memory, and which of them cannot fit into a worker.

A chain of neighbourhood steps is exact at a seam only with the sum of their reaches. Each step
states its own reach; tasks carry the margin of their cell in their arguments.

A task's need is that of a worker that has loaded its kernels and the points that the task holds
times the bytes of each; ``benchmarks/memory.py`` measures them.
"""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from spl_batch.airborne.classes import buildings
from spl_batch.airborne.filter import denoise
from spl_batch.airborne.noise import haze
from spl_batch.airborne.products import surface_rasters
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.airborne.tasks.delivery import PASS_POINTS, written_labels
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.plan.worker_memory import (
    LOADED_BASE_BYTES,
    USABLE_SHARE,
    enough_mib,
    usable_bytes,
)
from spl_batch.errors import grouped
from spl_batch.formats.units import METRES, Units
from spl_batch.lattice.density import Piece, largest
from spl_batch.lattice.tables import COLUMNS
from spl_batch.lattice.tiles import Bounds, grow, quanta

RASTER_BYTES: Final = 400
"""Memory of a surface cell by each raster cell of it and its margin [byte]."""

STRETCH_POINTS: Final = 1_000_000
"""Points that a stretch holds on average, or a square of a reference, at most [count]."""

UNEVEN: Final = 2
"""A stretch is a span of time: where much returns, it holds more than the average, up to this."""


def halo_m(workflow: Workflow) -> float:
    """Margin of a cell of ``denoise``: reaches of the filter and of noise in air, added up [m]."""
    air = denoise.asks_for_air(workflow.filter, workflow.noise)
    return denoise.reach_m(workflow.filter) + (haze.REACH_M if air else 0.0)


def surface_reach_m(workflow: Workflow) -> float:
    """Margin that a ground cell's rasters read [m]."""
    reaches = [surface_rasters.reach_m(workflow.products), reflectance.reach_m(workflow.products)]
    return max(*reaches, buildings.REACH_M if workflow.classes.building else 0.0)


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


def name_of(kind: str) -> str:
    """What a task is called, in words."""
    return f"{kind} of a {STEPS[kind].unit}"


def refusal(kind: str, points: float, limit: int, needed: int | None = None) -> str:
    """Why a task cannot be started, and what helps; empty if it can.

    ``limit``: memory of a worker; ``needed``: of the task, where it does not follow from its points
    [byte].
    """
    needed = task_bytes(kind, points) if needed is None else needed
    if needed <= usable_bytes(limit):
        return ""
    return (
        f"{name_of(kind)} with {grouped(points)} points in reach needs about "
        f"{grouped(needed / 2**20)} MiB, more than {100 * USABLE_SHARE:.0f} % of --memory "
        f"{grouped(limit / 2**20)} MiB; raise it to {enough_mib(needed)}MiB or "
        f"{remedy(kind, points, needed)}"
    )


class Need(NamedTuple):
    """Memory of a task."""

    task: str  #: What it is, and where.
    memory_bytes: int
    remedy: str  #: How to make it lighter, beside more memory.


def needs(
    pieces: Sequence[Piece],
    workflow: Workflow,
    files: Sequence[int],
    side: int,
    units: Units = METRES,
) -> list[Need]:
    """Memory of the heaviest task of each kind, where the points of ``pieces`` lie.

    Parts of files and the trajectory are left out: a stretch of ordinary size holds more.

    ``files``: points of each file; ``side``: tiles along one side of a cell of ``denoise`` [count];
    ``units``: in which places are named.
    """
    points, most = sum(files), max(files, default=0)
    # Beside its labels a task knows of each point whether it is a copy.
    labels = 1 + sum(np.dtype(COLUMNS[name].dtype).itemsize for name in written_labels(workflow))
    found = list(_cells(pieces, workflow, side, units))
    if workflow.outputs.copc:
        task = f"{name_of('deliver_copc')} with {grouped(most)} points"
        found.append(Need(task, task_bytes("deliver_copc", most), STEPS["deliver_copc"].remedy))
    tiles = largest(piece.peak(quanta(workflow.tiling.tile_m), 0) for piece in pieces)
    return [
        *found,
        Need(
            "a stretch of a flightline",
            task_bytes("scatter", min(points, UNEVEN * STRETCH_POINTS)),
            "",
        ),
        Need(
            "a file's labels",
            task_bytes("deliver_tile", tiles.points) + min(most, PASS_POINTS) * labels,
            "lower tiling.tile_m",
        ),
    ]


def _cells(pieces: Sequence[Piece], workflow: Workflow, side: int, units: Units) -> Iterator[Need]:
    """The cells that read most; the points of a file spread evenly over its box."""
    tile_m, cell_m = workflow.tiling.tile_m, workflow.ground.cell_m
    for kind, edge_m, margin_m in (
        ("build_tile", tile_m, 0.0),
        ("denoise", side * tile_m, halo_m(workflow)),
        ("ground", cell_m, workflow.ground.buffer_m),
        ("surface", cell_m, surface_reach_m(workflow)),
        ("strip_patches", cell_m, 0.0),
    ):
        peak = largest(piece.peak(quanta(edge_m), quanta(margin_m)) for piece in pieces)
        place = f"around {_middle(peak.core, units)} with {grouped(peak.points)} points in reach"
        needed = cell_bytes(kind, peak.core, peak.points, workflow)
        yield Need(f"{name_of(kind)} {place}", needed, remedy(kind, peak.points, needed))


def _middle(core: Bounds, units: Units) -> str:
    """Middle of a cell, in the unit of places, with metres beside."""
    x, y = (sum(ends) / 2 * QUANTUM_M for ends in (core[::2], core[1::2]))
    name, unit_m = units.of_places
    metres = f"x {x:.0f}, y {y:.0f}"
    if unit_m == 1.0:
        return metres
    return f"x {x / unit_m:.0f}, y {y / unit_m:.0f} {name} ({metres} m)"
