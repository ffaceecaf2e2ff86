"""Several methods on one survey: a table and profiles side by side, as JSON and as a page."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import Field

from spl_batch.airborne.report.plots import Profile, draw_methods
from spl_batch.engine.report import style
from spl_batch.engine.report.comparison import Compared, ComparedMethod, write_comparison
from spl_batch.engine.report.parts import Count, Number
from spl_batch.engine.report.picture import Picture


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
    dtm_off_share: Number = Field(
        None, description="DTM cells more than 0.5 m off the first method's, 0..1."
    )
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
    photons: bool = Field(description="Whether the survey is single-photon lidar.")
    far_m: float = Field(description="Far begins at this height difference, at most [m].")
    far_m3: Number = Field(None, description="Volume of the gate that is far [m3].")
    far_recorded_per_m3: Number = Field(None, description="Recorded there, kept or not [1/m3].")
    methods: tuple[MethodResult, ...] = Field(description="In the order asked for.")
    left_out: tuple[str, ...] = Field((), description="Tiles that not all methods finished.")


def write(
    out: Path,
    report: ComparisonReport,
    profiles: Sequence[tuple[str, str, Mapping[str, Profile]]],
) -> None:
    """Write ``compare.json`` and ``compare.html`` into a folder.

    Parameters
    ----------
    profiles : sequence of (str, str, mapping of str to Profile)
        Title, caption and strips by method, of each picture.
    """
    pictures = [_picture(*shown) for shown in profiles]
    write_comparison(out, report, "compare.html.j2", __package__, pictures)


def _picture(title: str, caption: str, profiles: Mapping[str, Profile]) -> Picture:
    if not profiles:
        return Picture(title, "No strip of the survey holds points to show.")
    png, width, height = style.to_png(draw_methods(profiles))
    return Picture(title, caption, f"{title}. {caption}", png, width, height)
