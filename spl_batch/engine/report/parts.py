"""Parts that every report has: cost, failures, provenance, statistics of differences.

Every number is finite or null: a statistic of nothing is null, never NaN, so that any JSON
reader takes the file.
"""

import math
import operator
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final, Literal, SupportsIndex

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    PlainSerializer,
)

SCHEMA_VERSION: Final = 1
"""Raised when a field of ``report.json`` is renamed or removed."""


def finite_or_none(value: Any) -> Any:
    """Replace every non-finite number inside a value by ``None``.

    Parameters
    ----------
    value : object
        A number, or mappings and sequences of them; numpy scalars are welcome.

    Returns
    -------
    object
        The same value of plain Python types, finite or ``None``.
    """
    if isinstance(value, Mapping):
        return {str(key): finite_or_none(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [finite_or_none(item) for item in value]
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, SupportsIndex):
        return operator.index(value)
    try:
        number = float(value)
    except (TypeError, ValueError):
        return value  # not a number: the field's own type names what is wrong with it
    return number if math.isfinite(number) else None


def _plain_integer(value: Any) -> Any:
    return operator.index(value) if isinstance(value, SupportsIndex) else value


Number = Annotated[float | None, BeforeValidator(finite_or_none)]


def _nan_if_null(value: Any) -> Any:
    return math.nan if value is None else value


Measured = Annotated[
    float,
    BeforeValidator(_nan_if_null),
    PlainSerializer(finite_or_none, return_type=float | None),
]
"""A number that code computes with: finite or null in the report, NaN for null in memory."""


Count = Annotated[int, BeforeValidator(_plain_integer), Field(ge=0)]


Parameters = Annotated[dict[str, JsonValue], BeforeValidator(finite_or_none)]


STRICT: Final = ConfigDict(extra="forbid")
"""Of a part of the report that is a frozen dataclass of pydantic's."""


class Part(BaseModel):
    """Base of every part of the report: frozen, and strict about its keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Statistics(Part):
    """Differences of one class of surface, delivered minus reference."""

    n: Count = Field(description="Compared points or cells [count].")
    mean: Number = Field(None, description="Mean difference [m].")
    median: Number = Field(None, description="Median difference [m].")
    rmse: Number = Field(None, description="Root mean square difference [m].")
    sd: Number = Field(None, description="Standard deviation [m].")
    nmad: Number = Field(None, description="1.4826 x median absolute deviation [m].")
    p95: Number = Field(None, description="95th percentile of the absolute difference [m].")
    min: Number = Field(None, description="Smallest difference [m].")
    max: Number = Field(None, description="Largest difference [m].")


class StagePerformance(Part):
    """Cost of one stage."""

    wall_s: Number = Field(None, description="Summed time of its tasks [s].")
    tasks: Count = Field(0, description="Tasks done in this run [count].")
    skipped: Count = Field(0, description="Tasks found done by an earlier run [count].")
    failed: Count = Field(0, description="Tasks that failed [count].")
    points_per_s: Number = Field(None, description="Points per second and worker [1/s].")
    peak_rss_mb: Number = Field(None, description="Highest resident memory of a worker [MB].")


class Performance(Part):
    """Cost of the run."""

    wall_s: Number = Field(None, description="From start to the report [s].")
    compile_s: Number = Field(
        None,
        description="The part of it in which tasks waited for kernels that were compiled for this "
        "machine; later runs find that done. Null where nothing was to be compiled, or tasks did "
        "it [s].",
    )
    points_per_s: Number = Field(
        None,
        description="Input points per second, end to end but for compiling; null where some of the "
        "work was found finished [1/s].",
    )
    peak_rss_mb: Number = Field(None, description="Highest resident memory of a worker [MB].")
    workers: Count | None = Field(None, description="Workers [count].")
    stages: dict[str, StagePerformance] = Field({}, description="By stage, in order of work.")

    @property
    def part_alone(self) -> bool:
        """Whether its duration leaves out that of work which it found finished."""
        return any(stage.skipped for stage in self.stages.values())


class Failure(Part):
    """One task or file that did not make it."""

    code: str = Field("F04", description="Its code; docs/troubleshooting.md has all of them.")
    stage: str = Field(description="Stage that failed.")
    place: str = Field(description="File, flightline stretch or tile.")
    reason: str = Field(description="What went wrong, in one line.")
    remedy: str | None = Field(None, description="What to do, or the command that tries again.")
    task: str | None = Field(None, description="Kind and name of the task.")
    inputs: tuple[str, ...] = Field((), description="Files, tiles and stretches that it reads.")


class FindingReport(Part):
    """Something to warn of; findings that are alike are one, with the values of the worst."""

    code: str = Field(description="Its code; docs/troubleshooting.md has all of them.")
    severity: Literal["note", "warning"] = Field("warning", description="How much it matters.")
    title: str = Field(description="What the code means.")
    subject: str = Field("", description="What it concerns; empty for all of the survey.")
    subjects: tuple[str, ...] = Field((), description="All that it concerns, the worst first.")
    place: tuple[Number, Number, Number, Number] | None = Field(
        None, description="West, south, east, north of the worst place [m]."
    )
    values: Parameters = Field({}, description="Numbers and names of the sentence, by name.")
    sentence: str = Field(description="What is so.")
    consequence: str = Field("", description="What that means.")
    remedy: str = Field("", description="What to do.")

    @property
    def text(self) -> str:
        """All of it in one line."""
        opening = f"{self.code} {self.subject}: " if self.subject else f"{self.code} "
        ending = "; ".join(filter(None, (self.consequence, self.remedy)))
        return f"{opening}{self.sentence}" + (f": {ending}" if ending else "")


class InputFile(Part):
    """Identity of one input file."""

    path: str = Field(description="Path as the workflow gives it.")
    role: str = Field("flightline", description="Flightline, trajectory, reference, polygons.")
    size: Count = Field(description="Size [bytes].")
    hash: str = Field(description="Algorithm and digest, e.g. sha256:9f86d0...")
    points: Count | None = Field(None, description="Points that its header promises [count].")


class Provenance(Part):
    """Enough to do it again."""

    version: str = Field(description="Version of this software.")
    created: str = Field(description="When the report was written, ISO 8601 with offset.")
    command: str | None = Field(None, description="Command line of the run.")
    python: str | None = Field(None, description="Version of Python.")
    platform: str | None = Field(None, description="Operating system and processor.")
    libraries: dict[str, str] = Field({}, description="Version of each library used.")
    parameters: Parameters = Field({}, description="The whole workflow, defaults included.")
    inputs: tuple[InputFile, ...] = ()
