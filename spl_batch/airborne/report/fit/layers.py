"""Noise that varies along the gate: observed over expected noise by height, away from surfaces."""

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.noise.haze import CUBE_M
from spl_batch.airborne.report.fit.places import Terrain
from spl_batch.engine.report.number_format import as_ascii
from spl_batch.engine.report.run_record import Receipts

TOLD: Final = 1.25
"""Times more, or less, noise than expected that is told; the model is within 1.03 in all strata
that were simulated."""

BAND: Final = 4
"""Layers of cubes that are told together: 20 m."""

SURE: Final = 5.0
"""Standard deviations of the number of returns beyond which a difference is no chance."""

SHARE: Final = 0.15
"""Part of the noise that a difference must concern."""


class Band(NamedTuple):
    """Noise between two heights, over what is expected of it."""

    low_m: float
    high_m: float
    times: float


def misfit_warning(done: Receipts, context: Context) -> Iterator[str]:
    """Sentence on heights in which noise alone is more, or less, than expected."""
    bands = _bands([r.facts.get("layers", []) for r in done.get("denoise", {}).values()])
    if not bands:
        return
    boxes = [r.facts["bounds"] for r in done["index_file"].values() if r.facts["bounds"]]
    low = [min(box[axis] for box in boxes) for axis in (0, 1)]
    high = [max(box[axis] for box in boxes) for axis in (3, 4)]
    (ground,) = Terrain(context.output).below([[*low, *high]])
    base, of = (0.0, "in height") if ground is None else (ground, "above the mean ground")
    listed = ", ".join(
        f"{_times(band.times)} times between {round(band.low_m - base)} and "
        f"{round(band.high_m - base)} m"  # whole numbers know no -0
        for band in bands
    )
    hint = ""
    if context.workflow.survey.channel_dimension is None:
        hint = "; if this is linear-mode lidar, which has no such noise, set filter.method: none"
    yield as_ascii(
        f"away from all surfaces the noise is not what its model expects: {listed} {of}. The "
        "noise changes along the gate. Where there is more of it, the filter keeps more than "
        f"filter.alpha says; where there is less, weak signals are lost{hint}"
    )


def _times(ratio: float) -> str:
    """A ratio; one over next to nothing is only large."""
    return f"{ratio:.2f}" if ratio < LARGE else f"more than {LARGE:.0f}"


LARGE: Final = 100.0
"""Ratios from here on are told as no number: hardly any noise was expected."""


def _bands(parts: list[list[list[Any]]]) -> list[Band]:
    """Heights in which noise differs from what is expected, joined where they touch."""
    rows = np.array([row for part in parts for row in part], dtype=np.float64).reshape(-1, 3)
    if not len(rows):
        return []
    band, at = np.unique(np.floor(rows[:, 0] / BAND), return_inverse=True)
    seen, expected = (np.bincount(at, rows[:, k]).astype(np.float64) for k in (1, 2))
    differs = _differs(seen, expected)
    more = seen > expected
    if expected[differs].sum() < SHARE * expected.sum():
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
                times = seen[run].sum() / expected[run].sum()
                found.append(Band(band[start] * edge, (band[k] + 1) * edge, float(times)))
            start = k + 1
    return found


def _differs(seen: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether noise differs from what is expected by more than chance and more than is told."""
    sure = np.abs(seen - expected) > SURE * np.sqrt(np.maximum(expected, 1.0))
    large: NDArray[np.bool_] = (seen > TOLD * expected) | (seen < expected / TOLD)
    return sure & large
