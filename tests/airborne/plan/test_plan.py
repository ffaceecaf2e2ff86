"""From headers and receipts to tasks: flightlines, blocks, mosaics, sizes."""

import itertools
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from spl_batch.airborne.plan.block_layout import ORIGIN, Block, Layout, around, parse_block
from spl_batch.airborne.plan.block_size import (
    FEW_TILES,
    LARGEST,
    WIDEST,
    Holders,
    Sizes,
    blocks,
    choose_sizes,
    count_blocks,
    layout_of,
    remember_sizes,
    remember_stretch,
    remembered_sizes,
    remembered_stretch,
)
from spl_batch.airborne.plan.flightlines import (
    Flightline,
    find_flightlines,
    fullest_span,
    is_timeless,
)
from spl_batch.airborne.plan.mosaics import split_mosaic
from spl_batch.airborne.plan.space_units import Unit, tile_counts, voxel_index
from spl_batch.airborne.plan.task_memory import UNEVEN
from spl_batch.airborne.settings.workflow import Workflow, parse_workflow
from spl_batch.airborne.tasks.file_tally import merge_spans
from spl_batch.airborne.tasks.return_rate import BINS_PER_S, Rate, most_points
from spl_batch.engine.plan.input_files import source_key
from spl_batch.engine.store.working_store import Store, read_json, write_json
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs import preparing
from spl_batch.engine.verbs.preparing import parse_bytes
from spl_batch.errors import WorkflowError
from spl_batch.lattice.density import from_counts
from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds, overlap


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
    return find_flightlines({r.name: r for r in receipts}, workflow(**sections), 10_000)


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
    rate = Rate()
    for part in np.array_split(time, 3):
        rate.add(np.sort(part))
    fullest = rate.fullest()
    assert fullest == sorted(fullest)
    assert fullest[-1] == len(time)
    ordered = np.sort(time)
    held = np.searchsorted(ordered, ordered + span_s, side="right") - np.arange(len(time))
    assert held.max() <= most_points(fullest, span_s) <= len(time)
    even = Rate()
    even.add(np.arange(100_000) / 1000)
    assert most_points(even.fullest(), min(span_s, 60.0)) < 2100 * (min(span_s, 60.0) + 0.1)


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
    listed = []
    for time in times:
        rate = Rate()
        rate.add(time)
        listed.append((float(time[0]), float(time[-1]), rate.fullest()))
    every = np.sort(np.concatenate(times))
    held = np.searchsorted(every, every + span_s, side="right") - np.arange(len(every))
    assert held.max() <= fullest_span(listed, span_s)


def test_times_that_are_none_do_no_harm_to_the_rest() -> None:
    rate = Rate()
    rate.add(np.array([-1e300, 5.0, 5.001, 1e18, 1e300]))
    fullest = rate.fullest()
    assert (fullest[0], fullest[-1]) == (2, 5)
    assert most_points(fullest, 10.0) == 2
    assert most_points(fullest, 1e17) == 5


@given(
    first=st.floats(0, 1e6),
    length=st.floats(0.01, 4),
    points=st.integers(1000, 10**7),
    wanted=st.sampled_from([125_000, 250_000, 500_000, 1_000_000]),
)
def test_a_line_of_one_stretch_is_the_same_where_more_would_fit(
    first: float, length: float, points: int, wanted: int
) -> None:
    files = {"a": indexed("a", {1: [[first, first + length, points]]}, 60_000.0)}
    (less,), (more,) = (find_flightlines(files, DEFAULTS, n) for n in (wanted, 2 * wanted))
    if len(list(less.stretches())) == 1:
        assert less == more


def test_files_that_follow_each_other_do_not_add_up() -> None:
    listed = []
    for first in (0.0, 20.0, 40.0):
        rate = Rate()
        rate.add(first + np.arange(20_000) / 1000)
        listed.append((first, first + 20.0, rate.fullest()))
    assert 4000 <= fullest_span(listed, 4.0) <= 6000
    assert 8000 <= fullest_span([*listed, *listed], 4.0) <= 12_000


