"""Report of an airborne survey: model, sentences, pictures, page."""

from typing import Final

CLIP_PAGE: Final = "report_3d.html"
"""Name of the page beside the report on which a square can be turned."""
