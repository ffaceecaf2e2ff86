"""Classes beyond ground, noise and water: what deliveries of some clients ask for."""

from typing import Self

from pydantic import Field, model_validator

from spl_batch.engine.settings.base import Positive, Section


class VegetationSettings(Section):
    """From which height above the ground on a return is vegetation: classes 3, 4, 5 of the ASPRS.

    The standard leaves the heights to the contract.
    """

    low: Positive = Field(0.2, description="Low vegetation from this height above ground [m].")
    medium: Positive = Field(0.5, description="Medium vegetation from this height [m].")
    high: Positive = Field(2.0, description="High vegetation from this height [m].")

    @model_validator(mode="after")
    def _rise(self) -> Self:
        if not self.low < self.medium < self.high:
            raise ValueError(
                f"low {self.low:g}, medium {self.medium:g}, high {self.high:g} do not rise: "
                "give three heights above ground [m], each larger than the one before"
            )
        return self


class ClassSettings(Section):
    """Further classes and flags of delivered points; all off."""

    vegetation: VegetationSettings | None = Field(
        None, description="Classes 3, 4 and 5 by height above ground; {} takes the defaults."
    )
    building: bool = Field(
        False, description="Class 6 for planes that stand 2 m or more above the ground."
    )
    overlap: bool = Field(
        False, description="Flag overlap where two flightlines or more cover a square of 5 m."
    )
    withheld: bool = Field(
        False, description="Flag withheld on noise, classes 7 and 18, and on copies."
    )

    @property
    def flags(self) -> bool:
        """Whether flags of points are set."""
        return self.overlap or self.withheld
