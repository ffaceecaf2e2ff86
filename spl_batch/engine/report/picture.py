"""One picture of a report: PNG with title and caption, or the reason why there is none."""

import base64
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Picture:
    """One picture of the report, or the reason why there is none."""

    #: Heading, and what to look for (or why the picture is missing).
    title: str
    caption: str
    alt: str = ""  #: For a reader who cannot see it.
    png: bytes = b""  #: Empty where there is no picture.
    #: Size that the page lays out.
    width_px: int = 0
    height_px: int = 0

    @property
    def data_uri(self) -> str:
        """The image as text that a page can hold."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")
