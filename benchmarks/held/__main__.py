"""Measure what must hold, and compare it with what was accepted last.

Run ``python -m benchmarks.held [--only GROUP ...] [--data FOLDER] [--since REVISION] [--accept]``.

Makes small seeded surveys, each once, and prints a table of figures with the values of the last
accepted commit (``benchmarks/held.json``, or that of another revision) and how far each may move;
seconds by group go to standard error. The exit status is 1 where a figure lies outside its
tolerance or is missing, or a hash differs. All groups take less than half an hour on two quiet
cores.

FOLDER holds real data: single-photon plots in ``spl``, the ISPRS samples in ``isprs``, classified
tiles in ``linear``, labelled tracks in ``icesat2``. Groups whose data is not given are left out.
"""

import argparse
import contextlib
import io
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.held import figures
from benchmarks.held.groups import GROUPS
from benchmarks.held.surveys import Given


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print and accept; the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.held", description=(__doc__ or "").split("\n", maxsplit=1)[0]
    )
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), metavar="GROUP",
                        help=f"of {', '.join(GROUPS)}")  # fmt: skip
    parser.add_argument("--data", type=Path, metavar="FOLDER", help="real data")
    parser.add_argument("--since", metavar="REVISION", help="compare with held.json of this one")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the table there, too")
    parser.add_argument("--accept", action="store_true", help="write held.json")
    options = parser.parse_args(arguments)
    if options.data and not options.data.is_dir():
        parser.error(f"--data {options.data}: no such folder")
    accepted = figures.accepted(options.since)
    rows: list[figures.Row] = []
    measured: figures.Groups = {}
    seconds: dict[str, float] = {}
    print(figures.HEAD)
    with tempfile.TemporaryDirectory() as scratch:
        for group in options.only:
            start = time.perf_counter()
            with contextlib.redirect_stdout(io.StringIO()):  # what benchmarks print
                found = list(GROUPS[group](Given(Path(scratch), options.data)))
            seconds[group] = time.perf_counter() - start
            print(f"{group}: {seconds[group]:.0f} s", file=sys.stderr, flush=True)
            if not found:
                print(f"{group:12s}left out: needs --data")
                continue
            measured[group] = found
            for row in figures.compare({group: found}, accepted):
                rows.append(row)
                print(figures.line(row), flush=True)
    failed = [row for row in rows if row.fails]
    print(f"{len(rows)} figures in {sum(seconds.values()):.0f} s, {len(failed)} do not hold")
    if options.json:
        options.json.write_text(figures.to_json(rows, seconds), encoding="utf-8")
    if options.accept:
        figures.accept(measured)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
