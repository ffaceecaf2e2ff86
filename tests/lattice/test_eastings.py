"""Strips hold about as many points each, wherever these lie."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.lattice.eastings import SLAB_POINTS, Eastings, slabs_of
from spl_batch.lattice.tiles import Bounds

REGION = Bounds(-40_000, -40_000, 240_000, 240_000)


def test_even_points_make_strips_of_one_width() -> None:
    cut = Eastings.even(2_800_000, REGION).cut(10_000, 0, 700_000)
    assert cut.ends == (-40_000, 30_000, 100_000, 170_000, 240_000)
    assert cut.strips == 4
    assert cut.fullest == 700_000


def test_a_corridor_is_cut_where_it_lies() -> None:
    slab = (100_000, -40_000, 130_000, 240_000)
    cut = Eastings.of_slabs([(slab, 3_000_000)], REGION).cut(10_000, 0, 1_000_000)
    assert cut.strips == 3
    assert cut.fullest == 1_000_000, "strips of one width would hold all of it, or a third more"
    assert cut.ends[1:-1] == (110_000, 120_000)


def test_what_lies_north_and_south_of_the_region_does_not_count() -> None:
    slab = (0, -340_000, 100_000, 60_000)
    assert Eastings.of_slabs([(slab, 400)], REGION).total == pytest.approx(100)
    assert Eastings.of_slabs([((0, 300_000, 9, 400_000), 400)], REGION).total == 0
    assert Eastings.of_slabs([], REGION).cut(10_000, 500, 10).strips == 1


def test_what_is_read_around_a_strip_counts() -> None:
    even = Eastings.even(2_800_000, REGION)
    cut = even.cut(10_000, 15_000, 700_000)
    assert cut.strips == 7, "of 40 m and twice 15 m"
    assert cut.fullest == 700_000
    # nothing is narrower than a step, whatever it holds
    least = even.cut(10_000, 15_000, 1)
    assert least.strips == 28
    assert least.fullest == 400_000


@settings(max_examples=200, deadline=None)
@given(
    n=st.integers(1, 60), seed=st.integers(0, 99), step=st.sampled_from([1_000, 8_000, 20_000]),
    reach=st.sampled_from([0, 700, 16_000]), share=st.floats(0.01, 1.2),
)  # fmt: skip
def test_strips_are_whole_and_hold_what_is_said(
    n: int, seed: int, step: int, reach: int, share: float
) -> None:
    rng = np.random.default_rng(seed)
    low = rng.integers(-60_000, 240_000, (n, 2))
    box = np.hstack([low, low + rng.integers(1, 60_000, (n, 2))])
    points = rng.integers(1, 99_999, n)
    given_slabs = list(zip(box.tolist(), points.tolist(), strict=True))
    spread = Eastings.of_slabs(given_slabs, REGION)
    most = share * spread.total
    cut = spread.cut(step, reach, most)
    assert (cut.ends[0], cut.ends[-1]) == (REGION.xmin, REGION.xmax)
    assert all(end % step == 0 for end in cut.ends[1:-1])
    assert list(cut.ends) == sorted(set(cut.ends))
    held = []
    for west, east in zip(cut.ends, cut.ends[1:], strict=False):
        near = max(west - reach, REGION.xmin), min(east + reach, REGION.xmax)
        across = np.minimum(box[:, 2], near[1]) - np.maximum(box[:, 0], near[0])
        along = np.minimum(box[:, 3], REGION.ymax) - np.maximum(box[:, 1], REGION.ymin)
        sides = box[:, 2:] - box[:, :2]
        share_of = np.clip(across / sides[:, 0], 0, 1) * np.clip(along / sides[:, 1], 0, 1)
        held.append(float(share_of @ points))
        assert held[-1] <= most * (1 + 1e-9) + 1e-6 or east - west <= step
    assert cut.fullest == pytest.approx(max(held), abs=1 + 1e-6 * max(held))


def test_slabs_of_a_tile() -> None:
    rng = np.random.default_rng(3)
    count = 2 * SLAB_POINTS + 5
    x, y = np.sort(rng.integers(0, 100_000, count)), rng.integers(0, 100_000, count)
    slabs = slabs_of(x, y)
    assert [slab[4] for slab in slabs] == [SLAB_POINTS, SLAB_POINTS, 5]
    assert (slabs[0][0], slabs[-1][2]) == (int(x[0]), int(x[-1]) + 1)
    assert min(slab[1] for slab in slabs) == int(y.min())
    assert slabs_of(x[:0], y[:0]) == []
