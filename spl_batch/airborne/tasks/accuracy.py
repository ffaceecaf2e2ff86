"""Compare the delivered rasters with reference points, square by square."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.accuracy import (
    STEPS_PER_M,
    Grid,
    Raster,
    Reference,
    Tallies,
    Tally,
    accuracy_report,
    add_up,
    difference_sums,
    ground_differences,
    surface_differences,
    tallies,
    terrain_differences,
)
from spl_batch.airborne.context import Context
from spl_batch.airborne.tasks.reference import read_square
from spl_batch.constants import NODATA
from spl_batch.engine.report.run_record import Receipts
from spl_batch.engine.store.working_store import forget_receipt
from spl_batch.engine.tasks.context import Produced
from spl_batch.errors import DamagedError
from spl_batch.formats.rasters.parts import overview_frame, read_part
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays
from spl_batch.lattice.tiles import cell_bounds, parse_cell

SAMPLE: Final = 500_000
"""Differences that the histogram is drawn from, at most [count]."""

_MAP: Final = ("cell", "total", "count")
"""What a square says of the map of differences."""


def accuracy(args: Mapping[str, Any], context: Context) -> Produced:
    """Compare the rasters with the reference points of a square."""
    square = args["square"]
    core = cell_bounds(parse_cell(square), args["edge"])
    known = read_square(context, args["files"], square, core)
    points = int(np.count_nonzero(known.counts))
    known = known.without_noise()  # once: each comparison below asks for it
    arrays: dict[str, NDArray[Any]] = {}
    terrain, surface, height = (
        _near(context, name, known) if name in args["rasters"] else None
        for name in ("dtm", "dsm", "chm")
    )
    if terrain is not None and surface is not None:
        at_ground_m = ground_differences(terrain, known)
        grid = Grid(*overview_frame(context.output / "dtm.tif"))
        arrays = dict(zip(_MAP, difference_sums(at_ground_m, known, grid), strict=True))
        by_class = terrain_differences(terrain, known, chm=height, at_ground_m=at_ground_m)
        arrays |= _as_arrays("dtm", tallies(by_class))
        arrays |= _as_arrays("dsm", tallies(surface_differences(surface, known)))
    path = context.store.path("accuracy", f"{square}.npz")
    write_arrays(path, arrays)
    return Produced([path], {}, points)


def _near(context: Context, name: str, known: Reference) -> Raster | None:
    """The part of a raster that reference points lie on; None where it does not reach them."""
    if not len(known.xyz_m):
        return None
    x, y, _ = known.xyz_m.T
    bounds = float(x.min()), float(y.min()), float(x.max()), float(y.max())
    part = read_part(context.output / f"{name}.tif", bounds)
    return None if part is None else Raster(part.values, part.left_m, part.top_m, part.cell_m)


def _as_arrays(product: str, found: Tallies) -> dict[str, NDArray[Any]]:
    """Counts as they are kept; 32 bits hold errors of up to 214 km."""
    arrays: dict[str, NDArray[Any]] = {}
    for name, tally in found.items():
        arrays[f"{product}.{name}.steps"] = tally.steps.astype(np.int32)
        arrays[f"{product}.{name}.counts"] = tally.counts.astype(np.uint32)
    return arrays


def _as_tallies(arrays: Mapping[str, NDArray[Any]]) -> Tallies:
    """Counts of a square, by ``PRODUCT.CLASS``."""
    names = [name.removesuffix(".steps") for name in arrays if name.endswith(".steps")]
    return {
        name: Tally(
            arrays[f"{name}.steps"].astype(np.int64), arrays[f"{name}.counts"].astype(np.int64)
        )
        for name in names
    }


@dataclass(frozen=True, slots=True)
class Comparison:
    """What the reference says."""

    statistics: dict[str, Any]
    differences_m: NDArray[np.float32]  #: (n,): every so many-th DTM minus reference by size [m].
    difference: Raster  #: Mean difference by cell [m].
    points: int


def compared(done: Receipts, context: Context) -> Comparison | None:
    """What all squares say together; None where nothing was compared.

    Raises
    ------
    DamagedError
        If what a square said is missing or damaged.
    """
    settings = context.workflow.reference
    if settings is None or settings.points is None:
        return None
    if not _comparable(context) or not _looked_at(done):
        return None
    grid = Grid(*overview_frame(context.output / "dtm.tif"))
    total, count = np.zeros((2, grid.rows * grid.columns), np.int64)
    errors = add_up(_squares(done, context, total, count))
    by_product = [
        {k.removeprefix(p): tally for k, tally in errors.items() if k.startswith(p)}
        for p in ("dtm.", "dsm.")
    ]
    mean = np.full(len(total), NODATA)
    np.divide(total, count * STEPS_PER_M, out=mean, where=count > 0)
    values = mean.reshape(grid.rows, grid.columns).astype(np.float32)
    return Comparison(
        accuracy_report(*by_product, remove_bias=settings.remove_bias),
        by_product[0].get("all", Tally()).sample_m(SAMPLE),
        Raster(values, grid.left_m, grid.top_m, grid.cell_m),
        sum(receipt.facts["points"] for receipt in done.get("reference", {}).values()),
    )


def _comparable(context: Context) -> bool:
    """Whether there are the rasters without which nothing is compared."""
    return all((context.output / name).exists() for name in ("dtm.tif", "dsm.tif"))


def _looked_at(done: Receipts) -> bool:
    """Whether reference files were cut, and squares compared if there is a point in any."""
    files = done.get("reference", {})
    held = any(receipt.facts["squares"] for receipt in files.values())
    return bool(files) and (not held or bool(done.get("accuracy")))


def _squares(
    done: Receipts, context: Context, total: NDArray[np.int64], count: NDArray[np.int64]
) -> Iterator[Tallies]:
    """Errors that each square has found; what it says of the map is added to ``total, count``."""
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
        yield _as_tallies(arrays)
    if damaged is not None:
        raise damaged
