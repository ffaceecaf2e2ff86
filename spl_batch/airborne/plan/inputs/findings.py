"""Findings on the inputs of an airborne survey, once a phase has read them."""

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np

from spl_batch.airborne.findings import CODES
from spl_batch.airborne.plan.flightlines import FALLBACK_PRF_HZ
from spl_batch.airborne.plan.inputs.channel_dimension import holds_few, unnamed_channels
from spl_batch.airborne.plan.inputs.file_positions import THINNEST
from spl_batch.airborne.plan.survey_ledger import Survey, timeless_sources
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import WorkflowError, counted, grouped, merged_faults, named
from spl_batch.formats.gps_clock import CLOCKS
from spl_batch.formats.las.reader import Numbers

PRF_APART: Final = 0.05
"""A stated pulse rate may differ by this part from the one that gps_time shows."""


def judge_index(survey: Survey, failures: Iterable[Receipt]) -> Iterator[Finding]:
    """Stop where no input is usable; name those without times."""
    usable = survey.of("index_file")
    if not usable or not any(r.points for r in usable.values()):
        reasons = [*merged_faults(survey.inputs.bad), *(r.reason for r in failures)]
        raise WorkflowError("no input is usable: " + ("; ".join(reasons) or "they hold no points"))
    unused = [r for r in usable.values() if r.points and r.facts["excluded"] == r.points]
    if sum(r.points for r in unused) == sum(r.points for r in usable.values()):
        names = named(sorted(str(r.facts["name"]) for r in unused))
        fault = CODES["I01"].sentence("withheld")
        raise WorkflowError(
            f"{names}: {fault}; clear the flag or the class of those that are valid"
        )
    yield from (Finding("I01", {"kind": "withheld"}, str(r.facts["name"])) for r in unused)
    _check_channels(survey)
    yield from channels_not_named(survey)
    timeless = timeless_sources(survey)
    yield from (Finding("I02", {"kind": "file"}, source.name) for source in timeless)
    for line in survey.flightlines:
        if line.prf_basis == "assumed":
            yield Finding("T01", {"kind": "assumed", "prf_hz": FALLBACK_PRF_HZ}, line.name)
    yield from _contradicted_rates(survey)
    yield from _flown_twice(survey)
    yield from other_clocks(survey)
    if survey.filtering and not survey.flightlines:
        raise WorkflowError(
            f"{named([source.name for source in timeless])}: no point has a usable gps_time, so "
            "there are no shots to filter by; set filter.method: none and afterpulse.enabled: "
            "false for ground and surfaces"
        )


def channels_not_named(survey: Survey) -> tuple[Finding, ...]:
    """Propose the dimension that holds beamlet numbers, where none is named."""
    if survey.workflow.survey.channel_dimension is not None or not survey.filtering:
        return ()
    held = {
        str(receipt.facts["name"]): {k: Numbers(*v) for k, v in receipt.facts["numbers"].items()}
        for receipt in survey.of("index_file").values()
    }
    return unnamed_channels(held, survey.workflow.sensor)


def _check_channels(survey: Survey) -> None:
    """Stop where the dimension that was named cannot hold beamlet numbers."""
    name, sensor = survey.workflow.survey.channel_dimension, survey.workflow.sensor
    indexed = survey.of("index_file").values()
    points = sum(r.facts["points"] for r in indexed)
    if name is None or not survey.filtering:
        return
    seen = 0
    for receipt in indexed:
        seen |= int(receipt.facts["channels_seen"], 16)
    if not holds_few(seen.bit_count(), points, sensor):
        return
    values = ", ".join(str(k) for k in range(256) if seen >> k & 1)
    files = named([str(r.facts["name"]) for r in indexed], 3)
    raise WorkflowError(
        f"survey.channel_dimension: {name} holds only {values} in {grouped(points)} points "
        f"({files}), and {sensor.name} has {sensor.beamlets} beamlets; name the dimension that "
        "holds their numbers, or leave the key out: a shot is one beamlet then"
    )


def refuse_empty_area(survey: Survey) -> None:
    """Stop where no point lies in the area of interest: all would be delivered as outside."""
    tiles = survey.of("build_tile").values()
    outside = sum(receipt.facts["outside_aoi"] for receipt in tiles)
    if outside and outside == sum(receipt.facts["points"] for receipt in tiles):
        raise WorkflowError(
            f"aoi: none of {grouped(outside)} points lies in {survey.workflow.aoi}, which meets "
            "the box around them; correct its polygons or leave the key out"
        )


