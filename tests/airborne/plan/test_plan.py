"""From headers and receipts to flightlines and stretches; sizes."""

import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.plan import flightlines
from spl_batch.airborne.plan.flightlines import (
    Flightline,
    find_flightlines,
    fullest_span,
    is_timeless,
)
from spl_batch.airborne.plan.task_memory import UNEVEN
from spl_batch.airborne.settings.workflow import Workflow, parse_workflow
from spl_batch.airborne.tasks.file_tally import (
    BINS_PER_S,
    fullest,
    merge_spans,
    most_points,
    rate_of,
    sum_of_bins,
)
from spl_batch.engine.plan.input_files import source_key
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs import planning
from spl_batch.engine.verbs.planning import parse_bytes
from spl_batch.errors import WorkflowError
from spl_batch.formats.gps_clock import LATEST_S


def workflow(**sections: Any) -> Workflow:
    survey = {"flightlines": "a", **sections.pop("survey", {})}
    return parse_workflow({"survey": survey, "output": "o", **sections}, "w")


DEFAULTS = workflow()


def indexed(name: str, spans: Mapping[int, list[list[float]]], prf: float | None = None) -> Receipt:
    points = sum(int(s[2]) for listed in spans.values() for s in listed)
    facts = {
        "name": name,
        "points": points,
        "excluded": 0,
        "spans": {str(k): v for k, v in spans.items()},
        "prf_hz": {str(k): prf for k in spans},
        "fullest": {str(k): evenly(v) for k, v in spans.items()},
    }
    return Receipt("index_file", name, "", "", "", {}, facts, points, 0.0, 0.0)


def evenly(spans: list[list[float]]) -> list[int]:
    """Most points in windows of growing length, where each span has them evenly."""
    most, total = [0], int(sum(s[2] for s in spans))
    rate = max(s[2] / (s[1] - s[0] + 1e-9) for s in spans)
    while most[-1] < total:
        window_s = 2 ** len(most) / 2 / BINS_PER_S
        most.append(min(math.ceil(rate * window_s), total))
    return most[1:]


def lines_of(receipts: list[Receipt], **sections: Any) -> list[Flightline]:
    return find_flightlines({r.name: r for r in receipts}, workflow(**sections))


def test_files_of_one_pass_are_one_flightline() -> None:
    files = [indexed("b", {7: [[110.5, 120.0, 400]]}), indexed("a", {7: [[100.25, 110.0, 600]]})]
    (line,) = lines_of(files)
    assert (line.name, line.psid, line.points) == ("00007_100", 7, 1000)
    assert (line.first_s, line.last_s) == (100.25, 120.0)
    assert line.sources == ("a", "b")
    assert line.clock.t0_s == 100.0, "the shot grid begins at a whole second"
    assert lines_of(files[::-1]) == [line]


def test_a_long_pause_starts_another_lift() -> None:
    files = [indexed("a", {7: [[0.0, 10.0, 5], [69.0, 80.0, 5], [141.0, 150.0, 5]]})]
    assert [x.name for x in lines_of(files)] == ["00007_0", "00007_141"]
    assert [x.name for x in lines_of(files, survey={"gap_s": 50})] == [
        "00007_0",
        "00007_69",
        "00007_141",
    ]
    assert len(lines_of(files, survey={"gap_s": 61.0})) == 1, "a gap is longer than gap_s"


def test_a_pause_inside_one_file_may_be_filled_by_another() -> None:
    first = indexed("a", {1: [[0.0, 10.0, 5], [100.0, 110.0, 5]]})
    second = indexed("b", {1: [[20.0, 90.0, 9]]})
    assert len(lines_of([first])) == 2
    (line,) = lines_of([first, second])
    assert line.sources == ("a", "b")


def test_pulse_rate_is_given_estimated_or_assumed() -> None:
    spans = {1: [[0.0, 9.0, 100]]}
    few, many = indexed("a", {1: [[9.0, 9.5, 10]]}, 10_000.0), indexed("b", spans, 25_000.0)
    assert (lines_of([few, many])[0].clock.prf_hz, lines_of([few])[0].prf_basis) == (
        25_000.0,
        "estimated",
    )
    pieces = [indexed(name, {1: [[9.0, 9.5, 60]]}, 10_000.0) for name in "cd"]
    assert lines_of([many, *pieces])[0].clock.prf_hz == 10_000.0, "points count, not files"
    given_rate = lines_of([many], acquisition={"prf_hz": 60000})[0]
    assert (given_rate.clock.prf_hz, given_rate.prf_basis) == (60_000.0, "given")
    assert lines_of([indexed("c", spans)])[0].prf_basis == "assumed"