def test_stretches_are_shorter_where_returns_come_in_bursts() -> None:
    """Twenty seconds over land and fifty over water, again and again."""
    lasting, per_s = 20, 5000
    land = np.concatenate([k * 70.0 + np.arange(lasting * per_s) / per_s for k in range(10)])
    parts = [land[land < 345.0], land[land >= 345.0]]
    receipts = {}
    for name, time in zip("ab", parts, strict=True):
        rate = Rate()
        rate.add(time)
        spans = {1: [[float(time[0]), float(time[-1]), float(len(time))]]}
        receipts[name] = indexed(name, spans, 10_000.0)
        receipts[name].facts["fullest"]["1"] = rate.fullest()  # type: ignore[index]
    wanted = 40_000
    (line,) = find_flightlines(receipts, DEFAULTS, wanted)
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
    joined = merge_spans([list(s) for s in listed], 5.0)
    random.shuffle(listed)
    assert merge_spans(listed, 5.0) == joined
    assert sum(s[2] for s in joined) == len(spans)
    assert all(b[0] - a[1] > 5.0 for a, b in itertools.pairwise(joined))


def test_empty_tiles_do_not_count() -> None:
    receipts = {
        name: Receipt("build_tile", name, "", "", "", {}, {"points": n}, n, 0.0, 0.0)
        for name, n in (("0_0", 5), ("-1_2", 0), ("-3_-4", 1))
    }
    assert tile_counts(receipts) == {CellId(-3, -4): 1, CellId(0, 0): 5}


def everywhere(points: int, side: int = 16) -> dict[CellId, int]:
    return dict.fromkeys(itertools.starmap(CellId, np.ndindex(side, side)), points)


def sizes_of(counts: Mapping[CellId, int], memory_gib: float, workers: int, **tiling: Any) -> Sizes:
    pieces = list(from_counts(counts, 100_000))
    return choose_sizes(pieces, workflow(tiling=tiling), int(memory_gib * 2**30), workers)


def test_blocks_of_a_large_survey_grow_with_memory_and_shrink_with_workers() -> None:
    many = everywhere(100_000, 24)
    assert len(many) > FEW_TILES
    found = [len(cores(many, sizes_of(many, memory, 2), memory)) for memory in (1, 4, 64)]
    assert found == sorted(found, reverse=True)
    assert found[0] > found[-1]
    assert sizes_of(many, 64, 300).tiles == 1
    assert sizes_of(many, 0.25, 2, block_tiles=3) == Sizes(3)
    assert sizes_of({}, 1, 2).tiles >= 1


def cores(counts: Mapping[CellId, int], sizes: Sizes, memory_gib: float = 64) -> set[str]:
    layout = layout_of(counts, DEFAULTS)
    return set(map(str, blocks(layout, sizes, DEFAULTS, int(memory_gib * 2**30))))


def test_a_small_survey_is_one_block_for_one_worker_and_is_shared_by_several() -> None:
    rim = {CellId(i, j): 3000 for i in (-1, 4) for j in range(-1, 5)}
    rim |= {CellId(i, j): 3000 for i in range(4) for j in (-1, 4)}
    counts = everywhere(100_000, 4) | rim
    assert cores(counts, sizes_of(counts, 64, 1)) == {"-1_-1_6_6"}
    assert cores(counts, sizes_of(counts, 64, 2)) == {"-1_-1_3_6", "2_-1_3_6"}
    assert cores(counts, sizes_of(counts, 64, 4)) == {
        "-1_-1_3_3", "-1_2_3_3", "2_-1_3_3", "2_2_3_3",
    }  # fmt: skip
    assert len(cores(counts, sizes_of(counts, 64, 16))) >= 16
    dense = {tile: 2 * n for tile, n in counts.items()}
    assert cores(dense, Sizes(4), 1) != cores(dense, Sizes(4)), "as memory allows"


