"""Findings that rest on the density of the signal."""

import pytest

from spl_batch.airborne.report.good_enough import sparse_vegetation
from spl_batch.airborne.report.model import Density
from spl_batch.airborne.settings import ClassSettings


@pytest.mark.parametrize(
    ("per_m2", "few"), [(0.24, True), (0.99, True), (1.0, False), (None, False)]
)
def test_vegetation_of_few_returns_is_warned_of(per_m2: float | None, *, few: bool) -> None:
    asked = ClassSettings.model_validate({"vegetation": {}})
    found = sparse_vegetation(Density(mean_per_m2=per_m2), asked)
    assert [one.code for one in found] == ["G03"] * few
    assert sparse_vegetation(Density(mean_per_m2=per_m2), ClassSettings()) == ()
