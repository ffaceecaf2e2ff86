"""What a report holds of flightlines that overlap."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.report.parts import Count, Number, Part


class StripPair(Part):
    """Where a flightline lies against another that overlaps it, from planar patches of both."""

    first: str = Field(description="The flightline that is compared with.")
    second: str = Field(description="The one whose place is told.")
    patches: Count = Field(description="Planar patches that both have [count].")
    area_m2: Number = Field(description="Area of these patches [m2].")
    centre_m: tuple[Number, Number] = Field(description="Easting and northing of their middle [m].")
    up_m: Number = Field(description="The second above the first [m].")
    up_sd_m: Number = Field(description="Standard deviation of it [m].")
    east_m: Number = Field(None, description="The second east of the first; null if flat [m].")
    north_m: Number = Field(None, description="The second north of the first; null if flat [m].")
    horizontal_sd_m: Number = Field(
        None, description="Standard deviation of these, in the worst direction [m]."
    )
    flat_patches: Count = Field(0, description="Smooth patches of up to 10 degrees [count].")
    rmsd_z_m: Number = Field(
        None, description="Root mean square of the vertical differences of these [m]."
    )
    noise_m: Number = Field(description="Ranging noise: spread about the smoothest patches [m].")
    largest_m: Number = Field(
        None, description="Largest vertical difference of a smooth patch of up to 10 degrees [m]."
    )
    largest_sd_m: Number = Field(None, description="Standard deviation of it [m].")
    largest_at_m: tuple[Number, Number] | None = Field(
        None, description="Easting and northing of that patch [m]."
    )
    tilt_east_m: Number = Field(
        None, description="Change of up_m on 100 m to the east; null where no tilt is sure [m]."
    )
    tilt_north_m: Number = Field(None, description="The same to the north [m].")
    tilt_sd_m: Number = Field(
        None, description="Standard deviation of these, in the worst direction [m]."
    )
    change_m: Number = Field(None, description="Change of up_m over all patches by that tilt [m].")


class LineShift(Part):
    """What brings a flightline together with those that overlap it; one of them is held."""

    name: str = Field(description="The flightline.")
    up_m: Number = Field(description="To be added to its heights [m].")
    east_m: Number = Field(None, description="To be added to its eastings; null if flat [m].")
    north_m: Number = Field(None, description="To be added to its northings; null if flat [m].")
    left_m: Number = Field(
        description="Largest vertical difference to another flightline that is left then [m]."
    )


class AlignedLine(Part):
    """What was added to the coordinates of a flightline, and how sure it is."""

    name: str = Field(description="The flightline.")
    east_m: Number = Field(description="Added to its eastings [m].")
    north_m: Number = Field(description="Added to its northings [m].")
    up_m: Number = Field(description="Added to its heights [m].")
    found_m: tuple[Number, Number, Number] = Field(
        description="East, north and up as found; null what nothing tells or was not asked [m]."
    )
    horizontal_sd_m: Number = Field(
        None, description="Standard deviation of east and north, the worse of the two [m]."
    )
    up_sd_m: Number = Field(None, description="Standard deviation of the height [m].")
    stays: Literal["", "held", "not compared", "not sure", "too far"] = Field(
        description="Why nothing was added: the others are shifted against it; too few planar "
        "patches with others; less than two standard deviations (2.5 on the map); more than 2 m. "
        "Empty where something was."
    )


class Alignment(Part):
    """Shifts that bring flightlines together: translations, applied to all that was delivered."""

    align: Literal["vertical", "rigid"] = Field(description="What was asked for.")
    lines: tuple[AlignedLine, ...] = Field(
        description="All flightlines; of those that overlap one is held: the one to which the "
        "others, weighted by their returns, come by the shortest way."
    )
    before: tuple[StripPair, ...] = Field(
        description="Pairs of flightlines as they were recorded; strips has what is left."
    )
