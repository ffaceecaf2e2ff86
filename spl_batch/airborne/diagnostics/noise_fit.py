"""Whether noise is what its model expects: by layer, in haze, and where it lies alone.

*Layers*: away from surfaces and haze cubes of 5 m hold noise alone. Their returns are compared with
the model's, in bands of 20 m of height, for the whole survey and for each block.

*Haze*: cubes that hold much more noise, evenly, are taken for haze
(:mod:`spl_batch.airborne.noise.haze`); their returns are class 18.

*P-values*: below all surfaces noise lies alone. There small p-values of the calibrated test are
uniform if its model holds: clusters, or denser noise, have too many of them, thinner noise too few.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.law_warnings import UNEVEN
from spl_batch.airborne.diagnostics.patches import WARNED_M2, largest_of_squares
from spl_batch.airborne.noise.gains import SURE_SIGMA
from spl_batch.airborne.noise.haze import CUBE_M, WINDOW
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts
from spl_batch.engine.tasks.task import Receipt

RATIO: Final = 1.25
SHARE: Final = 0.15
"""Times more, or less, noise than expected that a survey is warned of, and the part of the noise
that it must concern; the model is within 1.03 in all strata that were simulated. A block is warned
of from :data:`UNEVEN` times on: those of 100 m of a scene that fits had 0.71 to 1.16."""

BAND: Final = 4
"""Layers of cubes in a band: 20 m."""

P_VALUES: Final = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Values up to which p-values are counted. Larger ones are not resolved where noise is thin."""

LEAST: Final = 300
"""Returns that a block, or a p-value, must have by the model to be judged: p-values of neighbours
hang together, so that chance makes twice the difference that it makes otherwise [count]."""

P_TIMES: Final = (0.5, 1.5)
"""Small p-values over uniform ones that are no reason to warn: without beamlet numbers they are
0.64, and nothing is lost."""


def noise_findings(done: Receipts) -> Iterator[Finding]:
    """Noise that differs from what is expected, haze, and p-values that are not uniform."""
    yield from _layer_findings(done.get("denoise", {}))
    found = haze(done)
    if found is not None:
        yield found
    yield from _p_value_findings(done.get("ground", {}))


def _layer_findings(blocks: Mapping[str, Receipt]) -> Iterator[Finding]:
    rows = {name: receipt.facts.get("layers", ()) for name, receipt in blocks.items()}
    whole = _worst_band([row for some in rows.values() for row in some], RATIO, SHARE)
    if whole is not None:
        yield whole
        return
    for name, some in rows.items():
        found = _worst_band(some, UNEVEN, SHARE)
        if found is not None and sum(row[2] for row in some) >= LEAST:
            yield found._replace(subject=name, place=_place(blocks[name]))


def _place(receipt: Receipt) -> tuple[float, ...]:
    """What a task owns [m]."""
    return tuple(side * QUANTUM_M for side in receipt.facts["core"])


def _worst_band(layers: Sequence[Sequence[float]], ratio: float, share: float) -> Finding | None:
    """Heights in which noise differs most from what is expected, joined where they touch.

    ``layers``: index, returns and expected returns of each.
    """
    rows = np.array(layers, dtype=np.float64).reshape(-1, 3)
    if not len(rows):
        return None
    band, at = np.unique(np.floor(rows[:, 0] / BAND), return_inverse=True)
    seen, expected = (np.bincount(at, rows[:, k]).astype(np.float64) for k in (1, 2))
    differs = np.abs(seen - expected) > SURE_SIGMA * np.sqrt(np.maximum(expected, 1.0))
    differs &= (seen > ratio * expected) | (seen < expected / ratio)
    total = float(expected.sum())
    if not differs.any() or expected[differs].sum() < share * total:
        return None
    more, edge = seen > expected, BAND * CUBE_M
    same = (np.diff(band) == 1) & (differs[1:] == differs[:-1]) & (more[1:] == more[:-1])
    runs = np.split(np.arange(len(band)), np.flatnonzero(~same) + 1)
    run = max(
        (run for run in runs if differs[run[0]]),
        key=lambda run: abs(float(seen[run].sum() - expected[run].sum())),
    )
    here, model = float(seen[run].sum()), float(expected[run].sum())
    values = {
        "ratio": min(here / max(model, 1e-3), 999.0),
        "low_m": float(band[run[0]]) * edge,
        "high_m": float(band[run[-1]] + 1) * edge,
    }
    return Finding("N02", values, badness=abs(here - model) / max(total, 1e-3))


def haze(done: Receipts) -> Finding | None:
    """Haze of a whole survey; None where there is less than :data:`WARNED_M2`."""
    listed = [
        place
        for receipt in done.get("denoise", {}).values()
        for place in receipt.facts.get("air", ())
        if place[8] >= RATIO * place[9]
    ]
    rows = np.array(listed).reshape(-1, 10)
    area_m2 = float(rows[:, 6].sum()) * CUBE_M**2
    if area_m2 < WARNED_M2:
        return None
    at = (rows[:, :2] // WINDOW).astype(np.int64)
    _, place = largest_of_squares(at, WINDOW * CUBE_M)
    low_m, high_m = (
        CUBE_M * _weighted(rows[:, k], rows[:, 8], share) for k, share in ((4, 0.05), (5, 0.95))
    )
    values = {
        "low_m": low_m,
        "high_m": high_m + CUBE_M,
        "area_m2": area_m2,
        "ratio": float(rows[:, 8].sum()) / max(float(rows[:, 9].sum()), 1.0),
    }
    return Finding("N03", values, place=place)


def _weighted(values: NDArray[np.float64], weights: NDArray[np.float64], share: float) -> float:
    """Value that so much of the weight does not exceed."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order]) / weights.sum()
    return float(values[order[np.searchsorted(below, share)]])


def uniformity(counts: NDArray[np.int64]) -> tuple[float, float] | None:
    """Small p-values over uniform ones, where they are farthest from 1, and up to which value.

    None where too few returns show it. ``counts``: returns up to each value and not up to the one
    before, and beyond all.
    """
    total, value = int(counts.sum()), np.array(P_VALUES)
    times = np.cumsum(counts)[:-1] / (max(total, 1) * value)
    enough = total * value >= LEAST
    if not enough.any():
        return None
    worst = int(np.where(enough, np.abs(np.log(np.maximum(times, 1e-6))), -1.0).argmax())
    return float(times[worst]), P_VALUES[worst]


def p_values(cells: Iterable[Receipt]) -> NDArray[np.int64]:
    """Returns of ground cells by p-value, where noise lies alone."""
    counts = np.zeros(len(P_VALUES) + 1, np.int64)
    for receipt in cells:
        counts += np.array(receipt.facts.get("p_values", counts * 0), np.int64)
    return counts


def _p_value_findings(cells: Mapping[str, Receipt]) -> Iterator[Finding]:
    off = [
        found._replace(subject=name, place=_place(receipt))
        for name, receipt in cells.items()
        if (found := _not_uniform(p_values([receipt]))) is not None
    ]
    whole = None if off else _not_uniform(p_values(cells.values()))
    yield from off if whole is None else [whole]


def _not_uniform(counts: NDArray[np.int64]) -> Finding | None:
    """What :func:`uniformity` finds where it is a reason to warn."""
    found = uniformity(counts)
    if found is None or P_TIMES[0] < found[0] < P_TIMES[1]:
        return None
    values = {"times": found[0], "p_value": found[1], "returns": int(counts.sum())}
    return Finding("N05", values, badness=abs(float(np.log(max(found[0], 1e-6)))))
