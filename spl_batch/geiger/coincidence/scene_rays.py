"""Lines of sight against the artificial scene of [M20 3.1], and what a detector makes of them.

Points are relative to the scene's centre, heights above its flat ground [m]. A look meets leaves,
which pass a part of the light, and then one opaque surface. At each the number of photo-electrons
is Poisson of mean "detection probability x reflectivity x transmission so far" [M20 3.3]; dark
counts come exponentially from the opening of the gate. The nearest event ends the look (blocking
loss).

Deviation: the source paints points into voxels of each frame. Here each look is one ray through a
random point of its detector's field of view, which the source calls more faithful.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.geiger.coincidence.surface.voxel_raster import between, look_direction
from spl_batch.numerics.compiled import njit

_FAR: Final = 1e30
_COIL_STEPS: Final = 200
_CLOSE_M: Final = 1e-3


class Targets(NamedTuple):
    """The scene as bare arrays; lengths in metres from its centre and ground."""

    #: (p, 5): rectangles that lie flat: west, south, east, north, height.
    plates: NDArray[np.float64]
    spokes: NDArray[np.float64]  #: (s, 5): spoke targets: x, y, radius, height, number of spokes.
    cubes: NDArray[np.float64]  #: (c, 6): boxes: west, south, bottom, east, north, top.
    coil: NDArray[np.float64]  #: (k, 3): axis of a tube, point after point; none for no coil.
    coil_radius: float
    #: (4,): x and y of a painted disc, its radius, edge of its chequers; radius 0 for none.
    logo: NDArray[np.float64]
    #: (m, 5): level square leaves, highest first: x, y, height, reflectivity, transmissivity.
    leaves: NDArray[np.float64]
    leaf_m: float
    #: (5,): west, south, edge of the cells that leaves are listed by; lowest, highest leaf.
    leaf_grid: NDArray[np.float64]
    leaf_first: NDArray[np.int64]  #: (ny, nx + 1): first entry of each cell in ``leaf_item``.
    leaf_item: NDArray[np.int64]  #: (q,): leaves that rays through a cell's column may meet.
    #: Reflectivity of the ground, and of targets and paint.
    ground: float
    target: float


@njit()
def on_spoke(x: float, y: float, radius: float, spokes: float) -> bool:
    """Whether a point, from the target's centre, lies on one of its spokes."""
    if x * x + y * y > radius * radius:
        return False
    turns = math.atan2(y, x) / (2.0 * math.pi) * spokes
    return bool(turns - math.floor(turns) < 0.5)


@njit()
def painted(x: float, y: float, logo: NDArray[np.float64]) -> bool:
    """Whether a point of the ground is painted: a ring around a chequered disc."""
    x, y = x - logo[0], y - logo[1]
    share = math.sqrt(x * x + y * y) / max(logo[2], 1e-9)
    if share > 1.0:
        return False
    if share > 0.8:
        return True
    return bool(share < 0.7 and (math.floor(x / logo[3]) + math.floor(y / logo[3])) % 2 == 0)


@njit()
def tube_distance(x: float, y: float, z: float, axis: NDArray[np.float64], radius: float) -> float:
    """Distance of a point from the surface of a tube, negative inside [m]."""
    nearest = _FAR
    for k in range(len(axis) - 1):
        ax, ay, az = axis[k, 0], axis[k, 1], axis[k, 2]
        bx, by, bz = axis[k + 1, 0] - ax, axis[k + 1, 1] - ay, axis[k + 1, 2] - az
        px, py, pz = x - ax, y - ay, z - az
        t = (px * bx + py * by + pz * bz) / (bx * bx + by * by + bz * bz)
        t = min(max(t, 0.0), 1.0)
        px, py, pz = px - t * bx, py - t * by, pz - t * bz
        nearest = min(nearest, px * px + py * py + pz * pz)
    return math.sqrt(nearest) - radius


@njit()
def _into_tube(origin, way, near, far, axis, radius):  # type: ignore[no-untyped-def]
    """Range at which a ray enters a tube between two ranges; far away where it does not."""
    t = near
    for _ in range(_COIL_STEPS):
        d = tube_distance(
            origin[0] + t * way[0], origin[1] + t * way[1], origin[2] + t * way[2], axis, radius
        )
        if d < _CLOSE_M:
            return t
        t += d
        if t > far:
            break
    return _FAR


@njit()
def _into_box(origin, way, box):  # type: ignore[no-untyped-def]
    """Range at which a ray enters a box; far away where it does not."""
    near, far = between(origin, way, box[:3], box[3:])
    return near if 0.0 < near <= far else _FAR


