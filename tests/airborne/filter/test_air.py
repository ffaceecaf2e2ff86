"""What a cell shows of the air that it holds."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.diagnostics.noise_layers import layer_facts
from spl_batch.airborne.filter import expected_noise as looking
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, inside

CORNER = np.array([272_000_000, 3_290_000_000, 40_000])
CORE = Bounds(272_030_000, 3_290_030_000, 272_130_000, 3_290_110_000)


def block(*, tapers: bool) -> PointTable:
    """Noise, ground, and haze in the middle of it, or one that tapers upwards and downwards."""
    rng = np.random.default_rng(3)

    def box(per_m3: float, low: float, high: float) -> np.ndarray:
        size = np.array([160.0, 140.0, high - low])
        return rng.random((rng.poisson(per_m3 * size.prod()), 3)) * size + [0, 0, low]

    haze = box(0.9, 50, 75)
    haze = haze[np.hypot(haze[:, 0] - 80, haze[:, 1] - 70) < 45]
    if tapers:
        haze = haze[rng.random(len(haze)) < np.sin(np.pi * (haze[:, 2] - 50) / 25) ** 2]
    xyz = np.concatenate([box(0.04, -40, 100), box(30.0, 0, 0.1), haze])
    xyz = np.floor(xyz * 1000).astype(np.int64) + CORNER
    columns = dict(zip("xyz", xyz.T, strict=True))
    columns |= {"flags": np.zeros(len(xyz), np.uint8), "afterpulse": np.zeros(len(xyz), np.float32)}
    return PointTable(columns)


@pytest.mark.parametrize("tapers", [False, True])
def test_air_and_layers_of_a_cell(*, tapers: bool) -> None:
    table = block(tapers=tapers)
    # Rising from west to east, so that a sum of floats would depend on its order.
    model: Any = SimpleNamespace(local=lambda at: 0.04 + (at[0] - CORNER[0]) * 1e-8 / 3, heard=())
    settings = Workflow.model_validate({"survey": {"flightlines": "x"}, "output": "o"})
    whole = looking.look_at_air(table, model, settings, CORE)
    assert whole.air is not None
    assert whole.air.held.sum() > 500
    assert len(layer_facts(whole, model)) == (27 if tapers else 20)


def test_air_is_listed_by_squares_and_heights() -> None:
    table = block(tapers=False)
    model: Any = SimpleNamespace(local=lambda at: np.full(len(at[0]), 0.04), heard=())
    settings = Workflow.model_validate({"survey": {"flightlines": "x"}, "output": "o"})
    (found,) = [looking.look_at_air(table, model, settings, CORE)]
    places = looking.air_facts(found)
    sides = np.array([place[:4] for place in places]) * 5000
    assert len({tuple(side // 25_000) for side in sides[:, :2]}) == len(sides) > 10
    assert np.all(sides[:, 2:] - sides[:, :2] <= 25_000)
    assert np.all(sides[:, 2:] > sides[:, :2])
    assert found.air is not None
    centre = found.air.cube * 5000 + 2500
    mine = found.air.held & inside(centre[:, 0], centre[:, 1], CORE)
    assert sum(place[7] for place in places) == np.count_nonzero(mine)
    assert sum(place[8] for place in places) == found.air.returns[mine].sum()
    expected = found.air.expected[mine].sum() * 125
    assert sum(place[9] for place in places) == pytest.approx(expected, rel=1e-3)
    ends = {(place[4] * 5000, (place[5] + 1) * 5000) for place in places}
    assert (90_000, 115_000) in ends


def test_air_of_two_heights_over_one_square_is_listed_apart() -> None:
    cube = np.array([[0, 0, 4], [0, 0, 5], [1, 0, 4], [0, 0, 9], [7, 0, 4]], np.int64)
    places = list(looking._places(cube, np.full(5, 10), np.full(5, 0.01)))
    assert places == [
        [0, 0, 2, 1, 4, 5, 2, 3, 30, 3.75],
        [0, 0, 1, 1, 9, 9, 1, 1, 10, 1.25],
        [7, 0, 8, 1, 4, 4, 1, 1, 10, 1.25],
    ]
