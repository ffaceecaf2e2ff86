"""Tasks of ``kind: altimetry``: files, beams, segments of track, profiles, delivery."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.engine.tasks.runner import Kind

KINDS: Final[Mapping[str, Kind]] = MappingProxyType(
    {
        "index_file": Kind("index", "spl_batch.altimetry.tasks.index:index_file", ()),
        "take_in": Kind(
            "index",
            "spl_batch.altimetry.tasks.index:take_in",
            ("track.prf_hz", "rate.cell_m", "signal.window_m", "work"),
        ),
        "label": Kind(
            "signal",
            "spl_batch.altimetry.tasks.labels:label_segment",
            ("rate", "signal", "profile.photons_factor", "reference.baseline"),
        ),
        "profile": Kind(
            "profile",
            "spl_batch.altimetry.tasks.heights:profile_beam",
            ("profile", "reference.baseline"),
        ),
        "compare": Kind("profile", "spl_batch.altimetry.tasks.reference:compare", ("reference",)),
        "deliver_beam": Kind(
            "deliver",
            "spl_batch.altimetry.tasks.delivery:deliver_beam",
            ("outputs.refraction", "track.off_nadir_deg"),
        ),
        "deliver_file": Kind(
            "deliver", "spl_batch.altimetry.tasks.delivery:deliver_file", ("outputs.hdf5",)
        ),
    }
)
"""What is done, in the order in which it is done."""
