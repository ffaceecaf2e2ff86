"""The true density of simulated noise that tables along edges are compared with."""

import numpy as np
import pytest

from benchmarks.airborne.noise.true_density import LEAST, density_at, true_density
from spl_batch.airborne.simulate.scene.scene_file import parse_scene

SCENE = {
    "name": "even",
    "extent_m": [24, 24],
    "terrain": {"relief_m": 0.5, "wavelength_m": 100},
    "flights": [{"heading_deg": 0, "offset_m": 300}],
    "sky": {"background_per_m3": 0.2},
    "acquisition": {"prf_hz": 60_000, "gate_m": 40},
}


def test_it_is_what_the_scene_asks_for_between_the_ends_of_the_gate() -> None:
    scene = parse_scene(SCENE, "even")
    place = np.random.default_rng(3).uniform((0, 0, -10), (24, 24, 10), (4000, 3))
    place += np.array(scene.origin_m)
    found = true_density(scene, place)
    np.testing.assert_allclose(found.mean(), 0.2, rtol=0.05)
    beyond = true_density(scene, place + np.array([0.0, 0.0, 45.0]))
    np.testing.assert_allclose(beyond, LEAST, rtol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_it_is_moved_neither_up_nor_down(axis: int) -> None:
    """On either side of what beamlets cross it ends as far from the middle."""
    cells = np.zeros((24, 24, 24), dtype=np.float32)
    cells[6:18, 6:18, 6:18] = 1.0
    place = np.full((400, 3), 12.0)
    place[:, axis] = np.linspace(0.01, 23.99, 400)
    found = density_at(cells, place)
    assert found.max() > 100 * found.min()
    np.testing.assert_allclose(found, found[::-1])
