"""Noise filters: ours, and those of the sources.

What a source leaves open is ours, and marked so in its description.
"""

from typing import Literal

from pydantic import Field

from spl_batch.engine.settings.base import Positive, Section, Share


class WireSettings(Section):
    """Scan for conductors too weak for a test of single points."""

    enabled: bool = Field(True, description="Look along lines, with the tests of our own.")
    alpha: Share = Field(5e-4, description="Pure noise kept at most; out of the filter's alpha.")
    half_length_m: float = Field(12.0, ge=6, le=40, description="Half-length of a tube [m].")
    radius_m: float = Field(0.25, gt=0, le=1, description="Half-width of a tube [m].")
    slope_max: float = Field(
        0.3,
        gt=0,
        le=1,
        description="Steepest tube [rise/run]; spans that climb mountain sides need more.",
    )
    stretch: float = Field(
        1.2,
        ge=1,
        le=4,
        description="Agreeing tubes are sought within so many half-lengths [ratio].",
    )
    votes: int = Field(1, ge=1, description="Significant tubes that keep a point [count].")
    catenary_m: Positive = Field(
        700.0, description="Catenary constant of a typical conductor: radius at its lowest [m]."
    )
    surface_returns: int = Field(
        20,
        ge=4,
        description="Returns in a cube of 3 m, beyond twice its noise, of a surface [count].",
    )
    seed_share: float = Field(
        0.5, gt=0, le=1, description="Share of the points through which tubes are laid [0..1]."
    )
    classify: bool = Field(False, description="Give sure conductors class 14.")


class AesSettings(Section):
    """Adaptive ellipsoid searching [W17 ch. 5]; the ellipsoid's limits are the filter's."""

    neighbours: int = Field(25, ge=4, le=64, description="Neighbours that shape the ellipsoid.")
    radius_m: Positive = Field(1.5, le=10, description="Sphere of equal volume [m].")
    ratio_min: Share = Field(
        0.2, description="Least count in the ellipsoid over the sphere's [1/1]."
    )
    voxel_m: Positive = Field(
        10.0, le=50, description="Cube in which expected noise is added up [m]; ours."
    )
    square: int = Field(
        3,
        ge=1,
        le=10,
        description="Cubes along the side of a square in which the least crowded points are "
        "noise [count]; ours.",
    )


class DccSettings(Section):
    """Differential cell count of single shots [W17 3.2.3, Eq. 3.3]."""

    coarse_bin_m: Positive = Field(30.0, description="Range bin that finds the signal [m].")
    fine_bin_m: Positive = Field(5.0, description="Range bin that is kept or not [m].")


class PixelSettings(Section):
    """Neighbours in the detector's array, shot by shot [W17 3.2.1, after Zhang et al.]."""

    range_m: Positive = Field(1.0, description="Farthest from the return's range [m]; ours.")
    count: int = Field(
        3, ge=1, le=9, description="Of 3 x 3 pixels that return there [count]; ours."
    )


class VoxelSettings(Section):
    """Voxels as full as the mean of those around [W17 5.4, after Tang et al. 2016]."""

    edge_m: Positive = Field(3.0, le=50, description="Horizontal edge of a voxel [m].")
    height_m: Positive = Field(0.3, le=50, description="Height of a voxel [m].")
    column_m: Positive = Field(
        30.0, le=100, description="Square whose occupied voxels give the mean [m]; ours."
    )


class MultilevelSettings(Section):
    """Three levels of bins and voxels [W17 3.2.4, after Swatantran et al. 2016]."""

    bin_m: Positive = Field(30.0, description="Height bin of the first level [m].")
    column_m: Positive = Field(
        30.0, le=100, description="Square whose fullest bin is sought [m]; ours."
    )
    coarse_voxel_m: Positive = Field(3.0, le=20, description="Voxel of the second level [m].")
    coarse_count: int = Field(30, ge=1, description="Points that 27 of them need [count].")
    fine_voxel_m: Positive = Field(1.0, le=20, description="Voxel of the third level [m].")
    fine_count: int = Field(6, ge=1, description="Points that 27 of them need [count]; ours.")


class CylinderSettings(Section):
    """Upright cylinder around each point [W17 3.2.2, Eq. 3.2, after Cossio 2009]."""

    height_m: Positive = Field(1.0, le=100, description="Height D1 [m]; ours.")
    radius_m: Positive = Field(1.5, le=40, description="Radius, the root of D2 [m]; ours.")
    count: int = Field(5, ge=1, description="Other points that it needs [count]; ours.")


class FilterSettings(Section):
    """Which points are background noise [W18 2.2.3]."""

    method: Literal["vsaes", "aes", "dcc", "pixels", "voxel", "multilevel", "cylinder", "none"] = (
        Field(
            "vsaes", description="Filter: ours, or an earlier one of the sources; none keeps all."
        )
    )
    test: Literal["calibrated", "published"] = Field(
        "calibrated",
        description="By the null distribution; the published rule at 95 %.",
    )
    alpha: Share = Field(0.001, description="Pure noise kept, with the scan's share.")
    link_share: float = Field(
        0.4, ge=0, lt=1, description="Part of alpha for linked points, calibrated [0..1]."
    )
    weak_alpha: Share = Field(
        0.05, description="Significance that suffices near strongly significant points."
    )
    link_m: float = Field(6.0, ge=0, le=40, description="Strong points are sought within [m].")
    link_count: int = Field(
        4, ge=0, description="Strong points that let a weak one live [count]; 0 is no linking."
    )
    peer_ratio: float = Field(
        2.0,
        ge=1,
        description="Neighbours whose spacing is smaller than the point's by more than this "
        "factor are not counted.",
    )
    spacing_neighbours: int = Field(
        6, ge=1, le=64, description="Spacing is the distance to this neighbour [count]."
    )
    spacing_cap_m: Positive = Field(
        3.0, le=40, description="Largest spacing that is distinguished [m]."
    )
    neighbours: int = Field(
        25, ge=4, le=64, description="Neighbours whose spread shapes the ellipsoid; 15 in [W18]."
    )
    radius_m: Positive = Field(1.5, description="Radius of the sphere of equal volume [m].")
    axis_power: Literal["eigenvalue", "root"] = Field(
        "eigenvalue", description="Semi-axes follow the eigenvalues [W18] or their roots."
    )
    eigen_floor_m: Positive = Field(0.03, description="Smallest spread along an axis [m].")
    axis_cap_m: Positive = Field(12.0, description="Longest semi-axis [m].")
    neighbour_cap_m: Positive = Field(12.0, le=40, description="Farthest neighbour looked for [m].")
    wires: WireSettings = WireSettings()
    aes: AesSettings = AesSettings()
    dcc: DccSettings = DccSettings()
    pixels: PixelSettings = PixelSettings()
    voxel: VoxelSettings = VoxelSettings()
    multilevel: MultilevelSettings = MultilevelSettings()
    cylinder: CylinderSettings = CylinderSettings()