@pytest.mark.parametrize("west", [0, 3, 5])
def test_two_workers_share_a_small_survey_evenly_wherever_it_lies(west: int) -> None:
    counts = {CellId(t.i + west, t.j + 6): n for t, n in everywhere(100_000, 8).items()}
    found = cores(counts, sizes_of(counts, 64, 2))
    assert found == {f"{west}_6_4_8", f"{west + 4}_6_4_8"}


@pytest.mark.parametrize(("parts", "uneven"), [(2, 1.2), (3, 1.3), (6, 1.35), (8, 1.4)])
def test_parts_of_a_survey_cost_about_the_same(parts: int, uneven: float) -> None:
    layout = layout_of(everywhere(100_000, 13), DEFAULTS)
    found = layout.divide(around(layout.counts), parts)
    assert len(found) == parts
    costs = [layout.cost(block) for block in found]
    assert max(costs) < uneven * np.mean(costs)


@pytest.mark.parametrize("workers", [3, 5, 6])
def test_numbers_of_workers_that_are_no_powers_of_two_share_evenly(workers: int) -> None:
    counts = everywhere(100_000, 12)
    found = map(parse_block, cores(counts, sizes_of(counts, 64, workers)))
    layout = layout_of(counts, DEFAULTS)
    costs = sorted(map(layout.cost, found), reverse=True)
    busy = np.zeros(workers)
    for cost in costs:
        busy[busy.argmin()] += cost
    assert busy.max() < 1.25 * busy.mean()


@pytest.mark.parametrize(
    "apart",
    [
        [CellId(i, i + j) for i in range(60) for j in range(2)],  # a corridor
        [CellId(i + far, j) for far in (0, 200) for i in range(5) for j in range(5)],
    ],
)
def test_no_block_holds_the_empty_space_of_a_survey(apart: list[CellId]) -> None:
    counts = dict.fromkeys(apart, 100_000)
    found = [parse_block(name) for name in cores(counts, sizes_of(counts, 64, 2))]
    assert all(max(block.columns, block.rows) <= WIDEST for block in found)
    assert sum(block.columns * block.rows for block in found) < 12 * len(counts)


def test_one_dense_place_leaves_the_rest_its_large_blocks() -> None:
    counts = {**everywhere(100_000), CellId(3, 3): 13_000_000}
    pieces = list(from_counts(counts, 100_000))
    few = count_blocks(pieces, workflow(), 2**36, Sizes(8))
    assert few[:2] == (4, 8)
    more = count_blocks(pieces, workflow(), 3 * 2**30, Sizes(8))
    assert more.blocks in range(5, 12)
    assert more.tiles == 8
    assert 1.0 < few.read < more.read < 3.0, "the dense tile is judged in parts"


@pytest.mark.parametrize(("tiles", "side", "gib"), [(24, 6, 3), (24, 8, 2), (30, 8, 2)])
def test_the_plan_estimates_the_blocks_of_large_surveys(tiles: int, side: int, gib: int) -> None:
    counts = everywhere(100_000, tiles)
    found = cores(counts, Sizes(side), gib)
    pieces = list(from_counts(counts, 100_000))
    estimated = count_blocks(pieces, DEFAULTS, gib * 2**30, Sizes(side))
    assert estimated.blocks == pytest.approx(len(found), rel=0.1)
    assert estimated.tiles == max(int(n) for name in found for n in name.split("_")[2:])
    layout = layout_of(counts, DEFAULTS)
    read = sum(layout.unit(parse_block(name)).held for name in found) / sum(counts.values())
    assert estimated.read == pytest.approx(read, rel=0.02)


tile_points = st.dictionaries(
    st.builds(CellId, st.integers(-9, 9), st.integers(-9, 9)), st.integers(1, 1000), min_size=1
)
EDGE, HALO = 100, 30


def laid_out(
    counts: Mapping[CellId, int], side: int, most: float, anchor: CellId = ORIGIN, parts: int = 1
) -> dict[str, Unit]:
    layout = Layout(counts, EDGE, HALO)
    return {str(block): layout.unit(block) for block in layout.share(side, most, anchor, parts)}


