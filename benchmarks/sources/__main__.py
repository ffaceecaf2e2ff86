"""Write ``docs/sources.md``: each headline of the sources beside the published rule and ours.

Run ``python -m benchmarks.sources [--only GROUP ...] [--folder FOLDER] [--quick] [--page]``.

Twins of the sources' set-ups are simulated into FOLDER (a temporary one by default; what is there
is used again), filters run on them, and ``benchmarks/sources.json`` and the page are written.
Groups that are not asked for keep their figures. ``--quick`` runs each group on a small twin and
writes neither; ``--page`` writes the page of the figures that there are. All groups take about 20
minutes on two cores.
"""

import argparse
import contextlib
import io
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from benchmarks.sources import coincidence, page, seconds, surfaces, tank, terrain, tracks, wires
from benchmarks.sources.given import Figures, Given

GROUPS: Final[Mapping[str, Callable[[Given], Figures]]] = {
    "wires": wires.measure,
    "surfaces": surfaces.measure,
    "afterpulses": surfaces.afterpulses,
    "terrain": terrain.measure,
    "seconds": seconds.measure,
    "tracks": tracks.measure,
    "coincidence": coincidence.measure,
    "tank": tank.measure,
}
"""What measures each group."""


def commit() -> str:
    """Commit that is checked out, with ``+`` where files differ; empty outside a repository."""
    shown = subprocess.run(
        ["git", "describe", "--always", "--abbrev=8", "--exclude=*", "--dirty=+"],  # noqa: S607
        cwd=Path(__file__).parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return shown.stdout.strip()


def measure(groups: Sequence[str], given: Given) -> dict[str, page.Group]:
    """Figures of some groups; what benchmarks print is dropped."""
    found = {}
    for name in groups:
        start = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()):
            figures = GROUPS[name](given)
        rounded = {key: float(f"{value:.5g}") for key, value in figures.items()}
        found[name] = page.Group(commit(), rounded)
        print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure and write what the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sources", description=(__doc__ or "").split("\n", maxsplit=1)[0]
    )
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), metavar="GROUP",
                        help=f"of {', '.join(GROUPS)}")  # fmt: skip
    parser.add_argument("--folder", type=Path, help="where surveys are simulated")
    parser.add_argument("--quick", action="store_true", help="small twins; nothing is written")
    parser.add_argument("--page", action="store_true", help="nothing is measured")
    given = parser.parse_args(arguments)
    known = page.load()
    with tempfile.TemporaryDirectory() as scratch:
        if not given.page:
            folder = Given(given.folder or Path(scratch), given.quick)
            known |= measure(given.only, folder)
    if given.quick:
        print(page.text(known))
        return
    page.save(known)


if __name__ == "__main__":
    main()
