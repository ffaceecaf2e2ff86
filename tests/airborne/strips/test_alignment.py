"""Shifts that a run applies to its flightlines."""

from itertools import combinations

import numpy as np
import pytest

from spl_batch.airborne.strips.alignment import ALONE, TOO_FAR, UNSURE, align_lines
from tests.airborne.strips.test_line_shifts import OFF, pair

SAME = dict.fromkeys("abcde", 1000)
ALL = list(combinations("abcd", 2))


def test_offsets_are_taken_away_and_the_weighted_mean_stays() -> None:
    returns = {"a": 1000, "b": 3000, "c": 2000, "d": 500}
    found = align_lines("dcba", [pair(*names, squares=40) for names in ALL], returns, rigid=True)
    share = np.array([returns[name] for name in "abcd"]) / sum(returns.values())
    mean = share @ np.array([OFF[name] for name in "abcd"])
    assert [one.name for one in found] == list("abcd")
    for one in found:
        np.testing.assert_allclose(one.found_m, mean - OFF[one.name], atol=1e-9)
        applied = np.array([one.east_m, one.north_m, one.up_m])
        stays = applied == 0
        np.testing.assert_allclose(applied[~stays], (mean - OFF[one.name])[~stays], atol=6e-4)


def test_standard_deviations_are_those_of_all_pairs_together() -> None:
    """Against the dense inverse of the normal matrix, with the mean held."""
    pairs = [pair(*names, squares=40) for names in ALL[:-1]]
    found = align_lines("abcd", pairs, SAME, rigid=False)
    design = np.zeros((len(pairs), 4))
    for row, one in enumerate(pairs):
        design[row, ["abcd".index(one.first), "abcd".index(one.second)]] = -1, 1
    normal = design.T @ design / (0.01**2 + 0.01**2)
    variance = np.linalg.pinv(normal).diagonal()
    np.testing.assert_allclose([one.up_sd_m for one in found], np.sqrt(variance), rtol=1e-9)
    assert all(one.east_m == one.north_m == 0.0 for one in found)
    assert all(one.found_m[:2] == (None, None) for one in found)


def test_a_pair_that_fits_no_other_counts_little() -> None:
    pairs = [pair(*names, squares=40) for names in ALL]
    bad = pairs[0]._replace(up_m=pairs[0].up_m + 1.0)
    plain, robust = (
        {one.name: one for one in align_lines("abcd", some, SAME, rigid=False)}
        for some in (pairs, [bad, *pairs[1:]])
    )
    for name in "abcd":
        assert robust[name].found_m[2] == pytest.approx(plain[name].found_m[2], abs=0.05)
        assert robust[name].up_sd_m > plain[name].up_sd_m


def test_what_stays_is_said_and_why() -> None:
    alike = pair("a", "b")._replace(up_m=0.01, east_m=0.02, north_m=0.0)
    found = {one.name: one for one in align_lines("abe", [alike], SAME, rigid=True)}
    assert (found["a"].stays, found["b"].stays, found["e"].stays) == (UNSURE, UNSURE, ALONE)
    assert all((one.east_m, one.north_m, one.up_m) == (0.0, 0.0, 0.0) for one in found.values())
    assert found["e"].found_m == (None, None, None)


def test_few_squares_move_nothing_by_what_may_be_chance() -> None:
    """One square sees 12 cm: half of it for each flightline is less than twice its error."""
    few = pair("a", "b")._replace(up_m=0.0, east_m=0.12, north_m=0.0, squares=3)
    assert all(one.stays == UNSURE for one in align_lines("ab", [few], SAME, rigid=True))
    many = few._replace(squares=40)
    shifts = [one.east_m for one in align_lines("ab", [many], SAME, rigid=True)]
    assert shifts == pytest.approx([0.06, -0.06])


def test_a_flightline_that_is_absurdly_far_off_stays_and_spoils_no_other() -> None:
    pairs = [pair(*names, squares=40) for names in combinations("abc", 2)]
    far = [pair(name, "d")._replace(up_m=-OFF[name][2] + 7.0) for name in "abc"]
    found = {one.name: one for one in align_lines("abcd", [*pairs, *far], SAME, rigid=True)}
    plain = {one.name: one for one in align_lines("abcd", pairs, SAME, rigid=True)}
    assert found["d"].stays == TOO_FAR
    assert found["d"].found_m[2] < -2.0
    assert [found[name] for name in "abc"] == [plain[name] for name in "abc"]


def test_groups_are_solved_apart_and_nothing_needs_a_pair() -> None:
    pairs = [pair("a", "b"), pair("c", "d")]
    found = {one.name: one.up_m for one in align_lines("abcd", pairs, SAME, rigid=False)}
    assert found["a"] == -found["b"] == pytest.approx(-0.1)
    assert found["d"] == -found["c"] == pytest.approx(-0.225, abs=1e-3)
    assert align_lines([], [], {}, rigid=True) == []
