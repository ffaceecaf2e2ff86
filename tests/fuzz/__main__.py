"""Many mutants: ``python -m tests.fuzz [--mutants 10000] [--seed 1] [--only NAME]``.

Reads mutants of each format in processes of their own, which a crash of a library ends without
taking the others along, and gives a share to whole runs. A mutant that breaks a promise is kept in
FOLDER (by default ``fuzz-findings``) with what came of it; exits with 1 where there is one.
"""

import argparse
import sys
from pathlib import Path
from typing import Final

from tests.fuzz import whole_runs
from tests.fuzz.rounds import made_of, rounds, share
from tests.fuzz.seeds import SEEDS

RUNS: Final = "whole runs"
"""Every kind of them, without what readers alone read."""


def main() -> int:
    """Read many mutants; gives the number of promises that were broken."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("--mutants", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help=f"one format, or all of the {RUNS!r}")
    parser.add_argument("--folder", type=Path, default=Path("fuzz-findings"))
    given_ = parser.parse_args()
    given_.folder.mkdir(parents=True, exist_ok=True)
    names = [given_.only] if given_.only else [*SEEDS, *whole_runs.KINDS]
    if given_.only == RUNS:
        names = [*whole_runs.KINDS]
    broken = 0
    print(f"{'format':20s}{'mutants':>9s}{'read':>7s}{'refused':>9s}{'broken':>8s}")
    for name in names:
        made_of(name)
        came, said = rounds(name, share(name, given_.mutants, names), given_.seed, given_.folder)
        bad = came["broken"] + came["crashed"]
        broken += bad
        row = f"{came.total():9d}{came['sound']:7d}{came['refused']:9d}{bad:8d}"
        print(f"{name:20s}{row}", *said, sep="\n  ", flush=True)
    return broken


if __name__ == "__main__":
    sys.exit(bool(main()))
