"""The map that shows where the pieces of a survey lie."""

from collections.abc import Sequence
from typing import Final

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from spl_batch.engine.report import style
from spl_batch.engine.report.maps import framed, furnish

Extent = tuple[float | None, float | None, float | None, float | None]
"""West, east, south and north edges [m]."""

LEAST_SHARE: Final = 0.02
"""A box narrower than this share of the map is a dot."""

LARGEST_NUMBERED: Final = 60
"""Pieces that are numbered on the map: more would hide each other [count]."""


def draw_locator(extents: Sequence[Extent]) -> Figure:
    """Boxes of all pieces, numbered from 1.

    Parameters
    ----------
    extents : sequence of Extent
        At least one piece [m].
    """
    boxes = [tuple(float(edge or 0.0) for edge in extent) for extent in extents]
    whole = _margin(
        min(b[0] for b in boxes), max(b[1] for b in boxes),
        min(b[2] for b in boxes), max(b[3] for b in boxes),
    )  # fmt: skip
    least = LEAST_SHARE * (whole[1] - whole[0])
    with style.type_context():
        drawn, axes = framed(whole, "Pieces of the survey")
        for number, (west, east, south, north) in enumerate(boxes, start=1):
            axes.add_patch(
                Rectangle((west, south), east - west, north - south, fc=style.SIGNAL, ec=style.INK)
            )
            middle = ((west + east) / 2, (south + north) / 2)
            if max(east - west, north - south) < least:
                axes.plot(*middle, "o", ms=5, color=style.SIGNAL, mec=style.INK, mew=0.7)
            if number <= LARGEST_NUMBERED:
                axes.annotate(
                    str(number), middle, xytext=(7, 5), textcoords="offset points",
                    fontweight="bold",
                )  # fmt: skip
        furnish(axes, whole)
    return drawn


def _margin(
    west: float, east: float, south: float, north: float
) -> tuple[float, float, float, float]:
    """A map's extent around boxes: a tenth more to each side, and never a mere line."""
    reach = max(east - west, north - south, 1.0)
    grow = 0.12 * reach
    least = 0.3 * reach
    tall = max((least - (north - south)) / 2, 0.0)
    thin = max((least - (east - west)) / 2, 0.0)
    return (west - grow - thin, east + grow + thin, south - grow - tall, north + grow + tall)
