"""What each code of a water surface's findings means (:mod:`spl_batch.engine.findings`)."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.engine.findings import Code

CODES: Final[Mapping[str, Code]] = MappingProxyType(
    {
        "W01": Code(
            "Frames are missing or left out",
            {
                "chunks": "{count} chunks are missing and read as frames without a hit; a part of "
                "the file is gone, or the laser paused",
                "rest": "the last {count} frames do not fill an acquisition of {per} frames and "
                "are left out",
                "truth": "the truth is given for acquisitions of {truth} frames, but "
                "surface.frames_per_acquisition is {per}: accuracy is not measured against it",
            },
            remedy="copy the file again, or set surface.frames_per_acquisition as it was recorded",
            noun="file",
        ),
        "W02": Code("No CRS", "survey.crs is not set: the rasters will carry no CRS"),
    }
)
"""Codes of the water receiver."""
