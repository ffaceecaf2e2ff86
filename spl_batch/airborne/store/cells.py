"""A cell as a task has it: what it owns, and the points that lie in it and around."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.store.flown_lines import Shifts, read_shifts
from spl_batch.airborne.store.label_tables import LABELS, Origin, read_region, units_of
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, inside, parse_cell

Keep = Callable[[PointTable], NDArray[np.bool_]]
"""Which points are wanted, each by itself."""


class Cell(NamedTuple):
    """A square of the absolute grid that a task owns, and its points."""

    args: Mapping[str, Any]
    context: Context
    core: Bounds
    shifts: Shifts | None  #: Shifts of its flightlines.
    held: tuple[PointTable, Origin] | None = None  #: Points at hand, and where they lie.

    @classmethod
    def of(cls, args: Mapping[str, Any], context: Context) -> "Cell":
        """The cell of a task."""
        return cls(args, context, Bounds(*args["core"]), read_shifts(args, context.store))

    def holding(self, region: Bounds, columns: Sequence[str]) -> "Cell":
        """The cell with some columns of a region at hand: nothing else is read from files."""
        return self._replace(held=self.read(region, tuple(dict.fromkeys(columns))))

    def read(
        self,
        region: Bounds,
        columns: Sequence[str],
        keep: Keep | None = None,
        *,
        ordered: bool = False,
    ) -> tuple[PointTable, Origin]:
        """Points of a region [quanta], and where they lie; tile by tile unless ``ordered``."""
        if self.held is not None:
            return _chosen(*self.held, region, columns, keep)
        labels = units_of(self.args, [k for k in columns if k in LABELS])
        return read_region(
            self.context.store, list(map(parse_cell, self.args["tiles"])), region,
            [k for k in columns if k not in labels], labels, ordered=ordered, keep=keep,
            shifts=self.shifts,
        )  # fmt: skip


def _chosen(
    table: PointTable, origin: Origin, region: Bounds, columns: Sequence[str], keep: Keep | None
) -> tuple[PointTable, Origin]:
    """What is asked for of points at hand; a view where it is all of them."""
    some = table.select(columns)
    wanted = inside(table["x"], table["y"], region)
    if keep is not None:
        wanted &= keep(some)
    return (some, origin) if wanted.all() else (some.take(wanted), origin.of(wanted))
