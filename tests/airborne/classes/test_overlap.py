"""Squares that two flightlines cover, against loops."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.classes.overlap import lines_by_square, overlapping


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(0, 60))
def test_each_square_is_looked_at_by_itself(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    first, line = rng.integers(-20_000, 20_000, (n, 2)), rng.integers(0, 3, n)
    x, y = rng.integers(-20_000, 20_000, (2, 30))
    seen: dict[tuple[int, int], set[int]] = {}
    for (east, north), one in zip(first.tolist(), line.tolist(), strict=True):
        seen.setdefault((east // 5000, north // 5000), set()).add(one)
    places = zip((x // 5000).tolist(), (y // 5000).tolist(), strict=True)
    wanted = [len(seen.get(place, ())) > 1 for place in places]
    assert overlapping(lines_by_square(first, line), x, y).tolist() == wanted
