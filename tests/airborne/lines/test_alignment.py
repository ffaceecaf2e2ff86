"""Heights that a run adds to its flightlines."""

from dataclasses import fields, replace
from itertools import combinations

import numpy as np
import pytest

from spl_batch.airborne.lines.alignment import ALONE, KEPT, TOO_FAR, UNSURE, align_lines
from spl_batch.airborne.lines.pair_table import StripPair

SAME = dict.fromkeys("abcde", 1000)
ALL = list(combinations("abcd", 2))


OFF = {"a": 0.2, "b": 0.0, "c": -0.05, "d": 0.4}
"""By how much flightlines lie too high [m]."""


def pair(first: str, second: str, up_m: float | None = None) -> StripPair:
    values = dict.fromkeys((field.name for field in fields(StripPair)), 0.0)
    values |= {"first": first, "second": second, "centre_m": (0.0, 0.0)}
    values["up_m"] = OFF[second] - OFF[first] if up_m is None else up_m
    return StripPair(**{**values, "up_sd_m": 0.01})  # type: ignore[arg-type]


def test_offsets_are_taken_away_against_the_flightline_that_is_kept() -> None:
    returns = {"a": 1000, "b": 9000, "c": 2000, "d": 500}
    found = align_lines("dcba", [pair(*names) for names in ALL], returns)
    assert [one.name for one in found] == list("abcd")
    assert [one.stays for one in found] == ["", KEPT, "", ""]
    np.testing.assert_allclose([one.found_m for one in found], [-OFF[n] for n in "abcd"], atol=1e-9)
    np.testing.assert_allclose([one.up_m for one in found], [-OFF[n] for n in "abcd"], atol=6e-4)


def test_where_most_fit_they_stay_and_the_odd_one_is_shifted() -> None:
    pairs = [pair("b", name, 0.002) for name in "ac"] + [pair(name, "d", 0.2) for name in "abc"]
    found = align_lines("abcd", pairs, {**SAME, "d": 2500})
    assert [one.name for one in found if not one.stays] == ["d"]
    assert found[3].up_m == pytest.approx(-0.2, abs=0.003)


def test_standard_deviations_are_those_of_all_pairs_together() -> None:
    """Against the dense inverse of the normal matrix, without the flightline that is kept."""
    pairs = [pair(*names) for names in ALL[:-1]]
    found = align_lines("abcd", pairs, SAME)
    design = np.zeros((len(pairs), 4))
    for row, one in enumerate(pairs):
        design[row, ["abcd".index(one.first), "abcd".index(one.second)]] = -1, 1
    normal = design.T @ design / (0.01**2 + 0.01**2)
    (kept,) = [k for k, one in enumerate(found) if one.stays == KEPT]
    free = [k for k in range(4) if k != kept]
    variance = np.linalg.inv(normal[np.ix_(free, free)]).diagonal()
    np.testing.assert_allclose([found[k].sd_m for k in free], np.sqrt(variance), rtol=1e-9)
    assert found[kept].sd_m == 0.0


def test_a_pair_that_fits_no_other_counts_little() -> None:
    pairs = [pair(*names) for names in ALL]
    bad = replace(pairs[0], up_m=pairs[0].up_m + 1.0)
    plain, robust = (align_lines("abcd", some, SAME) for some in (pairs, [bad, *pairs[1:]]))
    for k in range(4):
        ours, theirs = (some[k].found_m - some[2].found_m for some in (robust, plain))
        assert ours == pytest.approx(theirs, abs=0.05)
    assert max(one.sd_m for one in robust) > 1.5 * plain[3].sd_m


def test_what_is_unsure_or_alone_stays() -> None:
    a, b, e = align_lines("abe", [pair("a", "b", 0.01)], SAME)
    assert (a.stays, b.stays, e.stays) == (KEPT, UNSURE, ALONE)
    assert a.up_m == b.up_m == e.up_m == 0.0
    assert e.found_m is None


def test_a_flightline_that_is_absurdly_far_off_stays_and_spoils_no_other() -> None:
    pairs = [pair(*names) for names in combinations("abc", 2)]
    far = [pair(name, "d", 7.0 - OFF[name]) for name in "abc"]
    found, plain = (align_lines("abcd", some, SAME) for some in ([*pairs, *far], pairs))
    assert found[3].stays == TOO_FAR
    assert found[3].found_m < -2.0
    assert found[:3] == plain[:3]
