"""Flightlines of points, found by point source id and time, and their shifts."""

import numpy as np

from spl_batch.airborne.store.flown_lines import FlownLine, FlownLines

LINES = FlownLines(
    [
        FlownLine("00001_100", 1, 100.0, 200.0, 3),
        FlownLine("00001_500", 1, 500.0, 600.0, -10),
        FlownLine("00002", 2, -np.inf, np.inf, 7),
        FlownLine("00003_100", 3, 100.0, 200.0),
        FlownLine("00001", 1, -np.inf, np.inf, 5),
    ]
)


def test_each_point_gets_the_shift_of_its_flightline() -> None:
    points = [
        (1, 150.0, "00001_100", 3), (1, 99.0, "00001_100", 3), (1, 201.0, "00001_100", 3),
        (1, 500.0, "00001_500", -10), (1, 300.0, "00001", 5), (1, 98.9, "00001", 5),
        (1, np.nan, "00001", 5), (2, np.nan, "00002", 7), (2, 1e9, "00002", 7),
        (3, 150.0, "00003_100", 0), (3, np.nan, "00003", 0), (4, 150.0, "00004", 0),
    ]  # fmt: skip
    psid, time, names, up_q = zip(*points, strict=True)
    of_points = np.array(psid, np.uint16), np.array(time)
    np.testing.assert_array_equal(LINES.up_q(*of_points), up_q)
    numbers = LINES.numbers(*of_points).tolist()
    assert [LINES.line(number).name for number in numbers] == list(names)
    assert max(numbers) < LINES.count


def test_heights_alone_change_and_keep_their_type() -> None:
    columns = {
        "y": np.array([10, 20], np.int64),
        "z": np.array([1, 2], np.int32),
        "gps_time": np.array([150.0, 550.0]),
        "point_source_id": np.array([1, 1], np.uint16),
    }
    shifted = LINES.shifted(columns)
    assert (shifted["y"].tolist(), shifted["z"].tolist()) == ([10, 20], [4, -8])
    assert {k: v.dtype for k, v in shifted.items()} == {k: v.dtype for k, v in columns.items()}
    assert columns["z"].tolist() == [1, 2]


def test_what_is_stored_comes_back() -> None:
    assert FlownLines.from_arrays(LINES.to_arrays()).lines == LINES.lines
    assert LINES.up_of("00001_500") == -10
    assert FlownLines.from_arrays(FlownLines([]).to_arrays()).lines == []


def test_a_file_gets_a_record_where_it_holds_a_flightline_that_is_shifted() -> None:
    assert LINES.of_file({"3": [[100.0, 200.0, 5]]}) is None
    assert LINES.of_file({"1": [[700.0, 800.0, 5]], "9": []}) is not None  # of the id, in no line
    found = LINES.of_file({})
    assert found is not None
    assert b"00001_100" not in found.record.data
