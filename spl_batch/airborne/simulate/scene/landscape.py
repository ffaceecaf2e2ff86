"""Landscape of a scene file: ground, buildings, bridges, trees, wires, water.

Positions are metres east and north of the scene's origin.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from spl_batch.engine.settings.base import Positive, Section

NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Place = tuple[float, float]


class Landform(Section):
    """Ground that is raised or lowered within a ring, and falls back to the relief beside it.

    A wide ring with a steep edge is a plateau above cliffs, a narrow one a ridge; lowered, these
    are a quarry and a gorge.
    """

    ring_m: tuple[Place, ...] = Field(min_length=3, description="Corners, east and north [m].")
    height_m: float = Field(description="By which the ground within is raised [m].")
    slope_deg: float = Field(
        90.0, gt=0, le=90, description="Of the edge; 90 is a cliff from node to node [deg]."
    )


class Terrain(Section):
    """Ground: smooth random relief, landforms on it, and how it reflects."""

    relief_m: NotNegative = Field(15.0, description="Highest less lowest ground [m].")
    wavelength_m: Positive = Field(120.0, description="Size of hills [m].")
    roughness_m: NotNegative = Field(0.02, description="Spread of small bumps [m].")
    reflectance: Share = Field(0.25, description="Mean reflectance of the ground.")
    reflectance_variation: Share = Field(0.3, description="Relative spread of it.")
    reflectance_m: Positive = Field(40.0, description="Size of brighter and darker fields [m].")
    parcel_m: Positive | None = Field(None, description="Size of parcels of one reflectance [m].")
    grid_m: Positive = Field(1.0, description="Node spacing of the ground [m].")
    apron_m: Positive = Field(
        60.0, description="Ground beyond the extent, so that slanted beams meet it [m]."
    )
    landforms: tuple[Landform, ...] = Field((), description="Plateaus, ridges, valleys.")


class Building(Section):
    """A box with a roof."""

    centre_m: Place = Field(description="East and north of the origin [m].")
    size_m: tuple[Positive, Positive] = Field(description="Length and width [m].")
    heading_deg: float = Field(0.0, description="Of the length, clockwise from north [deg].")
    eave_m: Positive = Field(6.0, description="Eaves above the highest ground beneath [m].")
    roof: Literal["flat", "gable", "shed"] = Field("flat", description="Shape of the roof.")
    pitch_deg: float = Field(25.0, ge=0, lt=80, description="Of a gable or shed [deg].")
    reflectance: Share = Field(0.3, description="Of the roof.")


class Buildings(Section):
    """Buildings by list, by number, or both."""

    count: int = Field(0, ge=0, description="Random buildings [count].")
    eave_m: tuple[Positive, Positive] = Field((4.0, 12.0), description="Of random ones [m].")
    items: tuple[Building, ...] = Field((), alias="list", description="Buildings one by one.")


class Bridge(Section):
    """A straight deck between two places on the ground."""

    ends_m: tuple[Place, Place] = Field(description="Middles of its ends [m].")
    width_m: Positive = Field(8.0, description="Of the deck [m].")
    thickness_m: Positive = Field(1.2, description="Of the deck [m].")
    reflectance: Share = Field(0.2, description="Of the deck.")


class Trees(Section):
    """Crowns as turbid ellipsoids; light passes them by Beer-Lambert's law."""

    cover: float = Field(0.0, ge=0, lt=0.9, description="Share of the area under crowns.")
    height_m: tuple[Positive, Positive] = Field((8.0, 18.0), description="Lowest, highest [m].")
    radius_m: tuple[Positive, Positive] = Field((2.0, 4.5), description="Smallest, largest [m].")
    crown_share: float = Field(0.65, gt=0, le=1, description="Crown length / tree height.")
    extinction_per_m: Positive = Field(0.35, description="Interception along a path [1/m].")
    gaps: Share = Field(0.15, description="Share of a crown that lets light through.")
    reflectance: Share = Field(0.3, description="Of leaves.")
    understory: Share = Field(0.3, description="Share of trees with a shrub below.")


class Wires(Section):
    """A line of towers or poles, its conductors catenaries between them."""

    kind: Literal["transmission", "distribution"] = "transmission"
    points_m: tuple[Place, ...] = Field(min_length=2, description="Towers, east and north [m].")
    height_m: Positive = Field(28.0, description="Of the attachment above ground [m].")
    sag_m: Positive = Field(4.0, description="Of a conductor below its ends at mid-span [m].")
    conductors: int = Field(3, ge=1, description="Conductors side by side [count].")
    spacing_m: Positive = Field(4.0, description="Between neighbouring conductors [m].")
    shield: bool = Field(True, description="A thinner wire 5 m above the middle.")
    diameter_m: Positive = Field(0.03, description="Of a conductor [m].")
    shield_diameter_m: Positive = Field(0.012, description="Of the shield wire [m].")
    reflectance: Share = Field(0.4, description="Of the wire.")
    returns_per_m: Positive | None = Field(
        None, description="Expected returns per metre of conductor and flightline, instead."
    )


class Water(Section):
    """A pond or lake: flat and dark, opaque or clear.

    Clear water has a depth: light that passes its surface meets the bottom, attenuated both ways.
    The depth is apparent, without refraction and the lower speed of light in water.
    """

    ring_m: tuple[Place, ...] = Field(min_length=3, description="Corners, east and north [m].")
    reflectance: Share = Field(0.03, description="Of the surface.")
    bank_slope: Positive = Field(0.3, description="Steepest ground beside it [rise/run].")
    depth_m: NotNegative = Field(
        0.0, description="Of clear water, reached at the bank's slope [m]; 0 is opaque."
    )
    attenuation_per_m: NotNegative = Field(
        0.15, description="Diffuse attenuation of clear water, one way [1/m]."
    )
    bottom_reflectance: Share = Field(0.15, description="Of its bottom.")
    surface_share: float = Field(
        0.02,
        gt=0,
        le=1,
        description="Of a beam that the surface of clear water turns back: Fresnel's, near the "
        "vertical.",
    )
    waves_m: NotNegative = Field(
        0.0, description="Spread of heights of opaque water with standing waves [m]."
    )
    wavelength_m: Positive = Field(10.0, description="Of these waves [m].")

    @model_validator(mode="after")
    def _opaque_with_waves(self) -> "Water":
        if self.waves_m and self.depth_m:
            raise ValueError("waves_m needs opaque water: leave depth_m out")
        return self
