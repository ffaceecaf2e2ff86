"""Shifts of flightlines, told by point source id and time."""

import numpy as np

from spl_batch.airborne.store.line_moves import LineMove, LineMoves

MOVES = LineMoves(
    [
        LineMove("00001_100", 1, 100.0, 200.0, (1, 2, 3)),
        LineMove("00001_500", 1, 500.0, 600.0, (-10, 0, 0)),
        LineMove("00002", 2, -np.inf, np.inf, (0, 0, 7)),
        LineMove("00003_100", 3, 100.0, 200.0, (0, 0, 0)),
        LineMove("00001", 1, -np.inf, np.inf, (0, 5, 0)),
    ]
)
NOTHING = (0, 0, 0)


def test_each_point_gets_the_shift_of_its_flightline() -> None:
    points = [
        (1, 150.0, (1, 2, 3)), (1, 100.0, (1, 2, 3)), (1, 200.5, (1, 2, 3)),
        (1, 500.0, (-10, 0, 0)), (1, 300.0, (0, 5, 0)), (1, np.nan, (0, 5, 0)),
        (2, np.nan, (0, 0, 7)), (2, 1e9, (0, 0, 7)), (3, 150.0, NOTHING),
        (3, np.nan, NOTHING), (4, 150.0, NOTHING),
    ]  # fmt: skip
    psid, time, wanted = (np.array(some) for some in zip(*points, strict=True))
    np.testing.assert_array_equal(MOVES.of(psid.astype(np.uint16), time), wanted)


def test_coordinates_alone_change_and_keep_their_types() -> None:
    columns = {
        "y": np.array([10, 20], np.int64),
        "z": np.array([1, 2], np.int32),
        "gps_time": np.array([150.0, 550.0]),
        "point_source_id": np.array([1, 1], np.uint16),
    }
    moved = MOVES.add(columns)
    assert moved.keys() == columns.keys()
    assert (moved["y"].tolist(), moved["z"].tolist()) == ([12, 20], [4, 2])
    assert {k: v.dtype for k, v in moved.items()} == {k: v.dtype for k, v in columns.items()}
    assert columns["y"].tolist() == [10, 20]


def test_what_is_stored_comes_back() -> None:
    again = LineMoves.from_arrays(MOVES.to_arrays())
    assert again.moves == MOVES.moves
    assert again.reach_q == 10
    assert {one.name for one in again.moved} == {"00001", "00001_100", "00001_500", "00002"}
    assert again.of_line("00001_500") == (-10, 0, 0)
    assert LineMoves.from_arrays(LineMoves([]).to_arrays()).reach_q == 0
