"""The page of photon profiles."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from spl_batch.altimetry.report.model import METHOD_NAMES, TrackReport
from spl_batch.engine.report import number_format as text
from spl_batch.engine.report.page import Front, render_page
from spl_batch.engine.report.parts import Statistics
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.verdict import Verdict, ending_rows, failure_verdict, speed_remark
from spl_batch.errors import counted

SECTIONS: Final = (("profiles", "Profiles"), ("accuracy", "Accuracy"), ("beams", "Beams"))


def render(report: TrackReport, pictures: Sequence[Mapping[str, Picture]]) -> str:
    """The page, without any reference to another file; the same input gives the same text."""
    length_km = sum(b.length_km or 0.0 for b in report.beams)
    flat = {f"{key}_{i}": shown for i, drawn in enumerate(pictures) for key, shown in drawn.items()}
    return render_page(
        "track.html.j2",
        report,
        Front(
            title=report.name,
            kicker="Photon-counting altimetry",
            facts=(counted(len(report.beams), "beams"), f"{text.significant(length_km)} km"),
            sections=SECTIONS,
            verdicts=tuple(_verdicts(report)),
            cards=tuple(_cards(report)),
        ),
        package="spl_batch.altimetry.report",
        pictures=flat,
        keys=[[f"{key}_{i}" for key in drawn] for i, drawn in enumerate(pictures)],
        compared=_compared(report),
        labelled=[b for b in report.beams if b.labels],
        names=METHOD_NAMES,
    )


def _verdicts(report: TrackReport) -> Iterator[Verdict]:
    counts = report.counts
    if counts.points_in == counts.points_out and counts.points_in:
        yield Verdict("good", f"Every photon is delivered: {text.number(counts.points_in)}.")
    else:
        yield Verdict(
            "bad",
            f"{text.number(counts.points_in)} photons in, {text.number(counts.points_out)} out.",
        )
    if report.ground is None:
        yield Verdict(
            "neutral", "No reference heights are near: the accuracy of the heights is not known."
        )
    else:
        yield Verdict("good", f"Ground minus reference: {_accuracy(report.ground)}.")
    yield failure_verdict(report.failures, report.findings)


def _compared(report: TrackReport) -> list[tuple[str, Statistics | None, Statistics | None]]:
    """What is compared, ours and mDBSCAN's: all beams, and each where there are several."""
    each: list[tuple[str, Statistics | None, Statistics | None]] = [
        (f"{b.file} {b.name}", b.ground, b.baseline_ground)
        for b in report.beams
        if b.ground is not None
    ]
    return [("all", report.ground, report.baseline_ground), *each] if len(each) > 1 else each


def _cards(report: TrackReport) -> list[tuple[str, str, str]]:
    counts, work = report.counts, report.performance
    cards = []
    if report.ground is not None:
        rest = f"median {text.metres(report.ground.median)}, "
        rest += f"RMSE {text.metres(report.ground.rmse)}"
        cards.append(("Ground NMAD", text.metres(report.ground.nmad), rest))
    cells = sum(b.ground_cells for b in report.beams)
    wooded = sum(b.canopy_cells for b in report.beams)
    return [
        *cards,
        ("Photons", text.large(counts.points_in), f"{text.number(counts.points_out)} out"),
        (
            "Signal",
            text.large(counts.signal),
            text.of_all(counts.signal, counts.points_in, "photons"),
        ),
        ("Ground cells", text.large(cells), f"{text.number(wooded)} wooded"),
        ("Time", text.duration(work.wall_s), speed_remark(work, "photons")),
    ]


def screen_summary(report: TrackReport) -> list[tuple[str, str]]:
    """Label and value of each number that the console shows after a run."""
    counts, work = report.counts, report.performance
    rows = [
        ("photons", f"{text.number(counts.points_in)} in, {text.number(counts.points_out)} out"),
        ("signal", _with_share(counts.signal, counts.points_in)),
        ("noise", _with_share(counts.background, counts.points_in)),
    ]
    if counts.not_assessed:
        rows.append(("not assessed", _with_share(counts.not_assessed, counts.points_in)))
    surface, floor = (sum(getattr(b, part) for b in report.beams) for part in ("surface", "floor"))
    if surface:
        rows.append(
            ("level water", f"{text.number(surface)} of surface, {text.number(floor)} below")
        )
    rows.append(("ground accuracy", _accuracy(report.ground)))
    if report.baseline_ground is not None:
        rows.append(("by mDBSCAN", _accuracy(report.baseline_ground)))
    for beam in report.beams:
        for method, agreement in beam.labels.items():
            if agreement.f1 is not None:
                rows.append((f"{beam.name} labels, {method}", f"F1 {agreement.f1:.3f}"))
    plain = [(label, text.as_ascii(value)) for label, value in rows]
    return plain + ending_rows(work, report.failures, report.findings, "photons")


def _with_share(part: int, whole: int) -> str:
    return f"{text.number(part)} ({text.of_all(part, whole, 'photons')})"


def _accuracy(found: Statistics | None) -> str:
    if found is None:
        return "no reference heights"
    named = (("median", found.median), ("NMAD", found.nmad), ("RMSE", found.rmse))
    return ", ".join(f"{name} {text.metres(value)}" for name, value in named)
