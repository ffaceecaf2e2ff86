"""Faults that were tried and survived, as the fuzzer and the soak counted them.

Both add a line to ``faults.json`` with ``--record``. ``python -m benchmarks.faults`` prints the
table of docs/security.md.
"""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

RECORD: Final = Path(__file__).with_name("faults.json")
"""What was tried, the earliest first."""


def add(what: str, tried: int, survived: int, command: Sequence[str]) -> None:
    """Add what a script has counted."""
    row = {"what": what, "tried": tried, "survived": survived, "command": shlex.join(command)}
    content = json.dumps([*rows(), row], indent=1)
    RECORD.write_text(f"{content}\n", encoding="utf-8")


def rows() -> list[dict[str, Any]]:
    """All that was counted."""
    found: list[dict[str, Any]] = json.loads(RECORD.read_text(encoding="utf-8"))
    return found


def table() -> str:
    """The table of the page."""
    lines = ["| faults | tried | survived | script |", "|---|---|---|---|"]
    for row in rows():
        left = row["tried"] - row["survived"]
        kept = f"all but {left}, mended" if left else _count(row["survived"])
        cells = (row["what"], _count(row["tried"]), kept, f"`{row['command']}`")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _count(number: int) -> str:
    return f"{number:,}".replace(",", " ")


if __name__ == "__main__":
    print(table())
