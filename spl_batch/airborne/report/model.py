"""Content of a report: one frozen model, from which ``schemas/report.schema.json`` is made.

Nothing here draws or formats; ``report.json`` is this model, as it stands. A statistic of nothing
is null, never NaN, so that any JSON reader takes the file.
"""

from typing import Literal

from pydantic import Field

from spl_batch.airborne.accuracy.checkpoint_errors import CheckpointStatistics
from spl_batch.airborne.accuracy.error_tally import Accuracy
from spl_batch.airborne.accuracy.requirements import Requirement
from spl_batch.airborne.lines.alignment import AlignedLine
from spl_batch.airborne.lines.pair_table import StripPair
from spl_batch.engine.report.number_format import height
from spl_batch.engine.report.parts import (
    SCHEMA_VERSION,
    Count,
    Failure,
    FindingReport,
    Number,
    Part,
    Performance,
    Provenance,
)
from spl_batch.formats.units import Units

Basis = Literal["given", "sensor", "estimated", "assumed", "none"]
"""Where a number comes from."""


class Flightline(Part):
    """One pass, and what was found out about it."""

    id: str = Field(description="Point source id, with the lift where there are several.")
    points: Count = Field(description="Returns [count].")
    shots: Count | None = Field(None, description="Shots fired, silent ones included [count].")
    start_s: Number = Field(None, description="First GPS time, as the files have it [s].")
    end_s: Number = Field(None, description="Last GPS time, as the files have it [s].")
    prf_hz: Number = Field(None, description="Pulse repetition frequency [Hz].")
    prf_basis: Basis = Field(
        "none",
        description="Where the pulse repetition frequency comes from: given in the workflow, the "
        "sensor preset's, estimated from gps_time, or assumed as nothing shows it.",
    )
    gate_m: Number = Field(
        None,
        description="Median slant length of the range gate; what the returns fill where that is "
        "not the length stated [m].",
    )
    gate_basis: Basis = Field(
        "none",
        description="Where the length of the range gate comes from: given in the workflow, the "
        "sensor preset's, estimated from the returns, or assumed as nothing shows it.",
    )
    beam_basis: Literal["trajectory", "intersection", "scan_angle", "vertical", "none"] = Field(
        "none",
        description="What the beam directions were taken from; intersection: the sensor is "
        "where lines through several returns of one beamlet meet.",
    )
    seen_fraction: Number = Field(
        None,
        description="Beamlets with at least one return / beamlets fired, in the intervals that "
        "hold returns, 0..1.",
    )
    noise_per_m: Number = Field(None, description="Mean noise returns per metre of beamlet [1/m].")


class DeliveredUnits(Part):
    """Units that page and screen show: of clouds and rasters, or those that outputs.units names.

    The numbers of this report are in metres, as their names have it.
    """

    horizontal: str = Field("metre", description="Of eastings and northings, by PROJ's name.")
    horizontal_m: Number = Field(1.0, description="Metres in one of these.")
    vertical: str = Field("metre", description="Of heights.")
    vertical_m: Number = Field(1.0, description="Metres in one of these.")

    @property
    def known(self) -> Units:
        """The same, to be converted by."""
        return Units(**self.model_dump())

    def height(self, metres: float | None) -> str:
        """A small height as screen and page show it."""
        return height(metres, self.known.of_heights)


class Survey(Part):
    """What was processed."""

    name: str = Field(description="Title of the report.")
    crs: str | None = Field(
        None, description="CRS of what is delivered outside reprojected/, e.g. EPSG:32615."
    )
    crs_name: str | None = Field(None, description="Its name in words.")
    reprojected_crs_name: str | None = Field(
        None, description="Name of the CRS of reprojected/, where outputs.crs, units or cell ask."
    )
    units: DeliveredUnits = DeliveredUnits()
    sensor: str | None = Field(None, description="Name of the instrument.")
    area_km2: Number = Field(
        None,
        description="Area that the returns of all pieces cover, gaps of up to twice "
        "products.void_max_m included; the raster cell does not change it [km2].",
    )
    extent_m: tuple[Number, Number, Number, Number] | None = Field(
        None, description="West, east, south, north [m]."
    )
    cell_m: Number = Field(None, description="Edge of a raster cell [m].")
    flightlines: tuple[Flightline, ...] = ()
    organisation: str | None = Field(None, description="Who delivers the results.")
    contact: str | None = Field(None, description="Person or address to ask.")
    licence: str | None = Field(None, description="Licence of the results: SPDX, or a URL.")


