"""Stage ``coincide``: detections and looks of a region in, points out.

Domain: space. Needs every frame that looks at the region, with all its detections: also those far
above it end their looks. Reach: half a neighbourhood of voxels, and one voxel for the weights.
Points belong to the region that holds their voxel's centre, so the result does not depend on how
the survey is cut. Rasters are made only where enough detections coincide.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M
from spl_batch.geiger.coincidence.settings import (
    ArraySettings,
    BridgeSignSettings,
    CoincidenceSettings,
)
from spl_batch.geiger.coincidence.surface.quadratic_fit import (
    NOTHING,
    drop_weaker,
    edge_offset,
    find_surfaces,
    fit_matrix,
)
from spl_batch.geiger.coincidence.surface.voxel_raster import (
    UNIT,
    box_sum,
    deposit_all,
    interrogate,
)
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points
from spl_batch.lattice.tiles import Bounds

BESIDE = 1
"""Voxels beyond half a neighbourhood within which a point's strength is compared [count].

The blur of a target's edge ends half a neighbourhood away: the comparison reaches inside.
"""


class Box(NamedTuple):
    """Half-open box of voxels of the absolute lattice."""

    low: NDArray[np.int64]
    high: NDArray[np.int64]


class Scene(NamedTuple):
    """What a region is made from."""

    frames: Frames  #: Those that look at the region.
    detections: Detections  #: All of these frames, in their order.
    xyz: NDArray[np.int64]  #: (n, 3): detections near the region [quanta].
    edge_q: int


def reach_q(chosen: CoincidenceSettings, array: ArraySettings) -> int:
    """How far around a region its detections are needed [quanta]."""
    return (halo(chosen) + 2) * chosen.voxel_quanta(array)


def halo(chosen: CoincidenceSettings) -> int:
    """Voxels around a region in which there may be something that decides on its points [count]."""
    return min(chosen.windows) + BESIDE + max(chosen.windows)


def coincide(
    frames: Frames,
    detections: Detections,
    region: Bounds,
    chosen: CoincidenceSettings,
    array: ArraySettings,
) -> Points:
    """Points of the voxels whose centres lie in a region: in order of x, y, z.

    ``frames``: all that look at the region; more are no harm. ``detections``: all of these frames,
    in any order. ``region``: what is owned, at all heights [quanta].
    """
    edge = chosen.voxel_quanta(array)
    low = np.array([_first_voxel(region.xmin, edge), _first_voxel(region.ymin, edge)])
    high = np.array([_first_voxel(region.xmax, edge), _first_voxel(region.ymax, edge)])
    reach = halo(chosen) + 1
    voxel = detections.xyz[:, :2] // edge
    near = ((voxel >= low - reach) & (voxel < high + reach)).all(axis=1)
    by_frame = detections.take(np.argsort(detections.frame, kind="stable"))
    scene = Scene(frames, by_frame, detections.xyz[near], edge)
    parts = [_volume(scene, box, chosen, array) for box in _volumes(scene, low, high, chosen)]
    return Points.joined(parts).in_order()


def _first_voxel(edge_of_region: int, edge: int) -> int:
    """First voxel whose centre is not before a place; both in quanta."""
    return -((edge - 2 * edge_of_region) // (2 * edge))


def _volumes(
    scene: Scene, low: NDArray[np.int64], high: NDArray[np.int64], chosen: CoincidenceSettings
) -> Iterator[Box]:
    """Boxes of at most a sub-volume's size that hold everything worth rastering.

    A neighbourhood of w voxels takes weight from places within w + 1 edges, in a block of two by
    two by two cells of that edge. Blocks with too few detections are left out.
    """
    cell = 2 * max(chosen.windows) + 2
    least = chosen.bridge_sign.detections_min
    blocks = _crowded(scene.xyz // (cell * scene.edge_q), least) * cell
    if not len(blocks):
        return
    edge = chosen.volume_voxels
    spread = np.stack(np.meshgrid(*[[0, 2 * cell]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    volumes = np.unique(((blocks[:, None] + spread) // edge).reshape(-1, 3), axis=0)
    for volume in volumes:
        first, last = volume * edge, (volume + 1) * edge
        own = blocks[((blocks + 2 * cell >= first) & (blocks < last)).all(axis=1)]
        start = np.maximum(first, own.min(axis=0) - 1)
        stop = np.minimum(last, own.max(axis=0) + 2 * cell + 1)
        start[:2], stop[:2] = np.maximum(start[:2], low), np.minimum(stop[:2], high)
        if (stop > start).all():
            yield Box(start, stop)


def _crowded(cells: NDArray[np.int64], least: int) -> NDArray[np.int64]:
    """First cells of the blocks of 2 x 2 x 2 cells that hold enough detections: (b, 3)."""
    filled, count = np.unique(cells, axis=0, return_counts=True)
    spread = np.stack(np.meshgrid(*[[0, -1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    blocks = (filled[:, None] + spread).reshape(-1, 3)
    first, place = np.unique(blocks, axis=0, return_inverse=True)
    total = np.zeros(len(first), np.int64)
    np.add.at(total, place.ravel(), np.repeat(count, len(spread)))
    return first[total >= least]


def _volume(scene: Scene, box: Box, chosen: CoincidenceSettings, array: ArraySettings) -> Points:
    """Points of one sub-volume."""
    rules, wide = chosen.rules, max(chosen.windows)
    # Points just outside may be stronger than those inside: they are found as well.
    rim = halo(chosen)
    corner = box.low - rim
    raster = np.zeros(tuple((box.high - box.low + 2 * rim).tolist()), np.int64)
    first, last = (corner - 1) * scene.edge_q, (box.high + rim + 1) * scene.edge_q
    near = ((scene.xyz >= first) & (scene.xyz < last)).all(axis=1)
    deposit_all(scene.xyz[near], scene.edge_q, corner, raster)
    left = np.zeros(raster.shape, np.bool_)
    left[wide:-wide, wide:-wide, wide:-wide] = True
    crowded: dict[int, NDArray[np.int64]] = {}
    for half, least in chosen.windows.items():
        here = left & (_summed(raster, half) >= least * UNIT)
        crowded[half] = np.argwhere(here)
        left &= ~here
    voxel = np.concatenate(list(crowded.values()))
    if not len(voxel):
        return Points.joined([])
    looks, at = _looks(scene, voxel + corner, wide, array)
    parts = [
        _maxima(raster, rows, _summed(looks, half)[tuple((rows + corner - at).T)], half, rules)
        for half, rows in crowded.items()
    ]
    found = _Maxima(*map(np.concatenate, zip(*parts, strict=True)))
    # In the order of the raster, of points alone.
    rows = np.lexsort(voxel.T[::-1])
    rows = rows[found.kind[rows] != NOTHING]
    voxel, found = voxel[rows], found.take(rows)
    own = _strongest(raster.shape, voxel, found, rules)
    own &= ((voxel >= rim) & (voxel < np.array(raster.shape) - rim)).all(axis=1)
    places = (voxel[own] + corner + 0.5 + found.place[own]) * scene.edge_q
    share = found.value[own].astype(np.float32)
    return Points(np.rint(places).astype(np.int64), share, found.kind[own])


def _summed(raster: NDArray[np.int64], half: int) -> NDArray[np.int64]:
    sums = np.empty_like(raster)
    box_sum(raster, half, sums)
    return sums


class _Maxima(NamedTuple):
    """Results of :func:`find_surfaces`."""

    place: NDArray[np.float64]
    normal: NDArray[np.float64]
    value: NDArray[np.float64]
    kind: NDArray[np.uint8]

    def take(self, rows: NDArray[np.intp]) -> "_Maxima":
        """Some of them."""
        return _Maxima(self.place[rows], self.normal[rows], self.value[rows], self.kind[rows])


def _maxima(
    raster: NDArray[np.int64],
    voxel: NDArray[np.int64],
    looks: NDArray[np.int64],
    half: int,
    rules: BridgeSignSettings,
) -> _Maxima:
    n = len(voxel)
    # A thin layer's peak falls as the window grows.
    threshold = (rules.threshold or 0.0) * rules.window_voxels / (2 * half + 1)
    found = _Maxima(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros(n, np.uint8))
    find_surfaces(
        *(raster, looks, voxel, half, fit_matrix(half)),
        *(threshold, rules.looks_min, rules.curvature_ratio, rules.reach_voxels),
        edge_offset(half) if rules.edge_rule else math.inf,
        *found,
    )
    return found


def _strongest(
    shape: tuple[int, ...],
    voxel: NDArray[np.int64],
    found: _Maxima,
    rules: BridgeSignSettings,
) -> NDArray[np.bool_]:
    """Which points nothing stronger before, behind or beside takes the place of: (n,) bool."""
    half = rules.window_voxels // 2
    row_of = np.full(shape, -1, np.int32)
    row_of[tuple(voxel.T)] = np.arange(len(voxel))
    keep = np.empty(len(voxel), np.bool_)
    along = half if rules.strongest_along_normal else -1
    drop_weaker(
        *(voxel, found.place, found.normal, found.value, row_of),
        *(along, half + BESIDE, rules.edge_share, keep),
    )
    return keep


def _looks(
    scene: Scene, voxel: NDArray[np.int64], half: int, array: ArraySettings
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Raster of interrogations around voxels of the lattice, and its first voxel."""
    low, high = voxel.min(axis=0) - half, voxel.max(axis=0) + half + 1
    raster = np.zeros(tuple((high - low).tolist()), np.int64)
    edge_m = scene.edge_q * QUANTUM_M
    rows = looking_at(scene.frames, array, (low - 1) * edge_m, (high + 1) * edge_m)
    frames = scene.frames.take(rows)
    interrogate(
        frames.origin_m,
        frames.turn,
        scene.detections.of_frames(frames).ranges_m(frames, array),
        math.tan(array.ifov_rad),
        np.array([array.gate_start_m, array.gate_stop_m]),
        edge_m,
        low,
        raster,
    )
    return raster, low


