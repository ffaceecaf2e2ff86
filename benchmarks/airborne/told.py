"""Which warning of a report says what, for scenes of which the truth is known.

A warning tells of an effect only if it says what is off: one of gaps in the ground does not tell
of a cloud. So sentences have kinds, by words that they always hold, and each effect names the kinds
that tell of it. A test holds the words against the sentences of the package.
"""

import re
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any, Final

KINDS: Final[Mapping[str, str]] = MappingProxyType({
    "cloud": "haze or cloud; its returns are class 18",
    "thin layer": "look at the profile there, and classify by hand what is no canopy",
    "fog": "ground fog, or low plants",
    "mist": "mist, or plants without gaps",
    "noise by height": "away from all surfaces the noise is not what its model expects",
    "dense noise": "noise is dense",
    "drowned": "stands out: no ground is found there",
    "kept noise": "clusters that its model does not know",
    "p-values": "have a p-value up to",
    "floats": "the DSM may rest on it",
    "late afterpulses": "m behind the return that",
    "uneven afterpulses": "less often than the law of the flightline says",
    "ranges": "returns of hard surfaces spread by",
    "swing": "recorded positions or angles swing",
    "walk": "ranges walk with the strength",
    "light": "so strong a light",
    "flightlines": "appear twice, and the terrain follows the lower one",
    "beams": "do not lie on one beam",
    "channels": "survey.channel_dimension is not set",
    "crs": "reproject the file",
    "unsure": "dtm_quality.tif says where",
    "gaps": "heights are interpolated from ground up to",
    "roof": "that was taken for ground. Heights of the terrain",
    "deck": "probably a wide bridge",
    "dam": "between ground returns as a dam",
    "deck end": "goes on level from ground",
    "steep": "what lay there was cut off",
    "block": "no wall does",
})  # fmt: skip
"""Words of a warning by its kind."""

_NUMBER = re.compile(r"[\d\s.,]*\d")


def told_by(report: Mapping[str, Any]) -> list[str]:
    """What a report warns of, and why it lacks files."""
    found = [one["sentence"] for one in report["findings"]]
    return [*found, *(failure["reason"] for failure in report["failures"])]


def new_warnings(said: Iterable[str], usual: Iterable[str]) -> list[str]:
    """Warnings that say something else than the usual ones, not other numbers alone."""
    known = {_NUMBER.sub("", text) for text in usual}
    return [text for text in said if _NUMBER.sub("", text) not in known]


def kinds(said: Iterable[str]) -> list[str]:
    """Kinds of some warnings, each once; ``other`` for such as have none."""
    found = dict.fromkeys(
        kind
        for text in said
        for kind in [key for key, words in KINDS.items() if words in text] or ["other"]
    )
    return list(found)


def telling(said: Iterable[str], of: Iterable[str]) -> list[str]:
    """Warnings that are of one of some kinds."""
    words = [KINDS[kind] for kind in of]
    return [text for text in said if any(some in text for some in words)]
