"""What a report says of noise: a part of :mod:`~spl_batch.airborne.report.model`."""

from pydantic import Field

from spl_batch.engine.report.parts import Count, Number, Part


class NoiseFit(Part):
    """What the filter did below all surfaces, where noise lies alone."""

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
    fit: NoiseFit | None = Field(None, description="Null where nothing was filtered.")
    dsm_support: Count | None = Field(
        None, description="Returns nearby that a highest return needs to set a DSM cell [count]."
    )
