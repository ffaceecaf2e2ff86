"""Sections of a workflow of ``kind: coincidence``; what [M20] leaves open is marked as ours."""

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final, Literal, Self

from pydantic import Field, model_validator

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.settings.base import BaseWorkflow, Positive, Section, Share, StoreSettings

ARRAYS: Final[Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {"intelliearth": {"rows": 32, "columns": 128, "ifov_rad": 35e-6}}
)
"""Arrays whose numbers are public. Harris IntelliEarth: array size 32 x 128 and IFOV 35 urad, by M.
Romano, "Commercial Geiger Mode LiDAR", ASPRS annual conference 2015, table "Harris Geiger-mode
Specifications" (studylib.net/doc/18334073). Which side leads is not stated there: that is as
in [M20]. Gates follow from the flight."""


class ArraySettings(Section):
    """A Geiger-mode focal-plane array; defaults are the notional sensor of [M20 Table 1]."""

    preset: Literal["intelliearth"] | None = Field(
        None,
        description="An array with public numbers for rows, columns and ifov_rad, where these are "
        "not given: intelliearth, Harris 2015.",
    )
    rows: int = Field(32, ge=1, le=1024, description="Detectors across the flight [count].")
    columns: int = Field(128, ge=1, le=1024, description="Detectors along the flight [count].")
    ifov_rad: float = Field(
        30e-6, gt=0, le=0.01, description="Field of view of one detector, edge to edge [rad]."
    )
    gate_start_m: Positive = Field(2500.0, description="Slant range at which detectors arm [m].")
    gate_stop_m: Positive = Field(3500.0, description="Slant range at which they are read [m].")

    @model_validator(mode="before")
    @classmethod
    def _of_preset(cls, given: Any) -> Any:
        if not isinstance(given, Mapping):
            return given
        return {**ARRAYS.get(str(given.get("preset")), {}), **given}

    @model_validator(mode="after")
    def _gate_opens_before_it_closes(self) -> Self:
        start, stop = self.gate_start_m, self.gate_stop_m
        if stop <= start:
            text = f"gate_stop_m {stop:g} is not beyond gate_start_m {start:g}"
            raise ValueError(f"{text}; give slant ranges in metres")
        return self

    @property
    def detectors(self) -> int:
        """Detectors of the array [count]."""
        return self.rows * self.columns


class BridgeSignSettings(Section):
    """Moving quadratic least squares and its maxima [M20 4.2-4.3]."""

    window_voxels: Literal[3, 5, 7, 9] = Field(
        5, description="Edge of the neighbourhood that a polynomial is fitted to [count]; ours."
    )
    wide_below: int = Field(
        6,
        ge=0,
        description="Where fewer detections coincide, the neighbourhood is two voxels wider "
        "[count]; 0 for nowhere; ours.",
    )
    threshold: Share | None = Field(
        None,
        description="Least value of the polynomial at a point: detections for each look that "
        "interrogates the voxel [1/1]; 0.01 by default, and 0.06 as published, where nothing else "
        "separates surfaces from blur; ours.",
    )
    edge_rule: bool = Field(
        True,
        description="Whether a point is left out whose detections lie farther to the side than on "
        "a straight edge; ours.",
    )
    edge_share: float = Field(
        0.5,
        ge=0,
        lt=1,
        description="Least part that a point has of what is strong beside it: of the mean of the "
        "points within half a neighbourhood and one voxel, weighted with themselves [0..1]; ours.",
    )
    strongest_along_normal: bool = Field(
        True,
        description="Whether a point is left out that has a stronger one before or behind "
        "it, within half a neighbourhood; ours.",
    )
    reach_voxels: float = Field(
        0.5,
        gt=0,
        le=1,
        description="How far from its voxel's centre, along each axis, a point may lie "
        "[voxel edges]; ours.",
    )
    curvature_ratio: float = Field(
        0.5,
        gt=0,
        le=1,
        description="A direction is one of maximum when its second derivative is at least this "
        "part of the strongest [1/1]; ours.",
    )
    detections_min: int = Field(
        4, ge=1, description="Detections that coincide in a neighbourhood [count]; ours."
    )
    looks_min: Positive = Field(
        0.25, description="Least mean of looks through the neighbourhood's voxels [count]; ours."
    )


