"""Maps of one place that a reader switches between, with what failed marked on each.

Radio buttons and style sheets do it without a script: it works by keyboard and where no script may
run, and a printed page shows all maps.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from spl_batch.engine.report.parts import Failure
from spl_batch.engine.report.picture import Extent, MapPlace, Picture


@dataclass(frozen=True, slots=True)
class Mark:
    """A rectangle on a map."""

    #: Left and upper edge, width and height, as shares of the picture.
    box: tuple[float, float, float, float]
    text: str  #: What it means.

    @property
    def style(self) -> str:
        """Where it lies, as a page's style sheet says it."""
        edges = zip(("left", "top", "width", "height"), self.box, strict=True)
        return ";".join(f"{edge}:{100 * share:.2f}%" for edge, share in edges)


@dataclass(frozen=True, slots=True)
class Layer:
    """A map that can be chosen."""

    key: str  #: Its key among the pictures.
    picture: Picture  #: The map, or why there is none.
    marks: tuple[Mark, ...]  #: Places that failed, as far as the map shows them.


def layers(
    keys: Iterable[str], pictures: Mapping[str, Picture], failures: Sequence[Failure]
) -> list[Layer]:
    """Maps that a reader switches between.

    Parameters
    ----------
    keys : iterable of str
        Keys of the maps, in their order; those without a picture are left out.
    failures : sequence of Failure
        What did not make it, places among it.
    """
    found = ((key, pictures[key]) for key in keys if key in pictures)
    return [Layer(key, picture, tuple(_marks(picture, failures))) for key, picture in found]


def _marks(picture: Picture, failures: Iterable[Failure]) -> Iterable[Mark]:
    if picture.place is None:
        return
    for failure in failures:
        if failure.extent_m is None:
            continue
        box = _on_picture(failure.extent_m, picture.place)
        if box is not None:
            yield Mark(box, f"{failure.place} failed in stage {failure.stage}: {failure.reason}")


def _on_picture(extent_m: Extent, place: MapPlace) -> tuple[float, float, float, float] | None:
    """Left, top, width and height of a place, as shares of a picture; None where it is beside."""
    west, east, south, north = place.extent_m
    left, top, wide, high = place.box
    x0, x1 = max(extent_m[0], west), min(extent_m[1], east)
    y0, y1 = max(extent_m[2], south), min(extent_m[3], north)
    if x0 >= x1 or y0 >= y1:
        return None
    per_x, per_y = wide / (east - west), high / (north - south)
    return (
        left + (x0 - west) * per_x,
        top + (north - y1) * per_y,
        (x1 - x0) * per_x,
        (y1 - y0) * per_y,
    )
