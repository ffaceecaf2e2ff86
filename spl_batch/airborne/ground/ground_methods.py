"""Ground points of one fixed absolute cell with its buffer, by one of several methods.

Domain: space. A TIN has no bounded reach, so the stage never sees a tile or block:
it runs on squares of ``ground.cell_m`` on the absolute grid with ``ground.buffer_m`` of
points around them, always the same ones, and its caller keeps what the square owns.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.ground.ground_seeds import (
    first_true,
    lowest_grid,
    seen_through,
    start,
    sunk,
    supported,
)
from spl_batch.airborne.ground.lowest_layers import lowest_layers
from spl_batch.airborne.ground.multiscale.masks import Strip, multiscale_mask, multiscale_masks
from spl_batch.airborne.ground.multiscale.ranging_layer import SIGMA_M, evidence, reckoned_m
from spl_batch.airborne.ground.point_spacing import spacing_around_m, spacing_m
from spl_batch.airborne.ground.ptd import Limits, densify, heights_above
from spl_batch.airborne.ground.smrf import provisional_terrain
from spl_batch.airborne.settings import GroundSettings, PtdSettings, SmrfSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.cell_groups import chosen_places, group_by_cell

DOMAIN: Final = "space"
COLUMNS_NEEDED: Final = ("x", "y", "z")
"""And ``afterpulse`` and ``range_sigma`` where the time domain ran."""

COLUMNS_ADDED: Final = ("ground",)

_INSERT_M = 0.05
"""Nearer candidates leave the surface as it is: a third of the ranging noise of one
point, and more than that of a layer's mean [m]."""

_FILLED = 2.0
"""Points in an occupied cell below which the candidates' grid is doubled [count]."""

_GAP_SPACINGS = 10.0
"""Edges longer than this many mean spacings of the points around cross a gap of the ground
[count]."""

Float = NDArray[np.float64]


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
        Which are evidence, and which are to be told.
    """

    points: Points
    own: NDArray[np.bool_]
    asked: NDArray[np.bool_]

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
        Points of one ground cell and its buffer, in any order.
    usable : (n,) bool
        Points to look at: signal, not withheld.
    settings : GroundSettings
        Method and parameters.
    asked : (n,) bool, optional
        Points to be told; all by default.

    Returns
    -------
    (n,) bool
        True for ground; False wherever a point is not usable or not asked for.
    """
    mask = np.zeros(len(table), dtype=np.bool_)
    own = usable & ~dependents(table)
    if not own.any():
        own = usable
    told = usable if asked is None else usable & asked
    if told.any():
        used = own | told
        cloud = Cloud(_metres(table, used), own[used], told[used])
        mask[told] = METHODS[settings.method](cloud, settings, _told_m(table, own))
    return mask


class Band(NamedTuple):
    """Some of the points of a ground cell: those of whole blocks.

    Parameters
    ----------
    table : PointTable
        The points.
    usable, asked : (n,) bool
        As :func:`ground_mask` has them.
    origin : object
        Where the caller found them.
    """

    table: PointTable
    usable: NDArray[np.bool_]
    asked: NDArray[np.bool_]
    origin: Any = None


def ground_in_bands(
    bands: Callable[[], Iterable[Band]],
) -> Iterator[tuple[Band, NDArray[np.bool_]]]:
    """What :func:`ground_mask` finds by the method that follows the data, band by band.

    Parameters
    ----------
    bands : callable
        Gives the bands of a ground cell and its buffer; it is called several times, and no band is
        held while the next is made.

    Returns
    -------
    iterator of (Band, (n,) bool)
        Each band, and which of its points are ground.
    """
    # Where everything may be an afterpulse all of it is evidence.
    plain = not any(map(_has_evidence, bands()))
    if plain and not any(map(_has_usable, bands())):
        return ((band, np.zeros(len(band.table), np.bool_)) for band in bands())
    told_m, shown = 0.0, evidence(*np.empty((3, 0)))
    for band in bands():
        own = _evidence(plain, band)
        told_m = max(told_m, _told_m(band.table, own))
        if "range_sigma" in band.table:
            shown += evidence(*_metres(band.table, own))
    sigma_m = reckoned_m(told_m, shown)
    strips = partial(map, partial(_strip, plain))
    return map(_of_table, multiscale_masks(lambda: strips(bands()), sigma_m))


def _has_usable(band: Band) -> bool:
    return bool(band.usable.any())


def _has_evidence(band: Band) -> bool:
    return bool((band.usable & ~dependents(band.table)).any())


def _strip(plain: bool, band: Band) -> Strip:  # noqa: FBT001 - the first of a partial
    """Places of a band's points; it remembers the band, and which points are asked."""
    own = _evidence(plain, band)
    told = band.usable & band.asked
    return Strip(_metres(band.table, own), _metres(band.table, told), (band, told))


