"""Ground points by a surface whose scale follows the data.

Domain: space. See :mod:`spl_batch.airborne.ground.multiscale_surface`. There is nothing to set:
cell sizes, the
tolerance around the surface and its growth on slopes follow from the spacing of the points and
from how much the ground scatters.
"""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_seeds import sunk, supported
from spl_batch.airborne.ground.level_ground import levelled
from spl_batch.airborne.ground.lowest_layers import SUPPORTED, Nodes, lowest_layers
from spl_batch.airborne.ground.multiscale.lines_apart import (
    FAR_M,
    Apart,
    Lines,
    at_own_height,
    lines_apart,
    seen_lines,
)
from spl_batch.airborne.ground.multiscale.near_surface import (
    BAND_M,
    Near,
    Surface,
    near_surface,
    needed,
    surface_of,
    within,
)
from spl_batch.airborne.ground.multiscale.ranging_layer import (
    BLOCK_M,
    EVERYWHERE,
    Spread,
)
from spl_batch.airborne.ground.multiscale_surface import (
    ABOVE_SIGMA,
    CELL_M,
    MOST,
    agreeing_nodes,
    depths_below,
    ground_nodes,
    low_outliers,
    no_depths,
    noise_below,
    spread_below,
)
from spl_batch.airborne.ground.node_grids import lowest_nodes, nearest_node
from spl_batch.airborne.ground.pits import nearly_empty, over_ground, under_ground
from spl_batch.airborne.ground.point_spacing import (
    Squares,
    added_up,
    in_squares,
    spacings,
)
from spl_batch.airborne.ground.steep_ground import continued
from spl_batch.numerics.cell_groups import group_by_cell

_LAYER_SIGMA = 3.0
_LAYER_M = 0.15
_CROWDED = 20
"""Thickness of the layer whose mean is a node, in cells of so many points [standard deviations of a
range], and least one in others, where fewer points fill it [m]."""

_BELOW_SIGMA = 4.0
_TAIL = 0.9
"""Ground reaches below the surface by so many spreads of the tail of the points there, as nothing
grows below."""

_BAND_SPACINGS = 0.25
"""So many spacings of the points: between them the ground is not known better."""

