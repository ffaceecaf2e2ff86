"""Several filters, or ground methods, on one survey; ``engine.verbs.comparing`` runs them.

What they have in common, up to the point tiles, is done once. A table and profiles side by side
come as JSON and as a page.
"""

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Final, get_args

from pydantic import Field

from spl_batch.airborne.compare.contrast import FAR_M, Contrast, Outcome, contrast
from spl_batch.airborne.filter.denoise import METHODS as FILTERS
from spl_batch.airborne.filter.published import OF_SHOTS
from spl_batch.airborne.ground.ground_methods import METHODS as GROUND
from spl_batch.airborne.report.model import DeliveredUnits, Report
from spl_batch.airborne.report.plots import draw_methods
from spl_batch.airborne.report.profile_strips import read_strip, tallest_strip
from spl_batch.airborne.report.verdicts import noise_removed, photon_counting
from spl_batch.airborne.settings import AfterpulseSettings, FilterSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.report import style
from spl_batch.engine.report.number_format import as_ascii, percent, share, significant
from spl_batch.engine.report.page import Compared, ComparedMethod, write_comparison
from spl_batch.engine.report.parts import Count, Number
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.verbs.comparing import Methods, folder_of, per_million
from spl_batch.engine.verbs.reporting import recalled
from spl_batch.formats.rasters.parts import read_overview


class MethodResult(ComparedMethod):
    """What one method made of the survey."""

    points: Count = Field(description="Points in the input files [count].")
    background: Count = Field(description="Removed as solar and dark noise [count].")
    afterpulse: Count = Field(description="Removed as afterpulses [count].")
    removed_share: Number = Field(
        None, description="Background and afterpulses over all points, 0..1."
    )
    far_per_m3: Number = Field(None, description="Signal far from where most returns lie [1/m3].")
    far_share: Number = Field(None, description="Of what was recorded there, 0..1.")
    ground: Count = Field(description="Points called ground [count].")
    dtm_rmse_m: Number = Field(None, description="DTM against the reference [m].")
    dtm_mean_m: Number = Field(None, description="DTM minus reference, mean [m].")
    dsm_median_m: Number = Field(None, description="DSM minus reference, median [m].")
    dsm_nmad_m: Number = Field(None, description="DSM minus reference, NMAD [m].")
    dsm_rmse_m: Number = Field(None, description="DSM against the reference [m].")
    shuffle_s_per_million: Number = Field(
        None, description="Stage shuffle, where single shots are filtered [s per 1e6 points]."
    )
    s_per_million: Number = Field(
        None,
        description="Stage that does what is compared: ground for a ground method, else denoise "
        "[s per 1e6 points].",
    )


class ComparisonReport(Compared):
    """What a comparison writes down."""

    survey: str = Field(description="Name of the survey.")
    units: DeliveredUnits = DeliveredUnits()
    photons: bool = Field(description="Whether the survey is single-photon lidar.")
    far_m: float = Field(description="Far begins at this height difference, at most [m].")
    far_m3: Number = Field(None, description="Volume of the gate that is far [m3].")
    far_recorded_per_m3: Number = Field(None, description="Recorded there, kept or not [1/m3].")
    methods: tuple[MethodResult, ...] = Field(description="In the order asked for.")
    left_out: tuple[str, ...] = Field((), description="Tiles that not all methods finished.")


TESTS: Final = tuple(get_args(FilterSettings.model_fields["test"].annotation))
"""Tests of our own method."""

OWN: Final = "vsaes"
"""The method that has several tests."""

PUBLISHED: Final = "published"
"""The whole chain of [W18], as a method: test, ellipsoid, noise, and no afterpulses before it."""

PUBLISHED_FILTER: Final = (
    f"filter.method={OWN}", "filter.test=published", "filter.neighbours=15", "filter.radius_m=1.5",
)  # fmt: skip
"""Its filter."""

PUBLISHED_NOISE: Final = ("noise.correction=published", "afterpulse.enabled=false")
"""What the filter looks at; the other methods have the workflow's own."""


AFTERPULSES: Final = tuple(
    f"afterpulse:{rule}" for rule in get_args(AfterpulseSettings.model_fields["method"].annotation)
)
"""Rules for afterpulses, each before the filter of the workflow."""


def _keys(name: str, settings: Workflow) -> tuple[str, ...] | None:
    """Keys of the workflow that make a run one of a method, such as ``vsaes:published``."""
    del settings
    if name == PUBLISHED:
        return (*PUBLISHED_FILTER, *PUBLISHED_NOISE)
    if name in GROUND:
        return (f"ground.method={name}",)
    method, colon, test = name.partition(":")
    if name in AFTERPULSES:
        return ("afterpulse.enabled=true", f"afterpulse.method={test}")
    if method not in (*FILTERS, "none") or (colon and (method != OWN or test not in TESTS)):
        return None
    return (
        (f"filter.method={method}", f"filter.test={test}") if test else (f"filter.method={method}",)
    )


