"""The sources' tables on simulated twins of their set-ups, published figures beside ours.

``python -m benchmarks.airborne.published.tables [wires] [surfaces] [roofs] [dtm] [--folder FOLDER]
[--seeds 1 2 3]`` prints [W18] Tables 1-3, [W17] Tables 5-1 and 5-2, Table 7-1, and the terrain of
[W17] 7.4. Surveys are simulated into FOLDER (a temporary one by default); what is there is used
again.
"""

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.airborne.published import table_surfaces, table_terrain, table_wires

Printer = Callable[[Path, Sequence[int]], object]

TABLES: Mapping[str, Printer] = {
    "wires": table_wires.wire_tables,
    "surfaces": table_surfaces.surface_tables,
    "roofs": table_surfaces.roof_table,
    "dtm": table_terrain.terrain_table,
}
"""What prints each table, given a folder and seeds."""


def main() -> None:
    """Print the tables that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("tables", nargs="*", help=", ".join(TABLES), metavar="TABLE")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    given = parser.parse_args()
    unknown = sorted(set(given.tables) - set(TABLES))
    if unknown:
        parser.error(f"no table {', '.join(unknown)}; write some of {', '.join(TABLES)}")
    with tempfile.TemporaryDirectory() as temporary:
        for name in given.tables or TABLES:
            TABLES[name](given.folder or Path(temporary), given.seeds)


if __name__ == "__main__":
    main()
