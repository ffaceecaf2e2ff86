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

KINDS: Final = (
    "background",
    "ground",
    "roof",
    "vegetation",
    "wire",
    "water",
    "afterpulse",
    "other",
    "bottom",
)
"""What gave a simulated return: names of the values of the truth column ``kind``."""

KIND_BACKGROUND: Final = KINDS.index("background")
KIND_GROUND: Final = KINDS.index("ground")
KIND_ROOF: Final = KINDS.index("roof")
KIND_VEGETATION: Final = KINDS.index("vegetation")
KIND_WIRE: Final = KINDS.index("wire")
KIND_WATER: Final = KINDS.index("water")
KIND_AFTERPULSE: Final = KINDS.index("afterpulse")
KIND_OTHER: Final = KINDS.index("other")
KIND_BOTTOM: Final = KINDS.index("bottom")

GAP_CELL_M: Final = 0.5
"""Edge of the columns of a crown that are gaps or not [m]."""


class Ground(NamedTuple):
    """Ground and water of a scene on a grid of nodes."""

    z: NDArray[np.float64]  #: (ny, nx): heights [m].
    rho: NDArray[np.float64]  #: (ny, nx): reflectance.
    #: (ny, nx): ``KIND_GROUND``, ``KIND_WATER`` or, under clear water, ``KIND_BOTTOM``.
    kind: NDArray[np.uint8]
    grid: NDArray[np.float64]  #: (3,): x and y of the first node, and the step [m].
    pond_at: NDArray[np.uint8]  #: (ny, nx): row of ``ponds`` at nodes of kind ``KIND_BOTTOM``.
    #: (p, 4): height of clear water [m], its attenuation [1/m], reflectance of its surface, share
    #: of a beam that this turns back.
    ponds: NDArray[np.float64]
    #: Highest ground where some is so steep that a ray may meet it twice [m]; -inf without.
    steep_top: float = -math.inf
    #: (ny, nx): sunlight over the scene's mean brightness; empty where background has one rate.
    light: NDArray[np.float64] = np.empty((0, 0))


class SceneArrays(NamedTuple):
    """A scene as bare arrays; lengths in metres relative to the scene's origin."""

    ground: Ground
    #: (s, f, 4): half-spaces of each solid; unit outward normal and offset [m]. Those that a solid
    #: does not need hold all of space: normal 0, offset infinite.
    planes: NDArray[np.float64]
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
def meet_ground(ground: Ground, o: Any, d: Any) -> tuple[float, float]:
    """Range at which a ray first meets the ground [m], and the cosine of incidence there."""
    steep = ground.steep_top > -math.inf
    t, sx, sy = _march(ground, o, d) if steep else _iterate(ground, o, d)
    cosine = (sx * d[0] + sy * d[1] - d[2]) / math.sqrt(1 + sx * sx + sy * sy)
    return t, max(cosine, 0.0)


@njit()
def _iterate(ground: Ground, o: Any, d: Any) -> tuple[float, float, float]:
    """Range and slopes by fixed-point iteration, which contracts by slope x tan(off-nadir)."""
    z = ground.z[ground.z.shape[0] // 2, ground.z.shape[1] // 2]
    t = 0.0
    sx = sy = 0.0
    for _ in range(30):
        t = (z - o[2]) / d[2]
        new, sx, sy = bilinear(ground.z, ground.grid, o[0] + t * d[0], o[1] + t * d[1])
        step = abs(new - z)
        z = new
        if step < 1e-5:
            break
    return (z - o[2]) / d[2], sx, sy


@njit()
def _march(ground: Ground, o: Any, d: Any) -> tuple[float, float, float]:
    """Range and slopes where ground may be as steep as a cliff: steps, then bisection."""
    step = min(0.25 * ground.grid[2] / max(math.hypot(d[0], d[1]), 1e-9), 1.0)
    low = max((ground.steep_top - o[2]) / d[2], 0.0)
    while not _below(ground, o, d, low + step):
        low += step
    high = low + step
    for _ in range(20):
        t = 0.5 * (low + high)
        if _below(ground, o, d, t):
            high = t
        else:
            low = t
    _, sx, sy = bilinear(ground.z, ground.grid, o[0] + low * d[0], o[1] + low * d[1])
    return low, sx, sy


@njit()
def _below(ground: Ground, o: Any, d: Any, t: float) -> bool:
    """Whether a ray is below the ground at a range."""
    z, _, _ = bilinear(ground.z, ground.grid, o[0] + t * d[0], o[1] + t * d[1])
    return bool(o[2] + t * d[2] <= z)


@njit()
def clip_convex(planes: NDArray[np.float64], o: Any, d: Any) -> tuple[float, float, int]:
    """Part of a ray inside half-spaces (f, 4): enter and leave [m], and the face of entry.

    ``enter >= leave`` where the ray misses; the face is -1 where the origin is inside.
    """
    enter, leave, face = 0.0, np.inf, -1
    for f in range(len(planes)):
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
    """Part of a ray inside a crown's ellipsoid [m]; ``enter >= leave`` for a miss or a gap."""
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
    """Where a ray passes a wire, and how far from its axis [m]; infinite beyond the span's ends.

    The point of the ray at the wire's height is found by iteration; the distance is that
    of the ray to the wire's tangent there.
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
    """Share of a Gaussian beam of spread ``sigma`` that a straight wire so far off its axis takes.

    ``radius``: the wire's [m].
    """
    scale = 1.0 / (sigma * math.sqrt(2.0))
    return 0.5 * (math.erf((distance + radius) * scale) - math.erf((distance - radius) * scale))
