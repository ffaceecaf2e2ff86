"""Ground filters and rasters."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.settings.base import Edge, Length, Positive, Section, Share


class PtdSettings(Section):
    """Progressive TIN densification [Axelsson 2000; W17 7.4]."""

    seed_cell_m: Positive = Field(2.0, description="Grid of the first ground points [m].")
    seed_slope: Positive = Field(
        0.2, description="Slope tolerance of the opening that seeds survive [rise/run]."
    )
    seed_step_m: Positive = Field(
        3.0, description="Fall between two windows that is an object's at any slope [m]."
    )
    object_m: Positive = Field(60.0, description="Widest object that seeds avoid [m].")
    terrain_angle_deg: Positive = Field(88.0, le=90, description="Steepest terrain [deg].")
    iteration_angle_deg: Positive = Field(
        10.0, lt=90, description="Largest angle to a facet [deg]."
    )
    iteration_distance_m: Positive = Field(1.4, description="Largest distance to a facet [m].")
    spread_m: float = Field(
        0.15, ge=0, description="Part of a distance that ranging noise explains [m]."
    )
    node_m: Positive = Field(
        1.0, description="Grid of candidates [m]; twice that below two points in a cell."
    )
    layer_m: Positive = Field(0.3, description="Thickness of the lowest layer in a cell [m].")
    band_m: Positive = Field(0.2, description="Ground within this distance of the surface [m].")


class SmrfSettings(Section):
    """Simple morphological filter [Pingel, Clarke & McBride 2013]."""

    cell_m: Positive = Field(1.0, description="Grid of minimum heights [m].")
    slope: Positive = Field(0.15, description="Slope tolerance [rise/run].")
    window_m: Positive = Field(30.0, description="Radius of the largest window [m].")
    threshold_m: Positive = Field(0.5, description="Height above the surface [m].")
    scalar: float = Field(1.25, ge=0, description="Growth of the threshold with slope [m].")
    layer_m: Positive = Field(0.3, description="Thickness of the lowest layer in a cell [m].")


class GroundSettings(Section):
    """Ground points; run on fixed absolute cells, so that tiles cannot matter."""

    method: Literal["multiscale", "ptd", "smrf"] = Field(
        "multiscale",
        description="Ground filter: by scales that follow the data, with nothing to set; or as "
        "published, progressive TIN densification or the simple morphological filter.",
    )
    cell_m: Edge = Field(200.0, description="Edge of a ground cell [m].")
    buffer_m: Positive = Field(60.0, description="Points around a cell that take part [m].")
    ptd: PtdSettings = PtdSettings()
    smrf: SmrfSettings = SmrfSettings()


class ProductSettings(Section):
    """Rasters."""

    cell_m: Edge = Field(1.0, description="Edge of a raster cell [m].")
    void_max_m: Length = Field(
        20.0, description="Farthest ground point that a DTM cell may use [m], or as 60 ft."
    )
    edge_max_m: Length | None = Field(
        None,
        description="Longest edge of a triangle at the rim of the terrain [m], or as 50 ft; by "
        "default 15 times the spacing of its ground.",
    )
    dsm_void_max_m: float = Field(3.0, ge=0, description="Farthest DSM cell that fills a void [m].")
    dsm_near_m: Positive = Field(
        0.5, description="Smallest sphere in which returns confirm a DSM cell [m]."
    )
    dsm_support_m: Positive = Field(
        1.5, le=20, description="Largest such sphere, for thin crowns [m]."
    )
    dsm_support: int = Field(
        1, ge=0, description="Returns that confirm a DSM cell, at the least [count]."
    )
    dsm_false_alarm: Share = Field(
        1e-7, description="Chance that noise alone confirms a noise return, by Poisson's law."
    )
    dsm_peer_ratio: float = Field(
        1.5,
        ge=1,
        description="Returns whose spacing is smaller than a DSM cell's by more than this "
        "factor do not confirm it.",
    )
    dsm_spacing_neighbours: int = Field(
        3, ge=1, le=64, description="That spacing is the distance to this neighbour [count]."
    )
    intensity: Literal["detection", "las"] = Field(
        "detection",
        description="Intensity raster: reflectance from the share of beamlets that were seen, "
        "where their lines of sight are known; or the mean LAS intensity of first returns.",
    )
    extinction_per_m: float = Field(
        1.0e-4, ge=0, description="Extinction of the air that reflectance allows for [1/m]."
    )
