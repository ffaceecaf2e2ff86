"""Plots that are not maps: the histogram of differences and the vertical profile."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from spl_batch.constants import CLASS_GROUND, NOISE_AFTERPULSE, NOISE_BACKGROUND
from spl_batch.engine.report import style
from spl_batch.engine.report.number_format import centimetres, height
from spl_batch.engine.report.parts import Statistics
from spl_batch.formats.units import METRES, Units

MOST_POINTS: Final = 250_000
"""A profile with more points is thinned evenly: the picture has no pixels for them."""

COLOURS: Final = (style.NOISE, style.SIGNAL, style.GROUND, style.AFTERPULSE)
"""Of the :attr:`Profile.members`."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Points of a narrow vertical strip."""

    #: (n,): distance along the strip, and height [m].
    along_m: NDArray[Any]
    z_m: NDArray[Any]
    noise_class: NDArray[Any]  #: (n,): 0 signal, 1 background, 2 afterpulse, 255 not assessed.
    classification: NDArray[Any]  #: (n,): ASPRS class as delivered.
    width_m: float  #: Width of the strip [m].
    #: Easting and northing of its two ends, for maps [m].
    line_m: tuple[float, float, float, float] | None = None
    units: Units = METRES  #: In which a plot shows it.

    @property
    def along(self) -> NDArray[Any]:
        """Distance along the strip, as it is shown: (n,)."""
        return self.along_m / self.units.horizontal_m

    @property
    def z(self) -> NDArray[Any]:
        """Height, as it is shown: (n,)."""
        return self.z_m / self.units.vertical_m

    @property
    def labels(self) -> tuple[str, str]:
        """Names of both axes."""
        flat, flat_m = self.units.of_coordinates
        height, _ = self.units.of_heights
        width = f"strip {self.width_m / flat_m:.3g} {flat} wide"
        return f"distance [{flat}]; {width}", f"height [{height}]"

    @property
    def members(self) -> tuple[NDArray[np.bool_], ...]:
        """Which points are background, kept but no ground, ground, and afterpulses."""
        background = self.noise_class == NOISE_BACKGROUND
        afterpulse = self.noise_class == NOISE_AFTERPULSE
        kept = ~(background | afterpulse)
        ground = kept & (self.classification == CLASS_GROUND)
        return background, kept & ~ground, ground, afterpulse

    def heights(self) -> tuple[float, float]:
        """Heights around what was kept: the whole range gate would flatten the scene."""
        _, others, ground, _ = self.members
        scene = self.z_m[others | ground] if (others | ground).any() else self.z_m
        low, high = (float(p) for p in np.percentile(scene, [0.2, 99.8]))
        margin = max(8.0, 0.35 * (high - low))
        # No empty sky where nothing was recorded.
        lowest, highest = float(self.z_m.min()) - 1.0, float(self.z_m.max()) + 1.0
        return max(low - margin, lowest), min(high + margin, highest)

    def thinned(self) -> "Profile":
        """Every k-th point in an order that does not depend on the rows' order."""
        columns = (self.along_m, self.z_m, self.noise_class, self.classification)
        order = np.lexsort(tuple(reversed(columns)))
        step = -(-order.size // MOST_POINTS)
        along, z, noise, classes = (np.asarray(c)[order[::step]] for c in columns)
        return Profile(along, z, noise, classes, self.width_m, units=self.units)

    def size(self, least: float, most: float) -> float:
        """Area of a point of a picture [points2]."""
        return float(np.clip(9e4 / max(self.along_m.size, 1), least, most))


def draw_histogram(
    differences_m: NDArray[Any], statistics: Statistics | None, units: Units = METRES
) -> Figure:
    """Histogram of differences [m], at least one, with mean, RMSE and NMAD of the whole set.

    ``units``: of delivery, in which the heading has the RMSE too.
    """
    values = np.asarray(differences_m, dtype=np.float64)
    values = values[np.isfinite(values)] * 100.0
    low, high = (float(p) for p in np.percentile(values, [0.5, 99.5]))
    reach = max(abs(low), abs(high), 1.0) * 1.15
    outside = np.count_nonzero(np.abs(values) > reach) / values.size
    bins = int(np.clip(np.sqrt(values.size), 20, 90))
    with style.type_context():
        drawn = style.figure(5.1, 3.55)
        axes = drawn.subplots()
        counts, edges = np.histogram(values, bins=bins, range=(-reach, reach))
        share = 100.0 * counts / values.size
        axes.stairs(share, edges, fill=True, color="#9cc3da", linewidth=0)
        axes.stairs(share, edges, color=style.SIGNAL, linewidth=0.9)
        if statistics is not None:
            _statistic_lines(axes, statistics)
        axes.axvline(0.0, color=style.INK, linewidth=0.7)
        axes.set_xlim(-reach, reach)
        axes.set_ylim(0.0, None)
        note = f"; {100 * outside:.2g} % lie outside the axis" if outside > 0 else ""
        axes.set_xlabel(f"DTM minus reference [cm]{note}")
        axes.set_ylabel("share of comparisons [%]")
        axes.set_title(difference_title("All surfaces", statistics, units))
        axes.spines[["top", "right"]].set_visible(False)
    return drawn


def difference_title(opening: str, statistics: Statistics | None, units: Units) -> str:
    """Heading of a picture of differences, with their RMSE where it is known."""
    if statistics is None or statistics.rmse is None:
        return opening
    return f"{opening}: RMSE {height(statistics.rmse, units.of_heights)}"


def _statistic_lines(axes: Axes, statistics: Statistics) -> None:
    if statistics.mean is not None:
        label = f"mean {centimetres(statistics.mean)}"
        axes.axvline(100 * statistics.mean, color="#b03a1f", linewidth=1.5, label=label)
    for name, centre, around, value, dashes in (
        ("RMSE", 0.0, "zero", statistics.rmse, (5, 3)),
        ("NMAD", statistics.median or 0.0, "the median", statistics.nmad, (1.5, 2)),
    ):
        if value is None:
            continue
        colour = style.INK if name == "RMSE" else style.SIGNAL
        label = f"\N{PLUS-MINUS SIGN}{name} {centimetres(value)} around {around}"
        for side, shown in ((-value, "_"), (value, label)):
            place = 100 * (centre + side)
            axes.axvline(place, color=colour, linewidth=1.2, linestyle=(0, dashes), label=shown)
    # Below the axes: within them bars and lines may be anywhere.
    axes.figure.legend(loc="outside lower center", ncols=2, handlelength=2.2)


def draw_profile(profile: Profile) -> Figure:
    """The same strip twice: everything that was recorded, and what it was taken for."""
    shown, alphas = profile.thinned(), (0.45, 0.9, 0.95, 0.9)
    background, _, _, afterpulse = shown.members
    # Where no noise was looked for nothing is called signal.
    noise = bool((background | afterpulse).any())
    names = "signal: all else" if noise else "others", "signal: ground" if noise else "ground"
    labels = ("noise: background", *names, "noise: afterpulses")
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 6.2)
        top, bottom = drawn.subplots(2, 1, sharex=True, sharey=True)
        _draw_recorded(top, shown, shown.size(0.7, 5.0))
        _draw_classified(bottom, shown, shown.size(0.7, 5.0), alphas)
        bottom.set_title("As classified")
        handles = [
            Line2D([], [], ls="", marker="o", ms=4, color=colour, alpha=alpha, label=name, mew=0)
            for name, member, colour, alpha in sorted(
                zip(labels, shown.members, COLOURS, alphas, strict=True), key=lambda one: one[0]
            )
            if member.any()
        ]
        bottom.legend(
            handles=handles,
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=4,
            borderaxespad=0.2,
            handletextpad=0.2,
            columnspacing=1.4,
        )
        distance, height = profile.labels
        for axes in (top, bottom):
            axes.set_ylabel(height)
        bottom.set_xlabel(distance)
        _set_limits(bottom, shown)
    return drawn


