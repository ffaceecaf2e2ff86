"""Rays against a scene: ground, convex solids, crowns and wires.

A scene is a tuple of arrays (:class:`SceneArrays`) in metres relative to its origin; heights are
absolute. A ray is ``origin + t * direction``, a unit vector that points downwards: ``t`` is the
slant range [m].

Ground is a grid of heights, bilinear between its nodes; clear water stands over parts of it. A
solid is the intersection of half-spaces ``a x + b y + c z <= d``, without end downwards: opaque (a
building; these come first) or turbid (a lattice tower). A crown is a turbid ellipsoid. A wire is a
catenary; a beam of Gaussian profile lights a part of it. Only objects listed for the cell of a
ray's ground hit are tried.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

KIND_BACKGROUND: Final = 0
KIND_GROUND: Final = 1
KIND_ROOF: Final = 2
KIND_VEGETATION: Final = 3
KIND_WIRE: Final = 4
KIND_WATER: Final = 5
KIND_AFTERPULSE: Final = 6
KIND_OTHER: Final = 7
KIND_BOTTOM: Final = 8
"""What gave a simulated return."""

GAP_CELL_M: Final = 0.5
"""Edge of the columns of a crown that are gaps or not [m]."""


class SceneArrays(NamedTuple):
    """A scene as bare arrays; lengths in metres relative to the scene's origin."""

    ground_z: NDArray[np.float64]  #: (ny, nx): heights at the nodes of the ground grid [m].
    ground_rho: NDArray[np.float64]  #: (ny, nx): reflectance at the nodes.
    #: (ny, nx): ``KIND_GROUND``, ``KIND_WATER`` or, under clear water, ``KIND_BOTTOM`` at the
    #: nodes.
    ground_kind: NDArray[np.uint8]
    ground_pond: NDArray[np.uint8]  #: (ny, nx): row of ``pond`` at nodes of kind ``KIND_BOTTOM``.
    #: (p, 3): height of the water [m], its attenuation [1/m], reflectance of its surface.
    pond: NDArray[np.float64]
    grid: NDArray[np.float64]  #: (3,): x and y of the first node, and the step [m].
    #: (s, f, 4): half-spaces of each solid; unit outward normal and offset [m].
    planes: NDArray[np.float64]
    faces: NDArray[np.int64]  #: (s,): how many of them count.
    #: (s, 4): extinction [1/m] (0 = opaque), reflectance, kind of an upward face, of a wall.
    solid: NDArray[np.float64]
    #: (c, 8): centre x, y, z, horizontal and vertical radius [m], extinction [1/m], reflectance,
    #: share of gaps.
    crown: NDArray[np.float64]
    #: (w, 10): start x, y, unit direction x, y, horizontal span [m], catenary parameter a, place of
    #: its vertex along the span, height offset [m], radius [m], reflectance.
    wire: NDArray[np.float64]
    #: (3,): x and y of the corner of the object cells, and their edge [m].
    cell: NDArray[np.float64]
    #: (cy, cx + 1): first entry of each cell in ``cell_item``, row by row; the last column ends the
    #: row.
    cell_first: NDArray[np.int64]
    cell_item: NDArray[np.int64]  #: (k,): solids, then crowns, then wires, numbered through.
    #: Highest ground where some is so steep that a ray may meet it twice [m]; -inf without.
    steep_top: float = -math.inf
    #: (ny, nx): sunlight at the nodes over the scene's mean brightness; empty where background has
    #: one rate.
    light: NDArray[np.float64] = np.empty((0, 0))


@njit()
def bilinear(values: NDArray[Any], grid: NDArray[np.float64], x: float, y: float) -> Any:
    """Value and gradient of a bilinear grid; beyond its edge the edge goes on.

    Parameters
    ----------
    values : (ny, nx) float64
        Node values.
    grid : (3,) float64
        x and y of the first node, and the step [m].
    x, y : float
        Place [m].

    Returns
    -------
    value, dvalue/dx, dvalue/dy : float
    """
    ny, nx = values.shape
    u = min(max((x - grid[0]) / grid[2], 0.0), nx - 1.000001)
    v = min(max((y - grid[1]) / grid[2], 0.0), ny - 1.000001)
    i, j = int(u), int(v)
    u -= i
    v -= j
    a, b = values[j, i], values[j, i + 1]
    c, d = values[j + 1, i], values[j + 1, i + 1]
    low, high = a + (b - a) * u, c + (d - c) * u
    slope_x = ((b - a) * (1 - v) + (d - c) * v) / grid[2]
    return low + (high - low) * v, slope_x, (high - low) / grid[2]


