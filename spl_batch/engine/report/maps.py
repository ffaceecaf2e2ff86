"""Maps of rasters: shaded relief, ramps and differences, with scale bar and north arrow.

Rows run from north to south, as in the GeoTIFFs. Rasters larger than a picture are averaged in
blocks first; cells without a value take no part.
"""

import math
import textwrap
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from spl_batch.constants import NODATA
from spl_batch.engine.report import style
from spl_batch.engine.report.number_format import number
from spl_batch.engine.report.picture import Extent, MapPlace

WIDTH_IN: Final = 5.1
BESIDE_IN: Final = 2.2
"""Width of what lies beside a narrow map: colour bar, its label and coordinates [in]."""

NARROWEST_IN: Final = 3.0
"""Width of a picture whose map is narrow: its heading and what lies beside the map fit [in]."""

TALLEST_IN: Final = 5.6
LARGEST_PX: Final = 900
"""More cells than this along a side are averaged: the picture has no pixels for them."""

NAMED_BELOW: Final = 0.9
"""Share of a map's height from which on a line's name stands below it: above there is no room."""


@dataclass(frozen=True, slots=True)
class Raster:
    """Values of a regular grid and where it lies."""

    #: (rows, columns) float: north at row 0; NaN or -9999 where there is nothing.
    values: NDArray[Any]
    extent_m: Extent  #: West, east, south, north edges [m].
    #: Easting and northing of both ends of a line that a map shows, the profile's [m].
    line_m: tuple[float, float, float, float] | None = None

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
    """Average a raster in square blocks until no side has more cells than a picture shows.

    Returns
    -------
    Raster
        The same values where they fit, else block means; the extent grows to whole blocks.
    """
    rows, columns = raster.values.shape
    step = _step(raster, largest)
    if step <= 1:
        return Raster(raster.masked(), raster.extent_m, raster.line_m)
    down, across = -(-rows // step), -(-columns // step)
    means = np.full((down, across), np.nan)
    for row in range(down):  # strip by strip: a survey's raster need not be copied whole
        strip = Raster(raster.values[row * step : (row + 1) * step], raster.extent_m).masked()
        filled = np.full((step, across * step), np.nan)
        filled[: strip.shape[0], :columns] = strip
        blocks = filled.reshape(step, across, step)
        there = np.isfinite(blocks)
        counts = there.sum(axis=(0, 2))
        sums = np.where(there, blocks, 0.0).sum(axis=(0, 2))
        np.divide(sums, counts, out=means[row], where=counts > 0)
    return Raster(means, _whole_blocks(raster, step), raster.line_m)


def _step(raster: Raster, largest: int = LARGEST_PX) -> int:
    """Cells along the edge of the blocks that a picture shows [count]."""
    rows, columns = raster.values.shape
    return -(-int(max(rows, columns)) // largest)


def _whole_blocks(raster: Raster, step: int) -> Extent:
    """Extent of a raster that is filled up to blocks of ``step`` x ``step`` cells [m]."""
    rows, columns = raster.values.shape
    west, east, south, north = raster.extent_m
    wide = (east - west) / columns * (-(-columns // step) * step)
    high = (north - south) / rows * (-(-rows // step) * step)
    return (west, west + wide, north - high, north)


def hillshade(
    heights_m: NDArray[np.float64], cell_m: float, exaggeration: float = 1.0
) -> NDArray[np.float64]:
    """Lambertian shading by a sun in the north-west at 45 deg, the sky overhead and all around.

    Parameters
    ----------
    heights_m : (rows, columns) float64
        North at row 0; NaN where there is nothing [m].

    Returns
    -------
    (rows, columns) float64
        0.23 in full shadow to 1 in full light; flat ground 0.78; NaN where a slope is unknown.
    """
    if min(heights_m.shape) < 2:
        return np.where(np.isfinite(heights_m), 0.78, np.nan)
    southward, eastward = np.gradient(heights_m * exaggeration, cell_m)
    norm = np.sqrt(1.0 + southward**2 + eastward**2)
    # Normal (-dz/dE, dz/dS, 1), as a row down is a step south; sun (-1/2, 1/2, 1/sqrt 2).
    sun = (0.5 * eastward + 0.5 * southward) + math.sqrt(0.5)
    direct = np.clip(sun / norm, 0.0, 1.0)
    shade: NDArray[np.float64] = 0.78 * (0.55 * direct / math.sqrt(0.5) + 0.15 / norm + 0.30)
    return np.clip(shade, 0.0, 1.0)


def relief_exaggeration(heights_m: NDArray[np.float64], cell_m: float) -> float:
    """Factor that makes gentle terrain visible: 1, 2, 3, 5 or 8."""
    if min(heights_m.shape) < 2:
        return 1.0
    southward, eastward = np.gradient(heights_m, cell_m)
    slope = np.hypot(southward, eastward)
    slope = slope[np.isfinite(slope)]
    if slope.size == 0:
        return 1.0
    wanted = 0.35 / max(float(np.percentile(slope, 90)), 1e-6)
    return max(factor for factor in (1.0, 2.0, 3.0, 5.0, 8.0) if factor <= max(wanted, 1.0))


def draw_relief(
    raster: Raster, title: str, unit: str, limits: tuple[float, float] | None = None
) -> Figure:
    """Heights in colour under shaded relief.

    Parameters
    ----------
    raster : Raster
        Heights [m].
    title, unit : str
        Heading, and label of the colour bar.
    limits : tuple of float, optional
        Ends of the ramp; by default the 1st and 99th percentile.
    """
    shown = reduce_raster(raster)
    low, high = limits or spread(shown.values, 1, 99)
    factor = relief_exaggeration(shown.values, shown.cell_m)
    # A void's neighbours have no slope: they are shown as flat rather than as a hole.
    shade = hillshade(shown.values, shown.cell_m, factor)
    shade = np.where(np.isfinite(shade), shade, 0.78)[..., None]
    share = np.clip((shown.values - low) / (high - low), 0.0, 1.0)
    colour = style.TERRAIN(np.ma.masked_invalid(share))[..., :3]
    lit = colour * np.minimum(shade / 0.78, 1.0) + (1 - colour) * np.maximum(shade - 0.78, 0) * 1.6
    lit = np.where(np.isfinite(shown.values)[..., None], np.clip(lit, 0, 1), colour)
    with style.type_context():
        drawn, axes = framed(shown.extent_m, title)
        axes.imshow(lit, extent=shown.extent_m, interpolation="nearest")
        _colour_bar(drawn, shown, unit, ramp=style.TERRAIN, limits=(low, high), extend="both")
        furnish(axes, shown.extent_m, shown.line_m)
    return drawn


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
    with style.type_context():
        drawn, axes = framed(shown.extent_m, title)
        axes.imshow(
            np.ma.masked_invalid(shown.values),
            extent=shown.extent_m,
            cmap=ramp,
            vmin=limits[0],
            vmax=limits[1],
            interpolation="nearest",
        )
        _colour_bar(drawn, shown, unit, ramp=ramp, limits=limits, extend=extend)
        furnish(axes, shown.extent_m, shown.line_m)
    return drawn


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


@dataclass(frozen=True, slots=True)
class _Layout:
    """Where map and colour bar lie on the picture, from its lower left corner [in]."""

    width: float
    height: float
    map_box: tuple[float, float, float, float]
    bar_box: tuple[float, float, float, float]

    def share(self, box: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
        """Left, bottom, width, height as shares of the picture."""
        left, bottom, wide, high = box
        return left / self.width, bottom / self.height, wide / self.width, high / self.height


def map_place(raster: Raster) -> MapPlace:
    """Where the map of a raster lies on the picture that is drawn of it."""
    extent = _whole_blocks(raster, _step(raster))
    layout = _layout(extent)
    left, bottom, wide, high = layout.share(layout.map_box)
    return MapPlace((left, 1.0 - bottom - high, wide, high), extent)


def _layout(extent_m: tuple[float, float, float, float]) -> _Layout:
    """Colour bar at the right of the map, or below it where the map is flat."""
    west, east, south, north = extent_m
    shape = (north - south) / (east - west)
    margin, title, bar = 0.06, 0.36, 0.14
    if shape < 0.3:
        wide = WIDTH_IN - 2 * margin
        high = max(wide * shape, 0.12)
        below = 0.62
        box = (margin, below, wide, high)
        return _Layout(WIDTH_IN, below + high + title, box, (margin, 0.46, wide * 0.5, 0.1))
    wide = WIDTH_IN - margin - 0.9
    high = wide * shape
    if high > TALLEST_IN:
        wide, high = max(wide * TALLEST_IN / high, 0.12), TALLEST_IN
    bar_box = (margin + wide + 0.1, margin, bar, high)
    width = max(min(WIDTH_IN, margin + wide + BESIDE_IN), NARROWEST_IN)
    title *= 1.0 if width == WIDTH_IN else 1.5  # the heading takes two lines
    return _Layout(width, margin + high + title, (margin, margin, wide, high), bar_box)


def framed(extent_m: tuple[float, float, float, float], title: str) -> tuple[Figure, Axes]:
    """Empty map with its heading.

    Use it inside :func:`~spl_batch.engine.report.style.type_context`.

    ``extent_m``: west, east, south, north edges [m].
    """
    layout = _layout(extent_m)
    drawn = style.figure(layout.width, layout.height, layout=None)
    axes = drawn.add_axes(layout.share(layout.map_box))
    line = 1 - 0.07 / layout.height
    heading: dict[str, Any] = {"va": "top", "fontsize": 9.5, "fontweight": "bold"}
    title = textwrap.fill(title, int(11 * (layout.width - 0.3)))
    drawn.text(0.06 / layout.width, line, title, ha="left", **heading)
    drawn.text(1 - 0.06 / layout.width, line, "N \N{UPWARDS ARROW}", ha="right", **heading)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(style.RULE)
    axes.set_facecolor(style.VOID)
    return drawn, axes


def _colour_bar(
    drawn: Figure,
    raster: Raster,
    unit: str,
    *,
    ramp: Colormap,
    limits: tuple[float, float],
    extend: str,
) -> None:
    layout = _layout(raster.extent_m)
    flat = layout.bar_box[2] > layout.bar_box[3] and layout.bar_box[1] < layout.map_box[1]
    bar = drawn.colorbar(
        ScalarMappable(norm=Normalize(*limits), cmap=ramp),
        cax=drawn.add_axes(layout.share(layout.bar_box)),
        orientation="horizontal" if flat else "vertical",
        extend=extend,
        extendfrac=0.035,
    )
    bar.outline.set_edgecolor(style.RULE)
    bar.ax.tick_params(length=2.5)
    bar.set_label(unit)


def furnish(
    axes: Axes,
    extent_m: tuple[float, float, float, float],
    line_m: tuple[float, float, float, float] | None = None,
) -> None:
    """Add scale bar, coordinates of two corners and a line to a map, and set its limits."""
    if line_m is not None:
        _line(axes, line_m, extent_m)
    _corners(axes, extent_m)
    west, east, south, north = extent_m
    wide, high = east - west, north - south
    narrow = high > 2.5 * wide
    length = nice(wide * (0.8 if narrow else 0.28))
    label = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    halo = [_halo(2.6)]
    left, base = west + 0.035 * wide, south + 0.04 * max(high, wide * 0.3)
    ends: dict[str, Any] = {"solid_capstyle": "butt", "path_effects": [_halo(4.6)]}
    axes.plot([left, left + length], [base, base], color=style.INK, linewidth=2.2, **ends)
    axes.annotate(
        label,
        (left + (0 if narrow else length / 2), base),
        xytext=(0, 4),
        textcoords="offset points",
        ha="left" if narrow else "center",
        va="bottom",
        path_effects=halo,
    )
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)


def corner_texts(extent_m: tuple[float, float, float, float]) -> tuple[str, str]:
    """Easting and northing of the upper left and the lower right corner, as a map shows them."""
    west, east, south, north = extent_m
    digits = 0 if min(east - west, north - south) >= 10 else 2
    upper = f"{number(west, digits)} E, {number(north, digits)} N"
    return upper, f"{number(east, digits)} E, {number(south, digits)} N"


def _corners(axes: Axes, extent_m: tuple[float, float, float, float]) -> None:
    """Coordinates of two corners [m]; beside the map where it is too small to hold them."""
    layout = _layout(extent_m)
    upper, lower = corner_texts(extent_m)
    paper = {"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.2}
    look: dict[str, Any] = {"fontsize": 6.5, "bbox": paper, "zorder": 6}
    _, bottom, wide, high = layout.map_box
    if wide >= 2.6 and high >= 0.7:
        axes.text(0.012, 0.985, upper, transform=axes.transAxes, va="top", **look)
        axes.text(0.988, 0.015, lower, transform=axes.transAxes, ha="right", va="bottom", **look)
        return
    below = layout.bar_box[1] < bottom and layout.bar_box[2] > layout.bar_box[3]
    place = axes.figure.text
    if below:
        right = 1 - 0.06 / layout.width
        place(right, 0.46 / layout.height, f"upper left {upper}", ha="right", **look)
        place(right, 0.28 / layout.height, f"lower right {lower}", ha="right", **look)
    else:
        start = (layout.bar_box[0] + layout.bar_box[2] + 0.75) / layout.width
        top = (bottom + high) / layout.height
        place(start, top, f"upper left\n{upper}", va="top", **look)
        place(start, bottom / layout.height, f"lower right\n{lower}", va="bottom", **look)


def _line(
    axes: Axes,
    line_m: tuple[float, float, float, float],
    extent_m: tuple[float, float, float, float],
) -> None:
    """Where the profile runs; its name is at the middle, since corners have their coordinates."""
    x0, y0, x1, y1 = line_m
    west, east, south, north = extent_m
    # A profile may be longer than a small map.
    ends = np.clip([[x0, y0], [x1, y1]], (west, south), (east, north))
    middle = tuple(ends.mean(axis=0).tolist())
    above = middle[1] < south + NAMED_BELOW * (north - south)
    axes.plot([x0, x1], [y0, y1], color=style.AFTERPULSE, linewidth=1.4, zorder=5,
              path_effects=[_halo(3.0)])  # fmt: skip
    axes.annotate(
        "profile", middle, xytext=(0, 3 if above else -3), textcoords="offset points",
        fontsize=6.5, ha="center", va="bottom" if above else "top",
        color=style.AFTERPULSE, path_effects=[_halo(2.2)], zorder=6,
    )  # fmt: skip


def _halo(width: float) -> withStroke:
    """White around what stands on a map."""
    return withStroke(linewidth=width, foreground="white", alpha=0.9)