def _evidence(plain: bool, band: Band) -> NDArray[np.bool_]:  # noqa: FBT001 - as above
    return band.usable if plain else band.usable & ~dependents(band.table)


def _told_m(table: PointTable, own: NDArray[np.bool_]) -> float:
    """Largest ranging spread that the flightlines of some points tell, or 0 [m]."""
    if "range_sigma" not in table:
        return 0.0
    # A tenth of a millimetre: what single precision makes of the sensor's own is that again.
    return round(float(table["range_sigma"][own].max(initial=0.0)), 4)


def _of_table(told: tuple[Strip, NDArray[np.bool_]]) -> tuple[Band, NDArray[np.bool_]]:
    """What was found of a strip, for all points of its band."""
    (_, _, (band, asked)), found = told
    mask = np.zeros(len(band.table), np.bool_)
    mask[asked] = found
    return band, mask


def _metres(table: PointTable, chosen: NDArray[np.bool_]) -> Points:
    """Some points [m], on the absolute lattice."""
    found = np.empty((3, int(np.count_nonzero(chosen)) + 1))
    chosen_places((table["x"], table["y"], table["z"]), chosen, QUANTUM_M, *found)
    return Points(*found[:, :-1])


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
        Points to be told; at least one.
    settings : PtdSettings
        Parameters.

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    cell_m = node_cell(own.x, own.y, settings.node_m)
    nodes = start(*own, cell_m, settings)
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
    order = group_by_cell(asked.x, asked.y, cell_m).order
    x, y, z = (values[order] for values in asked)
    height, edge = heights_above(tin, x, y, z)
    edge = np.minimum(edge, _GAP_SPACINGS * spacing_around_m(own.x, own.y, x, y))
    allowed = settings.band_m + np.tan(np.radians(settings.iteration_angle_deg)) * edge
    mask[order] = np.abs(height) <= np.minimum(allowed, settings.iteration_distance_m)
    return mask


def _limits(settings: PtdSettings) -> Limits:
    return Limits(
        float(np.tan(np.radians(settings.terrain_angle_deg))),
        float(np.sin(np.radians(settings.iteration_angle_deg))),
        settings.iteration_distance_m,
        settings.spread_m,
        _INSERT_M,
    )


def node_cell(x: Float, y: Float, smallest_m: float) -> float:
    """Edge of the candidates' grid: doubled for sparse data.

    Parameters
    ----------
    x, y : (n,) float64
        Places [m]; n > 0.
    smallest_m : float
        Edge for dense data [m].
    """
    return smallest_m * (1 if smallest_m**2 >= _FILLED * spacing_m(x, y) ** 2 else 2)


def smrf_mask(own: Points, asked: Points, settings: SmrfSettings) -> NDArray[np.bool_]:
    """Ground points by the simple morphological filter.

    Parameters
    ----------
    own : Points
        Evidence; at least one.
    asked : Points
        Points to be told; at least one.
    settings : SmrfSettings
        Parameters.

    Returns
    -------
    (m,) bool
        Which of those asked are ground.
    """
    cells = group_by_cell(own.x, own.y, settings.cell_m)
    nodes = lowest_layers(*own, cells, settings.layer_m)
    below = sunk(nodes, cells.rows, cells.columns, settings.cell_m)
    believed = supported(nodes, cells.rows, cells.columns, settings.cell_m) & ~below
    leaves = seen_through(nodes, believed, cells, settings.cell_m)
    trusted = first_true((~nodes.doubtful & ~below & ~leaves,))
    lowest = lowest_grid(nodes, trusted, cells)
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


def _multiscale(cloud: Cloud, _: GroundSettings, told_m: float) -> NDArray[np.bool_]:
    """By a surface whose scale follows the data."""
    sigma_m = SIGMA_M
    if told_m > SIGMA_M:
        sigma_m = reckoned_m(told_m, evidence(*cloud.some(cloud.own)))
    return multiscale_mask(*cloud, sigma_m)


def _by_ptd(cloud: Cloud, settings: GroundSettings, _: float) -> NDArray[np.bool_]:
    return ptd_mask(cloud.some(cloud.own), cloud.some(cloud.asked), settings.ptd)


def _by_smrf(cloud: Cloud, settings: GroundSettings, _: float) -> NDArray[np.bool_]:
    return smrf_mask(cloud.some(cloud.own), cloud.some(cloud.asked), settings.smrf)


Method = Callable[[Cloud, GroundSettings, float], NDArray[np.bool_]]

METHODS: Final[Mapping[str, Method]] = {
    "multiscale": _multiscale,
    "ptd": _by_ptd,
    "smrf": _by_smrf,
}
"""Methods by their names in the settings: points, settings, ranging spread that is told, or 0 [m]
-> which of those asked are ground."""