def draw_methods(profiles: Mapping[str, Profile]) -> Figure:
    """The same strip by the method's name, side by side, after what was recorded."""
    first = next(iter(profiles.values()))
    rows = -(-(len(profiles) + 1) // 2)
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 0.5 + 2.5 * rows)
        grid = drawn.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
        panels = list(grid.ravel())
        shown = first.thinned()
        size = shown.size(0.4, 12.0)
        _draw_recorded(panels[0], shown, size)
        for axes, (name, profile) in zip(panels[1:], profiles.items(), strict=False):
            _draw_classified(axes, profile.thinned(), size, (0.25, 0.9, 0.9, 0.5))
            axes.set_title(name)
        for axes in panels[len(profiles) + 1 :]:
            axes.set_axis_off()
        distance, height = first.labels
        for axes in grid[:, 0]:
            axes.set_ylabel(height)
        for axes in grid[-1]:
            axes.set_xlabel(distance)
        _set_limits(grid[0, 0], first)
    return drawn


def _draw_recorded(axes: Axes, profile: Profile, size: float) -> None:
    """Everything that was recorded."""
    axes.scatter(profile.along, profile.z, s=size, c=style.RAW, alpha=0.55, linewidths=0)
    axes.set_title("As recorded")
    _frame(axes)


def _draw_classified(
    axes: Axes, profile: Profile, size: float, alphas: tuple[float, float, float, float]
) -> None:
    """What points were taken for."""
    for member, colour, alpha in zip(profile.members, COLOURS, alphas, strict=True):
        along, z = profile.along[member], profile.z[member]
        axes.scatter(along, z, s=size, c=colour, alpha=alpha, linewidths=0)
    _frame(axes)


def _frame(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color=style.RULE, linewidth=0.4)
    axes.set_axisbelow(True)


def _set_limits(axes: Axes, profile: Profile) -> None:
    along = profile.along
    axes.set_ylim(*(height / profile.units.vertical_m for height in profile.heights()))
    axes.set_xlim(float(along.min()), max(float(along.max()), float(along.min()) + 1.0))