class Counts(Part):
    """Where every point went."""

    points_in: Count = Field(description="Points in the input files [count].")
    points_out: Count = Field(description="Points in the delivered files [count].")
    signal: Count = Field(0, description="noise_class 0 [count].")
    background: Count = Field(0, description="noise_class 1: solar and dark noise [count].")
    afterpulse: Count = Field(0, description="noise_class 2 [count].")
    not_assessed: Count = Field(0, description="noise_class 255 [count].")
    ground: Count = Field(0, description="Classification 2 of assessed points [count].")
    building: Count = Field(0, description="Classification 6 of assessed points [count].")
    water: Count = Field(0, description="Classification 9 of assessed points [count].")
    withheld: Count = Field(0, description="Withheld by the vendor, carried along [count].")
    vendor_flagged: Count = Field(
        0, description="Class 7 or 18 in the input, carried along [count]."
    )
    no_beam: Count = Field(
        0, description="No valid time or no trajectory there; 0 where nothing is filtered [count]."
    )
    outside_aoi: Count = Field(0, description="Outside the area of interest [count].")
    copies: Count = Field(0, description="Returns that are there already, not assessed [count].")
    not_read: Count = Field(
        0, description="Points that the headers of unreadable files promise [count]."
    )
    records_left_out: Count = Field(
        0,
        description="Header records of input files that no reader parses, or that stand there "
        "once more than they count: named in the warnings, left out of the copies [count].",
    )
    classes: dict[str, Count] = Field(
        {}, description="Delivered points by their classification; together points_out [count]."
    )
    dropped: dict[str, Count] = Field(
        {},
        description="Points that outputs.drop left out of the clouds, by the first reason that "
        "holds: noise, withheld, outside; points_out and these are points_in [count].",
    )
    in_no_client_tile: Count | None = Field(
        None,
        description="Delivered points that lie in none of the client's tiles that were written; "
        "null where none are asked for [count].",
    )


class Density(Part):
    """How densely the ground is covered by signal."""

    mean_per_m2: Number = Field(
        None, description="Signal returns over the area that is covered [1/m2]."
    )
    median_per_m2: Number = Field(
        None, description="Median of density.tif where it was flown [1/m2]."
    )
    p05_per_m2: Number = Field(
        None, description="5th percentile of density.tif where it was flown [1/m2]."
    )
    ground_per_m2: Number = Field(
        None,
        description="Ground points over the area that is covered; null where no return counts as "
        "signal [1/m2].",
    )
    void_share: Number = Field(
        None, description="Share of the DTM cells that were flown that have no height, 0..1."
    )
    unsure_share: Number = Field(
        None,
        description="Share of the DTM cells with a height whose standard deviation, as "
        "dtm_quality.tif has it, is more than 0.5 m, 0..1.",
    )


class NoiseFit(Part):
    """What the filter did below all surfaces, where noise lies alone."""

    returns_below: Count = Field(
        0, description="Returns that were judged more than 10 m below all surfaces [count]."
    )
    p_value_times: Number = Field(
        None,
        description="How many of these have a p-value up to p_value, over what uniform ones would "
        "have: 1 if noise is as its model has it; null where they need not be so, or are few.",
    )
    p_value: Number = Field(
        None,
        description="Of 0.01, 0.02, 0.05, 0.1 and 0.2 the one at which that is farthest from 1.",
    )


