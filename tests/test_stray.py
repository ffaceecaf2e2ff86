"""Clusters of kept noise where nothing stands make no surface; thin surfaces do."""

import numpy as np

from spl_batch.model import PointTable
from spl_batch.stages.stray import stray


def cloud(kept: int, refused: int, seed: int = 1, shift: int = 0) -> PointTable:
    """A square of 15 m with kept and refused returns, and a far one with a dense surface."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform(5000, 10_000, kept), rng.uniform(0, 15_000, refused)])
    y = np.concatenate([rng.uniform(5000, 10_000, kept), rng.uniform(0, 15_000, refused)])
    noise_class = np.repeat([0, 1], [kept, refused])
    surface = rng.uniform(0, 15_000, (2000, 2)) + 100_000
    return PointTable(
        {
            "x": np.concatenate([x, surface[:, 0]]).astype(np.int64) + shift,
            "y": np.concatenate([y, surface[:, 1]]).astype(np.int64) - shift,
            "noise_class": np.concatenate([noise_class, np.zeros(2000)]).astype(np.uint8),
        }
    )


def test_a_few_kept_among_many_refused_are_stray() -> None:
    for shift in (0, -3_000_000):
        found = stray(cloud(7, 1000, shift=shift))
        assert found[:7].all()
        assert not found[7:].any()


def test_thin_surfaces_stay() -> None:
    # One return per ten square metres under noise of a long gate, and a clean cloud.
    assert not stray(cloud(23, 1000)).any()
    assert not stray(cloud(4, 10)).any()
    assert not stray(cloud(4, 0)).any()


def test_counts_are_those_of_the_slow_twin() -> None:
    table = cloud(40, 3000, seed=3)
    cells = np.stack([table[a] // 5000 for a in "xy"], axis=1)
    near = (np.abs(cells[:, None] - cells[None]) <= 1).all(axis=2)
    kept, gone = (
        near[:, table["noise_class"] == 0].sum(1),
        near[:, table["noise_class"] == 1].sum(1),
    )
    slow = (table["noise_class"] == 0) & (kept < np.minimum(12, 0.2 * gone) + 0.002 * gone)
    np.testing.assert_array_equal(stray(table), slow)
