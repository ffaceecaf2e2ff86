"""Several methods on photon profiles: a table and a stretch side by side, as JSON and as a page."""

from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from pydantic import Field

from spl_batch.altimetry.compare.contrast import Disputed
from spl_batch.altimetry.report.model import METHOD_NAMES, Agreement
from spl_batch.engine.report import style
from spl_batch.engine.report.comparison import Compared, ComparedMethod, write_comparison
from spl_batch.engine.report.parts import Count, Number, Statistics
from spl_batch.engine.report.picture import Picture

_QUANTILES: Final = (0.002, 0.998)


class TrackMethod(ComparedMethod):
    """What one method made of the photons."""

    title: str = Field(description="What a reader knows it by.")
    photons: Count = Field(description="Photons in the input files [count].")
    false_signal: Number = Field(
        None, description="Noise to be expected among it, where the method tells [count]."
    )
    labels: Agreement | None = Field(None, description="Against the reference's labels.")
    ground: Statistics | None = Field(None, description="Ground minus reference, all beams.")
    signal_s_per_million: Number = Field(
        None, description="Stage signal, reading and writing included [s per 1e6 photons]."
    )


class TrackComparison(Compared):
    """What a comparison writes down."""

    name: str = Field(description="Title of the workflow.")
    methods: tuple[TrackMethod, ...] = Field(description="In the order asked for.")


def write(out: Path, report: TrackComparison, disputed: Disputed | None) -> None:
    """Write ``compare.json`` and ``compare.html`` into a folder.

    Parameters
    ----------
    disputed : Disputed or None
        Where the methods disagree about most photons.
    """
    pictures = [_picture(disputed)]
    write_comparison(out, report, "compare_tracks.html.j2", __package__, pictures)


def _picture(disputed: Disputed | None) -> Picture:
    title = "Where the methods disagree most"
    if disputed is None:
        return Picture(title, "The methods agree on every photon.")
    caption = f"{disputed.beam}."
    with style.type_context():
        png, width, height = style.to_png(_draw(disputed))
    return Picture(title, caption, f"{title}. {caption}", png, width, height)


def _draw(disputed: Disputed) -> Figure:
    """The same stretch as each method sees it, below each other."""
    rows = len(disputed.signal)
    drawn = style.figure(style.WIDTH_IN, 0.5 + 1.7 * rows)
    panels = drawn.subplots(rows, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    along, height = disputed.along_m / 1000.0, disputed.height_m
    # Where the first method finds something: another may keep noise all over the gate.
    first = next(iter(disputed.signal.values()))
    shown = height[first] if first.any() else height
    low, high = np.quantile(shown, _QUANTILES)
    room = max(0.5 * (high - low), 5.0)
    for axes, (method, signal) in zip(panels, disputed.signal.items(), strict=True):
        for mine, colour, size in ((~signal, "#aab4be", 1.0), (signal, style.SIGNAL, 1.6)):
            axes.scatter(along[mine], height[mine], s=size, c=colour, linewidths=0, rasterized=True)
        axes.set_title(METHOD_NAMES[method])
        axes.set_ylabel("height [m]")
        axes.spines[["top", "right"]].set_visible(False)
        axes.ticklabel_format(useOffset=False)
    panels[0].set_ylim(low - room, high + room)
    panels[-1].set_xlabel("distance along track [km]")
    return drawn
