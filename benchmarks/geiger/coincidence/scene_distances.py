"""Distances of points from the surfaces of the known scene, and heights seen from above."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.geiger.coincidence.scene_rays import (
    Targets,
    on_spoke,
    opaque,
    tube_distance,
)
from spl_batch.numerics.compiled import njit


@njit()
def _spoke_distance(x, y, z, wheel):  # type: ignore[no-untyped-def]
    """Distance from a spoke target; along the level of it, to the nearest edge of a spoke."""
    x, y, z = x - wheel[0], y - wheel[1], z - wheel[3]
    r = math_hypot(x, y)
    beyond = max(r - wheel[2], 0.0)
    if not on_spoke(x, y, 1e9, wheel[4]):
        turns = np.arctan2(y, x) / (2.0 * np.pi) * wheel[4]
        part = turns - np.floor(turns)
        angle = min(part - 0.5, 1.0 - part) * 2.0 * np.pi / wheel[4]
        side = min(r, wheel[2]) * np.sin(angle)
        beyond = math_hypot(beyond, side)
    return math_hypot(beyond, z)


@njit()
def math_hypot(a, b):  # type: ignore[no-untyped-def]
    """Length of two legs."""
    return np.sqrt(a * a + b * b)


@njit()
def surface_distance(xyz: NDArray[np.float64], scene: Targets, out: NDArray[np.float64]) -> None:
    """Distance of each point from the nearest surface of the scene, leaves apart.

    Parameters
    ----------
    xyz : (n, 3) float64
        Points [m].
    scene : Targets
        The scene; its ground is everywhere, also beneath targets.
    out : (n,) float64
        Receives distances, not negative [m].
    """
    for row in range(len(xyz)):
        x, y, z = xyz[row, 0], xyz[row, 1], xyz[row, 2]
        best = abs(z)
        for k in range(len(scene.plates)):
            p = scene.plates[k]
            dx = max(p[0] - x, x - p[2], 0.0)
            dy = max(p[1] - y, y - p[3], 0.0)
            best = min(best, np.sqrt(dx * dx + dy * dy + (z - p[4]) ** 2))
        for k in range(len(scene.spokes)):
            best = min(best, _spoke_distance(x, y, z, scene.spokes[k]))
        for k in range(len(scene.cubes)):
            best = min(best, _box_distance(x, y, z, scene.cubes[k]))
        if (
            len(scene.coil) > 1
            and abs(x - scene.coil[0, 0]) < 5.0
            and abs(y - scene.coil[0, 1]) < 5.0
        ):
            best = min(best, abs(tube_distance(x, y, z, scene.coil, scene.coil_radius)))
        out[row] = best


@njit()
def _box_distance(x, y, z, box):  # type: ignore[no-untyped-def]
    """Distance from the surface of a box, from inside or outside."""
    point = (x, y, z)
    outside, inside = 0.0, 1e30
    for axis in range(3):
        away = max(box[axis] - point[axis], point[axis] - box[axis + 3])
        outside += max(away, 0.0) ** 2
        inside = min(inside, -away)
    return inside if outside == 0.0 else np.sqrt(outside)


@njit()
def heights_below(x, y, scene, z):  # type: ignore[no-untyped-def]
    """Heights of opaque surfaces straight below 100 m."""
    origin, way = np.empty(3), np.array([0.0, 0.0, -1.0])
    for row in range(len(x)):
        origin[0], origin[1], origin[2] = x[row], y[row], 100.0
        z[row] = 100.0 - opaque(origin, way, scene)[0]
