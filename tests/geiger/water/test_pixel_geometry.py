"""Lines of sight, points and refraction, against the source's equations and Snell's law."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from spl_batch.geiger.water.pixel_geometry import floor_points, refracted, rotation, view_of
from spl_batch.geiger.water.settings import CameraSettings, MountSettings

vectors = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.3, 1))


def test_the_source_s_arrangement() -> None:
    view = view_of(CameraSettings(), MountSettings(position_m=(-4.0, -0.3, -2.3)))
    assert view.x[0, 0] == pytest.approx(0.1 * 15.5 / 50)
    assert view.y[0, 0] == pytest.approx(-0.1 * 15.5 / 50)
    middle = view.look[15:17, 15:17].mean(axis=(0, 1))
    assert np.degrees(np.arctan2(middle[0], middle[2])) == pytest.approx(19.5, abs=1e-3)
    points = view.points(np.full((32, 32), 3.3))
    assert points[15, 15, 2] == pytest.approx(-2.3 + 3.3 * np.cos(np.radians(19.5)), abs=2e-3)
    assert points[0, 15, 0] > points[31, 15, 0], "the first row looks farthest forward"
    assert points[15, 31, 1] > points[15, 0, 1]


def test_a_body_rolls_then_pitches_then_turns() -> None:
    forward, starboard = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(rotation(0, 0, 90) @ forward, starboard, atol=1e-12)
    np.testing.assert_allclose(rotation(0, 90, 0) @ forward, [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(rotation(90, 0, 0) @ starboard, [0, 0, 1], atol=1e-12)
    apart = rotation(0, 0, 50) @ rotation(0, 20, 0) @ rotation(-30, 0, 0)
    np.testing.assert_allclose(rotation(-30, 20, 50), apart, atol=1e-12)


def test_lever_arm_boresight_and_heading_turn_with_the_body() -> None:
    camera, turned = CameraSettings(), {"attitude_deg": (0, 0, 90), "position_m": (5, 6, 7)}
    view = view_of(camera, MountSettings(off_nadir_deg=0.0, lever_arm_m=(1.0, 0.0, 0.2), **turned))
    np.testing.assert_allclose(view.origin_m, (5.0, 7.0, 7.2), atol=1e-12)
    assert view.look[0, 15, 1] > 0, "heading east, forward is east"
    tilted = view_of(camera, MountSettings(off_nadir_deg=0.0, boresight_deg=(0.0, 1.0, 0.0)))
    steered = view_of(camera, MountSettings(off_nadir_deg=1.0))
    np.testing.assert_allclose(tilted.rotation, steered.rotation, atol=1e-12)


@settings(deadline=None)
@given(vectors, st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)), st.floats(1.0, 1.6))
def test_refraction_obeys_snell(
    beam: tuple[float, ...], slope: tuple[float, float], index: float
) -> None:
    i, n = np.array(beam) / np.linalg.norm(beam), np.array([*slope, -1.0])
    n /= np.linalg.norm(n)
    assume(i @ n < -0.01)
    r = refracted(i, n, index)
    assert np.linalg.norm(r) == pytest.approx(1.0)
    np.testing.assert_allclose(np.cross(i, n), index * np.cross(r, n), atol=1e-9)
    assert r @ n < 1e-9, "it goes on into the water"
    np.testing.assert_allclose(floor_points(i, r, 5.0), i + 5.0 * r)