@njit()
def hit_ground(
    ground_z: NDArray[np.float64], grid: NDArray[np.float64], o: Any, d: Any
) -> tuple[float, float]:
    """Range at which a ray meets the ground, and the cosine of incidence there.

    Fixed-point iteration on the height; it contracts by slope x tan(off-nadir).

    Parameters
    ----------
    ground_z, grid
        As in :class:`SceneArrays`.
    o, d : (3,) float64
        Origin [m] and unit direction, pointing downwards.

    Returns
    -------
    range_m, cosine : float
    """
    z = ground_z[ground_z.shape[0] // 2, ground_z.shape[1] // 2]
    t = 0.0
    sx = sy = 0.0
    for _ in range(30):
        t = (z - o[2]) / d[2]
        new, sx, sy = bilinear(ground_z, grid, o[0] + t * d[0], o[1] + t * d[1])
        step = abs(new - z)
        z = new
        if step < 1e-5:
            break
    t = (z - o[2]) / d[2]
    cosine = (sx * d[0] + sy * d[1] - d[2]) / math.sqrt(1 + sx * sx + sy * sy)
    return t, max(cosine, 0.0)


@njit()
def meet_steep_ground(
    ground_z: NDArray[np.float64], grid: NDArray[np.float64], top: float, o: Any, d: Any
) -> tuple[float, float]:
    """Where a ray first meets ground that may be as steep as a cliff.

    Parameters
    ----------
    ground_z, grid, o, d
        As for :func:`hit_ground`.
    top : float
        Height above which there is no ground [m].

    Returns
    -------
    range_m, cosine : float
    """
    across = math.hypot(d[0], d[1])
    step = min(0.25 * grid[2] / max(across, 1e-9), 1.0)
    low = max((top - o[2]) / d[2], 0.0)
    while True:
        high = low + step
        z, _, _ = bilinear(ground_z, grid, o[0] + high * d[0], o[1] + high * d[1])
        if o[2] + high * d[2] <= z:
            break
        low = high
    for _ in range(20):
        t = 0.5 * (low + high)
        z, _, _ = bilinear(ground_z, grid, o[0] + t * d[0], o[1] + t * d[1])
        if o[2] + t * d[2] <= z:
            high = t
        else:
            low = t
    _, sx, sy = bilinear(ground_z, grid, o[0] + low * d[0], o[1] + low * d[1])
    cosine = (sx * d[0] + sy * d[1] - d[2]) / math.sqrt(1 + sx * sx + sy * sy)
    return low, max(cosine, 0.0)


@njit()
def clip_convex(
    planes: NDArray[np.float64], faces: int, o: Any, d: Any
) -> tuple[float, float, int]:
    """Part of a ray inside an intersection of half-spaces.

    Parameters
    ----------
    planes : (f, 4) float64
        Outward normal and offset of each half-space.
    o, d : (3,) float64
        Origin and direction.

    Returns
    -------
    enter, leave : float
        Ranges [m]; ``enter >= leave`` where the ray misses.
    face : int
        The face through which it enters; -1 where the origin is inside.
    """
    enter, leave, face = 0.0, np.inf, -1
    for f in range(faces):
        along = planes[f, 0] * d[0] + planes[f, 1] * d[1] + planes[f, 2] * d[2]
        depth = planes[f, 3] - (planes[f, 0] * o[0] + planes[f, 1] * o[1] + planes[f, 2] * o[2])
        if along == 0.0:
            if depth < 0.0:
                return 0.0, -1.0, -1
        elif along < 0.0:
            if depth / along > enter:
                enter, face = depth / along, f
        else:
            leave = min(leave, depth / along)
    return enter, leave, face


@njit()
def clip_crown(crown: NDArray[np.float64], o: Any, d: Any) -> tuple[float, float]:
    """Part of a ray inside a crown's ellipsoid; ``enter >= leave`` where it misses or a gap is.

    Parameters
    ----------
    crown : (8,) float64
        One row of :attr:`SceneArrays.crown`.
    o, d : (3,) float64
        Origin and direction.

    Returns
    -------
    enter, leave : float
        Ranges [m].
    """
    px, py, pz = (
        (o[0] - crown[0]) / crown[3],
        (o[1] - crown[1]) / crown[3],
        (o[2] - crown[2]) / crown[4],
    )
    ux, uy, uz = d[0] / crown[3], d[1] / crown[3], d[2] / crown[4]
    a = ux * ux + uy * uy + uz * uz
    b = px * ux + py * uy + pz * uz
    # The squared miss distance, computed from the closest point: b*b - a*c cancels badly
    # for an origin 1000 radii away.
    t = -b / a
    qx, qy, qz = px + t * ux, py + t * uy, pz + t * uz
    rest = 1.0 - (qx * qx + qy * qy + qz * qz)
    if rest <= 0.0:
        return 0.0, -1.0
    half = math.sqrt(rest / a)
    if crown[7] > 0.0:
        i = math.floor((o[0] + t * d[0]) / GAP_CELL_M)
        j = math.floor((o[1] + t * d[1]) / GAP_CELL_M)
        if _hash_share(i, j) < crown[7]:
            return 0.0, -1.0
    return t - half, t + half


@njit()
def _hash_share(i: int, j: int) -> float:
    """Fixed pseudo-random number in [0, 1) of a column: gaps belong to the scene, not a shot."""
    h = np.uint64(i & 0xFFFFFFFF) * np.uint64(0x9E3779B97F4A7C15)
    h ^= np.uint64(j & 0xFFFFFFFF) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    h ^= h >> np.uint64(32)
    return (h >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit()
def catenary_z(wire: NDArray[np.float64], s: float) -> Any:
    """Height of a wire at ``s`` metres along its span [m]."""
    return wire[7] + wire[5] * math.cosh((s - wire[6]) / wire[5])


@njit()
def meet_wire(wire: NDArray[np.float64], o: Any, d: Any) -> tuple[float, float]:
    """Where a ray passes a wire, and how far from its axis.

    The point of the ray at the wire's height is found by iteration; the distance is that
    of the ray to the wire's tangent there.

    Parameters
    ----------
    wire : (10,) float64
        One row of :attr:`SceneArrays.wire`.
    o, d : (3,) float64
        Origin and direction.

    Returns
    -------
    range_m, distance_m : float
        Infinite distance where the ray passes beyond the ends of the span.
    """
    z = catenary_z(wire, 0.5 * wire[4])
    t = s = 0.0
    for _ in range(6):
        t = (z - o[2]) / d[2]
        s = (o[0] + t * d[0] - wire[0]) * wire[2] + (o[1] + t * d[1] - wire[1]) * wire[3]
        z = catenary_z(wire, min(max(s, 0.0), wire[4]))
    if s < 0.0 or s > wire[4]:
        return t, np.inf
    across = (o[1] + t * d[1] - wire[1]) * wire[2] - (o[0] + t * d[0] - wire[0]) * wire[3]
    rise = math.sinh((s - wire[6]) / wire[5])
    # n = d x tangent; the offset vector is `across` times the horizontal normal (-uy, ux).
    nx = d[1] * rise - d[2] * wire[3]
    ny = d[2] * wire[2] - d[0] * rise
    nz = d[0] * wire[3] - d[1] * wire[2]
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return t, abs(across * (ny * wire[2] - nx * wire[3])) / length


@njit()
def lit_share(distance: float, radius: float, sigma: float) -> Any:
    """Share of a Gaussian beam that falls on a straight wire.

    Parameters
    ----------
    distance : float
        Of the beam's axis from the wire's axis [m].
    radius : float
        Of the wire [m].
    sigma : float
        Spread of the beam across one axis [m], > 0.
    """
    scale = 1.0 / (sigma * math.sqrt(2.0))
    return 0.5 * (math.erf((distance + radius) * scale) - math.erf((distance - radius) * scale))
