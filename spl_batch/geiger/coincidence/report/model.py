"""Model of a report on coincidence processing: frozen, and the source of its schema."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.report.parts import (
    Count,
    Failure,
    FindingReport,
    Number,
    Part,
    Performance,
    Provenance,
)


class Scene(Part):
    """What was flown over."""

    name: str = Field(description="Title.")
    crs: str | None = Field(None, description="CRS of the coordinates.")
    method: str = Field(description="How detections became points.")
    voxel_m: Number = Field(None, description="Edge of a voxel [m].")
    tile_m: Number = Field(None, description="Edge of a tile [m].")


class Counts(Part):
    """What went in and came out."""

    frames: Count = Field(0, description="Laser pulses [count].")
    looks: Count = Field(0, description="Frames times detectors [count].")
    detections: Count = Field(0, description="Looks that ended in a detection [count].")
    tiles: Count = Field(0, description="Tiles that hold points [count].")
    points: Count = Field(0, description="Points delivered [count].")
    surface: Count = Field(0, description="Of these, maxima in one direction [count].")
    ridge: Count = Field(0, description="Maxima in two [count].")
    peak: Count = Field(0, description="Maxima in all three [count].")


class Intensity(Part):
    """Detections per interrogation at the points, weighted by the points of a tile."""

    p05: Number = Field(None, description="Mean of the tiles' fifth percentiles [1/1].")
    median: Number = Field(None, description="Mean of the tiles' medians [1/1].")
    p95: Number = Field(None, description="Mean of the tiles' 95th percentiles [1/1].")


class CoincidenceReport(Part):
    """Everything that ``report.json`` holds and ``report.html`` shows."""

    schema_version: Literal[1] = 1
    scene: Scene
    counts: Counts
    intensity: Intensity = Intensity()
    performance: Performance = Performance()
    failures: tuple[Failure, ...] = Field((), description="Everything that did not make it.")
    findings: tuple[FindingReport, ...] = Field((), description="What a reader has to know.")
    provenance: Provenance
