"""Base of the workflow and of its sections, and the kinds of numbers in them."""

import re
from collections.abc import Iterable
from typing import Annotated, Final

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    field_validator,
)

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.findings import table
from spl_batch.errors import named
from spl_batch.formats.units import COMMON, NAMES

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, lt=1)]

_WITH_UNIT: Final = re.compile(r"\s*(.*?)\s*(us-ft|ft|m)?\s*")


def _in_metres(value: object) -> object:
    """A text, with a unit or without, in metres; anything else as it is."""
    found = _WITH_UNIT.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        return value
    try:
        return float(found[1]) * COMMON[NAMES[found[2] or "m"]]
    except ValueError:
        raise ValueError(
            "write metres, or a length with its unit: 15 m, 50 ft (international feet) or 50 us-ft"
        ) from None


Length = Annotated[Positive, BeforeValidator(_in_metres, json_schema_input_type=float | str)]
"""Metres, or a text with a unit: ``50 ft``, ``50 us-ft``, ``15 m``."""


def _whole_quanta(edge_m: float) -> float:
    """A length that is a whole number of quanta."""
    quanta = edge_m * QUANTA_PER_M
    if round(quanta) < 1 or abs(quanta - round(quanta)) > 1e-6:
        raise ValueError(
            "not a whole number of millimetres; rasters of whole feet come from outputs.cell"
        )
    return edge_m


Edge = Annotated[Positive, AfterValidator(_whole_quanta)]
"""Edge of a square of an absolute grid, in metres."""


class Section(BaseModel):
    """Base of every part of the workflow: frozen, strict about its keys, of finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class StoreSettings(Section):
    """Where the working store lies."""

    store: str | None = Field(
        None,
        pattern=r"^[a-z][a-z0-9+.-]*://.+",
        description="Working store on an object store, a URL for fsspec such as "
        "s3://bucket/survey; by default the folder store of the output.",
    )


class ReportSettings(Section):
    """Content of a report."""

    ignore: tuple[str, ...] = Field(
        (),
        description="Codes of findings that are not reported, as docs/troubleshooting.md has them.",
    )

    @field_validator("ignore")
    @classmethod
    def _known(cls, codes: tuple[str, ...]) -> tuple[str, ...]:
        unknown = [code for code in codes if code not in table()]
        if unknown:
            raise ValueError(f"no code {named(unknown)}; there are {', '.join(sorted(table()))}")
        return codes


class BaseWorkflow(Section):
    """What the engine needs to know of a workflow, whatever its receiver."""

    kind: str = Field(description="Receiver that the workflow is for.")
    output: str = Field(description="Folder of the results, relative to this file.")
    outputs: StoreSettings = StoreSettings()
    report: ReportSettings = ReportSettings()

    def faults(self) -> Iterable[str]:
        """Faults that no single key shows, each with key, value and remedy."""
        return ()
