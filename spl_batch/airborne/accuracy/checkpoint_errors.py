"""Vertical accuracy at checkpoints, as the second edition of the ASPRS standards wants it reported.

Source: ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2: Version 1.0
(2023), sections 7.1, 7.4 and 7.13; the wording is that of Version 2 (2024), section 7.16. Both
agree in what is computed here. The accuracy of a product has two components: how well it
fits the checkpoints, ``RMSE_V1``, and how well the checkpoints are known, ``RMSE_V2``;

    RMSE_V = sqrt(RMSE_V1^2 + RMSE_V2^2).

Non-vegetated (NVA) and vegetated (VVA) checkpoints are kept apart, 30 of them at least, and no
accuracy at 95 % confidence is stated any more. VVA is an RMSE too; it is reported and does not pass
or fail. With fewer checkpoints the standard has another sentence, which names their number; here it
follows the words that they are insufficient.

Deviation: heights are compared with the DTM, bilinear between cell centres, and not with a TIN of
the ground points.
"""

from collections.abc import Sequence
from math import hypot, sqrt
from typing import Final, NamedTuple

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from spl_batch.airborne.settings.standards import ASKED
from spl_batch.engine.report.number_format import as_ascii, height
from spl_batch.engine.report.parts import STRICT, Count, Number

STANDARD: Final = "ASPRS Positional Accuracy Standards for Digital Geospatial Data"

EDITION: Final = "Edition 2, Version 1.0 (2023)"
"""Where the numbers of sections are from that requirements cite."""

IN_FORCE: Final = "Edition 2, Version 2 (2024)"
"""What a statement is made by."""

OUTLIER_SIGMA: Final = 3.0
"""A checkpoint is named that differs from the median by more than so many robust standard
deviations, 1.4826 times the median absolute deviation."""

LEAST_OUTLIER_M: Final = 0.01
"""And by no less than this: a few equal errors would make the least other one an outlier [m]."""


class CheckpointError(NamedTuple):
    """Height of the DTM at a checkpoint."""

    id: str
    error_m: float
    accuracy_m: float | None


@dataclass(frozen=True, config=STRICT)
class CheckpointStatistics:
    """Vertical accuracy at checkpoints of one kind, by Edition 2 of the ASPRS standards."""

    n: Count = Field(description="Checkpoints on the terrain model [count].")
    mean_m: Number = Field(default=None, description="Mean of DTM minus checkpoint [m].")
    sd_m: Number = Field(default=None, description="Standard deviation [m].")
    rmse_v1_m: Number = Field(default=None, description="Fit of the DTM to the checkpoints [m].")
    rmse_v2_m: Number = Field(
        default=None, description="Accuracy of the checkpoints; null where one states none [m]."
    )
    rmse_v_m: Number = Field(default=None, description="Root of the sum of both squares [m].")
    outliers: tuple[str, ...] = Field(default=(), description="Checkpoints to look at; they count.")

    @property
    def enough(self) -> bool:
        """Whether there are as many as a statement needs, of known accuracy."""
        return self.n >= ASKED.checkpoints and self.rmse_v_m is not None


def at_checkpoints(found: Sequence[CheckpointError]) -> CheckpointStatistics:
    """Accuracy at checkpoints.

    ``found``: of one kind; may be empty.
    """
    if not found:
        return CheckpointStatistics(0)
    errors = np.array([one.error_m for one in found])
    fit = sqrt(float(np.mean(errors**2)))
    known = [one.accuracy_m for one in found if one.accuracy_m is not None]
    survey = sqrt(float(np.mean(np.square(known)))) if len(known) == len(found) else None
    away = np.abs(errors - np.median(errors))
    limit = max(OUTLIER_SIGMA * 1.4826 * float(np.median(away)), LEAST_OUTLIER_M)
    return CheckpointStatistics(
        n=len(found),
        mean_m=float(errors.mean()),
        sd_m=float(errors.std(ddof=1)) if len(found) > 1 else None,
        rmse_v1_m=fit,
        rmse_v2_m=survey,
        rmse_v_m=None if survey is None else hypot(fit, survey),
        outliers=tuple(one.id for one, far in zip(found, away > limit, strict=True) if far),
    )


def statement(
    nva: CheckpointStatistics,
    vva: CheckpointStatistics,
    class_m: float,
    of_heights: tuple[str, float] = ("m", 1.0),
) -> str:
    """Statement of accuracy of a product, in the standard's words.

    ``class_m``: vertical accuracy class that was asked for: the largest RMSE_V [m];
    ``of_heights``: unit of delivery, and the metres in it.
    """
    source = f"{STANDARD}, {IN_FORCE}"
    found = [
        _found("Non-Vegetated Vertical Accuracy (NVA)", "open", nva, of_heights),
    ]
    if vva.n:
        found.append(_found("Vegetated Vertical Accuracy (VVA)", "vegetated", vva, of_heights))
    if not nva.enough or nva.rmse_v_m is None:
        return f"Insufficient for a statement: {_lacking(nva)} ({source}). {' '.join(found)}"
    meets = "to meet" if nva.rmse_v_m <= class_m else "and does not meet"
    return (
        f"This data set was tested {meets} {source} for a {_height(class_m, of_heights)} RMSE_V "
        f"Vertical Accuracy Class. {' '.join(found)}"
    )


def _lacking(nva: CheckpointStatistics) -> str:
    if nva.n < ASKED.checkpoints:
        return (
            f"{nva.n} of the {ASKED.checkpoints} open checkpoints that it needs lie on the terrain"
        )
    return "the accuracy of the checkpoints themselves is not given"


def _found(name: str, kind: str, of: CheckpointStatistics, unit: tuple[str, float]) -> str:
    if of.rmse_v1_m is None:
        return f"The {name} was not tested: no {kind} checkpoint lies on the terrain."
    few = "" if of.n >= ASKED.checkpoints else ", using the reduced number of checkpoints"
    own = (
        "the checkpoints' own accuracy is not known"
        if of.rmse_v2_m is None
        else f"checkpoints {_height(of.rmse_v2_m, unit)}"
    )
    whole = "not known" if of.rmse_v_m is None else _height(of.rmse_v_m, unit)
    return (
        f"The {name} was found to be RMSE_V = {whole} at {of.n} checkpoints{few}: fit "
        f"{_height(of.rmse_v1_m, unit)}, {own}."
    )


def _height(metres: float, unit: tuple[str, float]) -> str:
    return as_ascii(height(metres, unit))