def copies(survey: Survey) -> Iterator[Finding]:
    """Files that hold returns twice, or returns that others hold too."""
    counts: Counter[tuple[str, str]] = Counter()
    for receipt in survey.of("build_tile").values():
        for copy, kept, count in receipt.facts["copies"]:
            counts[copy, kept] += count
    files = {str(source.key): source for source in survey.inputs.sources}
    named_pairs = ((files[copy], files[kept], n) for (copy, kept), n in counts.items())
    for copy, kept, count in sorted(named_pairs, key=lambda one: (one[0].name, one[1].name)):
        if copy is kept:
            values = {"kind": "repeated", "count": count, "points": copy.facts.n_points}
            yield Finding("I03", values, copy.name, badness=count)
        else:
            values = {"kind": "files", "count": count}
            yield Finding("I03", values, f"{copy.name} and {kept.name}", badness=count)


def points_astray(survey: Survey) -> Iterator[Finding]:
    """Few points outside the rest of the survey that make its rasters more than twice as large."""
    tiles, counts = np.array([*survey.counts]), np.array([*survey.counts.values()])
    if not counts.any():
        return
    typical = float((counts**2).sum() / counts.sum())
    dense = tiles[counts >= THINNEST * typical]
    low, high = dense.min(axis=0), dense.max(axis=0)
    beyond = np.any((tiles < low) | (tiles > high), axis=1)
    # Points on the edge of a tile reach no farther than that.
    west, south, _, east, north, _ = survey.bounds
    ends = np.array([(west, south), (east + 1, north + 1)])
    held = np.clip(np.array([low, high + 1]) * survey.tile_q, *ends)
    times = float(np.prod(np.diff(ends, axis=0) / np.diff(held, axis=0)))
    if times > 2.0:
        values = {
            "kind": "astray", "count": int(counts[beyond].sum()),
            "km": float(np.abs(ends - held).max() * QUANTUM_M / 1000), "times": times,
        }  # fmt: skip
        yield Finding("I05", values)


def _contradicted_rates(survey: Survey) -> Iterator[Finding]:
    """Flightlines whose gps_time shows another pulse rate than the one that is stated."""
    indexed = survey.of("index_file")
    for line in survey.flightlines:
        seen = [indexed[key].facts["prf_hz"].get(str(line.psid)) for key in line.sources]
        far = [hz for hz in seen if hz and abs(hz / line.clock.prf_hz - 1.0) > PRF_APART]
        if line.prf_basis == "given" and far and len(far) == sum(map(bool, seen)):
            values = {
                "kind": "contradicted", "prf_hz": float(far[0]), "stated_hz": line.clock.prf_hz
            }  # fmt: skip
            yield Finding("T01", values, line.name)


def other_clocks(survey: Survey) -> Iterator[Finding]:
    """Files that count their times in another way than those of most points do."""
    points: Counter[str] = Counter()
    files = [r for r in survey.of("index_file").values() if r.facts["standard"] in CLOCKS]
    for receipt in files:
        points[receipt.facts["standard"]] += receipt.points
    main = max(points, key=lambda standard: (points[standard], standard), default="")
    for receipt in files:
        if receipt.facts["standard"] != main:
            found = CLOCKS[receipt.facts["standard"]]
            values = {"kind": "clock", "found": found, "main": CLOCKS[main]}
            yield Finding("I01", values, str(receipt.facts["name"]))


def _flown_twice(survey: Survey) -> Iterator[Finding]:
    """Flightlines that begin and end in the same moments, and hold as many returns."""
    alike: dict[tuple[float, float, int], list[str]] = {}
    for line in survey.flightlines:
        if line.first_s < line.last_s:
            alike.setdefault((line.first_s, line.last_s, line.points), []).append(line.name)
    for (first_s, last_s, points), names in alike.items():
        if len(names) > 1:
            values = {
                "kind": "flightlines", "first_s": first_s, "last_s": last_s, "points": points
            }  # fmt: skip
            yield Finding("I03", values, named(names))


def beams_without_trajectory(survey: Survey) -> Finding:
    """What beams are taken from where there is no trajectory."""
    counts = Counter(receipt.facts["basis"] for receipt in survey.of("sensor_path").values())
    ways = {
        "intersection": "from where lines of sight meet",
        "scan_angle": "from scan_angle and the flight direction",
        "vertical": "as vertical",
    }
    listed = ", ".join(f"{ways[basis]} on {counts[basis]}" for basis in ways if counts[basis])
    return Finding("T03", {"how": f"{listed} of {counted(counts.total(), 'flightlines')}"})
