"""What ground cells hold in memory, and the strips in which those are done that do not fit at once.

Strips are cut where the points lie (:mod:`~spl_batch.lattice.eastings`): by headers before a run,
by the slabs of the tiles within it. What a strip reads around it counts.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from spl_batch.airborne.filter.drowned_surfaces import NEAR_M
from spl_batch.airborne.ground.multiscale.ranging_layer import BLOCK_M
from spl_batch.airborne.ground.water.off_water import PART_STEP_M
from spl_batch.airborne.lines.patches import SQUARE_M
from spl_batch.airborne.plan.halo import surface_reach_m
from spl_batch.airborne.plan.task_memory import task_bytes
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.surfaces import looks_at_surface
from spl_batch.engine.plan.worker_memory import LOADED_BASE_BYTES, usable_bytes
from spl_batch.lattice.eastings import Cut, Eastings
from spl_batch.lattice.tiles import Bounds, grow, quanta

GROUND_HELD_BYTES: Final = 16
"""Memory of the ground of a cell in strips, by each point that it owns: labels [byte]."""

PATCHES_BYTES: Final = 24 * 2**20
"""Memory of a cell whose flightlines are compared in strips: sums by square, whatever it holds."""

RASTER_BYTES: Final = 400
"""Memory of a surface cell in strips, by each raster cell of it and its margin [byte]."""

GATHERED_BYTES: Final = 20
"""And by each of its points: what all strips tell [byte]."""

LOOK_BYTES: Final[Mapping[str, int]] = MappingProxyType(
    {"ground": 215, "water": 150, "patches": 80, "tops": 175, "pulses": 175, "classes": 150}
)
"""And by each point of a strip and around it, in each look at a cell [byte]."""

STRIP_COST: Final = 0.08
"""Time that a cell takes longer with each further strip, over that of one at once."""

Spread = Callable[[Bounds], Eastings]
"""Gives the points of a region."""


class Parts(NamedTuple):
    """How a ground cell is done: at once, or in strips."""

    memory_bytes: int  #: What its task needs, its worker included.
    #: Look -> where strips begin but for the first one [quanta]; nothing where all is done at once.
    cuts: Mapping[str, tuple[int, ...]] = MappingProxyType({})

    @property
    def strips(self) -> int:
        """In how many strips the look with most is done [count]."""
        return 1 + max(map(len, self.cuts.values()), default=0)


def cell_parts(kind: str, core: Bounds, spread: Spread, workflow: Workflow, limit: int) -> Parts:
    """Fewest strips in which a task of a ground cell fits into memory; at once where it can.

    Parameters
    ----------
    kind : {"ground", "surface", "strip_patches"}
        What is done.
    core : Bounds
        The cell.
    spread : callable
        Gives the points of a region around it.
    limit : int
        Memory limit of a worker [byte].
    """
    looks = looks_at(kind, core, spread, workflow)
    points = max(region.total for region, _, _ in looks.values())
    whole = whole_bytes(kind, core, points, workflow)
    if whole <= usable_bytes(limit) or not _may_be_cut(kind, workflow):
        return Parts(whole)
    held = LOADED_BASE_BYTES + _held(kind, core, spread, points, workflow)
    found: dict[str, Cut] = {}
    for name, (region, step_q, reach_q) in looks.items():
        most = (usable_bytes(limit) - held) / LOOK_BYTES[name]
        found[name] = region.cut(step_q, reach_q, max(most, 0.0))
    needed = held + max(cut.fullest * LOOK_BYTES[name] for name, cut in found.items())
    return Parts(needed, {name: cut.ends[1:-1] for name, cut in found.items()})


def whole_bytes(kind: str, core: Bounds, points: float, workflow: Workflow) -> int:
    """Memory of a task that does a ground cell at once: of its points, or of its raster cells."""
    needed = task_bytes(kind, points)
    if kind != "surface":
        return needed
    return max(needed, LOADED_BASE_BYTES + _raster_bytes(core, workflow))


def _raster_bytes(core: Bounds, workflow: Workflow) -> int:
    """Memory of the raster cells of a ground cell and its margin [byte]."""
    wide = grow(core, quanta(surface_reach_m(workflow)))
    return int(wide.area_m2 / workflow.products.cell_m**2 * RASTER_BYTES)


def looks_at(
    kind: str, core: Bounds, spread: Spread, workflow: Workflow
) -> dict[str, tuple[Eastings, int, int]]:
    """Points of each look at a cell, the step at which it may be cut, and what a strip reads."""
    if kind == "ground":
        region = spread(grow(core, quanta(workflow.ground.buffer_m)))
        looks = {"ground": (region, quanta(BLOCK_M), quanta(NEAR_M))}
        if workflow.water is not None:
            looks["water"] = region, quanta(PART_STEP_M), quanta(NEAR_M)
        return looks
    if kind == "strip_patches":
        return {"patches": (spread(core), quanta(SQUARE_M), 0)}
    halo = quanta(surface_reach_m(workflow))
    return {
        name: (spread(grow(core, look.margin_q)), look.step_q, look.reach_q)
        for name, look in looks_at_surface(workflow, halo).items()
    }


def _may_be_cut(kind: str, workflow: Workflow) -> bool:
    """Whether strips give what a cell at once gives.

    Of the methods for the ground only the one that follows the data works in strips.
    """
    return kind != "ground" or workflow.ground.method == "multiscale"


def _held(kind: str, core: Bounds, spread: Spread, points: float, workflow: Workflow) -> int:
    """What is held of all strips of a cell [byte]."""
    if kind == "ground":
        return int(spread(core).total * GROUND_HELD_BYTES)
    if kind == "strip_patches":
        return PATCHES_BYTES
    return int(_raster_bytes(core, workflow) + points * GATHERED_BYTES)


def strips_cost(strips: int) -> float:
    """Time of a cell in strips, over that of one at once."""
    return 1.0 + STRIP_COST * (strips - 1)