class Noise(Part):
    """What was expected of the background noise, and how it was distinguished."""

    method: str = Field("none", description="Noise filter.")
    test: str | None = Field(None, description="Decision rule of the filter.")
    alpha: Number = Field(None, description="Share of pure noise that the test lets through.")
    mean_per_m3: Number = Field(None, description="Mean expected noise density [1/m3].")
    p05_per_m3: Number = Field(None, description="5th percentile of it [1/m3].")
    p95_per_m3: Number = Field(None, description="95th percentile of it [1/m3].")
    kept_by_chance: Number = Field(
        None,
        description="Background returns that the test is expected to have kept away from surfaces, "
        "by alpha; null where the filter fixes no share [count].",
    )
    fit: NoiseFit | None = Field(None, description="Null where nothing was filtered.")
    dsm_support: Count | None = Field(
        None, description="Returns nearby that a highest return needs to set a DSM cell [count]."
    )


class Checkpoint(Part):
    """One checkpoint of the field survey."""

    id: str = Field(description="Its name.")
    x_m: Number = Field(description="Easting in the survey's CRS [m].")
    y_m: Number = Field(description="Northing in the survey's CRS [m].")
    z_m: Number = Field(description="Its height [m].")
    surface: Literal["open", "vegetated"] = Field(description="Non-vegetated, or vegetated.")
    accuracy_m: Number = Field(None, description="Its own vertical accuracy, one sigma [m].")
    error_m: Number = Field(
        None, description="DTM minus checkpoint; null where the DTM has no value [m]."
    )
    outlier: bool = Field(False, description="Whether it differs far from the others.")


class Checkpoints(Part):
    """The statement of accuracy, and what it rests on."""

    statement: str = Field(description="In the words of the standard.")
    nva: CheckpointStatistics = Field(description="At open, non-vegetated checkpoints.")
    vva: CheckpointStatistics = Field(description="At vegetated checkpoints.")
    points: tuple[Checkpoint, ...] = ()


class Swath(Part):
    """What one flightline covers by itself, water excepted."""

    id: str | None = Field(None, description="Name of the flightline; null for what lies in none.")
    area_m2: Number = Field(description="Area that it covers [m2].")
    pulses: Count = Field(description="First signal returns on it [count].")
    middle_per_m2: Number = Field(
        description="First signal returns in its middle, some 95 % of the area [1/m2]."
    )
    filled_share: Number = Field(
        None,
        description="Share of the squares of twice the nominal spacing of the quality level, in "
        "its middle, that hold one, 0..1.",
    )


class ClientTile(Part):
    """A tile that a client has named."""

    name: str = Field(description="Its name.")
    points: Count = Field(description="Points in its cloud; none is written without any [count].")


class Report(Part):
    """Everything that ``report.json`` holds and ``report.html`` shows."""

    schema_version: Literal[1] = SCHEMA_VERSION
    survey: Survey
    counts: Counts
    header_changes: dict[str, Count] = Field(
        {},
        description="Delivered clouds whose header differs from their input's, by what differs: "
        "gps_time_bit, waveform_bits, wkt_bit, file_source_id, system_identifier, "
        "generating_software, creation_date [count].",
    )
    accuracy: Accuracy | None = Field(None, description="Null without reference points.")
    requirements: tuple[Requirement, ...] = Field((), description="Is it good enough?")
    checkpoints: Checkpoints | None = Field(None, description="Null without checkpoints.")
    density: Density = Density()
    noise: Noise = Noise()
    swaths: tuple[Swath, ...] = Field((), description="Density of each flightline by itself.")
    strips: tuple[StripPair, ...] = Field(
        (), description="Pairs of flightlines that share enough planar patches, by their names."
    )
    strips_not_compared: tuple[tuple[str, str], ...] = Field(
        (), description="Pairs of flightlines that overlap without planar patches enough."
    )
    alignment: tuple[AlignedLine, ...] = Field(
        (),
        description="Shifts in height that were applied; none without survey.align. Of flightlines "
        "that overlap one is kept as it is: the one to which the others, weighted by their "
        "returns, come by the shortest way. strips has what is left.",
    )
    client_tiles: tuple[ClientTile, ...] = Field(
        (), description="Tiles of outputs.client_tiles, but for those that failed."
    )
    performance: Performance = Performance()
    failures: tuple[Failure, ...] = Field((), description="Everything that did not make it.")
    findings: tuple[FindingReport, ...] = Field((), description="What a reader has to know.")
    provenance: Provenance