PUBLISHED: Final[Mapping[str, float]] = MappingProxyType(
    {"wide_below": 0, "edge_rule": False, "edge_share": 0.0, "strongest_along_normal": False}
)
"""What the source does without."""


class CoincidenceSettings(Section):
    """How detections become points."""

    method: Literal["bridge_sign", "published"] = Field(
        "bridge_sign",
        description="With our rules for edges and along the normal, or without as published: "
        "edge_rule and strongest_along_normal false, edge_share and wide_below 0.",
    )
    voxel_m: float | None = Field(
        None,
        ge=0.005,
        le=5,
        description="Edge of a voxel, whole millimetres [m]; by default half the ground size of "
        "a detector's field of view, in the middle of the gate.",
    )
    volume_voxels: int = Field(
        128, ge=32, le=512, description="Edge of a sub-volume that is rastered at once [count]."
    )
    bridge_sign: BridgeSignSettings = BridgeSignSettings()

    @property
    def rules(self) -> BridgeSignSettings:
        """Settings of the chosen method, its threshold put in."""
        published = self.method == "published"
        threshold = self.bridge_sign.threshold or (0.06 if published else 0.01)
        chosen = PUBLISHED if published else {}
        return self.bridge_sign.model_copy(update={**chosen, "threshold": threshold})

    @property
    def windows(self) -> dict[int, int]:
        """Voxels beside a neighbourhood's centre, and detections from which it is taken."""
        rules = self.rules
        half = rules.window_voxels // 2
        if rules.wide_below <= rules.detections_min:
            return {half: rules.detections_min}
        return {half: rules.wide_below, half + 1: rules.detections_min}

    def voxel_quanta(self, array: ArraySettings) -> int:
        """Edge of a voxel on the survey's lattice, at least 5 [quanta].

        Half of what a detector sees on the ground [M20 4.1], rounded down to whole quanta: the
        sampling stays on the safe side.
        """
        if self.voxel_m is not None:
            return round(self.voxel_m * QUANTA_PER_M)
        middle_m = 0.5 * (array.gate_start_m + array.gate_stop_m)
        # Half a quantum more, against a product that falls a hair short of a whole one.
        return max(5, math.floor(0.5 * array.ifov_rad * middle_m * QUANTA_PER_M + 1e-6))


class L1Settings(Section):
    """What was flown and where its files are."""

    name: str = Field("survey", description="Title of the report.")
    crs: str | None = Field(None, description="CRS of all coordinates, e.g. EPSG:32615.")
    frames: str | tuple[str, ...] = Field(
        description="Frames as Parquet: a path or glob, or several, relative to this file."
    )
    detections: str | tuple[str, ...] = Field(
        description="Detections as Parquet: a path or glob, or several, relative to this file."
    )


class TileSettings(Section):
    """How space is cut for work; results never depend on it."""

    tile_m: float = Field(20.0, ge=1, le=1000, description="Edge of a tile, whole millimetres [m].")


class PointSettings(StoreSettings):
    """What is written."""

    aggregate_bit: bool = Field(
        True,
        description="Set bit 5 of the LAS global encoding, which drafts of LAS 1.4 R14 called "
        "the aggregate model; the published ones reserve it.",
    )


class CoincidenceWorkflow(BaseWorkflow):
    """Everything that coincidence processing needs to know."""

    kind: Literal["coincidence"] = Field(description="Coincidence processing, Geiger mode.")
    survey: L1Settings
    array: ArraySettings = ArraySettings()
    coincidence: CoincidenceSettings = CoincidenceSettings()
    tiling: TileSettings = TileSettings()
    outputs: PointSettings = PointSettings()

    def faults(self) -> Iterator[str]:
        """What is wrong that no single key shows: edges that are no whole millimetres."""
        edges = {
            "tiling.tile_m": self.tiling.tile_m,
            "coincidence.voxel_m": self.coincidence.voxel_m,
        }
        for key, edge in edges.items():
            if edge is not None and abs(edge * QUANTA_PER_M - round(edge * QUANTA_PER_M)) > 1e-6:
                yield f"{key}: {edge:g} is not a whole number of millimetres"

    @property
    def tile_q(self) -> int:
        """Edge of a tile [quanta]."""
        return round(self.tiling.tile_m * QUANTA_PER_M)

    @property
    def voxel_q(self) -> int:
        """Edge of a voxel [quanta]."""
        return self.coincidence.voxel_quanta(self.array)
