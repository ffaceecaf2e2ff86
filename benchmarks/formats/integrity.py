"""What it costs to verify point tables: processor time with and without checksums.

    python -m benchmarks.formats.integrity [--points 1000000]

Prints Markdown. The table without checksums is written and read by pyarrow alone, with the
same encoding.
"""

import argparse
import hashlib
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from spl_batch.formats.verified.parquet_npz import read_columns, write_table
from spl_batch.lattice.tables import COLUMNS, TILE_COLUMNS, PointTable

REPEATS = 7


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=1_000_000, help="points [count]")
    table = points(parser.parse_args().points)
    pa.set_cpu_count(1)
    with tempfile.TemporaryDirectory() as folder:
        plain, sealed = Path(folder, "plain.parquet"), Path(folder, "sealed.parquet")
        costs = {
            "write": (lambda: write_plain(plain, table), lambda: write_table(sealed, table)),
            "read": (lambda: read_plain(plain), lambda: read_columns(sealed, TILE_COLUMNS)),
        }
        print("| point tiles | plain [s per million points] | verified [s per million points] |")
        print("|---|---|---|")
        for name, ways in costs.items():
            seconds = [1e6 * least_s(way) / len(table) for way in ways]
            print(f"| {name} | {seconds[0]:.3f} | {seconds[1]:.3f} |")
        content = sealed.read_bytes()
    print("\n| checksum of a file | MB/s |\n|---|---|")
    hashes = {
        "BLAKE2b": lambda: hashlib.blake2b(content).digest(),
        "CRC-32": lambda: zlib.crc32(content),
    }
    for name, way in hashes.items():
        print(f"| {name} | {len(content) / least_s(way) / 1e6:.0f} |")


def points(n: int) -> PointTable:
    """Random points that compress about as well as measured ones."""
    rng = np.random.default_rng(0)
    columns: dict[str, NDArray[Any]] = {}
    for name in TILE_COLUMNS:
        dtype = np.dtype(COLUMNS[name].dtype)
        values = rng.integers(0, 100 if dtype.itemsize == 1 else 100_000, n)
        columns[name] = (np.sort(values) if name == "x" else values).astype(dtype)
    return PointTable(columns)


def write_plain(path: Path, table: PointTable) -> None:
    """Write without checksums."""
    arrow = pa.table({k: pa.array(v) for k, v in table.columns.items()})
    split = [f.name for f in arrow.schema if f.type.bit_width in {16, 32, 64}]
    pq.write_table(
        arrow, path, compression="zstd", compression_level=1, use_dictionary=False,
        use_byte_stream_split=split, row_group_size=len(table),
    )  # fmt: skip


def read_plain(path: Path) -> dict[str, NDArray[Any]]:
    """Read without a look at checksums."""
    with pq.ParquetFile(path) as file:
        arrow = file.read_row_groups([0])
    return {name: arrow.column(name).to_numpy() for name in TILE_COLUMNS}


def least_s(call: Callable[[], object]) -> float:
    """Least processor time of several calls [s]."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


if __name__ == "__main__":
    main()
