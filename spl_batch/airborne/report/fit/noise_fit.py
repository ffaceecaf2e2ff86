"""Whether the filter's verdicts fit where nothing stands, for the report.

Numbers come from ground cells, which are the same however a survey is tiled.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.judged_fit import GAP, P_VALUES, uniformity
from spl_batch.airborne.filter.stray_returns import CELL_M
from spl_batch.airborne.report.fit.places import extent_of, largest
from spl_batch.airborne.report.noise_model import NoiseFit
from spl_batch.airborne.settings import FilterSettings
from spl_batch.engine.report.number_format import as_ascii, significant
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import counted, grouped
from spl_batch.lattice.tiles import quanta

TIMES_TOLD: Final = (0.5, 1.5)
"""Small p-values over uniform ones, below and above which that is told: without beamlet numbers
they are 0.64, and nothing is lost."""

FLOAT_TOLD: Final = 0.01
"""Share of the signal of a ground cell that floats, from which on it is told."""

FLOAT_TIMES: Final = 5.0
"""So many times what ``filter.alpha`` lets through ..."""

FLOAT_M2: Final = 500.0
"""... and over this area [m2]."""

Facts = Sequence[Mapping[str, Any]]


def noise_fit(done: Receipts) -> NoiseFit | None:
    """Numbers of the whole survey; None where nothing filters, or of an earlier version."""
    facts = [receipt.facts for receipt in done.get("ground", {}).values()]
    aloft = [some["afloat"] for some in facts if "afloat" in some]
    if not aloft:
        return None
    floats, kept = (sum(counts[k] for counts in aloft) for k in (0, 1))
    counts = _p_values(facts)
    found = uniformity(counts)
    return NoiseFit(
        returns_below=int(counts.sum()),
        p_value=None if found is None else found.at,
        p_value_times=None if found is None else found.times,
        floating=floats,
        floating_share=floats / kept if kept else None,
    )


def uniform_warning(done: Receipts) -> Iterator[str]:
    """Sentence on p-values that are not uniform where noise lies alone."""
    facts = [r.facts for r in done.get("ground", {}).values() if "p_values" in r.facts]
    alone = [some for some in facts if _is_off([some])]
    more = [some for some in alone if _more([some])]
    off = more if 2 * len(more) >= len(alone) else [some for some in alone if not _more([some])]
    found = uniformity(_p_values(off or (facts if _is_off(facts) else [])))
    if found is None:
        return
    told = off or facts
    returns = [sum(some["p_values"]) for some in told]
    where = f"in {len(off)} of {counted(len(facts), 'ground cells')}" if off else "of all together"
    where += f", {largest([some['core'] for some in told], returns, extent=extent_of(done))}"
    means = (
        "it is denser than expected or comes in clusters, and more of it is kept than filter.alpha "
        "says, above surfaces as well"
        if found.times > 1
        else "it is thinner than expected, and weak signals are lost"
    )
    yield as_ascii(
        f"below all surfaces, where only noise lies, {found.times:.2f} times as many of "
        f"{grouped(found.returns)} returns as the model of the noise says have a p-value up to "
        f"{found.at:g}, {where}: {means}"
    )


def float_warning(done: Receipts, settings: FilterSettings) -> Iterator[str]:
    """Sentence on signal that hangs in the air."""
    facts = [r.facts for r in done.get("ground", {}).values() if r.facts.get("afloat")]
    least = (
        max(FLOAT_TOLD, FLOAT_TIMES * settings.alpha) if settings.method == "vsaes" else FLOAT_TOLD
    )
    off = [some for some in facts if some["afloat"][0] > least * some["afloat"][1]]
    floats, kept, columns = (sum(some["afloat"][k] for some in off) for k in range(3))
    area_m2 = columns * CELL_M**2
    if area_m2 < FLOAT_M2:
        return
    cell = quanta(CELL_M)
    ends = [some["afloat"][3:] for some in off]
    boxes = [[west, south, east + cell, north + cell] for west, east, south, north in ends]
    where = largest(boxes, [some["afloat"][0] for some in off], [some["core"] for some in off])
    yield as_ascii(
        f"{significant(100 * floats / kept, 2)} % of the signal {where}, "
        f"{grouped(floats)} returns over {grouped(round(area_m2))} m2, floats: nothing was kept in "
        f"the {GAP * CELL_M:.0f} m below it, though something lies farther down. Haze, a cloud or "
        "noise in clusters that the filter took for signal, unless "
        "many wires or cranes hang there; the DSM may rest on it, look at the profile"
    )


def _p_values(facts: Facts) -> NDArray[np.int64]:
    """Returns of some ground cells by p-value."""
    counts = np.zeros(len(P_VALUES) + 1, np.int64)
    for some in facts:
        counts += np.array(some.get("p_values", counts * 0), np.int64)
    return counts


def _more(facts: Facts) -> bool:
    """Whether small p-values are too many rather than too few."""
    found = uniformity(_p_values(facts))
    return found is not None and found.times > 1


def _is_off(facts: Facts) -> bool:
    """Whether enough returns have too many small p-values, or too few."""
    found = uniformity(_p_values(facts))
    return found is not None and not TIMES_TOLD[0] < found.times < TIMES_TOLD[1]
