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
from spl_batch.engine.report.number_format import centimetres
from spl_batch.engine.report.parts import Statistics

MOST_POINTS: Final = 250_000
"""A profile with more points is thinned evenly: the picture has no pixels for them."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Points of a narrow vertical strip.

    Parameters
    ----------
    along_m : (n,) float64
        Distance along the strip [m].
    z_m : (n,) float64
        Height [m].
    noise_class : (n,) uint8
        0 signal, 1 background, 2 afterpulse, 255 not assessed.
    classification : (n,) uint8
        ASPRS class as delivered.
    width_m : float
        Width of the strip [m].
    line_m : tuple of float, optional
        Easting and northing of its two ends, for maps [m].
    """

    along_m: NDArray[Any]
    z_m: NDArray[Any]
    noise_class: NDArray[Any]
    classification: NDArray[Any]
    width_m: float
    line_m: tuple[float, float, float, float] | None = None


def draw_histogram(differences_m: NDArray[Any], statistics: Statistics | None) -> Figure:
    """Histogram of differences with mean, RMSE and NMAD.

    Parameters
    ----------
    differences_m : (n,) float
        Delivered minus reference, all of them or an even sample [m]; n >= 1.
    statistics : Statistics, optional
        Of the whole set; drawn as lines and given in the title.
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
        axes.set_title(_difference_title("All surfaces", statistics))
        axes.spines[["top", "right"]].set_visible(False)
    return drawn


def _difference_title(opening: str, statistics: Statistics | None) -> str:
    if statistics is None or statistics.rmse is None:
        return opening
    return f"{opening}: RMSE {centimetres(statistics.rmse)}"


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
    """The same strip twice: everything that was recorded, and what it was taken for.

    Parameters
    ----------
    profile : Profile
        At least one point.
    """
    shown = _thinned(profile)
    along, z = shown.along_m, shown.z_m
    background = shown.noise_class == NOISE_BACKGROUND
    afterpulse = shown.noise_class == NOISE_AFTERPULSE
    kept = ~(background | afterpulse)
    ground = kept & (shown.classification == CLASS_GROUND)
    # Where no noise was looked for nothing is called signal.
    noise = bool((background | afterpulse).any())
    of_ground, all_else = ("signal: ground", "signal: all else") if noise else ("ground", "others")
    limits = _height_limits(z, kept)
    size = float(np.clip(9e4 / max(along.size, 1), 0.7, 5.0))
    layers = (
        ("noise: background", background, style.NOISE, 0.45),
        (all_else, kept & ~ground, style.SIGNAL, 0.9),
        (of_ground, ground, style.GROUND, 0.95),
        ("noise: afterpulses", afterpulse, style.AFTERPULSE, 0.9),
    )
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 6.2)
        top, bottom = drawn.subplots(2, 1, sharex=True, sharey=True)
        top.scatter(along, z, s=size, c=style.RAW, alpha=0.55, linewidths=0)
        top.set_title("As recorded")
        for _, member, colour, alpha in layers:
            bottom.scatter(along[member], z[member], s=size, c=colour, alpha=alpha, linewidths=0)
        bottom.set_title("As classified")
        handles = [
            Line2D([], [], ls="", marker="o", ms=4, color=colour, alpha=alpha, label=name, mew=0)
            for name, member, colour, alpha in sorted(layers)
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
        for axes in (top, bottom):
            axes.set_ylabel("height [m]")
            axes.spines[["top", "right"]].set_visible(False)
            axes.grid(color=style.RULE, linewidth=0.4)
            axes.set_axisbelow(True)
        bottom.set_xlabel(f"distance along the profile [m]; strip {profile.width_m:g} m wide")
        bottom.set_ylim(*limits)
        bottom.set_xlim(float(along.min()), max(float(along.max()), float(along.min()) + 1.0))
    return drawn


def draw_methods(profiles: Mapping[str, Profile]) -> Figure:
    """The same strip as several methods see it, side by side, after what was recorded.

    Parameters
    ----------
    profiles : mapping of str to Profile
        The strip by the method's name; at least one, each with at least one point.
    """
    first = next(iter(profiles.values()))
    kept = ~np.isin(first.noise_class, (NOISE_BACKGROUND, NOISE_AFTERPULSE))
    low, high = _height_limits(first.z_m, kept)
    rows = -(-(len(profiles) + 1) // 2)
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 0.5 + 2.5 * rows)
        grid = drawn.subplots(rows, 2, sharex=True, sharey=True, squeeze=False)
        panels = list(grid.ravel())
        shown = _thinned(first)
        size = float(np.clip(9e4 / max(shown.along_m.size, 1), 0.4, 12.0))
        panels[0].scatter(shown.along_m, shown.z_m, s=size, c=style.RAW, alpha=0.55, linewidths=0)
        panels[0].set_title("As recorded")
        for axes, (name, profile) in zip(panels[1:], profiles.items(), strict=False):
            _draw_kept(axes, _thinned(profile), size)
            axes.set_title(name)
        for axes in panels[len(profiles) + 1 :]:
            axes.set_axis_off()
        for axes in panels[: len(profiles) + 1]:
            axes.spines[["top", "right"]].set_visible(False)
            axes.grid(color=style.RULE, linewidth=0.4)
            axes.set_axisbelow(True)
        for axes in grid[:, 0]:
            axes.set_ylabel("height [m]")
        for axes in grid[-1]:
            axes.set_xlabel(f"distance [m]; strip {first.width_m:g} m wide")
        grid[0, 0].set_ylim(low, high)
        along = first.along_m
        grid[0, 0].set_xlim(float(along.min()), max(float(along.max()), float(along.min()) + 1.0))
    return drawn


def _draw_kept(axes: Axes, profile: Profile, size: float) -> None:
    """What a method keeps and calls ground, over a hint of what it removes."""
    background = profile.noise_class == NOISE_BACKGROUND
    afterpulse = profile.noise_class == NOISE_AFTERPULSE
    kept = ~(background | afterpulse)
    ground = kept & (profile.classification == CLASS_GROUND)
    for member, colour, alpha in (
        (background, style.NOISE, 0.25),
        (kept & ~ground, style.SIGNAL, 0.9),
        (ground, style.GROUND, 0.9),
        (afterpulse, style.AFTERPULSE, 0.5),
    ):
        axes.scatter(
            profile.along_m[member], profile.z_m[member], s=size, c=colour, alpha=alpha,
            linewidths=0,
        )  # fmt: skip


def _height_limits(z_m: NDArray[Any], kept: NDArray[np.bool_]) -> tuple[float, float]:
    """Heights around what was kept: the whole range gate would flatten the scene."""
    scene = z_m[kept] if kept.any() else z_m
    low, high = (float(p) for p in np.percentile(scene, [0.2, 99.8]))
    margin = max(8.0, 0.35 * (high - low))
    # No empty sky where nothing was recorded.
    return max(low - margin, float(z_m.min()) - 1.0), min(high + margin, float(z_m.max()) + 1.0)


def _thinned(profile: Profile) -> Profile:
    """Every k-th point in an order that does not depend on the rows' order."""
    columns = (profile.along_m, profile.z_m, profile.noise_class, profile.classification)
    order = np.lexsort(tuple(reversed(columns)))
    step = -(-order.size // MOST_POINTS)
    along, z, noise, classes = (np.asarray(c)[order[::step]] for c in columns)
    return Profile(along, z, noise, classes, profile.width_m)
