"""Figures, the values that were accepted last, and which of them lie outside their tolerance."""

import json
import math
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

ACCEPTED: Final = Path(__file__).parents[1] / "held.json"
"""Values of the last accepted commit."""

DIGITS: Final = 6
"""Significant digits that are kept of a number [count]."""

Value = float | int | str | None
Worse = Literal["less", "more", "either"]


class Figure(NamedTuple):
    """A measured value and how far it may move.

    Parameters
    ----------
    name : str
        Name within its group.
    value : float, int, str or None
        A number, a hash, or None where the number is not defined.
    unit : str
        Unit of value and tolerance.
    worse : {"less", "more", "either"}
        Direction in which the value may move by the tolerance only.
    tolerance : float
        Largest move; hashes must be equal.
    """

    name: str
    value: Value
    unit: str = ""
    worse: Worse = "either"
    tolerance: float = 0.0


class Row(NamedTuple):
    """A line of the table: a figure beside the accepted value, and what follows from both."""

    group: str
    figure: Figure
    accepted: Value
    status: Literal["held", "OUTSIDE", "MISSING", "new"]

    @property
    def fails(self) -> bool:
        """Whether the figure does not hold."""
        return self.status in {"OUTSIDE", "MISSING"}


Groups = dict[str, list[Figure]]
Moves = Mapping[str, tuple[str, Worse, float]]
"""Unit, direction that is worse and tolerance of figures by name."""


def figure(
    name: str, value: float, unit: str = "", worse: Worse = "either", tolerance: float = 0.0
) -> Figure:
    """Figure of a number, rounded as it is written; None where it is not finite."""
    number = float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    return Figure(name, number, unit, worse, tolerance)


def chosen(found: Mapping[str, float], moves: Moves, of: str = "") -> Iterator[Figure]:
    """Those of the measured figures that must hold, by name behind a prefix."""
    for name, (unit, worse, tolerance) in moves.items():
        if name in found:
            yield figure(f"{of}{name}", found[name], unit, worse, tolerance)


def is_outside(value: Value, accepted: Value, worse: Worse, tolerance: float) -> bool:
    """Whether a value is worse than the accepted one by more than the tolerance."""
    if isinstance(value, str) or isinstance(accepted, str) or value is None or accepted is None:
        return value != accepted
    moved = value - accepted
    # The last digit that is written does not count.
    most = tolerance + 10.0 ** (1 - DIGITS) * max(abs(value), abs(accepted))
    return {"less": -moved, "more": moved, "either": abs(moved)}[worse] > most


def compare(measured: Mapping[str, Sequence[Figure]], accepted: Groups) -> Iterator[Row]:
    """Rows of the measured groups, and of figures in them that are accepted and were not measured.

    Tolerances are those of the measured figures: a commit that widens one shows it in its source.
    """
    for group, figures in measured.items():
        known = {one.name: one for one in accepted.get(group, [])}
        for one in figures:
            before = known.pop(one.name, None)
            if before is None:
                yield Row(group, one, None, "new")
                continue
            outside = is_outside(one.value, before.value, one.worse, one.tolerance)
            yield Row(group, one, before.value, "OUTSIDE" if outside else "held")
        for one in known.values():
            yield Row(group, one._replace(value=None), one.value, "MISSING")


def from_text(text: str) -> Groups:
    """Groups of a file that :func:`to_text` made."""
    return {
        group: [Figure(name, **entry) for name, entry in figures.items()]
        for group, figures in json.loads(text).items()
    }


def to_text(groups: Mapping[str, Sequence[Figure]]) -> str:
    """Groups as JSON, a line for each figure."""
    parts = []
    for group, figures in sorted(groups.items()):
        lines = []
        for one in figures:
            entry: dict[str, Any] = one._asdict()
            lines.append(f"  {json.dumps(entry.pop('name'))}: {json.dumps(entry)}")
        parts.append(f" {json.dumps(group)}: {{\n" + ",\n".join(lines) + "\n }")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def accepted(revision: str | None = None) -> Groups:
    """Groups that were accepted last, or in a revision; none where there is no such file."""
    if revision is None:
        return from_text(ACCEPTED.read_text(encoding="utf-8")) if ACCEPTED.exists() else {}
    shown = subprocess.run(  # noqa: S603
        ["git", "show", f"{revision}:./{ACCEPTED.name}"],  # noqa: S607
        cwd=ACCEPTED.parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if shown.returncode:
        raise SystemExit(f"{ACCEPTED.name} of {revision}: {shown.stderr.strip()}")
    return from_text(shown.stdout)


def accept(measured: Mapping[str, Sequence[Figure]]) -> None:
    """Write measured groups over the accepted ones, and leave the others."""
    ACCEPTED.write_text(to_text({**accepted(), **measured}), encoding="utf-8")


def line(row: Row) -> str:
    """A row as text."""
    one = row.figure
    bound = {"less": "-", "more": "+", "either": "+-"}[one.worse] + f"{one.tolerance:g}"
    if isinstance(one.value, str):
        bound = "equal"
    cells = f"{_shown(one.value):>18s}{_shown(row.accepted):>18s}{bound:>10s} {one.unit:12s}"
    return f"{row.group:12s}{one.name:58s}{cells}{row.status}"


HEAD: Final = f"{'group':12s}{'figure':58s}{'value':>18s}{'accepted':>18s}{'may move':>10s}"


def _shown(value: Value) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.5g}"


def to_json(rows: Sequence[Row], seconds: Mapping[str, float]) -> str:
    """The table as JSON."""
    table = [
        {"group": r.group, **r.figure._asdict(), "accepted": r.accepted, "status": r.status}
        for r in rows
    ]
    content = {"figures": table, "seconds": {k: round(v, 1) for k, v in seconds.items()}}
    return json.dumps(content, indent=1) + "\n"
