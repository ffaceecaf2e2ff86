"""Tasks of ``kind: altimetry``: files, beams, segments of track, profiles, delivery."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.altimetry.runner import delivery, heights, intake, photons
from spl_batch.runner import Kind

_FOUND: Final = ("rate", "signal", "reference.baseline")

KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "index_file": Kind("index", intake.index_file, ()),
        "take_in": Kind("index", intake.take_in, ("track.prf_hz", "rate.cell_m")),
        "rate": Kind("rate", photons.find_rate, ("rate", "signal", "work")),
        "score": Kind("signal", photons.score, _FOUND),
        "select": Kind("signal", photons.select, ("rate", "signal", "profile")),
        "profile": Kind("profile", heights.profile_beam, ("profile", "reference.baseline")),
        "compare": Kind("profile", heights.compare, ("reference",)),
        "deliver_beam": Kind("deliver", delivery.deliver_beam, ()),
        "deliver_file": Kind("deliver", delivery.deliver_file, ("outputs.hdf5",)),
    }
)
"""What is done, in the order in which it is done."""
