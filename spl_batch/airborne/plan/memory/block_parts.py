"""What a denoise block holds in memory, and the parts in which one is judged that does not fit.

A task looks twice: for air as far as its halo goes, with few columns, which are given back; then
for the filter, which looks less far. Where points lie unevenly, most of them may be within reach of
both looks; so each is counted by itself.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from spl_batch.airborne.plan.halo import filter_reach_m, halo_m
from spl_batch.airborne.plan.task_memory import LEAST_PART_Q, part_bytes, task_bytes
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.lattice.tiles import Bounds, grow, quanta


class Part(NamedTuple):
    """What of a block is judged at once."""

    core: Bounds
    held: float  #: Points that it reads, its halo included [count].
    memory_bytes: int  #: What that needs, the worker included.


def parts_of(
    core: Bounds, points: Callable[[Bounds], float], workflow: Workflow, limit: int
) -> list[Part]:
    """A block at once where it fits; else halves of it, and of these, while one needs too much.

    Parameters
    ----------
    core : Bounds
        What the block owns.
    points : callable
        Gives the points of a region [count].
    limit : int
        Memory limit of a worker [byte].
    """
    wide_q, near_q = quanta(halo_m(workflow)), quanta(filter_reach_m(workflow))
    held = points(grow(core, wide_q))
    whole = Part(core, held, task_bytes("denoise", held))
    usable = usable_bytes(limit)
    if whole.memory_bytes <= usable:
        return [whole]
    found, waiting = [], [*_halves(core)][::-1] or [core]
    while waiting:
        part = waiting.pop()
        held = points(grow(part, wide_q))
        needed = part_bytes(held, points(grow(part, near_q)))
        halves = [] if needed <= usable else [*_halves(part)]
        if halves:
            waiting += halves[::-1]
        else:
            found.append(Part(part, held, needed))
    return found


def _halves(part: Bounds) -> Iterator[Bounds]:
    """Halves along the longer side; none where they would be too small."""
    wide, high = part.xmax - part.xmin, part.ymax - part.ymin
    if max(wide, high) < 2 * LEAST_PART_Q:
        return
    if wide >= high:
        middle = part.xmin + wide // 2
        yield part._replace(xmax=middle)
        yield part._replace(xmin=middle)
    else:
        middle = part.ymin + high // 2
        yield part._replace(ymax=middle)
        yield part._replace(ymin=middle)
