"""Base of the workflow's sections, and the kinds of numbers in them."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, lt=1)]


class Section(BaseModel):
    """Base of every part of the workflow: frozen, and strict about its keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)
