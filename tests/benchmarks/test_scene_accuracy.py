"""What points on the known scene are judged by."""

import numpy as np
import pytest

from benchmarks.geiger.coincidence import accuracy
from spl_batch.geiger.coincidence.simulate import (
    BAR_WIDTHS_M,
    POSITIONS_M,
    SceneSettings,
    bars,
    build,
)


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((4.0, 0.1, 2.3), 0.3),
        ((4.0, -0.1, 2.0), 0.1),
        ((-5.4, 0.0, 2.0), 0.4),
        ((25.3, 0.1, 1.5), 0.5),
        ((26.3, 1.4, 0.9), 0.5),
        ((25.0, 0.0, 2.4), 0.4),
        ((10.0, 10.0, -0.2), 0.2),
    ],
)
def test_distances_from_surfaces(point: tuple[float, ...], distance: float) -> None:
    scene = build(SceneSettings(targets=("spokes", "cube", "foliage")))
    assert accuracy.distance_m(np.array([point]), scene) == pytest.approx(distance, abs=0.06)
    assert accuracy.distance_m(scene.leaves[:50, :3], scene).max() == 0


def test_tri_bars_by_known_points() -> None:
    rng, xyz = np.random.default_rng(2), []
    for k, (width, north, plates) in enumerate(bars(POSITIONS_M["bars"])):
        filled = list(plates)
        if k % 2:
            # One gap as full as the bars.
            filled.append(plates[0] + width * np.array([north, not north, north, not north, 0]))
        for west, south, east, top, _ in filled:
            x, y = rng.uniform(west, east, 300), rng.uniform(south, top, 300)
            xyz.append(np.stack([x, y, np.full(300, 2.0)], axis=-1))
    found = accuracy.tri_bars(np.concatenate(xyz))
    assert [f.width_m for f in found] == [*BAR_WIDTHS_M, *BAR_WIDTHS_M]
    for k, one in enumerate(found):
        assert one.contrast == pytest.approx(0.0 if k % 2 else 1.0, abs=0.05)
        assert one.bars == pytest.approx(300 / (5 * one.width_m**2), rel=0.01)


def test_what_is_seen_from_above_and_how_much_of_it_is_found() -> None:
    scene = build(SceneSettings(targets=("cube", "covered_spokes")))
    seen = accuracy.seen_from_above(scene, np.array([23.5, -1.5]), np.array([26.5, 1.5]), 0.1)
    assert len(seen) == 900
    on_top = (np.abs(seen[:, 0] - 25) < 1) & (np.abs(seen[:, 1]) < 1)
    assert seen[:, 2] == pytest.approx(2.0 * on_top)
    centre = np.array(POSITIONS_M["covered_spokes"])
    assert len(accuracy.seen_from_above(scene, centre - 3, centre + 3, 0.1)) < 0.05 * 3600
    assert accuracy.completeness(seen, seen[:450] + 0.01, 0.02) == 0.5