def _share(settings: Workflow, method: str) -> set[str]:
    """Stages that a method can use of the workflow's own run, and its reference."""
    stages = {"index", "reference"}
    if method in GROUND:
        # The first of them has done the filter for the others.
        stages |= {"shots", "shuffle", "denoise"}
    elif method != PUBLISHED:
        stages.add("shots")
        # The points of a tile carry the verdict of single shots, which some methods alone ask for.
        asked = settings.filter.method if method in AFTERPULSES else method
        other = method in AFTERPULSES and not method.endswith(f":{settings.afterpulse.method}")
        same = settings.filter.method == asked or not {settings.filter.method, asked} & {*OF_SHOTS}
        if same and not other:
            stages.add("shuffle")
    return stages


def _until(names: Collection[str]) -> str:
    """Last stage that methods have in common: ground methods share the filter."""
    return "denoise" if all(name in GROUND for name in names) else "shuffle"


def _row(report: ComparisonReport, method: MethodResult) -> tuple[str, ...]:
    height = report.units.height
    values = (
        *(
            percent(part / method.points if method.points else None)
            for part in (method.signal, method.background, method.afterpulse)
        ),
        share(method.far_share),
        percent(method.ground / method.points if method.points else None),
        height(method.dtm_rmse_m),
        height(method.dsm_median_m),
        height(method.dsm_nmad_m),
        significant(method.s_per_million),
    )
    return (method.name, *map(as_ascii, values))


def _write(output: Path, reports: Mapping[str, Report]) -> ComparisonReport:
    """Gather the table and the pictures, and write them."""
    runs = {name: Outcome(*recalled(output / folder_of(name))[:2]) for name in reports}
    found = contrast(list(runs.values()))
    first = next(iter(reports.values()))
    # Ground methods share the filter, or have none: they show nothing of noise.
    far_m3 = 0 if all(name in GROUND for name in reports) else found.far_m3
    results = tuple(_result(*named, found, k) for k, named in enumerate(reports.items()))
    report = ComparisonReport(
        survey=first.survey.name,
        units=first.survey.units,
        version=first.provenance.version,
        far_m=FAR_M,
        photons=photon_counting(first),
        far_m3=far_m3 or None,
        far_recorded_per_m3=found.far_points / far_m3 if far_m3 else None,
        methods=results,
        left_out=tuple(found.left_out),
    )
    pictures = list(_pictures(runs, found))
    write_comparison(output, report, "compare.html.j2", __package__, pictures)
    return report


def _result(name: str, report: Report, found: Contrast, k: int) -> MethodResult:
    counts, accuracy = report.counts, report.accuracy
    dtm = accuracy.dtm.get("all") if accuracy else None
    dsm = accuracy.dsm.get("all") if accuracy else None
    kept, of_ground = int(found.far_kept[k]), name in GROUND
    work = "ground" if of_ground else "denoise"
    return MethodResult(
        name=name,
        folder=folder_of(name),
        points=counts.points_in,
        signal=counts.signal,
        background=counts.background,
        afterpulse=counts.afterpulse,
        removed_share=noise_removed(report),
        kept_only=int(found.kept_only[k]),
        removed_only=int(found.removed_only[k]),
        far_per_m3=kept / found.far_m3 if found.far_m3 and not of_ground else None,
        far_share=kept / found.far_points if found.far_points and not of_ground else None,
        ground=counts.ground,
        dtm_rmse_m=dtm.rmse if dtm else None,
        dtm_mean_m=dtm.mean if dtm else None,
        dsm_median_m=dsm.median if dsm else None,
        dsm_nmad_m=dsm.nmad if dsm else None,
        dsm_rmse_m=dsm.rmse if dsm else None,
        shuffle_s_per_million=per_million(report.performance, "shuffle", counts.points_in),
        s_per_million=per_million(report.performance, work, counts.points_in),
        failures=len(report.failures),
    )


def _pictures(runs: Mapping[str, Outcome], found: Contrast) -> Iterator[Picture]:
    """Profiles of the strip where most stands on the ground, and of the most disputed one."""
    heights = next(iter(runs.values())).context.output / "chm.tif"
    strips = (
        (
            "Where most stands on the ground",
            "Look for wires, roof edges and crowns as signal, and for noise left between them.",
            tallest_strip(read_overview(heights)) if heights.exists() else None,
        ),
        (
            "Where the filters disagree most",
            "Look for what is signal to one filter and noise to another near the surface.",
            found.disputed,
        ),
    )
    for title, caption, strip in strips:
        if strip is None:
            continue
        cut = {name: read_strip(strip, run.done, run.context) for name, run in runs.items()}
        profiles = {name: profile for name, profile in cut.items() if profile is not None}
        if profiles:
            yield style.picture(draw_methods(profiles), title, caption)
        else:
            yield Picture(title, "No strip of the survey holds points to show.")


METHODS: Final = Methods(
    known=f"{', '.join(FILTERS)}, none; {', '.join(f'{OWN}:{test}' for test in TESTS)}; "
    f"{PUBLISHED}; {', '.join(AFTERPULSES)}; and {', '.join(GROUND)} for the ground",
    keys=_keys,
    until=_until,
    share=_share,
    write=_write,
    row=_row,
    titles=(
        *("method", "signal", "background noise", "afterpulses", "far noise"),
        *("ground", "DTM RMSE", "DSM median", "DSM NMAD", "s per million"),
    ),
)
"""What can be compared."""
