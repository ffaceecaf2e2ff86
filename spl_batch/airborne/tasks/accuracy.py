"""Compare the delivered rasters with reference points, square by square."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.accuracy.differences import (
    difference_sums,
    ground_differences,
    return_differences,
    surface_differences,
    terrain_differences,
)
from spl_batch.airborne.accuracy.error_tally import (
    STEPS_PER_M,
    Accuracy,
    Tallies,
    Tally,
    accuracy_report,
    add_up,
    tallies,
)
from spl_batch.airborne.accuracy.raster_and_reference import Raster, Reference
from spl_batch.airborne.context import Context
from spl_batch.airborne.store.flown_lines import read_shifts
from spl_batch.airborne.store.label_tables import read_region, units_of
from spl_batch.airborne.tasks.reference import read_square
from spl_batch.constants import NODATA, NOISE_SIGNAL, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts, RunFacts
from spl_batch.engine.store.working_store import forget_receipt
from spl_batch.engine.tasks.context import Produced
from spl_batch.errors import DamagedError
from spl_batch.formats.rasters.parts import Grid, RasterPart, overview_frame
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds, inside, overlap, parse_cell, quanta

SAMPLE: Final = 500_000
"""Differences that the histogram is drawn from, at most [count]."""

OWN_EDGE_M: Final = 10.0
"""Edge of the window of a square in which the reference's points are sought in the survey [m]."""

EVERY: Final = 8
"""Of the kept returns one in so many is compared, by its coordinates [count]."""

_MAP: Final = ("cell", "total", "count")
"""Arrays of a square for the map of differences."""


def accuracy(args: Mapping[str, Any], context: Context) -> Produced:
    """Compare the rasters with the reference points of a square."""
    square = args["square"]
    core = cell_bounds(parse_cell(square), args["edge"])
    known = read_square(context, args["files"], square, core)
    points = int(np.count_nonzero(known.counts))
    known = known.without_noise()  # once: each comparison below asks for it
    arrays: dict[str, NDArray[Any]] = {}
    terrain, surface, height = (
        Raster.around(context.output / f"{name}.tif", known.xyz_m[:, :2])
        if name in args["rasters"]
        else None
        for name in ("dtm", "dsm", "chm")
    )
    if terrain is not None and surface is not None:
        at_ground_m = ground_differences(terrain, known)
        grid = Grid(*overview_frame(context.output / "dtm.tif"))
        arrays = dict(zip(_MAP, difference_sums(at_ground_m, known, grid), strict=True))
        by_class = terrain_differences(terrain, known, chm=height, at_ground_m=at_ground_m)
        arrays |= _as_arrays("dtm", tallies(by_class))
        arrays |= _as_arrays("dsm", tallies(surface_differences(surface, known)))
        arrays |= _as_arrays("returns", _of_returns(known, core, args, context))
    path = context.store.path("accuracy", f"{square}.npz")
    write_arrays(path, arrays)
    return Produced([path], {"own": _own_points(known, args["tiles"], context)}, points)


def _of_returns(
    known: Reference, core: Bounds, args: Mapping[str, Any], context: Context
) -> Tallies:
    """Kept returns of a square against the reference, held a tile at a time."""
    if context.workflow.filter.method == "none":
        return {}
    labels, shifts = units_of(args, ["noise_class"]), read_shifts(args, context.store)

    def chosen(table: PointTable) -> NDArray[np.bool_]:
        some = (table["x"] + table["y"] + table["z"]) % EVERY == 0
        wanted: NDArray[np.bool_] = some & (table["noise_class"] == NOISE_SIGNAL)
        return wanted

    def returns_of(tile: CellId) -> NDArray[np.float64]:
        held, _ = read_region(
            context.store, [tile], core, ("x", "y", "z"), labels, ordered=False,
            keep=chosen, shifts=shifts,
        )  # fmt: skip
        return np.column_stack([held[axis] * QUANTUM_M for axis in "xyz"])

    clouds = map(returns_of, map(parse_cell, args["tiles"]))
    return add_up(map(tallies, return_differences(clouds, known)))


