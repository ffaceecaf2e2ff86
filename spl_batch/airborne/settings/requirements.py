"""What a client's contract asks for."""

from typing import Literal

from pydantic import Field

from spl_batch.engine.settings.base import Positive, Section


class RequirementSettings(Section):
    """What the page "Is it good enough?" of the report judges by; it changes no other result."""

    quality_level: Literal["QL0", "QL1", "QL2", "QL3"] = Field(
        "QL2", description="Quality level of the USGS Lidar Base Specification."
    )
    coverage: Literal["single", "multiple"] = Field(
        "single",
        description="Whether each flightline has the density by itself, or all of them together.",
    )
    rmse_v_m: Positive | None = Field(
        None, description="Largest RMSE_V at open checkpoints; by default the level's [m]."
    )
    pulses_per_m2: Positive | None = Field(
        None, description="Least density of first returns; by default the level's [1/m2]."
    )
