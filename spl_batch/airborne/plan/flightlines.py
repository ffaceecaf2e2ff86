"""Flightlines and stretches, from what the index stage found in each file."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spl_batch.airborne.plan.task_memory import STRETCH_POINTS, UNEVEN
from spl_batch.airborne.pulses.swaths import SwathTotals, by_flightline
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.store.flown_lines import Pass, numbers
from spl_batch.airborne.tasks.file_tally import chained, most_points
from spl_batch.airborne.tasks.pulses import SWATHS
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.tables import ShotClock

FALLBACK_PRF_HZ = 50_000.0
"""Pulse rate where neither the workflow states one nor the data show it [Hz]."""


STEPS = 8
"""Steps of a span of time in which parts of it are known [count]."""


@dataclass(frozen=True, slots=True)
class Flightline:
    """One pass: a point source id, between two long pauses."""

    name: str  #: Point source id and the second in which it begins.
    number: int  #: What its points carry as ``line``.
    psid: int
    #: Times of its first and last return [s].
    first_s: float
    last_s: float
    points: int  #: Returns with a valid time [count].
    clock: ShotClock
    prf_basis: str  #: ``given``, ``estimated`` or ``assumed``.
    sources: tuple[str, ...]  #: Keys of the files that hold it.
    stretch_shots: int

    @property
    def as_pass(self) -> Pass:
        """What tasks know of it."""
        return Pass(self.number, self.name, self.psid, self.first_s, self.last_s)

    def stretches(self) -> Iterable[tuple[str, int]]:
        """Names and numbers of its stretches."""
        first = self._shot(self.first_s) // self.stretch_shots
        last = self._shot(self.last_s) // self.stretch_shots
        for k in range(first, last + 1):
            yield f"{self.name}/{k}", k

    def window_s(self, k: int) -> tuple[float, float]:
        """Time span that surely holds every shot of a stretch [s]."""
        low, high = k * self.stretch_shots - 1, (k + 1) * self.stretch_shots + 1
        return (
            self.clock.t0_s + low / self.clock.prf_hz,
            self.clock.t0_s + high / self.clock.prf_hz,
        )

    def _shot(self, time_s: float) -> int:
        return round((time_s - self.clock.t0_s) * self.clock.prf_hz)


def is_timeless(receipt: Receipt, workflow: Workflow) -> bool:
    """Whether a file's points have no time to speak of: none, or all the same one."""
    facts = receipt.facts
    if facts["points"] == facts["excluded"]:
        return False
    if not facts["spans"]:
        return True
    # What more points share than a shot may have is no time.
    a_shot = workflow.sensor.beamlets * 8 if workflow.survey.channel_dimension else 64
    spans = [span for spans in facts["spans"].values() for span in spans]
    return all(first == last and points > a_shot for first, last, points in spans)


def find_flightlines(receipts: Mapping[str, Receipt], workflow: Workflow) -> list[Flightline]:
    """Flightlines of a survey, by name.

    A stretch holds :data:`~spl_batch.airborne.plan.task_memory.STRETCH_POINTS` on average, and
    none more than :data:`~spl_batch.airborne.plan.task_memory.UNEVEN` times as many.
    """
    spans: dict[int, list[tuple[float, float, int, str]]] = {}
    for key, receipt in sorted(receipts.items()):
        if is_timeless(receipt, workflow):
            continue
        for psid, listed in receipt.facts["spans"].items():
            spans.setdefault(int(psid), []).extend((a, b, n, key) for a, b, n in listed)
    lifts = [
        (psid, lift)
        for psid, listed in sorted(spans.items())
        for lift in chained(sorted(listed), workflow.survey.gap_s)
    ]
    return [
        _flightline(number, psid, lift, receipts, workflow)
        for number, (psid, lift) in zip(numbers([p for p, _ in lifts]), lifts, strict=True)
    ]


def _flightline(
    number: int,
    psid: int,
    lift: list[tuple[float, float, int, str]],
    receipts: Mapping[str, Receipt],
    workflow: Workflow,
) -> Flightline:
    first, last = lift[0][0], max(span[1] for span in lift)
    points = sum(span[2] for span in lift)
    prf, basis = _prf(psid, lift, receipts, workflow)
    clock = ShotClock(float(math.floor(first)), prf)
    shots = max(round((last - first) * prf), 1)
    interval = workflow.noise.interval_shots
    wanted = shots * STRETCH_POINTS / points / interval
    stretch = interval * 2 ** max(math.floor(math.log2(max(wanted, 1.0))), 0)
    rates = [(a, b, receipts[key].facts["fullest"][str(psid)]) for a, b, _, key in lift]
    start, end = clock.shot(np.array([first, last])).tolist()
    most = UNEVEN * STRETCH_POINTS
    # One that holds all of it is the same, however much memory there is.
    while stretch > interval and (
        start // (stretch // 2) == end // (stretch // 2)
        or (points > most and fullest_span(rates, stretch / prf) > most)
    ):
        stretch //= 2
    return Flightline(
        f"{psid:05d}_{math.floor(first)}",
        number,
        psid,
        first,
        last,
        points,
        clock,
        basis,
        tuple(sorted({span[3] for span in lift})),
        stretch,
    )


def fullest_span(files: Sequence[tuple[float, float, Sequence[int]]], span_s: float) -> int:
    """Points that a span of time holds at the most, whatever it begins with [count].

    ``files``: first and last time [s] of each file of a flightline, and its
    :meth:`~spl_batch.airborne.tasks.file_tally.Rate.fullest`.
    """
    # Files that follow each other share a span: each is looked at with its own part of it,
    # and that part is known to a step.
    step = span_s / STEPS
    edges = {edge for first, last, _ in files for edge in (first, last)}
    starts = {edge - k * step for edge in edges for k in range(STEPS + 1)}
    return max(
        sum(
            most_points(rate, min(min(last, start + span_s) - max(first, start) + step, span_s))
            for first, last, rate in files
            if first <= start + span_s + step and last >= start - step
        )
        for start in starts
    )


def _prf(
    psid: int,
    lift: list[tuple[float, float, int, str]],
    receipts: Mapping[str, Receipt],
    workflow: Workflow,
) -> tuple[float, str]:
    """Pulse rate: given, else what the files with most points of the line show."""
    if workflow.sensor.prf_hz is not None:
        return workflow.sensor.prf_hz, "given"
    votes: Counter[float] = Counter()
    for _, _, points, key in lift:
        found = receipts[key].facts["prf_hz"].get(str(psid))
        if found:
            votes[float(found)] += points
    if votes:
        return max(votes, key=lambda rate: (votes[rate], rate)), "estimated"
    return FALLBACK_PRF_HZ, "assumed"


def swath_totals(
    cells: Iterable[Receipt], lines: Sequence[Flightline], spacing: str
) -> dict[str, SwathTotals]:
    """First returns of each flightline by its name; ``spacing``: which nominal pulse spacing."""
    names = {line.number: line.name for line in lines}
    found = (receipt.facts[SWATHS] for receipt in cells if not receipt.failed)
    return by_flightline(found, names, spacing)
