"""Where the report's profile is cut: over what stands, never through an empty place."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.report.profile_strips import tallest_strip
from spl_batch.constants import NODATA
from spl_batch.formats.rasters.parts import RasterPart
from spl_batch.lattice.tiles import Bounds


def strip(values: NDArray[np.float64]) -> Bounds:
    """Strip of a CHM of 1 m cells with its lower left corner at (0, 0) [m]."""
    found = tallest_strip(RasterPart(values.astype(np.float32), 0.0, float(len(values)), 1.0))
    return Bounds(*(edge // 500 for edge in found))


def test_runs_through_the_trees() -> None:
    height = np.zeros((60, 300))
    height[20, 120:200] = 12.0
    # Row 20 of 60: its middle is 39.5 m north, the strip half of 3 m on each side.
    found = strip(height)
    assert (found.ymin, found.ymax) == (2 * 38, 2 * 41)
    assert found.xmin <= 2 * 120
    assert found.xmax >= 2 * 200


def test_leaves_without_ground_are_passed_over() -> None:
    height = np.zeros((60, 300))
    height[20] = 25.0  # a closed canopy
    height[40, 30:200:2] = 18.0
    assert strip(height).ymin == 2 * 18


def test_a_mast_at_the_empty_edge_does_not_decide() -> None:
    height = np.full((60, 300), NODATA)
    height[10:] = 1.0
    height[2, 5] = 140.0
    found = strip(height)
    assert found.ymax <= 2 * 51
