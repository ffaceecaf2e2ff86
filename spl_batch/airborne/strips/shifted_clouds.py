"""Delivered clouds whose flightlines were shifted: which of them, and how each file says so."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from spl_batch.airborne.context import Context
from spl_batch.airborne.store.line_moves import MARGIN_S, LineMove, LineMoves
from spl_batch.constants import QUANTA_PER_M
from spl_batch.formats.las.header import Vlr
from spl_batch.formats.las.writer import Moved

KEY: Final = (b"spl-batch", 1)
"""User id and number of the record that tells the shifts: JSON."""


def moved_of_file(
    moves: LineMoves | None, spans: Mapping[str, Sequence[Sequence[float]]], context: Context
) -> Moved | None:
    """Shifts of the points of a file; None where all of them stay.

    ``spans``: of each point source id first and last time [s], and more; none without times.
    """
    if moves is None:
        return None
    mine = [one for one in moves.moved if _is_in(one, spans)]
    return Moved(moves.of, record_of(mine, context)) if mine else None


def _is_in(move: LineMove, spans: Mapping[str, Sequence[Sequence[float]]]) -> bool:
    """Whether a file may hold returns of a flightline."""
    if not spans:
        return bool(np.isinf(move.first_s))
    return any(
        first <= move.last_s + MARGIN_S and last >= move.first_s - MARGIN_S
        for first, last, *_ in spans.get(str(move.psid), ())
    )


def record_of(moves: Sequence[LineMove], context: Context) -> Vlr:
    """Record of a file that says what was added to the coordinates of its flightlines."""
    content = {
        "align": context.workflow.survey.align,
        "meaning": "added to the coordinates of each flightline, rounded to the file's scale [m]",
        "flightlines": [_line(move) for move in moves],
    }
    data = json.dumps(content, indent=1).encode() + b"\0"
    return Vlr(*KEY, b"shifts of flightlines", data)


def _line(move: LineMove) -> dict[str, Any]:
    east, north, up = (one / QUANTA_PER_M for one in move.shift)
    timed = bool(np.isfinite(move.first_s))
    return {
        "name": move.name,
        "point_source_id": move.psid,
        "gps_time": [move.first_s, move.last_s] if timed else None,
        "east_m": east,
        "north_m": north,
        "up_m": up,
    }
