"""Rows that are put in order on disk, a stretch at a time."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.formats.files.external_sort import Sorter, repeated

DTYPES = {"frame": np.int64, "detector": np.int32, "x": np.float64}


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.integers(0, 70), max_size=8),
    st.integers(1, 60),
    st.sampled_from([1, 16, 40, 1000]),
    st.integers(0, 10_000),
)
def test_against_one_sort_of_all(sizes: list[int], most: int, held: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [
        {
            "frame": rng.integers(0, most, n) * 2**55,
            "detector": rng.integers(0, 5, n).astype(np.int32),
            "x": rng.random(n),
        }
        for n in sizes
    ]
    with Sorter(DTYPES, 2, None, held) as sorter:
        for part in parts:
            order = sorter.add(part)
            assert np.array_equal(order, np.lexsort((part["detector"], part["frame"])))
        assert len(sorter) == sum(sizes)
        found = list(sorter.in_order())
    ends = [(int(p["frame"][0]), int(p["frame"][-1])) for p in found]
    assert all(a[1] < b[0] for a, b in pairwise(ends)), "a frame in one part"
    whole = {k: np.concatenate([np.empty(0, DTYPES[k]), *(p[k] for p in parts)]) for k in DTYPES}
    order = np.lexsort((whole["detector"], whole["frame"]))  # stable: rows as they came
    for name, values in whole.items():
        got = np.concatenate([np.empty(0, DTYPES[name]), *(p[name] for p in found)])
        assert got.dtype == DTYPES[name]
        assert np.array_equal(got, values[order])


@pytest.mark.parametrize("shuffled", [False, True])
def test_parts_are_small_whatever_the_order(shuffled: bool, tmp_path: Path) -> None:  # noqa: FBT001
    n, held = 40_000, 2_000
    frame = np.arange(n) // 5
    if shuffled:
        frame = np.random.default_rng(1).permutation(frame)
    with Sorter({"frame": np.int64}, 1, tmp_path / "new", held) as sorter:
        for start in range(0, n, held):
            sorter.add({"frame": frame[start : start + held]})
        sizes = [len(part["frame"]) for part in sorter.in_order()]
    assert sum(sizes) == n
    # What is held, and a sixteenth of it, the step of the sample, from each stretch.
    assert max(sizes) <= held + (held // 16) * (n // held + 1)
    assert list((tmp_path / "new").iterdir()) == []


def test_repeated_rows() -> None:
    columns = {"a": np.array([1, 1, 1, 2, 2]), "b": np.array([0, 3, 3, 3, 3])}
    assert repeated(columns, ("a", "b")).tolist() == [2, 4]
    assert repeated(columns, ("a",)).tolist() == [1, 2, 4]
    assert repeated({"a": np.empty(0, int)}, ("a",)).tolist() == []
