"""Shifts that a run applies to its flightlines."""

from itertools import combinations

import numpy as np
import pytest

from spl_batch.airborne.strips.alignment import ALONE, HELD, TOO_FAR, UNSURE, align_lines
from tests.airborne.strips.test_line_shifts import OFF, pair

SAME = dict.fromkeys("abcde", 1000)
ALL = list(combinations("abcd", 2))


def test_offsets_are_taken_away_against_the_flightline_that_is_held() -> None:
    returns = {"a": 1000, "b": 9000, "c": 2000, "d": 500}
    found = align_lines("dcba", [pair(*names, squares=40) for names in ALL], returns, rigid=True)
    assert [one.name for one in found] == list("abcd")
    assert [one.stays for one in found] == ["", HELD, "", ""]
    for one in found:
        wanted = np.subtract(OFF["b"], OFF[one.name])
        np.testing.assert_allclose(one.found_m, wanted, atol=1e-9)
        np.testing.assert_allclose((one.east_m, one.north_m, one.up_m), wanted, atol=6e-4)


def test_where_most_fit_they_stay_and_the_odd_one_is_moved() -> None:
    lines = [pair("b", name)._replace(up_m=0.002, east_m=0.0, north_m=0.0) for name in "ac"]
    odd = [pair(name, "d")._replace(up_m=0.2, east_m=0.3, north_m=0.0) for name in "abc"]
    found = align_lines("abcd", [*lines, *odd], {**SAME, "d": 2500}, rigid=True)
    assert [one.name for one in found if not one.stays] == ["d"]
    assert (found[3].east_m, found[3].up_m) == pytest.approx((-0.3, -0.2), abs=0.003)


def test_standard_deviations_are_those_of_all_pairs_together() -> None:
    """Against the dense inverse of the normal matrix, without the flightline that is held."""
    pairs = [pair(*names, squares=40) for names in ALL[:-1]]
    found = align_lines("abcd", pairs, SAME, rigid=False)
    design = np.zeros((len(pairs), 4))
    for row, one in enumerate(pairs):
        design[row, ["abcd".index(one.first), "abcd".index(one.second)]] = -1, 1
    normal = design.T @ design / (0.01**2 + 0.01**2)
    (held,) = [k for k, one in enumerate(found) if one.stays == HELD]
    free = [k for k in range(4) if k != held]
    variance = np.linalg.inv(normal[np.ix_(free, free)]).diagonal()
    np.testing.assert_allclose([found[k].up_sd_m for k in free], np.sqrt(variance), rtol=1e-9)
    assert found[held].up_sd_m == 0.0
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
        ours, theirs = (some[name].found_m[2] - some["c"].found_m[2] for some in (robust, plain))
        assert ours == pytest.approx(theirs, abs=0.05)
    assert max(one.up_sd_m for one in robust.values()) > 1.5 * plain["d"].up_sd_m


def test_what_stays_is_said_and_why() -> None:
    alike = pair("a", "b")._replace(up_m=0.01, east_m=0.02, north_m=0.0)
    found = {one.name: one for one in align_lines("abe", [alike], SAME, rigid=True)}
    assert (found["a"].stays, found["b"].stays, found["e"].stays) == (HELD, UNSURE, ALONE)
    assert all((one.east_m, one.north_m, one.up_m) == (0.0, 0.0, 0.0) for one in found.values())
    assert found["e"].found_m == (None, None, None)


def test_few_squares_move_nothing_by_what_may_be_chance() -> None:
    """One square sees 12 cm: less than 2.5 of its errors."""
    few = pair("a", "b")._replace(up_m=0.0, east_m=0.12, north_m=0.0, squares=3)
    assert [one.stays for one in align_lines("ab", [few], SAME, rigid=True)] == [HELD, UNSURE]
    many = few._replace(squares=40)
    shifts = [one.east_m for one in align_lines("ab", [many], SAME, rigid=True)]
    assert shifts == pytest.approx([0.0, -0.12])


def test_two_directions_need_more_than_one_to_be_sure() -> None:
    """They are known to 3.2 cm, of which 7.5 cm are 2.4 and 8.5 cm are 2.7."""
    found = pair("a", "b")._replace(up_m=0.0, east_m=0.075, north_m=0.0, squares=1000)
    assert [one.stays for one in align_lines("ab", [found], SAME, rigid=True)] == [HELD, UNSURE]
    surer = found._replace(east_m=0.085)
    assert [one.stays for one in align_lines("ab", [surer], SAME, rigid=True)] == [HELD, ""]


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
    assert found == pytest.approx({"a": 0.0, "b": 0.2, "c": 0.0, "d": -0.45})
    assert align_lines([], [], {}, rigid=True) == []
