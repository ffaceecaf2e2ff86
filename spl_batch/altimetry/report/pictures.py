"""Pictures of photon profiles: photons with ground and canopy, noise rate, differences."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from spl_batch.altimetry.tasks.delivery import FLOOR, SURFACE
from spl_batch.engine.report import style
from spl_batch.engine.report.picture import Picture

MOST_PHOTONS: Final = 120_000
"""A picture of more photons is thinned evenly: it has no pixels for them."""

_SURFACE: Final = "#4fb3d9"
_FLOOR: Final = "#d08a2e"
_LINES: Final = (
    (style.GROUND, "ground"),
    ("#3f7a63", "canopy top"),
    ("#1b6f93", "water surface"),
    ("#8f4f0e", "floor"),
)


@dataclass(frozen=True, slots=True)
class TrackAxis:
    """Distance along the track without gaps that are longer than all of its data."""

    gap: NDArray[np.float64]  #: (g,): where gaps begin that are left out [m].
    left_out: NDArray[np.float64]  #: (g + 1,): length left out before each piece [m].

    @classmethod
    def of(cls, at: NDArray[np.float64]) -> "TrackAxis":
        """Axis of cells by their middles [m], in order."""
        step = np.diff(at)
        cell = float(np.median(step)) if len(step) else 0.0
        long = np.flatnonzero(step > cell * len(at))
        return cls(at[long] + cell, np.cumsum(np.r_[0.0, step[long] - 2.0 * cell]))

    def km(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions of distances [m] on the axis [km]."""
        shown: NDArray[np.float64] = at - self.left_out[np.searchsorted(self.gap, at)]
        return shown / 1000

    def line(self, at: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[Any, Any]:
        """Points of a line that is drawn across no gap."""
        stop = np.searchsorted(at, self.gap)
        return np.insert(self.km(at), stop, np.nan), np.insert(values, stop, np.nan)

    def mark(self, axes: Any) -> None:
        """Draw a dotted line for each gap, and label ticks by their distances."""
        if not len(self.gap):
            return
        ends = (self.gap - self.left_out[:-1]) / 1000
        for end in ends:
            axes.axvline(end, color=style.MUTED, linewidth=0.8, linestyle=":")
        left_out = self.left_out / 1000
        axes.xaxis.set_major_formatter(
            lambda km, _: f"{km + left_out[np.searchsorted(ends, km)]:.2f}"
        )


def draw(
    name: str,
    photons: NDArray[np.float64],
    profile: NDArray[np.float64],
    rate: NDArray[np.float64],
    differences: NDArray[np.float64] | None,
) -> dict[str, Picture]:
    """Pictures of a beam, by what they show; without the gaps that are longer than its data.

    Along-track distance is every first column [m]. ``photons``: (n, 4), height [m], label, and part
    of the water as delivered; ``profile``: (c, 5), ground, canopy top, water surface and floor [m],
    NaN where there is none; ``rate``: (r, 2), noise density [1/m2]; ``differences``: (d, 3), ground
    minus reference, ours and mDBSCAN's [m].
    """
    axis = TrackAxis.of(rate[:, 0])
    drawn = {
        "profile": _picture(
            f"Profile of {name}",
            "Dots are photons, lines what is drawn through them.",
            lambda: _profile(photons, profile, axis),
            there=len(photons) > 0,
        ),
        "rate": _picture(
            f"Noise along {name}",
            "Noise photons per metre of track and metre of height.",
            lambda: _rate(rate, axis),
            there=len(rate) > 0,
        ),
    }
    if differences is not None:
        drawn["differences"] = _picture(
            f"Ground of {name} minus reference",
            "Blue ours, red mDBSCAN's, where both were run; beyond the axis at its edge.",
            lambda: _differences(differences, axis),
        )
    return drawn


def _picture(
    title: str, caption: str, make: Callable[[], Figure], *, there: bool = True
) -> Picture:
    if not there:
        return Picture(title, "There is nothing to show.")
    with style.type_context():
        return style.picture(make(), title, f"{title}. {caption}")


def _axes(xlabel: str, ylabel: str, height_in: float) -> tuple[Figure, Any]:
    figure = style.figure(style.WIDTH_IN, height_in)
    axes = figure.subplots()
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    axes.spines[["top", "right"]].set_visible(False)
    axes.ticklabel_format(useOffset=False)
    return figure, axes


def _profile(photons: NDArray[np.float64], profile: NDArray[np.float64], axis: TrackAxis) -> Figure:
    figure, axes = _axes("distance along track [km]", "height [m]", 4.2)
    x, z, label, water = photons.T
    for mine, colour, size, name in (
        (label == 0, "#aab4be", 0.5, "noise"),
        ((label == 1) & (water == 0), style.SIGNAL, 1.2, "signal"),
        ((label == 1) & (water == SURFACE), _SURFACE, 1.2, "water surface"),
        ((label == 1) & (water == FLOOR), _FLOOR, 1.2, "floor"),
    ):
        if mine.any():
            axes.scatter(
                axis.km(x[mine]), z[mine], s=size, c=colour, linewidths=0, rasterized=True,
                label=name,
            )  # fmt: skip
    at, *lines = profile.T
    for line, (colour, name) in zip(lines, _LINES, strict=True):
        if np.isfinite(line).any():
            axes.plot(*axis.line(at, line), color=colour, linewidth=0.8, label=f"{name} line")
    axis.mark(axes)
    axes.legend(loc="upper right", markerscale=6)
    return figure


def _rate(rate: NDArray[np.float64], axis: TrackAxis) -> Figure:
    figure, axes = _axes("distance along track [km]", "noise [photons/m\N{SUPERSCRIPT TWO}]", 2.0)
    axes.plot(*axis.line(*rate.T), color=style.NOISE, linewidth=0.8)
    axis.mark(axes)
    axes.set_ylim(bottom=0)
    return figure


def _differences(differences: NDArray[np.float64], axis: TrackAxis) -> Figure:
    figure, axes = _axes("distance along track [km]", "ground minus reference [m]", 2.4)
    at, ours, theirs = differences.T
    known = np.abs(ours[np.isfinite(ours)])
    limit = max(float(np.percentile(known, 99)) * 2.0, 1.0)
    for values, colour in ((theirs, style.NOISE), (ours, style.SIGNAL)):
        axes.plot(axis.km(at), np.clip(values, -limit, limit), ".", color=colour, markersize=2.5)
    axes.axhline(0.0, color=style.MUTED, linewidth=0.6)
    axis.mark(axes)
    axes.set_ylim(-limit * 1.05, limit * 1.05)
    return figure
