"""The page of an airborne survey: what its report shows beside what all reports have."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.airborne.accuracy.requirements import answers
from spl_batch.airborne.report.model import Counts, Report, Survey
from spl_batch.airborne.report.verdicts import (
    noise_removed,
    parameter,
    photon_counting,
    terrain_statistics,
    verdicts,
)
from spl_batch.constants import CLASS_NAMES
from spl_batch.engine.report import number_format as text
from spl_batch.engine.report.page import Front, render_page
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.verdict import speed_remark

SECTIONS: Final = (
    ("good-enough", "Is it good enough?"),
    ("map", "Map and profile"),
    ("accuracy", "Accuracy"),
    ("strips", "Between flightlines"),
    ("noise", "Noise"),
    ("survey", "Survey"),
)
"""Anchor and name of each section of its own."""

LAYERS: Final = (
    "dtm",
    "dsm",
    "chm",
    "dtm_quality",
    "density",
    "noise_density",
    "difference",
    "strips",
)
"""Maps that a reader switches between."""

OF_PHOTONS: Final = ("noise", "survey")
"""Sections that linear-mode lidar leaves empty."""

_SMALL_KM2: Final = 0.01
"""A smaller area is given in square metres."""

HOW: Final[Mapping[str, str]] = MappingProxyType(
    {
        "vsaes": (
            "Around each return an ellipsoid is fitted to its neighbours, so that it follows a "
            "wire, a roof or the ground; the return is signal when background alone would hardly "
            "give as many neighbours."
        ),
        "aes": (
            "As many returns as background is expected, those with fewest neighbours for it, are "
            "removed first; then those around which an ellipsoid fitted to the neighbours holds "
            "far fewer returns than a sphere."
        ),
        "dcc": (
            "Each shot is then judged by itself: its fullest long range bin and the two beside it "
            "are taken for signal, what lies in the others gives its background, and of the short "
            "bins those are signal that hold more returns than that background explains."
        ),
        "pixels": (
            "Each shot is then judged by itself: a return is signal when enough of the beamlets "
            "beside its own returned from about its range."
        ),
        "voxel": (
            "This filter makes no use of that: space is cut into flat voxels, and all returns of a "
            "voxel are signal when it holds at least the mean number of those around it that are "
            "not empty."
        ),
        "multilevel": (
            "This filter makes no use of that: returns are signal near the fullest height of "
            "a place, where their voxel and the 26 around it hold a fixed number of them, first of "
            "large voxels and then of small ones."
        ),
        "cylinder": (
            "This filter makes no use of that: a return is signal when a fixed number of others "
            "lie in an upright cylinder around it, however dense the background is there."
        ),
    }
)
"""What each noise filter does, for a reader of the report."""


def render(report: Report, pictures: Mapping[str, Picture]) -> str:
    """The page of an airborne survey: HTML without any reference to another file.

    The same input gives the same text; any of ``pictures`` may be missing.
    """
    photons = photon_counting(report)
    # Without beamlet numbers nothing in the points shows that the instrument is the one named.
    numbered = parameter(report, "survey.channel_dimension") is not None
    return render_page(
        "survey_page.html.j2",
        report,
        Front(
            title=report.survey.name,
            kicker=_kicker(photons=photons, numbered=numbered),
            facts=tuple(_facts(report.survey, photons=photons, numbered=numbered)),
            sections=tuple(_sections(report, photons=photons)),
            verdicts=tuple(verdicts(report)),
            cards=tuple(_cards(report)),
        ),
        package=__package__,
        pictures=pictures,
        photons=photons,
        layers=[
            {"key": key, "picture": shown}
            for key in _layer_keys(report, photons=photons)
            if (shown := pictures.get(key)) is not None and (shown.png or key != "strips")
        ],
        shares=_shares(report.counts),
        set_aside=_set_aside(report.counts),
        classes=[(_class_name(int(k)), n) for k, n in report.counts.classes.items()],
        how=HOW,
        answers=answers(row.verdict for row in report.requirements),
        level=parameter(report, "requirements.quality_level") or "",
    )


def _sections(report: Report, *, photons: bool) -> Iterator[tuple[str, str]]:
    """Anchor and name of each section that this report has."""
    for key, name in SECTIONS:
        if key == "good-enough" and not report.requirements:
            continue
        if photons or key not in OF_PHOTONS:
            yield key, name


def _layer_keys(report: Report, *, photons: bool) -> Iterator[str]:
    """Keys of the maps that this report has anything for."""
    for key in LAYERS:
        if key == "noise_density" and not photons:
            continue
        if key == "difference" and report.accuracy is None:
            continue
        yield key


def _kicker(*, photons: bool, numbered: bool) -> str:
    """What stands above the title."""
    if not photons:
        return "Linear-mode lidar"
    return "Single-photon lidar" if numbered else "Taken as single-photon lidar"


def _facts(survey: Survey, *, photons: bool, numbered: bool) -> Iterator[str]:
    """What stands below the title."""
    if survey.area_km2 is not None:
        small = survey.area_km2 < _SMALL_KM2
        area = survey.area_km2 * 1e6 if small else survey.area_km2
        yield f"{text.significant(area)} {'m' if small else 'km'}\N{SUPERSCRIPT TWO}"
    if survey.flightlines:
        n = len(survey.flightlines)
        yield f"{n} flightline{'s' * (n != 1)}"
    if survey.sensor and photons:
        yield survey.sensor if numbered else f"taken as {survey.sensor}, beamlets not numbered"
    if survey.crs:
        words = survey.crs_name and survey.crs_name != survey.crs
        yield f"{survey.crs} ({survey.crs_name})" if words else survey.crs
    else:
        yield "no CRS"
    yield from filter(None, (survey.organisation, survey.contact, survey.licence))


def _cards(report: Report) -> list[tuple[str, str, str]]:
    """Label, value and remark of each key number."""
    counts, work, density = report.counts, report.performance, report.density
    whole, photons = counts.points_in, photon_counting(report)
    terrain = terrain_statistics(report)
    cards = []
    if terrain is not None:
        name, statistics = terrain
        remark = f"on {text.surface_name(name)}, mean {report.survey.units.height(statistics.mean)}"
        cards.append(("DTM RMSE", report.survey.units.height(statistics.rmse), remark))
    cards.append(
        ("Points in", text.large(counts.points_in), f"{text.number(counts.points_out)} out")
    )
    if photons:
        background, afterpulse = (
            text.percent(n / whole if whole else None)
            for n in (counts.background, counts.afterpulse)
        )
        cards += [
            ("Signal", text.large(counts.signal), text.of_all(counts.signal, whole)),
            (
                "Noise",
                text.percent(noise_removed(report)),
                f"of all points: background {background}, afterpulses {afterpulse}",
            ),
        ]
    cards += [
        ("Ground", text.large(counts.ground), text.of_all(counts.ground, whole)),
        (
            "Signal density" if photons else "Density",
            f"{text.significant(density.mean_per_m2)} per m\N{SUPERSCRIPT TWO}",
            (
                f"median {text.significant(density.median_per_m2)}, "
                f"ground {text.significant(density.ground_per_m2)}"
            ),
        ),
        ("Time", text.duration(work.wall_s), speed_remark(work)),
    ]
    return cards


def _shares(counts: Counts) -> list[tuple[str, str, int, float]]:
    """Key, label, count and share of each noise class, for the bar."""
    parts = (
        ("signal", "signal", counts.signal),
        ("background", "background noise", counts.background),
        ("afterpulse", "afterpulses", counts.afterpulse),
        ("aside", "not assessed", counts.not_assessed),
    )
    whole = sum(count for _, _, count in parts)
    return [(key, label, n, n / whole) for key, label, n in parts if n] if whole else []


def _class_name(number: int) -> str:
    """An ASPRS class in words."""
    return f"{number} {CLASS_NAMES[number]}" if number in CLASS_NAMES else f"class {number}"


def _set_aside(counts: Counts) -> list[tuple[str, int]]:
    """Points that took no part, or not in full, by reason."""
    reasons = (
        ("withheld by the vendor", counts.withheld),
        ("flagged as noise by the vendor", counts.vendor_flagged),
        ("without a valid time or trajectory", counts.no_beam),
        ("outside the area of interest", counts.outside_aoi),
        ("that are copies of others", counts.copies),
        ("in files that could not be read", counts.not_read),
    )
    return [(reason, count) for reason, count in reasons if count]
