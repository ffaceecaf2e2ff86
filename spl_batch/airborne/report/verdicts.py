"""The few numbers and sentences that a reader wants first, for the console and the page."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from spl_batch.airborne.report.model import ClientTile, Counts, Report
from spl_batch.airborne.settings.standards import LEVELS
from spl_batch.engine.report.number_format import (
    as_ascii,
    number,
    of_all,
    percent,
    significant,
    surface_name,
)
from spl_batch.engine.report.parts import Statistics
from spl_batch.engine.report.verdict import Tone, Verdict, ending_rows, failure_verdict
from spl_batch.errors import named

OPEN_SURFACES: Final = ("open_ground", "open", "bare_ground", "ground", "all")
"""Classes that the terrain verdict is taken from; the first one that is there."""

_NO_REFERENCE: Final = "no reference was given"


def verdicts(report: Report) -> list[Verdict]:
    """Sentences on whether the result can be used, bad news before the others.

    Always three: accuracy, conservation of points, failures.
    """
    found = [
        _accuracy_verdict(report),
        _conservation_verdict(report),
        failure_verdict(report.failures, report.findings),
    ]
    return sorted(found, key=lambda verdict: verdict.tone != "bad")


def terrain_statistics(report: Report) -> tuple[str, Statistics] | None:
    """Name and statistics of the surface that terrain accuracy is judged on."""
    found = report.accuracy
    classes = {} if found is None or found.own_points else found.dtm
    for name in OPEN_SURFACES:
        if name in classes and classes[name].rmse is not None:
            return name, classes[name]
    return None


def noise_removed(report: Report) -> float | None:
    """Background and afterpulses as a share of all points, 0..1.

    Every share of a report is of all points, so that those of the classes add up.
    """
    counts = report.counts
    removed = counts.background + counts.afterpulse
    return removed / counts.points_in if counts.points_in else None


def photon_counting(report: Report) -> bool:
    """Whether noise or afterpulses were looked for, as single-photon lidar needs it.

    Without either, points went straight to ground and surfaces: linear-mode lidar, of which a
    report has nothing about shots, beamlets and detectors.
    """
    return report.noise.method != "none" or parameter(report, "afterpulse.enabled") is not False


def parameter(report: Report, key: str) -> Any:
    """Value of the workflow by its key, such as ``filter.alpha``; None where it is not stated."""
    value: Any = report.provenance.parameters
    for name in key.split("."):
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def terrain_accuracy(report: Report) -> str | None:
    """RMSE of the terrain and the surfaces it is over: those judged, and all of them."""
    terrain = terrain_statistics(report)
    if terrain is None or report.accuracy is None:
        return None
    name, statistics = terrain
    rmse = f"RMSE {report.survey.units.height(statistics.rmse)} on {surface_name(name)}"
    overall = report.accuracy.dtm.get("all")
    if name == "all" or overall is None or overall.rmse is None:
        return rmse
    return f"{rmse} ({report.survey.units.height(overall.rmse)} on all surfaces)"


def mostly_unfiltered(counts: Counts, method: str) -> str:
    """Sentence for a survey of which more than half could not be filtered; empty for others."""
    if method == "none" or 2 * counts.no_beam <= counts.points_in:
        return ""
    return (
        f"{percent(counts.no_beam / counts.points_in)} of the points have no usable time or no "
        "trajectory there and stay unfiltered, noise among them: the warnings name which, and why; "
        "mend the times or the trajectory and run again"
    )


def screen_summary(report: Report) -> list[tuple[str, str]]:
    """Label and value of each number that the console shows after a run."""
    counts, work = report.counts, report.performance
    kinds = [("ground", counts.ground)]
    if photon_counting(report):
        noise = [("background noise", counts.background), ("afterpulses", counts.afterpulse)]
        kinds = [("signal", counts.signal), *noise, *kinds]
    kinds += [("not assessed", counts.not_assessed)] * bool(counts.not_assessed)
    not_read = f", about {number(counts.not_read)} not read" if counts.not_read else ""
    dropped = sum(counts.dropped.values())
    rows = count_rows(counts.points_in, counts.points_out, kinds, dropped, not_read)
    if counts.in_no_client_tile is not None:
        rows.append(("client tiles", _client_tiles(report.client_tiles, counts.in_no_client_tile)))
    if unfiltered := mostly_unfiltered(counts, report.noise.method):
        rows.append(("attention", unfiltered))
    if report.density.mean_per_m2 is not None:
        ground = report.density.ground_per_m2
        of_it = "" if ground is None else f", {significant(ground)} of it ground"
        what = "signal density" if photon_counting(report) else "density"
        rows.append((what, f"{significant(report.density.mean_per_m2)} per m2{of_it}"))
    accuracy = terrain_accuracy(report) or _at_checkpoints(report)
    if accuracy is None:
        missing = any(
            one.code == "C02" and one.values["kind"] == "missing" for one in report.findings
        )
        remedy = "; `spl-batch run` does it" if missing else ""
        rows.append(("accuracy", _without_accuracy(report) + remedy))
    else:
        rows.append(("DTM accuracy", accuracy))
    return [(label, as_ascii(value)) for label, value in rows] + ending_rows(
        work, report.failures, report.findings
    )


def count_rows(
    points_in: int,
    points_out: int,
    kinds: Iterable[tuple[str, int]],
    dropped: int,
    not_read: str = "",
) -> list[tuple[str, str]]:
    """Label and value of points in and out, and of each kind as a share of all [count]."""
    left_out = f"{not_read}, {number(dropped)} dropped" if dropped else not_read
    points = f"{number(points_in)} in, {number(points_out)} out{left_out}"
    shares = ((label, f"{number(n)} ({of_all(n, points_in)})") for label, n in kinds)
    return [("points", points), *shares]


def _client_tiles(tiles: Sequence[ClientTile], outside: int) -> str:
    """How many a client has, which are empty, and how many points lie in none."""
    empty = [tile.name for tile in tiles if not tile.points]
    text = number(len(tiles))
    if empty:
        text += f", {number(len(empty))} of them without points ({named(empty)})"
    return f"{text}; {f'{number(outside)} points lie' if outside else 'no point lies'} in none"


def _accuracy_verdict(report: Report) -> Verdict:
    terrain = terrain_statistics(report)
    if terrain is None:
        why, fit = _without_accuracy(report), _at_checkpoints(report)
        if fit is not None and why == _NO_REFERENCE:
            return Verdict("neutral", f"DTM {fit}; no reference lidar was given.")
        tone: Tone = "neutral" if why == _NO_REFERENCE else "attention"
        return Verdict(tone, f"{why[0].upper()}{why[1:]}: accuracy is not known.")
    rmse = terrain[1].rmse or 0.0
    opening = f"DTM {terrain_accuracy(report)}, against linear-mode lidar and not checkpoints: "
    limits = sorted({level.rmse_v_m for level in LEVELS.values()})
    for limit in limits:
        if rmse <= limit:
            allow = [name for name, level in LEVELS.items() if level.rmse_v_m == limit]
            return Verdict(
                "good",
                f"{opening}within the {report.survey.units.height(limit)} that USGS "
                f"{' and '.join(allow)} allows at checkpoints.",
            )
    least = report.survey.units.height(limits[-1])
    return Verdict("attention", f"{opening}above the {least} that USGS QL3 allows at checkpoints.")


def _without_accuracy(report: Report) -> str:
    """Why accuracy is not known."""
    if report.accuracy is not None and report.accuracy.own_points:
        return "the reference holds the survey's own points"
    if report.accuracy is not None:
        return "the reference covers no terrain"
    if parameter(report, "reference.points"):
        return "the rasters were not compared with the reference"
    return _NO_REFERENCE


def _at_checkpoints(report: Report) -> str | None:
    """How well the terrain fits the open checkpoints; None where there are none on it."""
    if report.checkpoints is None or report.checkpoints.nva.rmse_v1_m is None:
        return None
    nva = report.checkpoints.nva
    return f"RMSE {report.survey.units.height(nva.rmse_v1_m)} at {number(nva.n)} open checkpoints"


def _conservation_verdict(report: Report) -> Verdict:
    counts = report.counts
    if counts.points_in == 0:
        return Verdict("bad", "No points were read.")
    gap = counts.points_in - counts.points_out - sum(counts.dropped.values())
    if not gap:
        return _all_delivered(report)
    change = f"{number(abs(gap))} points {'fewer' if gap > 0 else 'more'} out than in"
    return Verdict("bad", f"{change}: do not use the clouds before this is explained.")


def _all_delivered(report: Report) -> Verdict:
    """Sentences where as many points come out as were read."""
    counts, points = report.counts, number(report.counts.points_in)
    if counts.not_assessed == counts.points_in and report.noise.method != "none":
        text = f"{points} points are delivered, and none was assessed: the warnings name why."
        return Verdict("bad", text)
    if unfiltered := mostly_unfiltered(counts, report.noise.method):
        return Verdict("bad", f"Every point is delivered, {points} in and out, but {unfiltered}.")
    if counts.not_read:
        missing = f"about {number(counts.not_read)} in files that cannot be read are not"
        text = f"Every point that could be read is delivered, {points} in and out; {missing}."
        return Verdict("attention", text)
    if counts.dropped:
        left_out = ", ".join(f"{number(n)} {kind}" for kind, n in counts.dropped.items())
        text = f"Every point is accounted for: {points} in, {number(counts.points_out)} out"
        return Verdict("good", f"{text}; outputs.drop left out {left_out}.")
    return Verdict("good", f"Every point is delivered: {points} in and out.")
