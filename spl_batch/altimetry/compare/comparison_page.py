"""Several methods on photon profiles: a table and a stretch side by side, as JSON and as a page."""

import json
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from pydantic import Field

from spl_batch.altimetry.compare.contrast import Disputed
from spl_batch.altimetry.report.model import METHOD_NAMES, Agreement
from spl_batch.engine.report import style
from spl_batch.engine.report.page import environment
from spl_batch.engine.report.parts import Count, Number, Part, Statistics
from spl_batch.engine.report.picture import Picture
from spl_batch.formats.files.atomic import write_bytes

_QUANTILES: Final = (0.002, 0.998)


class TrackMethod(Part):
    """What one method made of the photons."""

    name: str = Field(description="Method.")
    title: str = Field(description="What a reader knows it by.")
    folder: str = Field(description="Its results, relative to the comparison.")
    photons: Count = Field(description="Photons in the input files [count].")
    signal: Count = Field(description="Signal [count].")
    false_signal: Number = Field(
        None, description="Noise to be expected among it, where the method tells [count]."
    )
    kept_only: Count = Field(description="Signal here, noise by the first method [count].")
    removed_only: Count = Field(description="Noise here, signal by the first method [count].")
    labels: Agreement | None = Field(None, description="Against the reference's labels.")
    ground: Statistics | None = Field(None, description="Ground minus reference, all beams.")
    signal_s_per_million: Number = Field(
        None, description="Stage signal, reading and writing included [s per 1e6 photons]."
    )
    failures: Count = Field(0, description="Files and tasks that failed [count].")


class TrackComparison(Part):
    """What a comparison writes down."""

    name: str = Field(description="Title of the workflow.")
    version: str = Field(description="Version of the code.")
    methods: tuple[TrackMethod, ...] = Field(description="In the order asked for.")


def write_comparison(out: Path, report: TrackComparison, disputed: Disputed | None) -> None:
    """Write ``compare.json`` and ``compare.html`` into a folder.

    Parameters
    ----------
    out : Path
        Folder.
    report : TrackComparison
        The table.
    disputed : Disputed or None
        Where the methods disagree about most photons.
    """
    content = json.dumps(report.model_dump(mode="json"), indent=2, allow_nan=False) + "\n"
    template = environment(__package__).get_template("compare_tracks.html.j2")
    page = template.render(report=report, shown=_picture(disputed), cards=report.methods)
    write_bytes(out / "compare.json", content.encode())
    write_bytes(out / "compare.html", page.encode())


def _picture(disputed: Disputed | None) -> Picture:
    title = "Where the methods disagree most"
    if disputed is None:
        return Picture(title, "The methods agree on every photon.")
    caption = f"{disputed.beam}: blue is signal, grey noise."
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
