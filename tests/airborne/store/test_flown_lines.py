"""Numbers of flightlines, and the shifts of their heights."""

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.airborne.store.flown_lines import Pass, Shifts, line_of, numbers

PASSES = [
    Pass(1, "00001_100", 1, 100.0, 200.0),
    Pass(65535, "00001_500", 1, 500.0, 600.0),
    Pass(2, "00002", 2, -np.inf, np.inf),
    Pass(3, "00003_100", 3, 100.0, 200.0),
]
SHIFTS = Shifts(PASSES, np.array([3, -10, 7, 0], np.int32))


@given(st.lists(st.integers(0, 65535), max_size=40))
def test_numbers_are_different_and_the_first_of_an_id_is_its_own(psids: list[int]) -> None:
    found = numbers(psids)
    assert len(set(found)) == len(found)
    first = {psid: k for k, psid in reversed(list(enumerate(psids)))}
    assert all(found[k] == psid for psid, k in first.items())


def test_a_point_belongs_to_the_pass_of_its_id_and_time() -> None:
    points = [
        (1, 150.0, 1), (1, 500.0, 65535), (1, 600.0, 65535), (1, 499.9, 1), (1, np.nan, 1),
        (2, np.nan, 2), (3, 550.0, 3), (4, 550.0, 4),
    ]  # fmt: skip
    psid, time, wanted = (np.array(column) for column in zip(*points, strict=True))
    assert line_of(psid.astype(np.uint16), time, PASSES).tolist() == wanted.tolist()


def test_heights_alone_change_and_keep_their_type() -> None:
    columns = {
        "y": np.array([10, 20], np.int64),
        "z": np.array([1, 2], np.int32),
        "line": np.array([1, 65535], np.uint16),
    }
    shifted = SHIFTS.shifted(columns)
    assert (shifted["y"].tolist(), shifted["z"].tolist()) == ([10, 20], [4, -8])
    assert {k: v.dtype for k, v in shifted.items()} == {k: v.dtype for k, v in columns.items()}


def test_what_is_stored_comes_back() -> None:
    again = Shifts.from_arrays(SHIFTS.to_arrays())
    assert again.passes == PASSES
    assert [again.of_name(one.name) for one in PASSES] == [3, -10, 7, 0]
    assert Shifts.from_arrays(Shifts([], np.zeros(0, np.int32)).to_arrays()).passes == []


def test_a_file_gets_a_record_where_it_holds_a_flightline_that_is_shifted() -> None:
    assert SHIFTS.of_file({"3": [[100.0, 200.0, 5]]}) is None
    found = SHIFTS.of_file({"1": [[100.0, 200.0, 5]], "9": []})
    assert found is not None
    listed = json.loads(found.record.data.rstrip(b"\0"))["flightlines"]
    assert [one["name"] for one in listed] == ["00001_100", "00001_500"]
    up_q = found.up_q(np.array([1, 1], np.uint16), np.array([150.0, 550.0]))
    assert up_q.tolist() == [3, -10]
