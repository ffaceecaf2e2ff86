"""Columns of one byte that share columns of a file."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.io.short_columns import holders, joined, shared, taken
from spl_batch.io.tables import read_columns, writing


@given(st.lists(st.booleans(), max_size=11), st.integers(0, 50), st.integers(0, 9))
def test_every_byte_comes_back(short: list[bool], n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = {
        f"c{k}": rng.integers(0, 256, n).astype(np.uint8 if one else np.float64)
        for k, one in enumerate(short)
    }
    stored = shared({name: values.dtype for name, values in columns.items()})
    assert len(stored) == short.count(False) + -(-short.count(True) // 4)
    places = holders(list(stored))
    assert set(places) == set(columns)
    for name, values in columns.items():
        whole, at = places[name]
        found = taken(joined(columns, whole), at)
        assert found.dtype == values.dtype
        np.testing.assert_array_equal(found, values)


@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 3000))
def test_a_file_gives_each_by_its_own_name(tmp_path: Path, n: int) -> None:
    rng = np.random.default_rng(n)
    columns: dict[str, NDArray[Any]] = {
        name: rng.integers(0, 256, n).astype(np.uint8) for name in "abcdef"
    }
    columns["far"] = rng.integers(0, 1 << 60, n)
    dtypes = {name: values.dtype for name, values in columns.items()}
    with writing(tmp_path / "t.parquet", dtypes, sharing=True) as writer:
        writer.write(columns)
    names = ["e", "far", "b"]
    found = read_columns(tmp_path / "t.parquet", names)
    assert list(found) == names
    for name in names:
        np.testing.assert_array_equal(found[name], columns[name])
    assert len(pq.read_schema(tmp_path / "t.parquet")) == 3
    with writing(tmp_path / "own.parquet", dtypes) as writer:
        writer.write(columns)
    # What a user is given has a column for each.
    plain = pq.read_table(tmp_path / "own.parquet")
    assert plain.column_names == list(columns)