@given(
    first=st.floats(0, 1e6),
    length=st.floats(0.5, 4000),
    points=st.integers(1, 10**9),
    prf=st.sampled_from([1000.0, 25_000.0, 60_000.0]),
)
def test_stretches_cover_a_line_without_overlap(
    first: float, length: float, points: int, prf: float
) -> None:
    files = [indexed("a", {1: [[first, first + length, points]]}, prf)]
    (line,) = find_flightlines({"a": files[0]}, DEFAULTS)
    ks = [k for _, k in line.stretches()]
    assert ks == list(range(ks[0], ks[-1] + 1))
    low, high = (line.clock.shot(_array(t))[0] for t in (line.first_s, line.last_s))
    assert ks[0] * line.stretch_shots <= low
    assert high < (ks[-1] + 1) * line.stretch_shots
    assert line.window_s(ks[0])[0] <= first
    assert first + length <= line.window_s(ks[-1])[1]
    intervals = line.stretch_shots / DEFAULTS.noise.interval_shots
    assert intervals == int(intervals), "stretches are whole intervals"
    assert math.log2(intervals) % 1 == 0, "of which a power of two make one"


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(st.floats(0, 500), st.integers(1, 400)), min_size=1, max_size=8),
    st.floats(0.01, 300),
    st.integers(0, 9),
)
def test_no_span_of_time_holds_more_than_its_rate_says(
    bursts: list[tuple[float, int]], span_s: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    time = np.concatenate([start + rng.random(n) for start, n in bursts])
    most = fullest(sum_of_bins([rate_of(np.sort(part)) for part in np.array_split(time, 3)]))
    assert most == sorted(most)
    assert most[-1] == len(time)
    ordered = np.sort(time)
    held = np.searchsorted(ordered, ordered + span_s, side="right") - np.arange(len(time))
    assert held.max() <= most_points(most, span_s) <= len(time)
    even = fullest(rate_of(np.arange(100_000) / 1000))
    assert most_points(even, min(span_s, 60.0)) < 2100 * (min(span_s, 60.0) + 0.1)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(
        st.tuples(st.floats(0, 90), st.floats(0.1, 40), st.integers(2, 300)), min_size=1, max_size=5
    ),
    st.floats(0.05, 50),
)
def test_no_span_of_several_files_holds_more_than_they_say(
    files: list[tuple[float, float, int]], span_s: float
) -> None:
    rng = np.random.default_rng(0)
    times = [np.sort(start + length * rng.random(n)) for start, length, n in files]
    listed = [(float(time[0]), float(time[-1]), fullest(rate_of(time))) for time in times]
    every = np.sort(np.concatenate(times))
    held = np.searchsorted(every, every + span_s, side="right") - np.arange(len(every))
    assert held.max() <= fullest_span(listed, span_s)


def test_times_that_are_none_do_no_harm_to_the_rest() -> None:
    most = fullest(rate_of(np.array([-LATEST_S, 5.0, 5.001, 1e9, LATEST_S])))
    assert (most[0], most[-1]) == (2, 5)
    assert most_points(most, 10.0) == 2
    assert most_points(most, 2 * LATEST_S) == 5


def test_files_that_follow_each_other_do_not_add_up() -> None:
    rates = {first: rate_of(first + np.arange(20_000) / 1000) for first in (0.0, 20.0, 40.0)}
    listed = [(first, first + 20.0, fullest(rate)) for first, rate in rates.items()]
    assert 4000 <= fullest_span(listed, 4.0) <= 6000
    assert 8000 <= fullest_span([*listed, *listed], 4.0) <= 12_000