def _own_points(known: Reference, tiles: Sequence[str], context: Context) -> tuple[int, int]:
    """Reference points in a window of a square, and how many of them the survey itself holds."""
    mine = np.rint(known.xyz_m[known.counts] / QUANTUM_M).astype(np.int64)
    if not len(mine):
        return 0, 0
    edge, tile_q = quanta(OWN_EDGE_M), quanta(context.workflow.tiling.tile_m)
    middle = mine[len(mine) // 2] // edge
    window = cell_bounds(CellId(int(middle[0]), int(middle[1])), edge)
    asked = mine[inside(mine[:, 0], mine[:, 1], window)]
    near = [t for t in map(parse_cell, tiles) if overlap(cell_bounds(t, tile_q), window)]
    held, _ = read_region(context.store, near, window, ("x", "y", "z"), {}, ordered=False)
    own = np.column_stack([held[axis].astype(np.int64) for axis in "xyz"])
    return len(asked), int(np.count_nonzero(np.isin(_as_one(asked), _as_one(own))))


def _as_one(places: NDArray[np.int64]) -> NDArray[np.void]:
    """Places as values that compare as wholes: (n,) of (n, 3)."""
    return np.ascontiguousarray(places).view([(axis, np.int64) for axis in "xyz"]).ravel()


def _as_arrays(product: str, found: Tallies) -> dict[str, NDArray[Any]]:
    """Steps and counts as they are kept; 32 bits hold errors of up to 214 km."""
    return {
        f"{product}.{name}": np.array([tally.steps, tally.counts], np.int32)
        for name, tally in found.items()
    }


@dataclass(frozen=True, slots=True)
class Comparison:
    """The survey against its reference."""

    accuracy: Accuracy
    differences_m: NDArray[np.float32]  #: (n,): every so many-th DTM minus reference by size [m].
    difference: RasterPart  #: Mean difference by cell [m].
    own_share: float | None  #: Of those looked at, share that are the survey's own points, 0..1.


def compared(done: Receipts, context: Context) -> Comparison | None:
    """What all squares found together; None where nothing was compared.

    Raises DamagedError if what a square found is missing or damaged.
    """
    settings = context.workflow.reference
    if settings is None or not _comparable(context) or not _looked_at(done):
        return None
    grid = Grid(*overview_frame(context.output / "dtm.tif"))
    total, count = np.zeros((2, grid.rows * grid.columns), np.int64)
    errors = add_up(_squares(done, context, total, count))
    by_product = [
        {k.removeprefix(p): tally for k, tally in errors.items() if k.startswith(p)}
        for p in ("dtm.", "dsm.", "returns.")
    ]
    mean = np.full(len(total), NODATA)
    np.divide(total, count * STEPS_PER_M, out=mean, where=count > 0)
    values = mean.reshape(grid.rows, grid.columns).astype(np.float32)
    looked = [receipt.facts["own"] for receipt in done.get("accuracy", {}).values()]
    asked, own = np.sum([(0, 0), *looked], axis=0).tolist()
    share = own / asked if asked else None
    accuracy = accuracy_report(
        *by_product,
        remove_bias=settings.remove_bias,
        reference_points=sum(r.facts["points"] for r in done.get("reference", {}).values()),
        own_points=any(own_points(share)),
    )
    return Comparison(
        accuracy,
        by_product[0].get("all", Tally()).sample_m(SAMPLE),
        RasterPart(values, grid.left_m, grid.top_m, grid.cell_m),
        share,
    )


def own_points(share: float | None) -> Iterator[Finding]:
    """Whether most points of a reference are the survey's own to the millimetre.

    Of another survey's hardly any is.
    """
    if share is not None and share > 1.0 - share:
        yield Finding("C02", {"kind": "own", "share": share})


def not_compared(done: Receipts, context: Context, facts: RunFacts) -> Iterator[Finding]:
    """Whether a comparison is missing that did not fail: nobody has asked for it yet."""
    missing = _comparable(context) and not _looked_at(done)
    if missing and not facts.failures:  # without the rasters of this run it is not made either
        yield Finding("C02", {"kind": "missing"})


def _comparable(context: Context) -> bool:
    """Whether reference points are named, and there are the rasters that all is compared with."""
    settings = context.workflow.reference
    named = settings is not None and settings.points is not None
    return named and all((context.output / name).exists() for name in ("dtm.tif", "dsm.tif"))


def _looked_at(done: Receipts) -> bool:
    """Whether reference files were cut, and squares compared if there is a point in any."""
    files = done.get("reference", {})
    held = any(receipt.facts["squares"] for receipt in files.values())
    return bool(files) and (not held or bool(done.get("accuracy")))


def _squares(
    done: Receipts, context: Context, total: NDArray[np.int64], count: NDArray[np.int64]
) -> Iterator[Tallies]:
    """Errors that each square has found; its part of the map is added to ``total, count``."""
    damaged: DamagedError | None = None
    for square in done.get("accuracy", {}):
        try:
            arrays = read_arrays(context.store.path("accuracy", f"{square}.npz"))
        except DamagedError as error:
            if damaged is not None:
                forget_receipt(context.store, "accuracy", square)  # made again with the first
            damaged = damaged or error
            continue
        if "cell" in arrays:
            # No cell is named twice by one square.
            total[arrays["cell"]] += arrays["total"]
            count[arrays["cell"]] += arrays["count"]
        yield {k: Tally(*v.astype(np.int64)) for k, v in arrays.items() if k not in _MAP}
    if damaged is not None:
        raise damaged
