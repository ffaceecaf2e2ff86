"""Noise that the filter tells among what it takes, beside labelled or true noise, by part.

The filter tells how many noise photons are expected among those that it takes. A sum over a track
may be right by errors that cancel, so it is looked at by part: land, where no water is seen, above
the water, among its waves, in the rest of the first metre, and below.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.altimetry.photon_beams import Beam, Mask, Photons
from spl_batch.altimetry.water.level_water import SURFACE_M, WAVE_M
from spl_batch.constants import QUANTA_PER_M

PARTS = ("land", "no water", "above", "waves", "first metre", "below")

LEAST, WITHIN = 20, 0.3
"""Photons of noise that a part holds to be judged [count], and how well it is to be told."""


class Told(NamedTuple):
    """Noise of a part of a track among what is taken: told by the filter, and by the labels."""

    part: str
    told: float
    labelled: int


def part_of(beam: Beam, along: NDArray[Any], height: NDArray[Any], ashore: Mask) -> NDArray[Any]:
    """Number of the part that places lie in, (n,) int."""
    depth = beam.depth_m(along, height)
    edges = (-SURFACE_M, WAVE_M, SURFACE_M)
    wet = 2 + np.searchsorted(edges, np.nan_to_num(depth))
    return np.where(ashore, 0, np.where(np.isnan(depth), 1, wet))


def by_part(
    beam: Beam, kept: Mask, noise: Mask, ashore: Callable[[NDArray[Any]], Mask]
) -> list[Told]:
    """Noise told and labelled of each part, of photons that a beam has kept.

    Parameters
    ----------
    noise : (n,) bool
        Photons that are noise by the labels.
    ashore : callable
        Whether places along the track lie over land.
    """
    along, height, told = beam.told_at
    theirs = part_of(beam, along, height, ashore(along))
    mine = part_of(beam, beam.along, beam.height, ashore(beam.along))
    return [
        Told(name, float(told[theirs == i].sum()), np.count_nonzero(kept & noise & (mine == i)))
        for i, name in enumerate(PARTS)
    ]


def in_words(parts: Iterable[Told]) -> str:
    """Told over labelled of the parts that have some."""
    said = [
        f"{p.part} {p.told:.0f} / {p.labelled}" for p in parts if p.labelled or round(p.told) > 0
    ]
    return ", ".join(said)


def judged(parts: Sequence[Told]) -> str:
    """How many parts with enough noise are told well, by name."""
    said = []
    for name in PARTS:
        own = [p for p in parts if p.part == name and p.labelled >= LEAST]
        well = [p for p in own if abs(p.told / p.labelled - 1.0) <= WITHIN]
        told, labelled = sum(p.told for p in own), sum(p.labelled for p in own)
        if own:
            said.append(
                f"  {name:12}{len(well):4} of {len(own):3} within {WITHIN:.0%}; "
                f"all: told {told:.0f}, labelled {labelled}: {told / labelled:.2f}"
            )
    return "\n".join(said)


def near(photons: Photons, places: Sequence[NDArray[Any]], size_m: Sequence[float]) -> Any:
    """Distance of places from the nearest photon, in boxes of this half-size, (n,) float64."""
    size = np.array(size_m) * QUANTA_PER_M
    tree = cKDTree(np.stack(photons, axis=1) / size)
    return tree.query(np.stack(places, axis=1) / size, p=np.inf)[0]
