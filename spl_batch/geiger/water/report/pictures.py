"""Pictures of a water surface: its raster, the errors of pixels, the histogram of bins."""

from dataclasses import dataclass

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


@dataclass(frozen=True, slots=True)
class WaterPictures:
    """Plain arrays that the pictures are drawn from."""

    height: Raster | None  #: Mean height of a file's surfaces [m].
    #: mapping of str to (rows, cols) float64: errors of pixels; empty without truth.
    pixels: dict[str, Floats]
    #: (a, 3): bias [m], MSE [m2] and normal error [deg] of each surface; none without truth.
    surfaces: Floats
    histogram: NDArray[np.int64] | None  #: (bins + 1,): hits of each bin.
    gate: tuple[int, int]  #: First bin of the gate, first one behind it.
    intensity: Floats | None  #: (rows, cols): share of frames with a hit.


def make_pictures(given: WaterPictures) -> dict[str, Picture]:
    """Draw everything that there is data for."""
    made = {"height": _height(given.height)}
    if given.histogram is not None:
        made["histogram"] = _histogram(given.histogram, given.gate)
    if given.intensity is not None:
        made["intensity"] = _intensity(given.intensity)
    if len(given.surfaces) > 1:
        made["each"] = _each(given.surfaces)
    if given.pixels:
        made["pixels"] = _pixels(given.pixels)
    return made


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


def _each(rows: Floats) -> Picture:
    title = "Errors of each surface"
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 3.4)
        bias, normal = drawn.subplots(1, 2)
        along = np.arange(len(rows))
        bias.plot(along, 1e3 * rows[:, 0], ".", color=style.SIGNAL, label="bias")
        bias.plot(along, 1e3 * np.sqrt(rows[:, 1]), ".", color=style.NOISE, label="RMSE")
        bias.set(title="Heights", ylabel="error of depth [mm]", xlabel="acquisition [number]")
        bias.legend()
        for axes in (bias, normal):
            axes.xaxis.get_major_locator().set_params(integer=True)
        normal.plot(along, rows[:, 2], ".", color=style.SIGNAL)
        normal.set(
            title="Normals", ylabel="mean error of a pixel's normal [deg]",
            xlabel="acquisition [number]", ylim=(0, None),
        )  # fmt: skip
    return _finished(
        drawn,
        title,
        "One point for each acquisition. A bias that drifts points to a laser that is not warm.",
    )


def _pixels(maps: dict[str, Floats]) -> Picture:
    title = "Errors of each pixel"
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 8.0)
        for k, (key, label, factor) in enumerate(PANELS):
            axes = drawn.add_subplot(2, 2, k + 1)
            values = maps[key] if key in {"bias_m", "normal_deg"} else np.sqrt(maps[key])
            signed = key == "bias_m"
            scaled = factor * values
            top = float(np.nanpercentile(np.abs(scaled), 98)) if np.isfinite(scaled).any() else 1.0
            shown = axes.imshow(
                scaled,
                cmap=style.DIFFERENCE if signed else style.SKY,
                vmin=-top if signed else 0.0,
                vmax=top,
                interpolation="nearest",
            )
            drawn.colorbar(shown, ax=axes, label=label)
            axes.set(xlabel="column [pixel]", ylabel="row [pixel]")
    return _finished(
        drawn,
        title,
        "Over all acquisitions. What follows the beam points to range walk, what follows nothing "
        "to the delays of pixels.",
    )
