"""Ground points and rasters of an array, by the ground cells of a run."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spl_batch.airborne.arrays.checked import (
    box_of,
    points_of,
    refuse_large,
    settings_of,
    values_of,
)
from spl_batch.airborne.arrays.compiling import with_notice
from spl_batch.airborne.arrays.empty_space import empty_space
from spl_batch.airborne.arrays.labels import Labels
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.plan.grid import Grid
from spl_batch.airborne.plan.task_memory import RASTER_BYTES
from spl_batch.airborne.products import surface_points, surface_rasters
from spl_batch.airborne.products.cell_values import shape_of
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.raster_cells import placed
from spl_batch.constants import (
    NODATA,
    NOISE_BACKGROUND,
    NOISE_NOT_ASSESSED,
    NOISE_SIGNAL,
    QUANTUM_M,
)
from spl_batch.errors import InputError, grouped, needed
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, CellId, grow, inside, quanta, whole_cells

LAYERS_BYTES: Final = 16
"""Memory of a cell of the four rasters [byte]."""


@dataclass(frozen=True, slots=True, eq=False)
class Rasters:
    """Rasters on one grid, north up; NaN where there is no value.

    Parameters
    ----------
    dtm, dsm, chm : (rows, cols) float32
        Height of the terrain, of the surface, and of the surface above the terrain [m].
    density : (rows, cols) float32
        Signal returns [1/m2].
    west_m, north_m : float
        Western and northern edge of the first cell [m].
    cell_m : float
        Edge of a cell [m].
    """

    dtm: NDArray[np.float32]
    dsm: NDArray[np.float32]
    chm: NDArray[np.float32]
    density: NDArray[np.float32]
    west_m: float
    north_m: float
    cell_m: float

    def __repr__(self) -> str:
        rows, columns = self.dtm.shape
        known = self.dtm[np.isfinite(self.dtm)]
        terrain = f"{known.min():.2f} to {known.max():.2f} m" if len(known) else "without a value"
        return (
            f"Rasters(dtm, dsm, chm, density: {rows} x {columns} cells of {self.cell_m:g} m from "
            f"west {self.west_m:.2f}, north {self.north_m:.2f}; terrain {terrain})"
        )

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """The six numbers of ``rasterio.Affine(*transform)``."""
        return (self.cell_m, 0.0, self.west_m, 0.0, -self.cell_m, self.north_m)

    @property
    def x(self) -> NDArray[np.float64]:
        """Eastings of the cells' centres: (cols,) [m]."""
        centres: NDArray[np.float64] = np.arange(self.dtm.shape[1], dtype=np.float64) + 0.5
        return self.west_m + self.cell_m * centres

    @property
    def y(self) -> NDArray[np.float64]:
        """Northings of the cells' centres, from north to south: (rows,) [m]."""
        centres: NDArray[np.float64] = np.arange(self.dtm.shape[0], dtype=np.float64) + 0.5
        return self.north_m - self.cell_m * centres

    def to_xarray(self) -> Any:
        """The rasters as an ``xarray.Dataset`` with coordinates ``y`` and ``x``.

        Raises
        ------
        MissingPackageError
            If xarray is not installed.
        """
        xarray = needed("xarray", "rasters as an xarray.Dataset", "xarray")
        units = {"dtm": "m", "dsm": "m", "chm": "m", "density": "m-2"}
        return xarray.Dataset(
            {k: (("y", "x"), getattr(self, k), {"units": unit}) for k, unit in units.items()},
            coords={"y": self.y, "x": self.x},
        )