@settings(deadline=None, max_examples=50)
@given(tile_points, st.integers(1, 12), st.integers(1, 9000), st.integers(-9, 9), st.integers(1, 9))
@example({CellId(0, 0): 1, CellId(0, -1): 1}, 8, 1, 0, 1)
def test_blocks_own_each_tile_once_and_hold_what_they_may(
    counts: dict[CellId, int], side: int, most: int, anchor: int, parts: int
) -> None:
    found = laid_out(counts, side, most, CellId(anchor, -anchor), parts)
    owning = {t: [n for n, u in found.items() if overlap(u.core, cell_bounds(t, EDGE))]
              for t in counts}  # fmt: skip
    assert all(len(names) == 1 for names in owning.values())
    assert Holders(found, EDGE).of(counts) == owning  # type: ignore[arg-type]
    for name, unit in found.items():
        i, j, columns, rows = parse_block(name)
        assert unit.core == Bounds(i * EDGE, j * EDGE, (i + columns) * EDGE, (j + rows) * EDGE)
        assert unit.held <= most or columns == rows == 1
        assert unit.points == sum(n for t, n in counts.items() if owning[t] == [name])


@settings(deadline=None, max_examples=50)
@given(tile_points, st.sampled_from(LARGEST), st.integers(1, 9000))
def test_blocks_that_are_joined_read_less(counts: dict[CellId, int], side: int, most: int) -> None:
    layout = Layout(counts, EDGE, HALO)

    def read(blocks: Iterable[Block]) -> int:
        return sum(layout.unit(block).held for block in blocks)

    cut = list(layout.cut(layout.squares(side), most))
    # what is held is rounded up to whole points
    assert read(layout.join(cut, most)) <= read(cut) + len(cut)


def test_a_strip_is_joined_to_the_neighbour_that_reads_it_anyway() -> None:
    counts = everywhere(1000, 4) | {CellId(4, j): 20 for j in range(4)}
    assert set(laid_out(counts, 4, 1e9)) == {"0_0_5_4"}
    assert set(laid_out(counts, 4, 16_050)) == {"0_0_2_4", "2_0_3_4"}, "cut through all of it"
    corner = {CellId(0, 0): 1000, CellId(1, 0): 9, CellId(1, 1): 1000, CellId(0, 1): 1000}
    assert set(laid_out(corner, 1, 1e9)) == {"0_0_2_1", "0_1_1_1", "1_1_1_1"}


@settings(deadline=None, max_examples=50)
@given(tile_points, tile_points, st.integers(1, 9000))
def test_points_far_away_change_no_block(
    counts: dict[CellId, int], more: dict[CellId, int], most: int
) -> None:
    far = {CellId(t.i + 400, t.j): n for t, n in more.items()}
    before, after = laid_out(counts, 8, most), laid_out({**counts, **far}, 8, most)
    assert before.items() <= after.items()


def test_the_sizes_of_blocks_are_remembered_for_each_size_of_tiles(tmp_path: Path) -> None:
    store, other = Store(tmp_path), workflow(tiling={"tile_m": 50})
    assert remembered_sizes(store, DEFAULTS) is None
    remember_sizes(store, DEFAULTS, Sizes(4, 6, CellId(-3, 7), 2**30))
    remember_sizes(store, other, Sizes(2))
    assert remembered_sizes(store, DEFAULTS) == Sizes(4, 6, CellId(-3, 7), 2**30)
    assert remembered_sizes(store, other) == Sizes(2)
    older = read_json(store.path("blocks.json"))
    for sizes in older.values():
        del sizes["anchor"], sizes["parts"], sizes["memory_bytes"]
    write_json(store.path("blocks.json"), older)
    assert remembered_sizes(store, DEFAULTS) == Sizes(4)
    remember_stretch(store, 500_000)
    assert remembered_stretch(store) == 500_000
    assert remembered_sizes(store, DEFAULTS) == Sizes(4), "stands beside the stretches"
    store.path("blocks.json").write_text("{half")
    assert remembered_stretch(store) is None
    assert remembered_sizes(store, DEFAULTS) is None, "chosen anew"