@njit()
def opaque(
    origin: NDArray[np.float64], way: NDArray[np.float64], scene: Targets
) -> tuple[float, bool]:
    """Range at which a ray that points downwards ends [m], and whether on a target or paint.

    ``origin``, ``way``: (3,) float64, start [m] and unit vector.
    """
    ground = -origin[2] / way[2]
    best = _FAR
    for k in range(len(scene.plates)):
        plate = scene.plates[k]
        t = (plate[4] - origin[2]) / way[2]
        x, y = origin[0] + t * way[0], origin[1] + t * way[1]
        if t < best and plate[0] <= x < plate[2] and plate[1] <= y < plate[3]:
            best = t
    for k in range(len(scene.spokes)):
        wheel = scene.spokes[k]
        t = (wheel[3] - origin[2]) / way[2]
        x, y = origin[0] + t * way[0] - wheel[0], origin[1] + t * way[1] - wheel[1]
        if t < best and on_spoke(x, y, wheel[2], wheel[4]):
            best = t
    for k in range(len(scene.cubes)):
        best = min(best, _into_box(origin, way, scene.cubes[k]))
    if len(scene.coil) > 1:
        box = np.empty(6)
        for axis in range(3):
            box[axis] = scene.coil[:, axis].min() - scene.coil_radius
            box[axis + 3] = scene.coil[:, axis].max() + scene.coil_radius
        near = _into_box(origin, way, box)
        if near < ground:
            best = min(best, _into_tube(origin, way, near, ground, scene.coil, scene.coil_radius))
    if best < ground:
        return best, True
    x, y = origin[0] + ground * way[0], origin[1] + ground * way[1]
    return ground, painted(x, y, scene.logo)


@njit()
def _leaves(origin, way, scene, hit):  # type: ignore[no-untyped-def]
    """Leaves that a ray meets, nearest first, put into ``hit``; gives how many."""
    grid = scene.leaf_grid
    ny, nx = scene.leaf_first.shape[0], scene.leaf_first.shape[1] - 1
    t = (0.5 * (grid[3] + grid[4]) - origin[2]) / way[2]
    i = math.floor((origin[0] + t * way[0] - grid[0]) / grid[2])
    j = math.floor((origin[1] + t * way[1] - grid[1]) / grid[2])
    if i < 0 or j < 0 or i >= nx or j >= ny:
        return 0
    n, half = 0, 0.5 * scene.leaf_m
    for at in range(scene.leaf_first[j, i], scene.leaf_first[j, i + 1]):
        leaf = scene.leaf_item[at]
        t = (scene.leaves[leaf, 2] - origin[2]) / way[2]
        x = origin[0] + t * way[0] - scene.leaves[leaf, 0]
        y = origin[1] + t * way[1] - scene.leaves[leaf, 1]
        if abs(x) <= half and abs(y) <= half and n < len(hit):
            hit[n] = leaf
            n += 1
    return n


@njit()
def _event(rng, origin, way, scene, efficiency, hit):  # type: ignore[no-untyped-def]
    """Range of the first photo-electron from the scene; far away where there is none."""
    left = 1.0
    for at in range(_leaves(origin, way, scene, hit)):
        leaf = hit[at]
        mean = efficiency * scene.leaves[leaf, 3] * left
        if rng.random() < -math.expm1(-mean):
            return (scene.leaves[leaf, 2] - origin[2]) / way[2]
        left *= scene.leaves[leaf, 4]
    t, target = opaque(origin, way, scene)
    mean = efficiency * left * (scene.target if target else scene.ground)
    return t if rng.random() < -math.expm1(-mean) else _FAR


@njit()
def expose(
    rng: np.random.Generator, origin: NDArray[np.float64], turn: NDArray[np.float64],
    scene: Targets, tangent: float, gate: NDArray[np.float64], efficiency: float,
    dark_per_m: float, jitter: NDArray[np.float64], bin_m: float, range_m: NDArray[np.float64],
) -> None:  # fmt: skip
    """Ranges that the detectors of one frame record, into (rows, columns); infinite for none [m].

    ``origin``: from the scene's centre [m]. ``turn``: as :func:`look_direction` has it.
    ``tangent``: of a detector's field of view. ``gate``: slant ranges between which detectors are
    armed [m]. ``efficiency``: photo-electrons per look from reflectivity 1. ``dark_per_m``: dark
    counts per metre of armed detector. ``jitter``: standard deviations of range [m] and of each
    angle [rad]. ``bin_m``: range bin, whose middle is recorded [m].
    """
    rows, columns = range_m.shape
    way, hit = np.empty(3), np.empty(32, np.int64)
    for row in range(rows):
        for column in range(columns):
            # Uniform over the field of view, and the pointing error on top of it.
            across = row - 0.5 * rows + rng.random()
            along = column - 0.5 * columns + rng.random()
            across = across * tangent + jitter[1] * rng.standard_normal()
            along = along * tangent + jitter[1] * rng.standard_normal()
            look_direction(turn, across, along, way)
            signal = _event(rng, origin, way, scene, efficiency, hit)
            noise = gate[0] - math.log(1.0 - rng.random()) / dark_per_m
            first = min(noise, signal)
            if signal <= noise:
                first += jitter[0] * rng.standard_normal()
            range_m[row, column] = np.inf
            if gate[0] <= first < gate[1]:
                middle = math.floor((first - gate[0]) / bin_m) + 0.5
                range_m[row, column] = gate[0] + middle * bin_m
