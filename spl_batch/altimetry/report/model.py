"""Content of the report of photon profiles: one frozen model, from which its schema is made."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Literal

from pydantic import Field

from spl_batch.altimetry.settings import Method
from spl_batch.engine.report.parts import (
    SCHEMA_VERSION,
    Count,
    Failure,
    FindingReport,
    Number,
    Part,
    Performance,
    Provenance,
    Statistics,
)

METHOD_NAMES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "likelihood": "ours",
        "published": "posterior as published",
        "mdbscan": "mDBSCAN",
    }
)
"""What a reader knows each method by."""


class TrackCounts(Part):
    """Where every photon went."""

    points_in: Count = Field(description="Photons in the input files [count].")
    points_out: Count = Field(description="Photons in the delivered tables [count].")
    signal: Count = Field(0, description="Labelled 1 [count].")
    background: Count = Field(0, description="Labelled 0: noise [count].")
    not_assessed: Count = Field(
        0, description="Labelled 255: no position, or a failed task [count]."
    )


class Agreement(Part):
    """Signal and noise here against labels of another product."""

    photons: Count = Field(description="Photons compared [count].")
    precision: Number = Field(None, description="Share of our signal that is signal there.")
    recall: Number = Field(None, description="Share of their signal that is signal here.")
    f1: Number = Field(None, description="Harmonic mean of both.")


class Beam(Part):
    """One beam of one file, and what was found."""

    file: str = Field(description="Input file.")
    name: str = Field(description="Beam, as the product calls it.")
    photons: Count = Field(description="Photons [count].")
    signal: Count = Field(0, description="Signal photons [count].")
    estimated: Number = Field(None, description="Signal photons by the noise rate [count].")
    false_signal: Number = Field(
        None, description="Noise photons to be expected among the signal [count]."
    )
    length_km: Number = Field(None, description="Track that holds photons [km].")
    gate_m: Number = Field(None, description="Median length of the gate [m].")
    noise_per_m2: tuple[Number, Number, Number] | None = Field(
        None, description="Noise density, 5th, 50th and 95th percentile [1/m2]."
    )
    water: Number = Field(None, description="Share of the track that shows level water, 0..1.")
    surface: Count = Field(0, description="Signal at its surface [count].")
    floor: Count = Field(0, description="Signal below it [count].")
    ground_cells: Count = Field(0, description="Cells of the profile with a ground [count].")
    canopy_cells: Count = Field(0, description="Cells with canopy [count].")
    cells: Count = Field(0, description="Cells of the profile [count].")
    ground: Statistics | None = Field(None, description="Ground minus reference.")
    baseline_ground: Statistics | None = Field(None, description="The same, by mDBSCAN.")
    labels: dict[str, Agreement] = Field({}, description="By method: ours, mdbscan.")


class TrackReport(Part):
    """Everything that ``report.json`` holds and ``report.html`` shows."""

    schema_version: Literal[1] = SCHEMA_VERSION
    name: str = Field(description="Title of the report.")
    method: Method = Field(description="What separates signal from noise.")
    counts: TrackCounts
    ground: Statistics | None = Field(None, description="Ground minus reference, all beams.")
    baseline_ground: Statistics | None = Field(None, description="The same, by mDBSCAN.")
    ground_reference: Literal["points", "dtm", "labels"] | None = Field(
        None, description="Key of reference that gave the heights; labels is ATL08's terrain."
    )
    beams: tuple[Beam, ...] = ()
    performance: Performance = Performance()
    failures: tuple[Failure, ...] = Field((), description="Everything that did not make it.")
    findings: tuple[FindingReport, ...] = Field((), description="What a reader has to know.")
    provenance: Provenance
