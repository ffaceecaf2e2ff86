"""Ground points of one fixed absolute cell with its buffer, by one of several methods.

Domain: space. A TIN has no bounded reach, so the stage never sees a tile:
it runs on cells of ``ground.cell_m`` on the absolute grid with ``ground.buffer_m`` of
points around them, always the same ones, and its caller keeps what the cell owns.
"""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.ground.ground_seeds import Start, believed, first_true, start
from spl_batch.airborne.ground.lowest_layers import lowest_layers
from spl_batch.airborne.ground.multiscale.masks import multiscale_mask
from spl_batch.airborne.ground.multiscale_surface import low_outliers
from spl_batch.airborne.ground.node_grids import lowest_nodes
from spl_batch.airborne.ground.point_spacing import Blocks, largest_of, spacings_m
from spl_batch.airborne.ground.ptd import Limits, densify, heights_above
from spl_batch.airborne.ground.scales import SIGMA_M
from spl_batch.airborne.ground.smrf import provisional_terrain
from spl_batch.airborne.settings import GroundSettings, PtdSettings, SmrfSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.cell_groups import group_by_cell

_FILLED = 2.0
"""Points in an occupied cell below which the candidates' grid is doubled [count]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Points(NamedTuple):
    """Some points: three (n,) float64 [m], on the absolute lattice."""

    x: Float
    y: Float
    z: Float


class Cloud(NamedTuple):
    """Points of a ground cell.

    Parameters
    ----------
    points : Points
        All of them.
    own, asked : (n,) bool
        Which are evidence, and which are to be judged.
    sigma_m : (n,) floating or None
        Ranging spread of their flightlines [m], where it is known.
    """

    points: Points
    own: Mask
    asked: Mask
    sigma_m: NDArray[np.floating] | None

    def some(self, chosen: NDArray[np.bool_]) -> Points:
        """Chosen points; no copy where all are."""
        return self.points if chosen.all() else Points(*(v[chosen] for v in self.points))


def ground_mask(
    table: PointTable,
    usable: NDArray[np.bool_],
    settings: GroundSettings,
    asked: NDArray[np.bool_] | None = None,
) -> NDArray[np.bool_]:
    """Which points are ground.

    Returns that are probably afterpulses are no evidence: behind a bright meadow they lie
    so close together that they hold each other up, a metre below it. The surface is found
    without them; those that lie on it are ground like any other point.

    Parameters
    ----------
    table : PointTable
        Points of one ground cell and its buffer, in any order: ``x, y, z``, and ``afterpulse`` and
        ``range_sigma`` where the time domain ran.
    usable : (n,) bool
        Points to look at: signal, not withheld.
    settings : GroundSettings
        Method and parameters.
    asked : (n,) bool, optional
        Points to be judged; all by default.

    Returns
    -------
    (n,) bool
        True for ground; False wherever a point is not usable or not asked for.
    """
    mask = np.zeros(len(table), dtype=np.bool_)
    own = usable & ~dependents(table)
    asked = usable if asked is None else usable & asked
    if own.any() and asked.any():
        used = own | asked
        spreads = table["range_sigma"][used] if "range_sigma" in table else None
        cloud = Cloud(metres(table, used), own[used], asked[used], spreads)
        mask[asked] = METHODS[settings.method](cloud, settings)
    return mask


def metres(table: PointTable, chosen: NDArray[np.bool_]) -> Points:
    """Some points [m], on the absolute lattice."""
    rows = np.flatnonzero(chosen)
    return Points(*(table[axis].take(rows) * QUANTUM_M for axis in "xyz"))


def ptd_mask(own: Points, asked: Points, settings: PtdSettings) -> NDArray[np.bool_]:
    """Ground points by progressive TIN densification.

    Seeds are the lowest nodes that survive a progressive opening, so that neither a wide
    hall nor an embankment needs a seed grid of its own size; the source's iteration
    parameters then take in what the opening cut off. Points are ground in a band on both
    sides of the surface, so that their mean is not biased low; the band widens with the
    facets, over which the surface is known less well, but not over gaps: under a roof it
    would take in what noise and walls leave there.

    Parameters
    ----------
    own : Points
        Evidence; at least one.
    asked : Points
        Points to be judged; at least one.
    settings : PtdSettings
        Parameters.

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    nodes = _start(own, settings)
    others = np.flatnonzero(~nodes.seed & ~nodes.sunk)
    tin, _ = densify(
        nodes.xyz[nodes.seed],
        nodes.xyz[others],
        np.where(nodes.trusted[others], -np.inf, -settings.band_m),
        _limits(settings),
        settings.seed_cell_m,
    )
    mask = np.zeros(len(asked.x), dtype=np.bool_)
    if tin is None:
        return mask
    order = group_by_cell(asked.x, asked.y, settings.node_m).order
    x, y, z = (values[order] for values in asked)
    height, edge = heights_above(tin, x, y, z)
    allowed = settings.band_m + np.tan(np.radians(settings.iteration_angle_deg)) * edge
    mask[order] = np.abs(height) <= np.minimum(allowed, settings.iteration_distance_m)
    return mask


