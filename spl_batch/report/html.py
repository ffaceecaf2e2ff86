"""The page of an airborne survey: what its report shows beside what all reports have."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.report import format as text
from spl_batch.report.model import Counts, Report, Survey
from spl_batch.report.page import Front, render_page
from spl_batch.report.pictures import Picture
from spl_batch.report.summary import noise_removed, speed_remark, terrain_statistics, verdicts

SECTIONS: Final = (
    ("accuracy", "Accuracy"),
    ("surfaces", "Surfaces"),
    ("noise", "Noise"),
    ("survey", "Survey"),
)
"""Anchor and name of each section of its own."""

HOW: Final[Mapping[str, str]] = MappingProxyType(
    {
        "vsaes": (
            "Around each return an ellipsoid is fitted to its neighbours, so that it follows a "
            "wire, a roof or the ground; the return is kept when background alone would hardly "
            "give as many neighbours."
        ),
        "aes": (
            "As many returns as background is expected, those with fewest neighbours for it, are "
            "removed first; then those around which an ellipsoid fitted to the neighbours holds "
            "far fewer returns than a sphere."
        ),
        "dcc": (
            "Each shot is then judged by itself: its fullest long range bin and the two beside it "
            "are taken for signal, what lies in the others tells its background, and of the short "
            "bins those are kept that hold more returns than that background explains."
        ),
        "voxel": (
            "This filter makes no use of that: space is cut into flat voxels, and all returns of a "
            "voxel are kept when it holds at least the mean number of those around it that are "
            "not empty."
        ),
        "multilevel": (
            "This filter makes no use of that: returns are kept near the fullest height of a "
            "place, where their voxel and the 26 around it hold a fixed number of them, first of "
            "large voxels and then of small ones."
        ),
        "cylinder": (
            "This filter makes no use of that: a return is kept when a fixed number of others lie "
            "in an upright cylinder around it, however dense the background is there."
        ),
    }
)
"""What each noise filter does, for a reader of the report."""


def render(report: Report, pictures: Mapping[str, Picture]) -> str:
    """The page of an airborne survey.

    Parameters
    ----------
    report : Report
        What is shown.
    pictures : mapping of str to Picture
        As :func:`~spl_batch.report.pictures.make_pictures` gives them; any may be missing.

    Returns
    -------
    str
        HTML without any reference to another file; the same input gives the same text.
    """
    return render_page(
        "template.html.j2",
        report,
        Front(
            title=report.survey.name,
            kicker="Single-photon lidar",
            facts=tuple(_facts(report.survey)),
            sections=SECTIONS,
            verdicts=tuple(verdicts(report)),
            cards=tuple(_cards(report)),
        ),
        pictures=pictures,
        shares=_shares(report.counts),
        set_aside=_set_aside(report.counts),
        kept_noise_share=_kept_noise_share(report),
        how=HOW,
    )


def _facts(survey: Survey) -> Iterator[str]:
    """What stands below the title."""
    if survey.area_km2 is not None:
        yield f"{text.significant(survey.area_km2)} km\N{SUPERSCRIPT TWO}"
    if survey.flightlines:
        n = len(survey.flightlines)
        yield f"{n} flightline{'s' * (n != 1)}"
    if survey.sensor:
        yield survey.sensor
    if survey.crs:
        words = survey.crs_name and survey.crs_name != survey.crs
        yield f"{survey.crs} ({survey.crs_name})" if words else survey.crs
    else:
        yield "no CRS"


def _cards(report: Report) -> list[tuple[str, str, str]]:
    """Label, value and remark of each key number."""
    counts, work, density = report.counts, report.performance, report.density
    whole, kept = counts.points_in, counts.signal + counts.not_assessed
    terrain = terrain_statistics(report)
    cards = []
    if terrain is not None:
        name, statistics = terrain
        remark = f"mean {text.centimetres(statistics.mean)}, {text.surface_name(name)}"
        cards.append(("DTM RMSE", text.centimetres(statistics.rmse), remark))
    cards += [
        ("Points in", text.large(counts.points_in), f"{text.number(counts.points_out)} out"),
        (
            "Noise removed",
            text.percent(noise_removed(report)),
            f"{text.large(counts.background)} background",
        ),
        (
            "Afterpulses",
            text.large(counts.afterpulse),
            f"{text.percent(counts.afterpulse / whole if whole else None)} of all points",
        ),
        (
            "Ground points",
            text.large(counts.ground),
            f"{text.percent(counts.ground / kept if kept else None)} of all kept",
        ),
        (
            "Density kept",
            f"{text.significant(density.mean_per_m2)} /m\N{SUPERSCRIPT TWO}",
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


def _set_aside(counts: Counts) -> list[tuple[str, int]]:
    """Points that took no part, or not in full, by reason."""
    reasons = (
        ("withheld by the vendor", counts.withheld),
        ("flagged as noise by the vendor", counts.vendor_flagged),
        ("without a valid time or trajectory", counts.no_beam),
        ("outside the area of interest", counts.outside_aoi),
        ("in files that could not be read", counts.not_read),
    )
    return [(reason, count) for reason, count in reasons if count]


def _kept_noise_share(report: Report) -> float | None:
    """Share of the kept returns that is expected to be background, 0..1."""
    noise, signal = report.noise, report.counts.signal
    if noise.kept_by_chance is None or noise.kept_within_signal is None or not signal:
        return None
    return (noise.kept_by_chance + noise.kept_within_signal) / signal
