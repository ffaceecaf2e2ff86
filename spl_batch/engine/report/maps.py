"""Maps of rasters: shaded relief, ramps and differences, with coordinates along two edges.

Rows run from north to south, as in the GeoTIFFs. Rasters larger than a picture are averaged first;
cells without a value take no part.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, LightSource, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, StrMethodFormatter
from numpy.typing import NDArray

from spl_batch.constants import NODATA
from spl_batch.engine.report import style

WIDTH_IN: Final = 5.1
TALLEST_IN: Final = 6.0
LOWEST_IN: Final = 1.6
LARGEST_PX: Final = 900
"""More cells than this along a side are averaged: the picture has no pixels for them."""

_SUN: Final = LightSource(azdeg=315, altdeg=45)

Extent = tuple[float, float, float, float]
"""West, east, south, north edges [m]."""


@dataclass(frozen=True, slots=True)
class Raster:
    """Values of a regular grid and where it lies."""

    #: (rows, columns) float: north at row 0; NaN or -9999 where there is nothing.
    values: NDArray[Any]
    extent_m: Extent  #: West, east, south, north edges [m].
    #: Easting and northing of both ends of a line that a map shows, the profile's [m].
    line_m: tuple[float, float, float, float] | None = None
    axis_m: float = 1.0  #: Metres in one of the unit that the axes of a map are in.

    @property
    def any_value(self) -> bool:
        """Whether at least one cell holds something."""
        return bool(np.isfinite(self.masked()).any())

    @property
    def cell_m(self) -> float:
        """Edge of a cell along the easting [m]."""
        return (self.extent_m[1] - self.extent_m[0]) / int(self.values.shape[1])

    def masked(self) -> NDArray[np.float64]:
        """Values with NaN where there is nothing: (rows, columns) float64."""
        values = np.array(self.values, dtype=np.float64)
        values[(values == NODATA) | ~np.isfinite(values)] = np.nan
        return values


def reduce_raster(raster: Raster, largest: int = LARGEST_PX) -> Raster:
    """Average a raster until no side has more cells than a picture shows.

    Returns
    -------
    Raster
        The same values where they fit, else means of groups of cells; the extent is of whole ones.
    """
    rows, columns = raster.values.shape
    step = -(-int(max(rows, columns)) // largest)
    if step <= 1:
        return replace(raster, values=raster.masked())
    down, across = -(-rows // step), -(-columns // step)
    means = np.full((down, across), np.nan)
    for row in range(down):  # row by row: a survey's raster need not be copied whole
        part = Raster(raster.values[row * step : (row + 1) * step], raster.extent_m).masked()
        filled = np.full((step, across * step), np.nan)
        filled[: part.shape[0], :columns] = part
        cells = filled.reshape(step, across, step)
        there = np.isfinite(cells)
        counts = there.sum(axis=(0, 2))
        sums = np.where(there, cells, 0.0).sum(axis=(0, 2))
        np.divide(sums, counts, out=means[row], where=counts > 0)
    west, east, south, north = raster.extent_m
    wide, high = (east - west) / columns * step, (north - south) / rows * step
    extent = (west, west + wide * across, north - high * down, north)
    return replace(raster, values=means, extent_m=extent)


def draw_relief(
    raster: Raster, title: str, unit: str, limits: tuple[float, float] | None = None
) -> Figure:
    """Heights in colour under shaded relief.

    Parameters
    ----------
    raster : Raster
        Heights, in any unit.
    title, unit : str
        Heading, and label of the colour bar.
    limits : tuple of float, optional
        Ends of the ramp; by default the 1st and 99th percentile.
    """
    shown = reduce_raster(raster)
    there = np.isfinite(shown.values)
    ends = limits or spread(shown.values, 1, 99)
    colour = style.TERRAIN(Normalize(*ends, clip=True)(np.ma.masked_invalid(shown.values)))
    if min(shown.values.shape) > 1:
        heights = np.where(there, shown.values, np.median(shown.values[there]))
        slope = np.percentile(np.hypot(*np.gradient(heights, shown.cell_m)), 90)
        steeper = float(np.clip(0.35 / max(slope, 1e-6), 1.0, 8.0))  # gentle terrain is seen too
        shade = _SUN.hillshade(heights, steeper, shown.cell_m, shown.cell_m)
        lit = _SUN.blend_soft_light(colour[..., :3], shade[..., None])
        colour[there, :3] = np.clip(lit, 0.0, 1.0)[there]
    return _map(shown, colour, title, unit, ramp=style.TERRAIN, limits=ends, extend="both")


def draw_ramp(
    raster: Raster,
    title: str,
    unit: str,
    *,
    ramp: Colormap,
    limits: tuple[float, float],
    extend: str = "max",
) -> Figure:
    """Values in colour, without shading."""
    shown = reduce_raster(raster)
    colour = ramp(Normalize(*limits, clip=True)(np.ma.masked_invalid(shown.values)))
    return _map(shown, colour, title, unit, ramp=ramp, limits=limits, extend=extend)


def spread(values: NDArray[Any], low: float, high: float) -> tuple[float, float]:
    """Two percentiles of the finite values; never equal, so that a ramp can span them."""
    finite = values[np.isfinite(values)]
    bottom, top = (float(p) for p in np.percentile(finite, [low, high]))
    margin = max(abs(bottom) * 1e-6, 0.05)
    return (bottom, top) if top - bottom > margin else (bottom - margin, top + margin)


def nice(value: float) -> float:
    """Largest 1, 2 or 5 times a power of ten that is not above a value."""
    power: float = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1, 2, 5) if step * power <= value * (1 + 1e-9))


def _map(
    raster: Raster,
    colour: NDArray[Any],
    title: str,
    unit: str,
    *,
    ramp: Colormap,
    limits: tuple[float, float],
    extend: str,
) -> Figure:
    """A map with its colour bar, beside it or, where it is flat, below it."""
    west, east, south, north = extent = tuple(side / raster.axis_m for side in raster.extent_m)
    shape = (north - south) / (east - west)
    height = min(max(WIDTH_IN * shape * 0.75 + 0.6, LOWEST_IN), TALLEST_IN)
    with style.type_context():
        drawn = style.figure(WIDTH_IN, height)
        axes: Any = drawn.add_subplot(title=title, facecolor=style.VOID)
        axes.imshow(colour, extent=extent, interpolation="nearest")
        if raster.line_m is not None:
            x0, y0, x1, y1 = (end / raster.axis_m for end in raster.line_m)
            axes.plot([x0, x1], [y0, y1], color=style.AFTERPULSE, linewidth=1.4, label="profile")
        axes.set(xlim=(west, east), ylim=(south, north))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(3))
            axis.set_major_formatter(StrMethodFormatter("{x:.10g}"))
        axes.tick_params(axis="y", labelrotation=90)
        bar = drawn.colorbar(
            ScalarMappable(norm=Normalize(*limits), cmap=ramp),
            ax=axes,
            orientation="horizontal" if shape < 0.3 else "vertical",
            extend=extend,
        )
        bar.set_label(unit)
    return drawn
