"""Findings on a flightline's times, channels and trajectory, by what its stretches have seen."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from spl_batch.airborne.beams.geometry import ELSEWHERE_M, Ahead
from spl_batch.engine.findings import Finding
from spl_batch.engine.store.working_store import Store, read_receipt
from spl_batch.engine.tasks.task import Receipt

MERGED: Final = 0.01
"""Share of returns of one time and channel off one beam from which on it is reported; where times
separate shots there is none."""


def line_findings(line: str, names: Iterable[str], store: Store) -> Iterator[Finding]:
    """What is wrong with a flightline's shots and with where its sensor was.

    ``line``: its name; ``names``: those of its stretches, which are observed.
    """
    receipts = (read_receipt(store, "observe", name) for name in names)
    stretches = [receipt for receipt in receipts if receipt is not None]
    yield from _shots(line, _of(stretches, "off_one_beam"))
    yield from times_off(line, stretches)
    yield from _heights(line, _of(stretches, "other_unit"), store)
    lost = [one for one in stretches if one.facts["uncovered"]]
    if lost:
        count = sum(one.facts["uncovered"] for one in lost)
        first, last = np.array([one.facts["uncovered_span_s"] for one in lost]).T.tolist()
        values = {
            "kind": "uncovered", "count": count, "first_s": min(first), "last_s": max(last)
        }  # fmt: skip
        yield Finding("T02", values, line, badness=count)


def _of(stretches: Sequence[Receipt], fact: str) -> list[Any]:
    """A fact of the stretches that have it."""
    return [one.facts[fact] for one in stretches if fact in one.facts]


def _shots(line: str, off_one_beam: Sequence[Sequence[int]]) -> Iterator[Finding]:
    """Several shots that share one time, or channels that are none."""
    together, apart, elsewhere = np.sum([(0, 0, 0), *off_one_beam], axis=0).tolist()
    if 2 * elsewhere > apart:
        yield Finding("I03", {"kind": "elsewhere", "km": ELSEWHERE_M / 1000}, line)
    elif apart > MERGED * max(together, 1):
        share = apart / together
        yield Finding("T01", {"kind": "merged", "share": share}, line, badness=share)


def times_off(line: str, stretches: Sequence[Receipt]) -> Iterator[Finding]:
    """A sensor that is not above what it sees, as with times of a trajectory that are off.

    Leap seconds that these times lack, where they explain it; else by how many seconds they seem
    late. A place is seen ahead first and astern later, so that one stretch of a small survey may
    lie on one side: what counts is the mean over all returns.
    """
    leap = next((found for found in _of(stretches, "leap_s") if found), None)
    looks = _of(stretches, "ahead")
    if leap is not None:
        late = "early, as UTC is" if leap > 0 else "late, as GPS time is for UTC"
        yield Finding("T02", {"kind": "leap", "leap_s": abs(leap), "late": late}, line)
    elif looks:
        returns = [one.points for one in stretches if "ahead" in one.facts]
        whole = Ahead(*map(float, np.average(looks, axis=0, weights=returns)))
        seconds = whole.ahead_m / whole.speed_m_s
        side, late = ("behind", "early") if seconds < 0 else ("ahead of", "late")
        values = {"kind": "late", "side": side, "seconds": abs(seconds), "late": late}
        if not whole.is_above:
            yield Finding("T02", values, line, badness=abs(seconds))


def _heights(line: str, other_unit: Sequence[Any], store: Store) -> Iterator[Finding]:
    """Heights of the trajectory that are feet for metres, or metres for feet, in most stretches."""
    wrong, flown = [both for both in other_unit if both], read_receipt(store, "trajectory", "all")
    if flown is not None and 2 * len(wrong) > len(other_unit):
        stated_m, met_m = np.median(wrong, axis=0).tolist()
        unit, code = ("feet", "EPSG:...+6360") if stated_m > met_m else ("metres", "EPSG:...+5703")
        values = {
            "kind": "unit", "stated_m": stated_m, "met_m": met_m, "line": line, "unit": unit,
            "crs": code,
        }  # fmt: skip
        yield Finding("T02", values, str(flown.facts["name"]), badness=stated_m)
