"""A ground cell as a task sees it: strips of it, and its points with their labels."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.store.flown_lines import FlownLines
from spl_batch.airborne.store.label_tables import Origin, label_units, read_region, tile_cells
from spl_batch.airborne.tasks.space_domain import LABELS
from spl_batch.lattice.eastings import strips_between
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, inside

Keep = Callable[[PointTable], NDArray[np.bool_]]
"""Tells of each point by itself whether it is wanted."""


class Cell(NamedTuple):
    """A ground cell: what its task was told, and where its points lie."""

    args: Mapping[str, Any]
    context: Context
    core: Bounds
    shifts: FlownLines | None  #: Shifts of its flightlines.
    #: Points that all looks share, and where they lie; none where each look reads its own.
    held: tuple[PointTable, Origin] | None = None

    def parts(self, region: Bounds, look: str) -> list[Bounds]:
        """Strips of a region from west to east, cut as the plan says for one of the looks."""
        return strips_between(region, self.args.get("cuts", {}).get(look, ()))

    def holding(self, region: Bounds, columns: Sequence[str]) -> "Cell":
        """The cell with some columns of a region at hand: no look reads files then.

        It saves time, as columns that looks have in common are read once, and takes memory.
        """
        return self._replace(held=self.read(region, tuple(dict.fromkeys(columns))))

    def read(
        self, region: Bounds, columns: Sequence[str], keep: Keep | None = None
    ) -> tuple[PointTable, Origin]:
        """Points of a region [quanta], tile by tile, and where they lie."""
        if self.held is not None:
            return _chosen(*self.held, region, columns, keep)
        noise, ground = (label_units(self.args[kind]) for kind in ("noise", "ground"))
        labels = {k: ground if k == "ground" else noise for k in columns if k in LABELS}
        return read_region(
            self.context.store, tile_cells(self.args["tiles"]), region,
            [k for k in columns if k not in labels], labels, ordered=False, keep=keep,
            shifts=self.shifts,
        )  # fmt: skip


def _chosen(
    table: PointTable, origin: Origin, region: Bounds, columns: Sequence[str], keep: Keep | None
) -> tuple[PointTable, Origin]:
    """What a look asks for of points at hand; a view where it asks for all of them."""
    some = table.select(columns)
    wanted = inside(table["x"], table["y"], region)
    if keep is not None:
        wanted &= keep(some)
    return (some, origin) if wanted.all() else (some.take(wanted), origin.of(wanted))