GROUND: Final = 1
APART: Final = 2
"""Labels: on the surface, and on that of a flightline which lies apart from it."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Labels = NDArray[np.uint8]
Place = tuple[Float, Float, Float]


class Strip(NamedTuple):
    """Some of the points of a place, of whole blocks.

    Parameters
    ----------
    own : three (n,) float64
        Evidence: x, y, z [m].
    asked : three (m,) float64
        Points to be told [m].
    known_as : object
        What its maker knows it by.
    own_lines, asked_lines : Lines, optional
        Their flightlines, where there are several.
    """

    own: Place
    asked: Place
    known_as: Any = None
    own_lines: Lines | None = None
    asked_lines: Lines | None = None


def multiscale_masks(
    strips: Callable[[], Iterable[Strip]], sigma: Spread = EVERYWHERE
) -> Iterator[tuple[Strip, Labels]]:
    """Ground points by a surface whose scale follows the data, strip by strip.

    However points are divided into strips, the same ones are ground: nodes belong to cells, spreads
    and spacings to blocks, and the surface is made of the nodes of all.

    Parameters
    ----------
    strips : callable
        Gives all strips, and is called three times, so that none need be held; one point at least
        is evidence.
    sigma : Spread
        Standard deviation of a range.

    Yields
    ------
    strip : Strip
        One of them.
    labels : (m,) uint8
        Of those asked in it: :data:`GROUND`, :data:`APART` or 0.
    """
    surface = _ground_surface(map(_evidence, strips()), sigma)
    if surface is None:
        yield from ((strip, np.zeros(len(strip.asked[0]), np.uint8)) for strip in strips())
        return
    looked = filter(None, map(partial(_look, surface, sigma), strips()))
    below, counted, seen, lines = zip(*looked, strict=True)
    apart = lines_apart(seen, [of for of in lines if of is not None], sigma)
    known = _known(added_up(counted), added_up(below), sigma, apart)
    # A strip is held by nothing while the next one is read.
    yield from map(partial(_told, surface, known), strips())


def multiscale_mask(
    places: Place, own: Mask, asked: Mask, sigma: Spread = EVERYWHERE, lines: Lines | None = None
) -> Labels:
    """The same where all points are at hand: how high the surface is, is asked once.

    Parameters
    ----------
    places : three (n,) float64
        x, y, z [m].
    own, asked : (n,) bool
        Evidence, at least one; points to be told.
    sigma : Spread
        Standard deviation of a range.
    lines : Lines, optional
        Flightlines of the points, where there are several.

    Returns
    -------
    (m,) uint8
        Of those asked: :data:`GROUND`, :data:`APART` or 0.
    """
    # One cell after the other: neighbours follow each other wherever points are looked at.
    order = group_by_cell(*places[:2], CELL_M).order
    x, y, z = (v[order] for v in places)
    own, asked = own[order], asked[order]
    lines = lines.some(order) if lines is not None and lines.several else None
    evidence = _of((x, y, z), own)
    surface = _ground_surface((evidence,), sigma)
    found = np.zeros(len(x), np.uint8)
    if surface is None:
        return found[: int(asked.sum())]
    depths = no_depths(*evidence[:2])
    near = near_surface(
        _reaching(surface, lines), (x, y, z), needed(x, y, own, asked, depths)
    )  # fmt: skip
    counted = own[near.at]
    shown = Near(near.at[counted], near.off[counted], near.slope[counted])
    depths_below(shown.off, x[shown.at], y[shown.at], depths)
    apart = None
    if lines is not None:
        apart = lines_apart([seen_lines(shown, (x, y), lines, sigma)], [lines], sigma)
    known = _known(in_squares(*evidence[:2]), noise_below(depths), sigma, apart)
    _mark(known, near, (x, y), lines, found)
    told, by_place = np.empty_like(found), np.empty_like(asked)
    told[order], by_place[order] = found, asked
    return told[by_place]


def _reaching(surface: Surface, lines: Lines | None) -> Surface:
    """A surface that is asked for points farther above it where flightlines may be apart."""
    if lines is None:
        return surface
    tops = surface.tops
    return surface._replace(tops=tops._replace(top_m=tops.top_m + (FAR_M - BAND_M)))


def _of(places: Place, chosen: Mask) -> Place:
    """Some places; no copy where all are meant."""
    if chosen.all():
        return places
    x, y, z = (v[chosen] for v in places)
    return x, y, z


def _ground_surface(evidence: Iterable[Place], sigma: Spread) -> Surface | None:
    """Surface of the ground by some points, strip by strip; None where none of them is believed."""
    xyz, filled, doubtful = _nodes(evidence, sigma)
    if not len(xyz):
        return None
    chosen, high = agreeing_nodes(xyz, ~low_outliers(xyz), filled, sigma)
    grid = lowest_nodes(xyz, chosen, CELL_M)
    nearest = nearest_node(grid)
    ground = continued(xyz, grid, ground_nodes(xyz, high, grid, nearest), CELL_M)
    ground = levelled(xyz, grid, nearest, ground, CELL_M)
    judged = doubtful | nearly_empty(xyz, ground, filled | doubtful)
    ground &= ~under_ground(xyz, ground, judged)
    ground &= ~over_ground(xyz, ground, judged)
    return surface_of(xyz[ground])


def _evidence(strip: Strip) -> Place:
    return strip.own


class _Known(NamedTuple):
    """What tells ground: spacing of points around, and how far ground reaches by blocks [m]."""

    spacings: Squares
    above: Float
    below: Float
    first: tuple[int, int]
    apart: Apart | None


def _known(points: Squares, depths: Squares, sigma: Spread, apart: Apart | None) -> _Known:
    """How far ground reaches above and below a surface, by what lies below it."""
    sigma_m = sigma.over(depths.first, depths.sums.shape[:2])
    above, below = (
        many * np.maximum(spread_below(depths, share), sigma_m)
        for many, share in ((ABOVE_SIGMA, MOST), (_BELOW_SIGMA, _TAIL))
    )
    return _Known(spacings(points), above, below, depths.first, apart)


def _look(
    surface: Surface, sigma: Spread, strip: Strip
) -> tuple[Squares, Squares, dict[int, Squares], Lines | None] | None:
    """Points below the surface by depth, and all, by blocks, and flightlines; None without any."""
    x, y, z = strip.own
    if not len(x):
        return None
    order = group_by_cell(x, y, CELL_M).order
    places = x[order], y[order], z[order]
    lines = strip.own_lines
    near = near_surface(_reaching(surface, lines), places, np.ones(len(x), np.bool_))
    east, north = (v[near.at] for v in places[:2])
    depths = depths_below(near.off, east, north, no_depths(x, y))
    seen = {} if lines is None else seen_lines(near, places[:2], lines.some(order), sigma)
    return noise_below(depths), in_squares(x, y), seen, lines


def _told(surface: Surface, known: _Known, strip: Strip) -> tuple[Strip, Labels]:
    """A strip, and labels of the points that are asked."""
    x, y, z = strip.asked
    found = np.zeros(len(x), np.uint8)
    if len(x):
        order = group_by_cell(x, y, CELL_M).order
        places = x[order], y[order], z[order]
        wide = _reaching(surface, None if known.apart is None else strip.asked_lines)
        near = near_surface(wide, places, np.ones(len(x), np.bool_))
        _mark(known, near._replace(at=order[near.at]), (x, y), strip.asked_lines, found)
    return strip, found


def _mark(
    known: _Known, near: Near, place: tuple[Float, Float], lines: Lines | None, out: Labels
) -> None:
    """Fill the labels of the points that lie on the surface, or on that of their flightline."""
    if known.apart is not None and lines is not None:
        out[_on(known, at_own_height(near, place, lines, known.apart), place)] = APART
    out[_on(known, near, place)] = GROUND


def _on(known: _Known, near: Near, place: tuple[Float, Float]) -> Mask:
    """Points that lie on a surface: (n,) bool."""
    found = np.zeros(len(place[0]), np.bool_)
    reach = known.above, known.below
    within(near, place, *known.spacings, reach, known.first, _BAND_SPACINGS, found)
    return found


class _Layers(NamedTuple):
    """Nodes (n, 3) [m]; which are filled, and which are single returns below many."""

    xyz: Float
    filled: Mask
    doubtful: Mask


def _nodes(strips: Iterable[Place], sigma: Spread) -> _Layers:
    """Lowest layers that are no low noise."""
    parts = [part for part in map(partial(_layers, sigma), strips) if part is not None]
    found, row, column = zip(*parts, strict=True)
    at = [np.concatenate(some) for some in (row, column)]
    rows, columns = (int(np.ptp(along)) + 1 for along in at)
    cell = (at[0] - at[0].min()) * columns + at[1] - at[1].min()
    # Cell by cell, however the strips lie.
    order = np.argsort(cell, kind="stable")
    nodes = Nodes(*(np.concatenate(some)[order] for some in zip(*found, strict=True)))
    nodes = nodes._replace(cell=cell[order])
    above = ~sunk(nodes, rows, columns, CELL_M)
    # A single return below many others is ground where its neighbours continue it, else noise.
    if nodes.doubtful.any():
        above &= ~nodes.doubtful | supported(nodes, rows, columns, CELL_M)
    filled = nodes.points >= SUPPORTED
    return _Layers(nodes.xyz[above], filled[above], nodes.doubtful[above])


def _layers(sigma: Spread, own: Place) -> tuple[Nodes, Index, Index] | None:
    """Lowest layers of a strip; row and column of each; None without."""
    x, y, z = own
    if not len(x):
        return None
    cells = group_by_cell(x, y, CELL_M)
    south, west = (int(np.floor(v.min() / CELL_M)) for v in (y, x))
    along = (south + np.arange(cells.rows), west + np.arange(cells.columns))
    row, column = (np.floor(cell * CELL_M / BLOCK_M).astype(np.int64) for cell in along)
    thin_m = _LAYER_SIGMA * sigma.at(row[:, None], column[None, :]).ravel()
    crowded = np.diff(cells.start) >= _CROWDED
    nodes = lowest_layers(x, y, z, cells, np.where(crowded, thin_m, np.maximum(thin_m, _LAYER_M)))
    row, column = np.divmod(nodes.cell, cells.columns)
    return nodes, row + south, column + west
