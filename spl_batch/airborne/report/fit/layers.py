"""Noise that is not what its model expects: by height, in the whole survey and in each block."""

from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.noise.haze import CUBE_M
from spl_batch.airborne.report.fit.places import Box, Terrain, clipped, extent_of, within
from spl_batch.engine.report.number_format import as_ascii
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import counted

TOLD: Final = 1.25
"""Times more, or less, noise than expected that is told; the model is within 1.03 in all strata
that were simulated."""

BAND: Final = 4
"""Layers of cubes that are told together: 20 m."""

SURE: Final = 5.0
"""Standard deviations of the number of returns beyond which a difference is no chance."""

SHARE: Final = 0.15
"""Part of the noise that a difference must concern."""

BLOCK_LEAST: Final = 300.0
"""Noise that a block must be expected to hold to be judged alone [count]."""

BLOCK_TOLD: Final = 1.5
BLOCK_SHARE: Final = 0.3
"""The same two of a block: those of 100 m of a scene that fits had 0.71 to 1.16 times the noise in
bands away from surfaces, and up to 2.3 times in the one around the ground, a tenth of all."""

LARGE: Final = 100.0
"""Ratios from here on are told as no number: hardly any noise was expected."""

Rows = Sequence[Sequence[float]]
"""Index, returns and expected returns of each layer."""


class Band(NamedTuple):
    """Noise between two heights, over what is expected of it."""

    low_m: float
    high_m: float
    times: float
    off: float  #: Returns too many or too few, over all that are expected at any height [1].


class Block(NamedTuple):
    """A part of the survey whose noise is judged by itself."""

    box: Box
    bands: Sequence[Band]

    @property
    def off(self) -> float:
        """Part of the noise that is too much or too little."""
        return sum(band.off for band in self.bands)


def misfit_warning(done: Receipts, context: Context) -> Iterator[str]:
    """Sentence on heights in which noise alone is more, or less, than expected."""
    facts = [receipt.facts for receipt in done.get("denoise", {}).values()]
    rows = [some.get("layers", ()) for some in facts]
    bands = _bands([row for part in rows for row in part])
    extent = extent_of(done)
    judged = [
        Block(clipped(some.get("core", extent), extent), _bands(part, BLOCK_TOLD, BLOCK_SHARE))
        for some, part in zip(facts, rows, strict=True)
        if extent is not None and sum(row[2] for row in part) >= BLOCK_LEAST
    ]
    off = [block for block in judged if block.bands]
    if extent is None or not (bands or off):
        return
    terrain = Terrain(context.output)
    said = ""
    if bands:
        said = f": {_listed(bands, extent, terrain)}, {within([extent])}"
        said += ". The noise changes along the gate"
    if off and (len(judged) > 1 or not bands):
        worst = max(off, key=lambda block: block.off)
        blocks = counted(len(judged), "blocks")
        said += f"{'. It is off' if bands else ''} in {len(off)} of {blocks}"
        said += f"; the worst lies {within([worst.box])}, and there it is "
        said += _listed(worst.bands, worst.box, terrain)
    hint = ""
    if context.workflow.survey.channel_dimension is None:
        hint = "; if this is linear-mode lidar, which has no such noise, set filter.method: none"
    yield as_ascii(
        f"away from all surfaces the noise is not what its model expects{said}. Where there is "
        "more of it, the filter keeps more than filter.alpha says; where there is less, weak "
        f"signals are lost{hint}"
    )


def _listed(bands: Sequence[Band], box: Box, terrain: Terrain) -> str:
    """How much noise there is between which heights, above the ground of a place if it is known."""
    (ground,) = terrain.below([box])
    base, of = (0.0, "in height") if ground is None else (ground, "above the mean ground")
    listed = ", ".join(
        f"{_times(band.times)} times between {round(band.low_m - base)} and "
        f"{round(band.high_m - base)} m"  # whole numbers know no -0
        for band in bands
    )
    return f"{listed} {of}"


def _times(ratio: float) -> str:
    """A ratio; one over next to nothing is only large."""
    return f"{ratio:.2f}" if ratio < LARGE else f"more than {LARGE:.0f}"


def _bands(layers: Rows, told: float = TOLD, share: float = SHARE) -> list[Band]:
    """Heights in which noise differs from what is expected, joined where they touch.

    ``told``, ``share``: as :data:`TOLD` and :data:`SHARE`.
    """
    rows = np.array(layers, dtype=np.float64).reshape(-1, 3)
    if not len(rows):
        return []
    band, at = np.unique(np.floor(rows[:, 0] / BAND), return_inverse=True)
    seen, expected = (np.bincount(at, rows[:, k]).astype(np.float64) for k in (1, 2))
    differs = _differs(seen, expected, told)
    more = seen > expected
    total = float(expected.sum())
    if expected[differs].sum() < share * total:
        return []
    found: list[Band] = []
    edge = BAND * CUBE_M
    start = 0
    for k in range(len(band)):
        last = k + 1 == len(band)
        if last or band[k + 1] != band[k] + 1 or (differs[k + 1], more[k + 1]) != (
            differs[k], more[k],
        ):  # fmt: skip
            if differs[k]:
                run = slice(start, k + 1)
                here, model = float(seen[run].sum()), float(expected[run].sum())
                off = abs(here - model) / total
                found.append(Band(band[start] * edge, (band[k] + 1) * edge, here / model, off))
            start = k + 1
    return found


def _differs(
    seen: NDArray[np.float64], expected: NDArray[np.float64], told: float
) -> NDArray[np.bool_]:
    """Whether noise differs from what is expected by more than chance and more than is told."""
    sure = np.abs(seen - expected) > SURE * np.sqrt(np.maximum(expected, 1.0))
    large: NDArray[np.bool_] = (seen > told * expected) | (seen < expected / told)
    return sure & large
