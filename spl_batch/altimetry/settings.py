"""Settings of ``kind: altimetry``, each default written here and nowhere else.

Each key has its unit in its name or in its description.
"""

from typing import Literal

from pydantic import Field

from spl_batch.engine.settings.base import BaseWorkflow, Positive, Section, StoreSettings


class TrackSettings(Section):
    """What was flown and where its photons are."""

    name: str = Field("track", description="Title of the report.")
    photons: str | tuple[str, ...] = Field(
        description="ATL03 or MABEL-like HDF5, or CSV (along_track, height): a path or glob, or "
        "several, relative to this file."
    )
    beams: tuple[str, ...] = Field(
        (), description="Beams to process, as gt1r or channel006; all by default."
    )
    off_nadir_deg: float = Field(
        0.0, ge=0, lt=60, description="Angle of the beam from the vertical, for refraction [deg]."
    )


class RateSettings(Section):
    """Cells that noise is counted in."""

    cell_m: Positive = Field(20.0, ge=1, description="Cell of the along-track grid [m].")


class BaselineSettings(Section):
    """mDBSCAN [W17 3.1.2]: photons in an ellipse against a multiple of the mean of random ones."""

    scaled: bool = Field(True, description="On the axis that is scaled by the noise rate.")
    along_m: Positive = Field(12.0, le=200, description="Semi-axis along the track [m].")
    height_m: Positive = Field(4.0, le=200, description="Semi-axis in height [m].")
    factor: Positive = Field(4.0, description="Least photons, over the mean of random ellipses.")


Method = Literal["likelihood", "published", "mdbscan"]
"""What separates signal from noise: ours, [W17]'s posterior, and [W17]'s earlier filter."""


class Shape(Section):
    """Neighbourhood that a photon is scored in."""

    aspect: Positive = Field(description="Along-track over vertical extent.")
    neighbours: int = Field(
        ge=1, le=64, description="Largest k of the k-th neighbours [count]; 12 to 20 in [W17]."
    )


class SignalSettings(Section):
    """Which photons are signal."""

    method: Method = Field(
        "likelihood",
        description="Surfaces, diffuse parts and noise by one likelihood; published is the "
        "posterior of [W17 ch. 4] as its source has it, mdbscan its earlier filter [W17 3.1.2].",
    )
    shapes: tuple[Shape, ...] = Field(
        (Shape(aspect=4.0, neighbours=20), Shape(aspect=30.0, neighbours=8)),
        min_length=1,
        description="Neighbourhoods: each window takes the one with the largest F1 to be expected.",
    )
    contrast_max: float = Field(
        1000.0,
        gt=1,
        description="Signal is taken to be 1 to this many times as dense as noise, any order of "
        "magnitude being as likely as another.",
    )
    reach_m: Positive = Field(
        100.0, le=1000, description="Farthest neighbour along the track, however few photons [m]."
    )
    window_m: Positive = Field(
        4000.0,
        ge=100,
        description="Windows of the absolute grid that are assessed by themselves, with 1 km to "
        "each side [m].",
    )
    mdbscan: BaselineSettings = BaselineSettings()


class ProfileSettings(Section):
    """Ground and canopy top from the signal photons."""

    cell_m: Positive = Field(20.0, ge=1, description="Length of a cell of the profiles [m].")
    photons_factor: float = Field(
        1.5,
        ge=1,
        description="Photons that the ground is sought among, over the number of signal photons: "
        "few get through a canopy, and a line is fitted that stray ones do not move.",
    )
    reach_cells: int = Field(
        3, ge=1, le=20, description="Cells to each side that the ground is fitted over [count]."
    )
    slope_max: Positive = Field(1.0, description="Steepest ground that is followed [m/m].")
    layer_m: Positive | None = Field(
        None,
        description="Thickness of the layer that is ground [m]; by default 0.75 for ATL03, whose "
        "pulses of 1.5 ns are spread so far by a slope of 0.1 under 11 m of light, more on steeper "
        "stretches; 1.5 else.",
    )
    canopy_min_m: Positive = Field(2.0, description="Least height of canopy above ground [m].")
    canopy_share: float = Field(
        0.98, gt=0, le=1, description="Quantile of canopy photons that is the canopy's top."
    )
    photons_min: int = Field(3, ge=2, description="Least photons of a height [count].")


class TrackReferenceSettings(Section):
    """What the ground profile is compared with."""

    points: str | None = Field(
        None, description="CSV with along_track and height, in metres, of the reference ground."
    )
    dtm: str | None = Field(
        None, description="Raster of terrain heights, in any CRS; photons need latitude, longitude."
    )
    labels: str | None = Field(
        None,
        description="ATL08 file or glob whose photon labels are compared with ours, and, without "
        "points and dtm, its terrain with our ground.",
    )
    baseline: bool = Field(True, description="Run mDBSCAN beside it, for comparison.")
    remove_bias: bool = Field(
        False, description="Subtract the median difference before the statistics."
    )


class TrackOutputSettings(StoreSettings):
    """What is written beside profiles and photon tables."""

    refraction: bool = Field(
        False, description="Heights below water corrected for refraction, as a column of tables."
    )
    hdf5: bool = Field(True, description="HDF5 inputs again, with the labels in them.")


class WorkSettings(Section):
    """How the track is cut for work; results never depend on it."""

    segment_photons: int = Field(
        1_000_000, ge=1000, description="Photons of a segment of track, at most [count]."
    )


class TrackWorkflow(BaseWorkflow):
    """Everything that a run on photon profiles needs to know."""

    kind: Literal["altimetry"] = Field("altimetry", description="Photon profiles along a track.")
    track: TrackSettings
    reference: TrackReferenceSettings | None = None
    rate: RateSettings = RateSettings()
    signal: SignalSettings = SignalSettings()
    profile: ProfileSettings = ProfileSettings()
    work: WorkSettings = WorkSettings()
    outputs: TrackOutputSettings = TrackOutputSettings()
