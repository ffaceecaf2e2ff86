"""Pictures of a water surface: its raster, the errors of pixels, the histogram of bins."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from spl_batch.engine.report import style
from spl_batch.engine.report.maps import WIDTH_IN as MAP_WIDTH_IN
from spl_batch.engine.report.maps import Raster, draw_ramp, spread
from spl_batch.engine.report.number_format import metres, number
from spl_batch.engine.report.picture import Picture

Floats = NDArray[np.float64]

PANELS = (
    ("bias_m", "bias [mm]", 1e3),
    ("variance_m2", "standard deviation [mm]", 1e3),
    ("mse_m2", "root mean square error [mm]", 1e3),
    ("normal_deg", "angle of the normal [deg]", 1.0),
)
"""Errors of a pixel: their names, and the factor to the unit in the name."""


def make_pictures(
    height: Raster | None,
    pixels: dict[str, Floats],
    histogram: NDArray[np.int64],
    gate: tuple[int, int],
    intensity: Floats,
) -> dict[str, Picture]:
    """Draw everything that there is data for.

    Parameters
    ----------
    height : Raster, optional
        Mean height of a file's surfaces [m].
    pixels : mapping of str to (rows, cols) float64
        Errors of pixels; empty without truth.
    histogram : (bins + 1,) int64
        Hits of each bin of that file.
    gate : (int, int)
        First bin of the gate, first one behind it.
    intensity : (rows, cols) float64
        Share of frames with a hit.
    """
    made = {"height": _height(height), "intensity": _intensity(intensity)}
    made["histogram"] = _histogram(histogram, gate)
    return made | ({"pixels": _pixels(pixels)} if pixels else {})


def _finished(drawn: Figure, title: str, caption: str) -> Picture:
    png, width, height = style.to_png(drawn)
    return Picture(title, caption, f"{title}. {caption}", png, width, height)


def _height(raster: Raster | None) -> Picture:
    title = "Mean surface"
    if raster is None or not raster.any_value:
        return Picture(title, "No raster holds a value.")
    middle = float(np.nanmedian(raster.masked()))
    shown = Raster(1000 * (raster.masked() - middle), raster.extent_m)
    reach = max(float(np.abs(spread(shown.values, 1, 99)).max()), 1.0)
    drawn = draw_ramp(
        shown,
        title,
        "height above the median [mm]",
        ramp=style.DIFFERENCE,
        limits=(-reach, reach),
        extend="both",
    )
    return _finished(
        drawn,
        title,
        f"Mean of the surfaces of the first file, above its median height of {metres(middle, 3)}. "
        "Calm water is even; a tilt or a bowl points to the boresight or to range walk.",
    )


def _histogram(counts: NDArray[np.int64], gate: tuple[int, int]) -> Picture:
    title = "Time bins of the first file"
    low, high = gate
    first, last = max(low - 40, 1), min(high + 40, len(counts))
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 3.0)
        axes = drawn.add_subplot()
        axes.bar(np.arange(first, last), counts[first:last], width=1.0, color=style.SIGNAL)
        axes.axvspan(low - 0.5, high - 0.5, color=style.RULE, zorder=0)
        axes.set(title=title, xlabel="time bin [number]", ylabel="hits [count]", xlim=(first, last))
        axes.yaxis.set_major_formatter(lambda hits, _: number(hits))
    return _finished(
        drawn, title, f"Grey is the gate, bins {low} to {high - 1}: hits outside are not used."
    )


def _intensity(share: Floats) -> Picture:
    title = "Intensity"
    with style.type_context():
        drawn = style.figure(MAP_WIDTH_IN, 4.2)
        axes = drawn.add_subplot()
        shown = axes.imshow(share, cmap=style.DENSITY, vmin=0.0, interpolation="nearest")
        drawn.colorbar(shown, ax=axes, label="share of frames with a hit [1/1]")
        axes.set(title=title, xlabel="column [pixel]", ylabel="row [pixel]")
    return _finished(drawn, title, "Where the beam lies on the array, and which pixels are dead.")


def _pixels(maps: dict[str, Floats]) -> Picture:
    title = "Errors of each pixel"
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 8.0)
        for axes, (key, label, factor) in zip(drawn.subplots(2, 2).flat, PANELS, strict=True):
            values = factor * (maps[key] if key in {"bias_m", "normal_deg"} else np.sqrt(maps[key]))
            top = float(np.nanpercentile(np.abs(values), 98)) if np.isfinite(values).any() else 1.0
            colours = {"cmap": style.SKY, "vmin": 0.0, "vmax": top}
            if key == "bias_m":
                colours |= {"cmap": style.DIFFERENCE, "vmin": -top}
            shown = axes.imshow(values, interpolation="nearest", **colours)
            drawn.colorbar(shown, ax=axes, label=label)
            axes.set(xlabel="column [pixel]", ylabel="row [pixel]")
    return _finished(
        drawn,
        title,
        "Over all acquisitions. What follows the beam points to range walk, what follows nothing "
        "to the delays of pixels.",
    )
