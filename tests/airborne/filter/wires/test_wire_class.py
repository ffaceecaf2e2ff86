"""What is called a conductor: lines that hang free, and not the edges of things."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.filter.wires.wire_scan import scan
from spl_batch.airborne.settings import WireSettings
from tests.airborne.filter.wires.test_wire_scan import conductor, made_cloud, noise

Metres = NDArray[np.float64]
SETTINGS = WireSettings(classify=True)
DENSITY = 0.1


def roof(
    rng: np.random.Generator, size: tuple[float, float], pitch: float, per_m2: float
) -> Metres:
    """Gable roof, ridge along x at 8 m, over walls that few beams see."""
    long, wide = size
    x, y = rng.uniform(0, 1, (2, rng.poisson(per_m2 * long * wide))) * np.array([[long], [wide]])
    return np.column_stack([x, y, 8.0 - pitch * np.abs(y - wide / 2)])


def wall(rng: np.random.Generator, long: float, high: float, per_m2: float) -> Metres:
    x, z = rng.uniform(0, 1, (2, rng.poisson(per_m2 * long * high))) * np.array([[long], [high]])
    return np.column_stack([x, np.full(len(x), 10.0), z + 3.0])


def crowns(rng: np.random.Generator, long: float) -> Metres:
    """A row of trees, cut like a hedge 1 m wide and 1.5 m high."""
    return rng.uniform(0, 1, (int(6 * long), 3)) * np.array([long, 1.0, 1.5]) + np.array([0, 9, 5])


@pytest.mark.parametrize("of", ["dark roof", "steep roof", "wall", "fence", "hedge"])
def test_edges_ridges_walls_and_hedges_are_no_conductors(of: str) -> None:
    rng = np.random.default_rng(0)
    things = {
        "dark roof": lambda: roof(rng, (40, 12), 0.3, 0.8),
        "steep roof": lambda: roof(rng, (40, 8), 1.2, 3.0),
        "wall": lambda: wall(rng, 40, 4.0, 1.0),
        "fence": lambda: wall(rng, 40, 1.5, 2.0),
        "hedge": lambda: crowns(rng, 40),
    }
    thing = things[of]()
    thing = thing + rng.normal(0, 0.05, thing.shape) + np.array([10.0, 5.0, 8.0])
    xyz = np.concatenate([np.rint(thing * 1000).astype(np.int64), noise(rng, DENSITY, 60, 30, 40)])
    found = scan(made_cloud(xyz, DENSITY), SETTINGS)
    assert not found.wire.any()


@pytest.mark.parametrize(("per_m", "offsets", "found_share"), [
    (2.0, (0.0,), 0.95), (1.0, (0.0, 1.0, 2.0), 0.85), (0.6, (0.0, 4.0), 0.75),
])  # fmt: skip
def test_most_of_a_conductor_is_called_one(
    per_m: float, offsets: tuple[float, ...], found_share: float
) -> None:
    rng = np.random.default_rng(1)
    wires = [conductor(rng, per_m, 120.0, 14.0 + offset, 12.0) for offset in offsets]
    xyz = np.concatenate([*wires, noise(rng, DENSITY, 120, 30, 30)])
    true = np.arange(len(xyz)) < sum(map(len, wires))
    found = scan(made_cloud(xyz, DENSITY), SETTINGS)
    assert found.wire[true].mean() > found_share
    assert found.wire[true].sum() > 0.93 * found.wire.sum()
    assert found.signal[found.wire].all()
    unasked = scan(made_cloud(xyz, DENSITY), WireSettings())
    assert not unasked.wire.any()
    np.testing.assert_array_equal(unasked.signal, found.signal)
