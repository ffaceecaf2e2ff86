"""Vertical accuracy at checkpoints against the formulas of the standard, done by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.airborne.accuracy.checkpoint_errors import (
    CheckpointError,
    CheckpointStatistics,
    at_checkpoints,
    statement,
)
from spl_batch.constants import FOOT_M

metres = st.floats(-2, 2)


@given(st.lists(st.tuples(metres, st.floats(0.001, 0.2)), min_size=1, max_size=60))
def test_both_components_add_in_squares(found: list[tuple[float, float]]) -> None:
    said = at_checkpoints([CheckpointError(str(k), *one) for k, one in enumerate(found)])
    squares = sum(error**2 for error, _ in found) / len(found)
    own = sum(accuracy**2 for _, accuracy in found) / len(found)
    assert said.n == len(found)
    assert said.mean_m == pytest.approx(sum(error for error, _ in found) / len(found), abs=1e-12)
    assert said.rmse_v1_m == pytest.approx(math.sqrt(squares))
    assert said.rmse_v2_m == pytest.approx(math.sqrt(own))
    assert said.rmse_v_m == pytest.approx(math.sqrt(squares + own))
    if len(found) > 1:
        assert said.sd_m == pytest.approx(np.std([e for e, _ in found], ddof=1), abs=1e-12)


def many(n: int, *, accuracy: float | None = 0.03, scale: float = 0.04) -> CheckpointStatistics:
    return at_checkpoints([CheckpointError(f"P{k}", scale * (-1) ** k, accuracy) for k in range(n)])


def test_a_checkpoint_of_unknown_accuracy_leaves_the_sum_unknown() -> None:
    found = [CheckpointError("A", 0.1, 0.02), CheckpointError("B", 0.1, None)]
    assert at_checkpoints(found).rmse_v_m is None
    assert at_checkpoints(found).rmse_v1_m == pytest.approx(0.1)
    assert not many(30, accuracy=None).enough


def test_outliers_are_named_and_count() -> None:
    found = [CheckpointError(f"P{k}", e, 0.01) for k, e in enumerate(np.linspace(-0.04, 0.04, 40))]
    found.append(CheckpointError("blunder", 0.5, 0.01))
    said = at_checkpoints(found)
    assert said.outliers == ("blunder",)
    assert said.n == 41
    assert said.rmse_v1_m > 0.5 / math.sqrt(41)


def test_equal_errors_have_no_outlier_within_a_centimetre() -> None:
    found = [CheckpointError(str(k), 0.01, 0.01) for k in range(5)]
    assert at_checkpoints([*found, CheckpointError("near", 0.018, 0.01)]).outliers == ()


def test_a_statement_is_in_the_unit_of_delivery_with_centimetres_beside() -> None:
    nva = many(30, accuracy=0.03, scale=0.04)  # RMSE_V is 0.05 m
    metric = statement(nva, many(0), 0.1)
    assert "for a 10.0 cm RMSE_V" in metric
    assert "RMSE_V = 5.0 cm at 30 checkpoints: fit 4.0 cm, checkpoints 3.0 cm" in metric
    feet = statement(nva, many(0), 0.1, ("ft", FOOT_M))
    assert "for a 0.328 ft (10.0 cm) RMSE_V" in feet
    assert "RMSE_V = 0.164 ft (5.0 cm) at 30 checkpoints: fit 0.131 ft (4.0 cm)" in feet
