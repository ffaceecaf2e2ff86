"""The page of a report on coincidence processing, and its pictures."""

from collections.abc import Mapping
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


Slice = tuple[NDArray[Any], NDArray[Any]]
"""Detections and points of an upright slice: (n, 2) float64 each, along it and height [m]."""


def pictures(
    height: Raster | None, intensity: Raster | None, slice_m: Slice | None
) -> dict[str, Picture]:
    """Pictures ``height``, ``intensity`` and ``slice``; one without data says so."""
    shown = {"height": (height, _height), "intensity": (intensity, _intensity)}
    found = {
        name: draw(raster)
        if raster is not None and raster.any_value
        else Picture(name.title(), "There are no points to show.")
        for name, (raster, draw) in shown.items()
    }
    if slice_m is None or not len(slice_m[1]):
        return found | {"slice": Picture("Slice", "There are no points to show.")}
    return found | {"slice": _slice(*slice_m)}


def _height(raster: Raster) -> Picture:
    title = "Highest points"
    limits = spread(reduce_raster(raster).values, 0.5, 99.5)
    drawn = draw_relief(raster, title, "height [m]", limits)
    return _made(
        drawn, title, "Lone spikes would be noise taken for a surface, grey is without points."
    )


def _intensity(raster: Raster) -> Picture:
    title, top = "Intensity", spread(reduce_raster(raster).values, 1, 99)[1]
    drawn = draw_ramp(raster, title, "detections per look", ramp=style.DENSITY, limits=(0.0, top))
    return _made(
        drawn,
        title,
        "Detections for each look through a voxel: paint shows, and so do edges, which looks share "
        "with what lies behind.",
    )


def _slice(detections_m: NDArray[Any], points_m: NDArray[Any]) -> Picture:
    with style.type_context():
        figure = style.figure(style.WIDTH_IN, 4.8)
        upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, places, name in (
            (upper, detections_m, "Detections"),
            (lower, points_m, "Points"),
        ):
            axes.plot(places[:, 0], places[:, 1], ".", ms=2.5, mew=0, color=style.SIGNAL)
            axes.set(title=name, ylabel="height [m]")
            axes.spines[["top", "right"]].set_visible(False)
        lower.set_xlabel("distance along the slice [m]")
        lower.set_ylim(points_m[:, 1].min() - 2.0, points_m[:, 1].max() + 2.0)
    caption = "A slice of the fullest tile: detections above, points below."
    return _made(figure, "A slice, before and after", caption)


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
    """Sentences that state whether the result can be used."""
    counts, found = report.counts, failure_verdict(report.failures, report.findings)
    if not counts.points:
        return [
            Verdict("bad", "No points: nowhere do enough detections coincide for the threshold."),
            found,
        ]
    made = (
        f"{text.number(counts.detections)} detections became {text.number(counts.points)} points."
    )
    return sorted([Verdict("good", made), found], key=lambda verdict: verdict.tone != "bad")
