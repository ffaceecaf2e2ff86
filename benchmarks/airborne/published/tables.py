"""The sources' tables on simulated twins of their set-ups, published figures beside ours.

``python -m benchmarks.airborne.published.tables [setups] [wires] [dcc] [surfaces] [order] [roofs]
[dtm]
[--folder FOLDER] [--seeds 1 2 3]`` prints how the twins are flown, [W18] Tables 1-3 (``easton`` and
``lufkin`` print one twin's), what decides DCC's share there, [W17] Tables 5-1 and 5-2, what makes
AES and voxels change places there, [W17] Table 7-1, and the terrain of [W17] 7.4.
Surveys are simulated into FOLDER (a temporary one by default); what is there is used again.
"""

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from benchmarks.airborne.afterpulse import afterpulse_dtm
from benchmarks.airborne.published import (
    table_dcc,
    table_order,
    table_setups,
    table_surfaces,
    table_wires,
)

Printer = Callable[[Path, Sequence[int]], object]

TABLES: Mapping[str, Printer] = {
    "setups": table_setups.setup_table,
    "wires": table_wires.wire_tables,
    "dcc": table_dcc.dcc_table,
    "surfaces": table_surfaces.surface_tables,
    "order": table_order.order_table,
    "roofs": table_surfaces.roof_table,
    "dtm": afterpulse_dtm.terrain_table,
}
"""What prints each table, given a folder and seeds."""

PARTS: Mapping[str, Printer] = {
    twin: partial(table_wires.wire_tables, twins=(twin,)) for twin in table_wires.BRIGHTER
}
"""The same of a part of a table."""


def main() -> None:
    """Print the tables that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("tables", nargs="*", default=list(TABLES), metavar="TABLE",
                        help=", ".join((*TABLES, *PARTS)))  # fmt: skip
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    given = parser.parse_args()
    known = {**TABLES, **PARTS}
    unknown = sorted(set(given.tables) - set(known))
    if unknown:
        parser.error(f"no table {', '.join(unknown)}; write some of {', '.join(known)}")
    with tempfile.TemporaryDirectory() as temporary:
        for name in given.tables:
            known[name](given.folder or Path(temporary), given.seeds)


if __name__ == "__main__":
    main()
