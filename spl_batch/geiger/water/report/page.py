"""The page of a water surface, and the few numbers that the console shows."""

from collections.abc import Iterator, Mapping

from spl_batch.engine.report import number_format as text
from spl_batch.engine.report.page import Front, render_page
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.verdict import Verdict, ending_rows, failure_verdict
from spl_batch.geiger.water.report.model import WaterReport


def render(report: WaterReport, pictures: Mapping[str, Picture]) -> str:
    """The page.

    ``pictures``: from :mod:`~spl_batch.geiger.water.report.pictures`; any may be missing.
    """
    sections = (("accuracy", "Accuracy"), ("surface", "Surface"), ("calibration", "Calibration"))
    return render_page(
        "water.html.j2",
        report,
        Front(
            title=report.name,
            kicker="Water surface from a Geiger-mode array",
            facts=tuple(_facts(report)),
            sections=sections,
            verdicts=(
                _accuracy_verdict(report),
                failure_verdict(report.failures, report.findings),
            ),
            cards=tuple(_cards(report)),
        ),
        package="spl_batch.geiger.water.report",
        pictures=pictures,
    )


def _surfaces(report: WaterReport) -> int:
    return sum(file.acquisitions for file in report.files)


def _facts(report: WaterReport) -> Iterator[str]:
    water = [file for file in report.files if file.role == "water"]
    yield f"{len(water)} file{'s' * (len(water) != 1)} of frames"
    frames = text.number(report.frames_per_acquisition)
    yield f"{text.number(_surfaces(report))} acquisitions of {frames} frames"
    yield report.crs or "no CRS"


def _cards(report: WaterReport) -> Iterator[tuple[str, str, str]]:
    yield "Surfaces", text.number(_surfaces(report)), f"{text.large(report.points)} points"
    if report.surfaces is not None:
        made = report.surfaces
        spread = None if made.variance_m2 is None else made.variance_m2**0.5
        yield (
            "Normals",
            f"{text.significant(made.pixel_normal_deg)}°",
            f"{text.significant(made.normal_deg)}° of the mean normal",
        )
        yield (
            "Height",
            text.millimetres(spread),
            f"spread; bias {text.millimetres(made.signed_bias_m)} down",
        )
    if report.floor is not None:
        yield (
            "Sea floor",
            text.millimetres(report.floor.refracted_beam_m),
            f"{text.millimetres(report.floor.level_beam_m)} under a level surface",
        )
    if report.calibration is not None:
        dead = report.calibration.dead
        yield "Dead pixels", text.number(dead), f"of {text.number(report.calibration.used)} in use"


def _accuracy_verdict(report: WaterReport) -> Verdict:
    made = report.surfaces
    if made is None or made.pixel_normal_deg is None:
        return Verdict("neutral", "No truth and no level surface were given: accuracy is unknown.")
    return Verdict(
        "good",
        f"Normals lie {text.significant(made.pixel_normal_deg)}° from the true ones, heights "
        f"{text.millimetres((made.mse_m2 or 0.0) ** 0.5)} (root mean square).",
    )


def screen_summary(report: WaterReport) -> list[tuple[str, str]]:
    """Label and value of each number that the console shows after a run."""
    rows = [
        ("surfaces", f"{text.number(_surfaces(report))}, {text.number(report.points)} points"),
    ]
    if report.calibration is not None:
        made = report.calibration
        rows.append(("calibration", "fitted" if made.fitted else "as given"))
        rows.append(("dead pixels", f"{text.number(made.dead)} of {text.number(made.used)} in use"))
    if report.surfaces is None:
        rows.append(("accuracy", "no truth"))
    else:
        found = report.surfaces
        rows.append(("normals", f"{text.significant(found.pixel_normal_deg)} deg"))
        rows.append(("bias", text.millimetres(found.signed_bias_m)))
    if report.floor is not None:
        rows.append(("sea floor", text.millimetres(report.floor.refracted_beam_m)))
    plain = [(label, text.as_ascii(value)) for label, value in rows]
    return plain + ending_rows(report.performance, report.failures, report.findings)