def test_blocks_stay_as_they_are_when_a_worker_has_more_memory() -> None:
    dense = everywhere(400_000, 8)
    chosen = Sizes(8, memory_bytes=2 * 2**30)
    assert cores(dense, chosen, 9) == cores(dense, Sizes(8), 2) != cores(dense, Sizes(8), 9)
    assert cores(dense, chosen, 1) == cores(dense, Sizes(8), 1) != cores(dense, chosen, 2)
    pieces = list(from_counts(dense, 100_000))
    assert count_blocks(pieces, DEFAULTS, 9 * 2**30, chosen).blocks == len(cores(dense, chosen, 9))


def test_only_voxel_parts_of_the_region_are_read() -> None:
    boxes = {"a": [0, 0, 0, 2, 2, 9], "b": [2, 0, 0, 4, 2, 9], "c": [-9, -9, 0, -8, -8, 1]}
    index = voxel_index(boxes, 10)
    assert index.overlapping(Bounds(0, 0, 20, 20)) == ["a"]
    assert index.overlapping(Bounds(0, 0, 21, 20)) == ["a", "b"]
    assert index.overlapping(Bounds(-85, -85, -84, -84)) == ["c"]


def box(x: int, y: int, size: int = 150_000) -> list[int]:
    return [x, y, 0, x + size, y + size, 10]


def test_one_mosaic_where_the_survey_is_in_one_piece() -> None:
    cells = [CellId(0, 0), CellId(1, 0), CellId(-1, 2)]
    ((kept, region),) = split_mosaic(
        dict.fromkeys(cells, 9), [box(-100_500, 10_200, 400_000)], 200_000, 1000
    )
    assert kept == sorted(cells)
    assert region == Bounds(-101_000, 10_000, 300_000, 411_000)
    assert split_mosaic({}, [], 200_000, 1000) == []


def test_stray_points_some_kilometres_away_widen_no_raster() -> None:
    survey = [CellId(i, 0) for i in range(3)]
    strays = [CellId(45, 45), CellId(-45, -45)]
    boxes = [box(-45 * 200_000, -45 * 200_000, 91 * 200_000)]
    parts = split_mosaic(dict.fromkeys(survey, 9) | dict.fromkeys(strays, 1), boxes, 200_000, 1000)
    assert [cells for cells, _ in parts] == [survey, strays[1:], strays[:1]]
    assert all(region.area_m2 <= 600 * 200 for _, region in parts)


def test_pieces_far_apart_get_rasters_of_their_own() -> None:
    near = [CellId(i, 0) for i in range(3)]
    far = [CellId(200_000, 100_000)]
    boxes = [box(0, 0, 599_000), box(200_000 * 200_000, 100_000 * 200_000)]
    points = dict.fromkeys(near, 20) | dict.fromkeys(far, 50)
    parts = split_mosaic(points, boxes, 200_000, 1000)
    assert [p[0] for p in parts] == [near, far], "the piece with most points comes first"
    points[far[0]] = 61
    assert [p[0] for p in split_mosaic(points, boxes, 200_000, 1000)] == [far, near]
    for cells, region in parts:
        assert region.area_m2 <= 600 * 200
        assert all(v % 1000 == 0 for v in region)
        assert all(overlap(cell_bounds(c, 200_000), region) for c in cells)


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
    monkeypatch.setattr(preparing, "machine_memory", lambda: int(machine_gib * 2**30))
    assert preparing.usual_bytes(workers) == gib * 2**30


def test_a_key_depends_on_the_name_alone() -> None:
    assert source_key("a/b.laz") == source_key("a/b.laz") != source_key("a/c.laz")
    assert 0 <= source_key("x") < 2**63
