"""Point tables on disk: what comes back is what was written, group by group."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spl_batch.formats.verified.parquet_npz import (
    group_ranges,
    groups_between,
    read_arrays,
    read_columns,
    read_rows,
    read_table,
    write_arrays,
    write_table,
    writing,
)
from spl_batch.lattice.tables import COLUMNS, PointTable, canonical_order

NAMES = ("x", "y", "z", "gps_time", "channel", "return_number", "source", "index", "p_value")


def random_table(n: int, seed: int = 0) -> PointTable:
    """Table whose every bit is random, NaN among the floats."""
    rng = np.random.default_rng(seed)
    columns = {}
    for name in NAMES:
        dtype = np.dtype(COLUMNS[name].dtype)
        columns[name] = np.frombuffer(rng.bytes(n * dtype.itemsize), dtype)
    return PointTable(columns)


def assert_same(a: PointTable, b: PointTable) -> None:
    assert list(a.columns) == list(b.columns)
    for name in a.columns:
        assert a[name].dtype == b[name].dtype
        assert a[name].tobytes() == b[name].tobytes(), name


@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    n=st.integers(0, 400),
    cuts=st.sets(st.integers(0, 400), max_size=4),
    rows=st.tuples(st.integers(0, 400), st.integers(0, 400)),
    seed=st.integers(0, 9),
)
def test_round_trip(
    tmp_path: Path, n: int, cuts: set[int], rows: tuple[int, int], seed: int
) -> None:
    path = tmp_path / "t.parquet"
    table = random_table(n, seed)
    starts = sorted({0, *(c for c in cuts if c < n)})
    write_table(path, table, group_starts=starts)
    assert_same(read_table(path, NAMES), table)
    first, end = (min(row, n) for row in sorted(rows))
    for a, b in (*pairwise([*starts, n]), (first, end)):
        assert_same(read_rows(path, NAMES, a, b - a), table.take(slice(a, b)))
    assert_same(read_table(path, ("z", "x")), table.select(("z", "x")))


def test_footers_have_the_range_of_each_group(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    with writing(path, {"row": np.uint32, "gps_time": np.float64}) as writer:
        for a, b in ((5, 9), (-3, -3)):
            rows = np.arange(2, dtype=np.uint32)
            writer.write({"row": rows, "gps_time": np.array([a, b], np.float64)})
        nothing = np.empty(0)
        writer.write({"row": nothing.astype(np.uint32), "gps_time": nothing})
    assert group_ranges(path, "gps_time") == [(5, 9), (-3, -3), (0, -1)]
    assert len(read_columns(path, ["row"])["row"]) == 4
    assert len(read_columns(path, ["row"], [])["row"]) == 0


def test_only_groups_that_meet_every_span_are_read(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    with writing(path, {"x": np.int64, "row": np.uint32}) as writer:
        for low in (0, 10, 20, 30):
            rows = np.arange(low, low + 10)
            writer.write({"x": 2 * rows, "row": rows.astype(np.uint32)})
    columns, row = groups_between(path, {"x": (25, 41), "row": (0, 25)}).read(["x"])
    assert row.tolist() == list(range(10, 30))
    assert (columns["x"] == 2 * row).all()
    columns, row = groups_between(path, {"x": (79, 90)}).read(["row"])
    assert len(row) == 0
    assert len(columns["row"]) == 0


def test_arrays_round_trip_with_reproducible_bytes(tmp_path: Path) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array([], np.int8), "c": np.array(1)}
    for name in ("one.npz", "two.npz"):
        write_arrays(tmp_path / name, arrays)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    back = read_arrays(tmp_path / "one.npz")
    assert back.keys() == arrays.keys()
    for name, values in arrays.items():
        assert back[name].dtype == values.dtype
        assert np.array_equal(back[name], values)


@given(st.integers(0, 5), st.randoms(use_true_random=False))
def test_canonical_order_does_not_depend_on_row_order(seed: int, random: object) -> None:
    rng = np.random.default_rng(seed)
    few = {k: rng.integers(0, 3, 60).astype(COLUMNS[k].dtype) for k in NAMES if k != "index"}
    table = PointTable({**few, "index": np.arange(60, dtype=np.uint32)})
    shuffled = list(range(60))
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    other = table.take(np.array(shuffled))
    first, second = (t.take(canonical_order(t)) for t in (table, other))
    assert_same(first, second)
    assert np.all(np.diff(first["x"]) >= 0)
