"""The pictures of a report: from plain arrays to PNG with title and caption.

Each array is optional. A picture that cannot be drawn stays in the set, without an image
and with the sentence that names the reason, so that a reader never wonders whether something
was forgotten.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from spl_batch.airborne.products.product_table import NAMES
from spl_batch.airborne.report.model import Report
from spl_batch.airborne.report.plots import (
    Profile,
    difference_title,
    draw_histogram,
    draw_profile,
)
from spl_batch.airborne.report.verdicts import photon_counting, terrain_statistics
from spl_batch.engine.report import style
from spl_batch.engine.report.maps import (
    Raster,
    draw_ramp,
    draw_relief,
    nice,
    reduce_raster,
    spread,
)
from spl_batch.engine.report.parts import Statistics
from spl_batch.engine.report.picture import Picture
from spl_batch.formats.units import Units

PICTURES: Final = (
    "dtm", "dsm", "chm", "difference", "histogram", "profile", "noise_density", "dtm_quality",
    "density", "strips",
)  # fmt: skip
"""Names of all pictures, in the order in which a reader wants them."""

OF_PRODUCTS: Final = tuple(name for name in PICTURES if name in NAMES)
"""Pictures of delivered rasters: a picture has the name of its raster."""

IN_UNIT: Final = ("dtm", "dsm", "chm", "dtm_quality")
"""Of these, maps in the unit of heights that is delivered; differences are in centimetres."""

NO_REFERENCE: Final = "Without reference points there is nothing to compare with."
NO_RASTER: Final = "The raster holds no value."
NOT_MADE: Final = "This raster was not made."


def make_pictures(
    rasters: Mapping[str, Raster],
    report: Report,
    profile: Profile | None = None,
    differences_m: NDArray[Any] | None = None,
) -> dict[str, Picture]:
    """Draw everything that there is data for; titles quote the report.

    Parameters
    ----------
    rasters : mapping of str to Raster
        By the names of their pictures, those that there are; ``difference`` is DTM minus reference,
        ``strips`` the height between flightlines that overlap, whichever lies above [m]. Larger
        than a picture they may be given reduced, as an overview. Pictures are in the units of
        delivery.
    profile : Profile, optional
        A vertical strip, about 100 m long and 2-3 m wide; maps show where it lies.
    differences_m : (n,) ndarray, optional
        Single differences, DTM minus reference; all or an even sample [m].

    Returns
    -------
    dict of str to Picture
        All :data:`PICTURES`.
    """
    photons, units = photon_counting(report), report.survey.units.known
    shown = {name: _in_units(name, raster, units) for name, raster in rasters.items()}
    if profile is not None and profile.line_m is not None:
        for name in {"dtm", "dsm", "chm"} & shown.keys():
            shown[name] = replace(shown[name], line_m=profile.line_m)
    terrain = terrain_statistics(report)
    overall = None if report.accuracy is None else report.accuracy.dtm.get("all")
    if overall is None and terrain is not None:
        overall = terrain[1]
    amounts = AMOUNTS if photons else {**AMOUNTS, "density": POINT_DENSITY}
    made = {
        **{name: _relief(shown, name, units, photons=photons) for name in RELIEF_TEXT},
        **{name: _amount(shown.get(name), amount, units) for name, amount in amounts.items()},
        "difference": _difference(shown.get("difference"), overall, units),
        "histogram": _histogram(differences_m, overall, units),
        "profile": _profile(profile, photons=photons),
    }
    return {name: made[name] for name in PICTURES}


def _in_units(name: str, raster: Raster, units: Units) -> Raster:
    """A raster as it is shown: its place in the units of the CRS, heights too."""
    placed = replace(raster, axis_m=units.horizontal_m)
    if units.vertical_m == 1.0 or name not in IN_UNIT:
        return placed
    return replace(placed, values=raster.masked() / units.vertical_m)


def _map(
    raster: Raster | None, title: str, caption: str, missing: str, draw: Callable[[Raster], Figure]
) -> Picture:
    """A map, or why there is none."""
    if raster is None:
        return Picture(title, missing)
    if not raster.any_value:
        return Picture(title, NO_RASTER)
    return style.picture(draw(raster), title, caption)


FLAT: Final = 0.25
"""Share of the heights of terrain and surface below which the terrain has colours of its own."""

RELIEF_TEXT: Final[Mapping[str, tuple[str, str]]] = {
    "dtm": (
        "Terrain (DTM)",
        (
            "Bare ground. Buildings and trees should have gone without a trace: look for bumps "
            "under them and for pits{pits}. Grey is nodata."
        ),
    ),
    "dsm": (
        "Surface (DSM)",
        (
            "Highest surface. Look for lone spikes{spikes}, and for crisp roof edges. {colours} "
            "the terrain."
        ),
    ),
}


def _relief(rasters: Mapping[str, Raster], key: str, units: Units, *, photons: bool) -> Picture:
    (title, caption), legend = RELIEF_TEXT[key], f"height [{units.of_heights[0]}]"
    limits, raster = _heights(rasters, key), rasters.get(key)
    shared = limits == _heights(rasters, "dtm" if key == "dsm" else "dsm")
    caption = caption.format(
        colours="Same colours as" if shared else "Colours of its own, as it spans more than",
        pits=", which would be afterpulses taken for ground" if photons else "",
        spikes=", which would be noise taken for signal" if photons else "",
    )
    if raster is not None and raster.line_m is not None:
        caption += " The line is the profile's."
    return _map(
        raster, title, caption, NOT_MADE, lambda given: draw_relief(given, title, legend, limits)
    )


def _heights(rasters: Mapping[str, Raster], key: str) -> tuple[float, float] | None:
    """Ends of a ramp of heights: one for both, so that terrain and surface compare by colour.

    Terrain far flatter than what stands on it would be of one colour: each has its own then.
    """
    ends = {
        name: spread(reduce_raster(rasters[name]).values, 0.5, 99.5)
        for name in RELIEF_TEXT
        if name in rasters and rasters[name].any_value
    }
    if not ends:
        return None
    whole = min(e[0] for e in ends.values()), max(e[1] for e in ends.values())
    low, high = ends.get("dtm", whole)
    flat = high - low < FLAT * (whole[1] - whole[0])
    return ends.get(key, whole) if flat else whole


class Amount(NamedTuple):
    """A map of something that begins at zero."""

    title: str
    legend: str  #: What it shows, with its unit; ``{}`` is that of heights.
    caption: str
    ramp: Colormap
    percent: float = 98.0  #: Share of the cells that the colours resolve, from below [%].
    least: float = 0.0  #: Upper end of the colours, at least [unit of the legend].
    scale: float = 1.0  #: Units of the legend in one of the raster.
    missing: str = NOT_MADE  #: Why there is no raster, where there is none.


AMOUNTS: Final[Mapping[str, Amount]] = {
    "chm": Amount(
        "Heights above ground (CHM)",
        "height above ground [{}]",
        "Surface minus terrain. Open ground is near zero; roofs are even, trees are rough.",
        style.CANOPY,
        percent=99.5,
        least=1.0,
    ),
    "noise_density": Amount(
        "Expected background noise",
        "noise returns per cubic metre",
        "Solar and dark noise near the surface, from the rates of all beamlets that cross a "
        "place. It steps where flightlines overlap, and grows over bright ground.",
        style.SKY,
        percent=99.0,
        missing="No noise model was made for this run.",
    ),
    "dtm_quality": Amount(
        "How well the terrain is known",
        "standard deviation of the terrain [{}]",
        "By how far the nearest ground is, and by how much heights differ here over such a "
        "distance. What was wrongly taken for ground does not show.",
        style.SKY,
    ),
    "density": Amount(
        "Point density",
        "signal returns per square metre",
        "Signal. Look for gaps between flightlines; the arcs are the track of the circular scan.",
        style.DENSITY,
    ),
    "strips": Amount(
        "Height between flightlines",
        "height between flightlines [cm]",
        "Median over the planar patches of a place, whichever flightline lies above. An even tint "
        "along a flightline is an offset of the whole strip, a change across it a roll angle that "
        "is off.",
        style.DENSITY,
        least=1.0,
        scale=100.0,
        missing="No two flightlines share enough planar patches to be compared.",
    ),
}
"""Maps of amounts, by the names of their pictures."""

POINT_DENSITY: Final = AMOUNTS["density"]._replace(
    legend="points per square metre",
    caption="All points that take part. Look for gaps between flightlines.",
)
"""Density where no noise was looked for."""


def _amount(raster: Raster | None, of: Amount, units: Units) -> Picture:
    def draw(given: Raster) -> Figure:
        shown = given if of.scale == 1.0 else replace(given, values=of.scale * given.masked())
        top = max(spread(reduce_raster(shown).values, 1, of.percent)[1], of.least)
        legend = of.legend.format(units.of_heights[0])
        return draw_ramp(shown, of.title, legend, ramp=of.ramp, limits=(0.0, top))

    return _map(raster, of.title, of.caption, of.missing, draw)


def _difference(raster: Raster | None, statistics: Statistics | None, units: Units) -> Picture:
    title = "Terrain minus reference"

    def draw(given: Raster) -> Figure:
        scaled = replace(given, values=100 * given.masked())
        size = spread(abs(reduce_raster(scaled).values), 0, 95)[1]
        reach = max(nice(size * 1.6), 2.0)
        of_all = "" if statistics is None or statistics.rmse is None else ", all surfaces"
        return draw_ramp(
            scaled, difference_title(f"{title}{of_all}", statistics, units),
            "DTM minus reference [cm]", ramp=style.DIFFERENCE, limits=(-reach, reach),
            extend="both",
        )  # fmt: skip

    caption = (
        "Blue is too low, red too high, white is right. Patches that follow buildings or trees "
        "point to the ground filter, stripes that follow the flight to the alignment of "
        "flightlines, an even tint to a bias between the two sensors."
    )
    return _map(raster, title, caption, NO_REFERENCE, draw)


def _histogram(values: NDArray[Any] | None, statistics: Statistics | None, units: Units) -> Picture:
    title = "Distribution of the differences"
    if values is None:
        return Picture(title, NO_REFERENCE)
    if not np.isfinite(values).any():
        return Picture(title, "No difference could be formed.")
    return style.picture(
        draw_histogram(values, statistics, units),
        title,
        "A narrow peak at zero is what one wants. NMAD describes the peak and RMSE the whole: "
        "where RMSE is much larger, a few gross errors make it so.",
    )


def _profile(profile: Profile | None, *, photons: bool) -> Picture:
    title = "Vertical profile, before and after" if photons else "Vertical profile"
    if profile is None or len(profile.along_m) == 0:
        return Picture(title, "No strip of the survey holds points to show.")
    return style.picture(
        draw_profile(profile),
        title,
        "The same strip twice. Above, every recorded return; below, what each was taken for. "
        + (
            "Look for wires, roof edges and crowns that are signal, and for an empty sky. Noise "
            "far above and below the scene is cut off here."
            if photons
            else "Look for roofs, crowns and wires that were taken for ground."
        ),
    )
