"""Terrain across gaps: thin plates that go on with the slopes of the rim.

A TIN spans a gap with planes between its rims, whatever slopes lead there, so that it cuts off a
hill and fills a hollow. A smoothing thin plate (:mod:`spl_batch.numerics.thin_plates`) bends as
little as the ground around allows. Under halls, dense crowns and other places that are farther
than :data:`FAR_M` from ground it takes the TIN's place, wholly so from twice that distance on.

Deviation from a plate through all ground: plates are local and overlap, as a ground cell sees no
more than its margin. One belongs to each node of an absolute lattice, is fitted to the ground of a
window around it, and counts with bilinear weight as far as the next nodes. So no cut between
ground cells shows, and where a gap is wider than a window, its plate goes on from one side.
It is fitted to means of blocks of :data:`FAR_M`, two rows of them along the gaps: single cells
would lend it the slopes of their noise.

Two rules keep it from making up land. It is no higher and no lower than the ground it is fitted to,
and it does not come near water: where the nearest ground is the level of water, within
:data:`FAR_M`, the TIN stays.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.numerics.thin_plates import fit_plate, plate_heights

FAR_M: Final = 4.0
"""Distance to ground from which on a plate takes part, and edge of a block whose mean it is fitted
to [m]. Half moves 0 + 1 labels, twice 123 + 28 cells of the DTM."""

NODE_BLOCKS: Final = 3
"""Blocks from one plate to the next [count]. At 2 it moves 121 + 9 cells of the DTM, at twice 123 +
28 cells of the DTM."""

WINDOW_BLOCKS: Final = 7
"""Blocks on each side of a node that its plate is fitted to, at most [count]. Half moves 123 + 28
cells of the DTM, twice nothing."""

_RIM = 2
"""Blocks with an empty one no farther than this are the rim of a gap [count]. Half moves 123 + 28
cells of the DTM, twice 120 + 15 cells of the DTM."""

_STIFFNESS = 1.0
"""Of plates, in blocks: they smooth over about half a block. Half moves 122 + 15 cells of the DTM,
twice 123 + 24 cells of the DTM."""

_BLOCKS_LEAST = 6
"""Blocks that a plate is fitted to, at least [count]. Half and twice move nothing."""

_CELLS = 2.0
"""Cells with ground in a block, on the average; in sparser clouds gaps are everywhere [count]."""

Grid = NDArray[np.float64]


def bridged(
    dtm: Grid, means: Grid, wet: NDArray[np.bool_], size: int, far: float, corner: tuple[int, int]
) -> Grid:
    """A terrain model with plates across its gaps.

    ``dtm``: TIN, row 0 southernmost, NaN in voids, which stay. ``means`` (., ., 3), with a margin
    on each side: place, from the first corner of these cells on, and height of the ground in each
    cell, NaN without; all in the unit of ``size``, the edge of a cell. ``wet``: cells of ``means``
    whose ground is water; ``far``: :data:`FAR_M` in cells; ``corner``: absolute row and column of
    their first.
    """
    margin = (len(means) - len(dtm)) // 2
    block = max(round(far), 1)
    window = min(margin // block - NODE_BLOCKS, WINDOW_BLOCKS)
    share = _share(~np.isnan(means[:, :, 2]), wet, max(far, 2.0), margin)
    share[np.isnan(dtm)] = 0.0
    if window < NODE_BLOCKS or not share.any():
        return dtm
    before = corner[0] % block, corner[1] % block
    blocks = _blocks(means, size, before, block)
    # Row and column of the first cell of ``dtm`` on the lattice of blocks, and of its nodes.
    first = before[0] + margin, before[1] + margin
    step = NODE_BLOCKS * block
    phase = tuple((c - b) // block % NODE_BLOCKS for c, b in zip(corner, before, strict=True))
    nodes = _nodes(share > 0, (first[0] + phase[0] * block, first[1] + phase[1] * block), step)
    nodes = nodes * NODE_BLOCKS - phase
    off = np.zeros_like(dtm)
    for node in nodes:
        _add_plate(node, blocks, window, dtm, share > 0, np.array(first), block, off)
    return dtm + share * off


def _share(held: NDArray[np.bool_], wet: NDArray[np.bool_], far: float, margin: int) -> Grid:
    """How much a plate counts in each cell within the margin: 0 to 1."""
    inner = slice(margin, len(held) - margin), slice(margin, held.shape[1] - margin)
    if not held.any():
        return np.zeros_like(held[inner], np.float64)
    away = ndimage.distance_transform_edt(~held)[inner]
    share = np.clip(away / far - 1.0, 0.0, 1.0)
    if wet.any():
        beyond = ndimage.distance_transform_edt(~wet)[inner] - away
        share *= np.clip(beyond / far, 0.0, 1.0)
    return share


def _blocks(means: Grid, size: int, before: tuple[int, int], block: int) -> Grid:
    """Mean place [blocks] and height of the ground of each block, and cells with any: (., ., 4).

    Place and height are NaN in a block without ground.
    """
    held = np.nonzero(~np.isnan(means[:, :, 2]))
    row, column = ((axis + b) // block for axis, b in zip(held, before, strict=True))
    shape = [-(-(n + b) // block) for n, b in zip(means.shape, before, strict=False)]
    number = row * shape[1] + column
    count = np.bincount(number, minlength=shape[0] * shape[1])
    sums = [np.bincount(number, values, len(count)) for values in means[held].T]
    with np.errstate(invalid="ignore"):
        x, y, z = sums / count
    blocks = [(x / size + before[1]) / block, (y / size + before[0]) / block, z, count]
    return np.stack(blocks, axis=-1).reshape(*shape, 4)


def _nodes(gaps: NDArray[np.bool_], first: tuple[int, int], step: int) -> NDArray[np.int64]:
    """Nodes of a lattice, ``step`` cells apart, whose plates reach cells of gaps: (n, 2)."""
    row, column = (axis + f for axis, f in zip(np.nonzero(gaps), first, strict=True))
    corners = np.unique(np.column_stack([row // step, column // step]), axis=0)
    around = [corners + np.array([i, j]) for i in (0, 1) for j in (0, 1)]
    return np.unique(np.concatenate(around), axis=0)


def _add_plate(
    node: NDArray[np.int64], blocks: Grid, window: int,
    dtm: Grid, gaps: NDArray[np.bool_], first: NDArray[np.int64], block: int, off: Grid,
) -> None:  # fmt: skip
    """Add what a node's plate lies above the terrain, by its weight; ``first``: cell of that."""
    points = _rim_around(node, blocks, window)
    plate = fit_plate(points, _STIFFNESS) if len(points) >= _BLOCKS_LEAST else None
    if plate is None:
        return
    middle, reach = node * block - first, NODE_BLOCKS * block
    south, west = np.maximum(middle - reach, 0)
    north, east = np.maximum(middle + reach, 0)
    row, column = np.nonzero(gaps[south:north, west:east])
    at = row + south, column + west
    y, x = ((axis + 0.5 - m) / block for axis, m in zip(at, middle, strict=True))
    height = plate_heights(points, plate, x, y)
    height = np.clip(height, points[:, 2].min(), points[:, 2].max()) - dtm[at]
    off[at] += (1.0 - np.abs(x) / NODE_BLOCKS) * (1.0 - np.abs(y) / NODE_BLOCKS) * height


def _rim_around(node: NDArray[np.int64], blocks: Grid, window: int) -> Grid:
    """Blocks at rims, places from the node on: (n, 3); none where ground is sparse."""
    south, west = np.maximum(node - window, 0)
    near = blocks[south : node[0] + window, west : node[1] + window]
    empty = near[:, :, 3] == 0
    rim = ~empty & ndimage.maximum_filter(empty, 2 * _RIM + 1, mode="constant")
    if near[:, :, 3].sum() < _CELLS * np.count_nonzero(~empty):
        rim[:] = False
    places: Grid = near[rim][:, :3] - (node[1], node[0], 0)
    return places
