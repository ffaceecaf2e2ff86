"""One picture of a report: PNG with title and caption, or the reason why there is none."""

import base64
from dataclasses import dataclass

Extent = tuple[float, float, float, float]
"""West, east, south, north edges [m]."""


@dataclass(frozen=True, slots=True)
class MapPlace:
    """Where a map lies on its picture, and in the world."""

    #: Left and upper edge, width and height, as shares of the picture.
    box: tuple[float, float, float, float]
    extent_m: Extent


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture of the report, or the reason why there is none."""

    #: Heading, and what to look for (or why the picture is missing).
    title: str
    caption: str
    alt: str = ""  #: What a reader who cannot see it is told.
    png: bytes = b""  #: Empty where there is no picture.
    #: Size that the page lays out.
    width_px: int = 0
    height_px: int = 0
    place: MapPlace | None = None  #: Where a map lies on it, so that a page can mark places.

    @property
    def data_uri(self) -> str:
        """The image as text that a page can hold."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")
