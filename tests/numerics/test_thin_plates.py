"""Thin plates against scipy's."""

import tracemalloc

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator

from spl_batch.numerics.thin_plates import fit_plate, plate_heights


@pytest.mark.parametrize("stiffness", [0.0, 1.0, 20.0])
def test_plates_are_those_of_scipy(stiffness):
    rng = np.random.default_rng(1)
    points = rng.uniform(-7, 7, (60, 3)) * (1, 1, 3)
    plate = fit_plate(points, stiffness)
    asked = rng.uniform(-9, 9, (50, 2))
    expected = RBFInterpolator(
        points[:, :2], points[:, 2], kernel="thin_plate_spline", smoothing=stiffness
    )(asked)
    found = plate_heights(points, plate, *asked.T)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    alone = [plate_heights(points, plate, *one[:, np.newaxis]).item() for one in asked]
    assert found.tolist() == alone


def test_points_on_one_line_have_no_plate():
    line = np.array([[k, 0.0, 1.0] for k in range(9)])
    assert fit_plate(line, 1.0) is None


def test_heights_at_many_places_take_the_memory_of_a_few_arrays():
    rng = np.random.default_rng(2)
    points = rng.uniform(-7, 7, (100, 3))
    plate = fit_plate(points, 1.0)
    x, y = rng.uniform(-9, 9, (2, 20_000))
    tracemalloc.start()
    plate_heights(points, plate, x, y)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 10 * x.nbytes
