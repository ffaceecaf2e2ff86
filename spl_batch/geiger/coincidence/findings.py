"""What each code of coincidence processing means (:mod:`spl_batch.engine.findings`)."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.engine.findings import Code

CODES: Final[Mapping[str, Code]] = MappingProxyType(
    {
        "K01": Code(
            "Detections or frames are missing",
            {
                "empty": "holds no rows",
                "unread": "some detections could not be read: a frame counts only if its number "
                "lies between those of detections that were read",
                "crs": "survey.crs is not set: the points will have no CRS",
            },
            remedy="copy such files again, or write what is missing",
            noun="file",
        ),
        "K02": Code(
            "Detections lie off their lines of sight",
            "detections lie {fields:.1f} fields of view off the lines of sight of their detectors",
            "looks are counted in wrong places",
            "check heading, roll and pitch of the frames, and rows, columns and ifov_rad of the "
            "array",
            noun="file",
        ),
    }
)
"""Codes of coincidence processing."""