def test_stretches_are_shorter_where_returns_come_in_bursts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Twenty seconds over land and fifty over water, again and again."""
    lasting, per_s = 20, 5000
    land = np.concatenate([k * 70.0 + np.arange(lasting * per_s) / per_s for k in range(10)])
    parts = [land[land < 345.0], land[land >= 345.0]]
    receipts = {}
    for name, time in zip("ab", parts, strict=True):
        spans = {1: [[float(time[0]), float(time[-1]), float(len(time))]]}
        receipts[name] = indexed(name, spans, 10_000.0)
        receipts[name].facts["fullest"]["1"] = fullest(rate_of(time))  # type: ignore[index]
    wanted = 40_000
    monkeypatch.setattr(flightlines, "STRETCH_POINTS", wanted)
    (line,) = find_flightlines(receipts, DEFAULTS)
    length_s = line.stretch_shots / line.clock.prf_hz
    whole_s = (line.last_s - line.first_s) * wanted / len(land)
    assert whole_s > 20, "cut by the average, a stretch would be all land"
    starts = line.clock.t0_s + np.arange(0, 700, length_s)
    held = np.histogram(land, np.append(starts, starts[-1] + length_s))[0]
    assert held.max() <= UNEVEN * wanted
    assert held.max() > UNEVEN * wanted / 4


def _array(value: float) -> Any:
    return np.array([value])


def test_files_without_usable_time() -> None:
    assert not is_timeless(indexed("a", {1: [[0.0, 1.0, 500]]}), workflow())
    assert is_timeless(indexed("a", {1: [[5.0, 5.0, 500]]}), workflow())
    assert not is_timeless(indexed("a", {1: [[5.0, 5.0, 3]]}), workflow()), "one shot is a time"
    nothing = indexed("a", {})
    assert not is_timeless(nothing, workflow()), "an empty file is no fault"
    no_times = Receipt(*(getattr(nothing, f) for f in Receipt.__slots__[:6]), **_counted(5))
    assert is_timeless(no_times, workflow())
    assert lines_of([no_times]) == []


def _counted(points: int) -> dict[str, Any]:
    facts = {"name": "a", "points": points, "excluded": 0, "spans": {}, "prf_hz": {}}
    return {"facts": facts, "points": points, "wall_s": 0.0, "peak_rss_mb": 0.0}


@given(st.lists(st.tuples(st.integers(0, 500), st.integers(0, 20)), max_size=20), st.randoms())
def test_spans_join_in_any_order(spans: list[tuple[int, int]], random: Any) -> None:
    listed = [[float(a), float(a + n), 1] for a, n in spans]
    joined = merge_spans(np.array(listed).reshape(-1, 3), 5.0)
    random.shuffle(listed)
    assert merge_spans(np.array(listed).reshape(-1, 3), 5.0) == joined
    assert sum(s[2] for s in joined) == len(spans)
    assert all(b[0] - a[1] > 5.0 for a, b in itertools.pairwise(joined))


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("4GiB", 4 * 2**30),
        ("4 gib", 4 * 2**30),
        ("1.5GB", 1_500_000_000),
        ("500M", 500_000_000),
        ("300MiB", 300 * 2**20),
        (2**30, 2**30),
        ("2000000000", 2 * 10**9),
        ("2000000000B", 2 * 10**9),
    ],
)
def test_sizes(text: str | int, size: int) -> None:
    assert parse_bytes(text) == size


@pytest.mark.parametrize("text", ["", "lots", "4 GiBs", "-4GiB", "4GiB 2", "4XB", "100MiB", 0])
def test_what_is_no_size(text: str | int) -> None:
    with pytest.raises(WorkflowError, match="--memory"):
        parse_bytes(text)


@pytest.mark.parametrize(
    ("machine_gib", "workers", "gib"),
    [
        (24, 2, 9.5),
        (24, 0, 16),
        (8, 2, 3),
        (128, 16, 6.25),
        (512, 2, 16),
        (3.9, 2, 1.5),
        (1, 64, 0.25),
    ],
)
def test_workers_share_the_memory_of_the_machine(
    machine_gib: float, workers: int, gib: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(planning, "machine_memory", lambda: int(machine_gib * 2**30))
    assert planning.limit_bytes(None, workers) == gib * 2**30


def test_a_key_depends_on_the_name_alone() -> None:
    assert source_key("a/b.laz") == source_key("a/b.laz") != source_key("a/c.laz")
    assert 0 <= source_key("x") < 2**63
