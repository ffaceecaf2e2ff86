"""Shifts of flightlines that bring all pairs together."""

from itertools import combinations

import numpy as np
import pytest

from spl_batch.airborne.strips.line_shifts import line_shifts
from spl_batch.airborne.strips.pair_table import PairDifference

OFF = {"a": (0.3, -0.1, 0.2), "b": (0.0, 0.0, 0.0), "c": (-0.1, 0.2, -0.05), "d": (0.1, 0.0, 0.4)}
"""East, north and up by which flightlines lie off [m]."""


def pair(
    first: str, second: str, *, slopes: bool = True, error_m: float = 0.0, squares: int = 0
) -> PairDifference:
    east, north, up = np.subtract(OFF[second], OFF[first]).tolist()
    values = dict.fromkeys(PairDifference._fields, 0.0) | {
        "first": first, "second": second, "up_m": up + error_m, "up_sd_m": 0.01 + error_m,
        "east_m": east if slopes else None, "north_m": north if slopes else None,
        "horizontal_sd_m": 0.03 if slopes else None, "squares": squares,
    }  # fmt: skip
    return PairDifference(**values)  # type: ignore[arg-type]


def test_offsets_are_taken_away_and_the_line_nearest_to_the_others_is_held() -> None:
    found = line_shifts([pair(*names) for names in combinations("abcd", 2)], {})
    assert [one.name for one in found] == list("abcd")
    for one in found:
        shift = np.subtract(OFF["b"], OFF[one.name])
        np.testing.assert_allclose((one.east_m, one.north_m, one.up_m), shift, atol=1e-9)
        assert one.left_m == pytest.approx(0.0, abs=1e-9)
    many = line_shifts([pair(*names) for names in combinations("abcd", 2)], {"d": 1000})
    assert (many[3].east_m, many[3].north_m, many[3].up_m) == (0.0, 0.0, 0.0)


def test_groups_that_do_not_overlap_hold_a_flightline_each() -> None:
    found = {one.name: one.up_m for one in line_shifts([pair("a", "b"), pair("c", "d")], {})}
    assert found["a"] * found["b"] == found["c"] * found["d"] == 0.0
    assert found["c"] - found["d"] == pytest.approx(0.45)


def test_what_no_slopes_tell_is_not_told_and_a_bad_pair_counts_little() -> None:
    pairs = [
        pair("a", "b"),
        pair("b", "c", slopes=False),
        pair("a", "c", slopes=False, error_m=0.5),
    ]
    a, b, c = line_shifts(pairs, {})
    assert (c.east_m, c.north_m) == (None, None)
    assert b.east_m is not None
    assert a.east_m is not None
    assert b.east_m - a.east_m == pytest.approx(0.3)
    assert (b.up_m - a.up_m, c.up_m - b.up_m) == pytest.approx((0.2, 0.05), abs=0.002)
    assert a.left_m == c.left_m == pytest.approx(0.5, abs=0.002)
    assert line_shifts([], {}) == []
