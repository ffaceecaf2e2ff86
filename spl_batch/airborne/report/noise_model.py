"""What a report says of noise: a part of :mod:`~spl_batch.airborne.report.model`."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.report.parts import Count, Number, Part


class Haze(Part):
    """Air between the start of the gate and the surface that sends light back: the largest cloud.

    Places of 25 m that touch, and overlap in height, are one cloud.
    """

    low_m: Number = Field(None, description="Height above which 95 % of its returns lie [m].")
    high_m: Number = Field(None, description="Height below which 95 % of them lie [m].")
    above_ground_m: Number = Field(
        None,
        description="Its lower end above the terrain below each place of 25 m, in the median [m].",
    )
    top_above_ground_m: Number = Field(None, description="Its upper end above that, too [m].")
    noise_class: Literal[7, 18] | None = Field(
        None,
        description="Class of most of its returns: 18 above the terrain, 7 below it; null where "
        "the terrain is not known.",
    )
    area_km2: Number = Field(None, description="Area over which it was found [km2].")
    extent_m: tuple[Number, Number, Number, Number] | None = Field(
        None, description="West, east, south, north of all of it [m]."
    )
    returns: Count = Field(0, description="Returns in it, followers of others apart [count].")
    mean_per_m3: Number = Field(None, description="Mean density of these [1/m3].")
    times_expected: Number = Field(
        None, description="Returns over what the model of the noise expects there."
    )
    others: Count = Field(0, description="Other clouds [count].")
    others_area_km2: Number = Field(None, description="Area of these; null without [km2].")


class NoiseFit(Part):
    """What the filter did where nothing stands: below all surfaces, and high above them."""

    returns_below: Count = Field(
        0, description="Returns that were judged more than 10 m below all surfaces [count]."
    )
    p_value_times: Number = Field(
        None,
        description="How many of these have a p-value up to p_value, over what uniform ones would "
        "have: 1 if noise is what its model says; null where they need not be so, or are few.",
    )
    p_value: Number = Field(
        None,
        description="Of 0.01, 0.02, 0.05, 0.1 and 0.2 the one at which that is farthest from 1.",
    )
    floating: Count = Field(
        0,
        description="Signal with no other in the 15 m below it, in its column of 5 m and those "
        "around, though some lies farther down; surfaces excepted [count].",
    )
    floating_share: Number = Field(None, description="These over all signal, 0..1.")


class Noise(Part):
    """What was expected of the background noise, and how it was told apart."""

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
    kept_within_signal: Number = Field(
        None,
        description="Background returns expected in the cubes of 1.2 m that hold kept returns, "
        "where nothing tells them apart: kept as well, and not in kept_by_chance [count].",
    )
    fit: NoiseFit | None = Field(None, description="Null where nothing was filtered.")
    haze: Haze | None = Field(None, description="Haze or cloud that was found; null without.")
    dsm_support: Count | None = Field(
        None, description="Returns nearby that a highest return needs to set a DSM cell [count]."
    )