def _limits(settings: PtdSettings) -> Limits:
    return Limits(
        float(np.tan(np.radians(settings.terrain_angle_deg))),
        float(np.sin(np.radians(settings.iteration_angle_deg))),
        settings.iteration_distance_m,
        settings.spread_m,
        SIGMA_M,
    )


def _start(own: Points, settings: PtdSettings) -> Start:
    """Nodes and seeds, from cells of twice the size where data are sparse.

    Blocks choose by the spacing of the points in and around them, whatever ground cell they are in.
    """
    spacing, parts = spacings_m(own.x, own.y), []
    wide = sparse_at(spacing, own.x, own.y, settings.node_m)
    for times in (1, 2):
        if (wide == (times == 2)).any():
            found = start(*own, times * settings.node_m, settings)
            x, y = found.xyz[:, :2].T
            chosen = sparse_at(spacing, x, y, settings.node_m) == (times == 2)
            parts.append([of[chosen] for of in found])
    return Start(*(np.concatenate(some) for some in zip(*parts, strict=True)))


def sparse_at(spacing: Blocks, x: Float, y: Float, node_m: float) -> NDArray[np.bool_]:
    """Points around which cells of an edge hold too few points of a spacing: (n,) bool."""
    wide: NDArray[np.bool_] = node_m**2 < _FILLED * spacing.at(x, y) ** 2
    return wide


def smrf_mask(own: Points, asked: Points, settings: SmrfSettings) -> NDArray[np.bool_]:
    """Ground points by the simple morphological filter.

    Parameters
    ----------
    own : Points
        Evidence; at least one.
    asked : Points
        Points to be judged; at least one.
    settings : SmrfSettings
        Parameters.

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    cells = group_by_cell(own.x, own.y, settings.cell_m)
    nodes = lowest_layers(*own, cells, settings.layer_m)
    above = believed(nodes, cells, settings.cell_m)
    trusted = first_true((above & ~low_outliers(nodes.xyz), above))
    found = lowest_nodes(nodes.xyz, trusted, settings.cell_m)
    lowest = np.where(found >= 0, nodes.xyz[found, 2], np.nan)
    terrain = provisional_terrain(lowest, settings.cell_m, settings.slope, settings.window_m)
    column = asked.x / settings.cell_m - np.floor(own.x.min() / settings.cell_m) - 0.5
    row = asked.y / settings.cell_m - np.floor(own.y.min() / settings.cell_m) - 0.5
    steepness = _steepness(terrain, settings.cell_m)
    surface = ndimage.map_coordinates(terrain, [row, column], order=1, mode="nearest")
    slope = ndimage.map_coordinates(steepness, [row, column], order=1, mode="nearest")
    allowed = settings.threshold_m + settings.scalar * slope
    mask: NDArray[np.bool_] = np.abs(asked.z - surface) <= allowed
    return mask


def _steepness(terrain: Float, cell_m: float) -> Float:
    """Steepest rise of a grid [rise/run]; zero along an axis of one cell."""
    squared = np.zeros_like(terrain)
    for axis in (0, 1):
        if terrain.shape[axis] > 1:
            squared += np.gradient(terrain, cell_m, axis=axis) ** 2
    return np.sqrt(squared)


def _multiscale(cloud: Cloud, _: GroundSettings) -> Mask:
    """By a surface whose scale follows the data."""
    points, own, asked, sigma_m = cloud
    if sigma_m is None:
        return multiscale_mask(points, own, asked)
    some = cloud.some(own)
    sigma = largest_of(some.x, some.y, sigma_m[own], SIGMA_M)
    return multiscale_mask(points, own, asked, sigma)


def _by_ptd(cloud: Cloud, settings: GroundSettings) -> Mask:
    return ptd_mask(cloud.some(cloud.own), cloud.some(cloud.asked), settings.ptd)


def _by_smrf(cloud: Cloud, settings: GroundSettings) -> Mask:
    return smrf_mask(cloud.some(cloud.own), cloud.some(cloud.asked), settings.smrf)


Method = Callable[[Cloud, GroundSettings], Mask]

METHODS: Final[Mapping[str, Method]] = {
    "multiscale": _multiscale,
    "ptd": _by_ptd,
    "smrf": _by_smrf,
}
"""Methods by their names in the settings: points, settings -> mask of those asked."""
