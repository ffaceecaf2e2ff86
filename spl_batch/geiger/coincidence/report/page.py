"""The page of a report on coincidence processing, and its pictures."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from matplotlib.figure import Figure
from numpy.typing import NDArray

from spl_batch.engine.report import number_format as text
from spl_batch.engine.report import style
from spl_batch.engine.report.maps import Raster, draw_ramp, draw_relief, reduce_raster, spread
from spl_batch.engine.report.page import Front, render_page
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.verdict import Verdict, failure_verdict
from spl_batch.geiger.coincidence.report.model import CoincidenceReport

SECTIONS: Final = (("points", "Points"),)
_PACKAGE: Final = "spl_batch.geiger.coincidence.report"
_STRIP_IN: Final = (style.WIDTH_IN, 4.8)


@dataclass(frozen=True, slots=True)
class Strip:
    """A thin upright slice, seen from its side."""

    #: (n, 2) float64: along the slice, and height [m].
    detections_m: NDArray[Any]
    points_m: NDArray[Any]


def pictures(
    height: Raster | None, intensity: Raster | None, strip: Strip | None
) -> dict[str, Picture]:
    """Pictures ``height``, ``intensity`` and ``strip``; one without data says so."""
    return {
        "height": _height(height),
        "intensity": _intensity(intensity),
        "strip": _strip(strip),
    }


def _height(raster: Raster | None) -> Picture:
    title = "Highest points"
    if raster is None or not raster.any_value:
        return Picture(title, "There are no points to show.")
    limits = spread(reduce_raster(raster).values, 0.5, 99.5)
    drawn = draw_relief(raster, title, "height [m]", limits)
    return _made(
        drawn, title, "Lone spikes would be noise taken for a surface, grey is without points."
    )


def _intensity(raster: Raster | None) -> Picture:
    title = "Intensity"
    if raster is None or not raster.any_value:
        return Picture(title, "There are no points to show.")
    top = spread(reduce_raster(raster).values, 1, 99)[1]
    unit = "detections per look"
    drawn = draw_ramp(raster, title, unit, ramp=style.DENSITY, limits=(0.0, top))
    said = (
        "Detections for each look through a voxel: paint shows, and so do edges, which looks "
        "share with what lies behind."
    )
    return _made(drawn, title, said)


def _strip(strip: Strip | None) -> Picture:
    title = "A slice, before and after"
    if strip is None or not len(strip.points_m):
        return Picture(title, "No slice holds points to show.")
    with style.type_context():
        figure = style.figure(*_STRIP_IN)
        upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, places, name in (
            (upper, strip.detections_m, "Detections"),
            (lower, strip.points_m, "Points"),
        ):
            axes.plot(places[:, 0], places[:, 1], ".", ms=2.5, mew=0, color=style.SIGNAL)
            axes.set_title(name)
            axes.set_ylabel("height [m]")
            axes.spines[["top", "right"]].set_visible(False)
        lower.set_xlabel("distance along the slice [m]")
        low, high = strip.points_m[:, 1].min(), strip.points_m[:, 1].max()
        lower.set_ylim(low - 2.0, high + 2.0)
    return _made(figure, title, "A slice of the fullest tile: detections above, points below.")


def _made(drawn: Figure, title: str, caption: str) -> Picture:
    png, width, height = style.to_png(drawn)
    return Picture(title, caption, f"{title}. {caption}", png, width, height)


def render(report: CoincidenceReport, shown: Mapping[str, Picture]) -> str:
    """The page as HTML; ``shown`` is from :func:`pictures`."""
    counts, scene = report.counts, report.scene
    front = Front(
        scene.name,
        "Geiger-mode lidar, coincidence processing",
        tuple(filter(None, (scene.crs, f"voxels of {text.centimetres(scene.voxel_m)}"))),
        SECTIONS,
        tuple(verdicts(report)),
        (
            ("Looks", text.large(counts.looks), f"{text.number(counts.frames)} frames"),
            ("Detections", text.large(counts.detections), _share(counts.detections, counts.looks)),
            ("Points", text.large(counts.points), f"{text.number(counts.tiles)} tiles"),
        ),
    )
    return render_page("page_coincidence.html.j2", report, front, package=_PACKAGE, pictures=shown)


def _share(part: int, whole: int) -> str:
    return f"{text.percent(part / whole)} of the looks" if whole else ""


def verdicts(report: CoincidenceReport) -> list[Verdict]:
    """Sentences that say whether the result can be used."""
    counts = report.counts
    if counts.points:
        said = Verdict(
            "good",
            f"{text.number(counts.detections)} detections became "
            f"{text.number(counts.points)} points.",
        )
    else:
        said = Verdict("bad", "No points: nowhere do enough detections coincide for the threshold.")
    found = [said, failure_verdict(report.failures, report.findings)]
    return sorted(found, key=lambda verdict: verdict.tone != "bad")