def looking_at(
    frames: Frames,
    array: ArraySettings,
    low_m: NDArray[np.float64],
    high_m: NDArray[np.float64],
) -> NDArray[np.intp]:
    """Rows of frames of which a look may cross a box, whose corners are (3,) each [m]: (k,) intp.

    Lines of sight that point downwards cross a height within the quadrilateral of the image's
    corners; frames with a corner that does not are always among them.
    """
    tangent = math.tan(array.ifov_rad)
    across, along = 0.5 * array.rows * tangent, 0.5 * array.columns * tangent
    corners = np.array([[x, y, -1.0] for x in (-across, across) for y in (-along, along)])
    way = np.einsum("fij,cj->fci", frames.turn, corners)
    down = np.minimum(way[..., 2], -1e-6)
    near = np.ones(len(frames), np.bool_)
    for axis in range(2):
        cross = np.stack(
            [
                frames.origin_m[:, None, axis]
                + way[..., axis] / down * (height - frames.origin_m[:, None, 2])
                for height in (low_m[2], high_m[2])
            ]
        )
        near &= (cross.min(axis=(0, 2)) <= high_m[axis]) & (cross.max(axis=(0, 2)) >= low_m[axis])
    return np.flatnonzero(near | (way[..., 2] > -1e-6).any(axis=1))


def sight_error(frames: Frames, detections: Detections, array: ArraySettings) -> float:
    """How far detections lie from their lines of sight: median [fields of view of a detector].

    Detections come in order of their frames; those of other frames are left out, and 0 is none.
    """
    own = detections.of_frames(frames)
    if not len(own):
        return 0.0
    row = np.searchsorted(frames.number, own.frame)
    away = own.xyz * QUANTUM_M - frames.origin_m[row]
    body = np.einsum("nji,nj->ni", frames.turn[row], away)
    at = body[:, :2] / -body[:, 2:]
    place = np.stack(np.divmod(own.detector, array.columns), axis=-1)
    middle = 0.5 * (np.array([array.rows, array.columns]) - 1)
    off = at - (place - middle) * math.tan(array.ifov_rad)
    return float(np.median(np.hypot(off[:, 0], off[:, 1])) / array.ifov_rad)