@with_notice
def ground_points(
    xyz: ArrayLike,
    labels: Labels | ArrayLike | None = None,
    *,
    water: ArrayLike | None = None,
    method: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> NDArray[np.bool_]:
    """Which points are ground.

    Parameters
    ----------
    xyz : (n, 3) array_like
        Easting, northing, height in a projected CRS [m].
    labels : Labels or (n,) array_like, optional
        Result of :func:`.filter_points`, or their noise class (0 signal), or a mask of the
        signal. Without it every point is signal, as in clouds that were filtered before.
    water : (n,) array_like of bool, optional
        Points over water, whose surface is level.
    method : str, optional
        ``ground.method`` of a workflow: ``multiscale``, ``ptd`` or ``smrf``.
    settings : mapping, optional
        Sections of a workflow file: ``ground``.

    Returns
    -------
    (n,) bool

    Raises
    ------
    InputError
        If an array has a wrong shape, or holds no places.
    WorkflowError
        If a setting is unknown or wrong.
    """
    workflow = settings_of(settings, ground={"method": method})
    table = _labelled(xyz, labels, water)
    found = np.zeros(len(table), np.bool_)
    for core, rows in _cells(table, workflow, quanta(workflow.ground.buffer_m)):
        near = table.take(rows)
        owned = inside(near["x"], near["y"], core)
        mask = ground_mask(near, surface_points.holds_ground(near), workflow.ground, owned)
        found[rows[owned]] = mask[owned]
    return found


@with_notice
def rasterize(
    xyz: ArrayLike,
    labels: Labels | ArrayLike | None = None,
    ground: ArrayLike | None = None,
    *,
    water: ArrayLike | None = None,
    cell_m: float | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Rasters:
    """Terrain, surface, height and density of a cloud.

    Parameters
    ----------
    xyz, labels
        As for :func:`ground_points`.
    ground : (n,) array_like of bool, optional
        Which points are ground; :func:`ground_points` finds them by default.
    water : (n,) array_like of bool, optional
        Points over water, whose surface is level.
    cell_m : float, optional
        ``products.cell_m`` of a workflow, 1 m by default [m].
    settings : mapping, optional
        Sections of a workflow file: ``ground``, ``products``.

    Returns
    -------
    Rasters
        Of whole cells around all points; its grid is aligned to whole multiples of the cell.

    Raises
    ------
    InputError
        If an array has a wrong shape, there is no point, or memory cannot hold the rasters.
    WorkflowError
        If a setting is unknown or wrong.
    """
    workflow = settings_of(settings, products={"cell_m": cell_m})
    table = _labelled(xyz, labels, water)
    if not len(table):
        raise InputError("xyz", "no point, so there is nothing to make rasters of")
    if ground is None:
        ground = ground_points(xyz, labels, water=water, settings=settings)
    table = table.with_columns(ground=values_of("ground", ground, len(table)))
    if "noise_density" not in table and (table["noise_class"] == NOISE_BACKGROUND).any():
        # What was refused shows that there is noise, and the cloud's empty space how much.
        density = empty_space(*(table[axis] for axis in "xyz")).density
        table = table.with_columns(noise_density=density.astype(np.float32))
    size, edge = quanta(workflow.products.cell_m), quanta(workflow.ground.cell_m)
    whole = whole_cells(box_of(table), size)
    rows, cols = shape_of(whole, size)
    reach = quanta(surface_rasters.reach_m(workflow.products))
    held = ((edge + 2 * reach) // size) ** 2
    refuse_large(
        "cell_m", f"rasters of {grouped(rows)} x {grouped(cols)} cells",
        LAYERS_BYTES * rows * cols + RASTER_BYTES * held, "give a larger cell_m",
    )  # fmt: skip
    layers = {
        name: np.full((rows, cols), np.nan, np.float32) for name in ("dtm", "dsm", "chm", "density")
    }
    for core, near in _cells(table, workflow, reach):
        shown = surface_points.makes_surfaces(table.take(near))
        made = surface_rasters.surfaces(
            shown, core, workflow.products, workflow.sensor.range_sigma_m
        )
        for name, layer in layers.items():
            row, column, part = placed(made[name], core, whole)
            cut = np.where(part == np.float32(NODATA), np.float32(np.nan), part)
            layer[row : row + len(cut), column : column + cut.shape[1]] = cut
    return Rasters(
        **layers,
        west_m=whole.xmin * QUANTUM_M,
        north_m=whole.ymax * QUANTUM_M,
        cell_m=size * QUANTUM_M,
    )


def _labelled(
    xyz: ArrayLike, labels: Labels | ArrayLike | None, water: ArrayLike | None
) -> PointTable:
    """Points with what is known of their noise."""
    table = points_of(xyz, water=water)
    of_shots: dict[str, NDArray[np.float32]] = {}
    if isinstance(labels, Labels):
        given = labels.noise_class
        names = ("afterpulse", "range_sigma", "noise_density")
        of_shots = {name: getattr(labels, name) for name in names}
    else:
        given = np.asarray(NOISE_SIGNAL if labels is None else labels)
        if given.dtype == np.bool_:
            given = np.where(given, NOISE_SIGNAL, NOISE_BACKGROUND)
    noise_class = values_of("labels", given, len(table))
    unseen = (noise_class == NOISE_NOT_ASSESSED) * np.uint8(PointFlag.NO_BEAM)
    columns = {"noise_class": noise_class, "flags": table["flags"] | unseen}
    return table.with_columns(**columns, **of_shots)


def _cells(
    table: PointTable, workflow: Workflow, reach: int
) -> Iterator[tuple[Bounds, NDArray[np.intp]]]:
    """Ground cells with points, and the rows of all points within ``reach`` of each."""
    if not len(table):
        return
    x, y = table["x"], table["y"]
    cells = Grid.of_workflow([box_of(table)], workflow)
    order = np.argsort(x, kind="stable")
    ascending = x[order]
    squares = np.unique(np.stack([y, x]) // cells.edge, axis=1).T.tolist()
    for cell in dict.fromkeys(cells.keeper(CellId(i, j)) for j, i in squares):
        core = cells.core(cell)
        wide = grow(core, reach)
        span = np.searchsorted(ascending, (wide.xmin, wide.xmax))
        rows = np.sort(order[slice(*span.tolist())])
        rows = rows[inside(x[rows], y[rows], wide)]
        yield core, rows
