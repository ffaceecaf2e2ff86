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
from spl_batch.geiger.coincidence.settings import ArraySettings, CoincidenceSettings
from spl_batch.geiger.coincidence.surface import quadratic_fit as fits
from spl_batch.geiger.coincidence.surface import voxel_raster as rasters
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points
from spl_batch.lattice.tiles import Bounds

BESIDE = 1
"""Voxels beyond half a neighbourhood, where an edge's blur ends, that points are compared in."""


class Scene(NamedTuple):
    """What a region is made from."""

    frames: Frames  #: Those that look at the region.
    detections: Detections  #: All of these frames.
    xyz: NDArray[np.int64]  #: (n, 3): detections near the region [quanta].
    edge_q: int
    chosen: CoincidenceSettings
    array: ArraySettings


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
    scene = Scene(frames, detections, detections.xyz[near], edge, chosen, array)
    return Points.joined([_volume(scene, *box) for box in _volumes(scene, low, high)]).in_order()


def _first_voxel(edge_of_region: int, edge: int) -> int:
    """First voxel whose centre is not before a coordinate; both in quanta."""
    return -((edge - 2 * edge_of_region) // (2 * edge))


def _volumes(
    scene: Scene, low: NDArray[np.int64], high: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """First and last voxels of sub-volumes that hold everything worth rastering.

    A neighbourhood of w voxels takes weight from detections within w + 1 edges, in a cube of two by
    two by two cells of that edge. Cubes with too few detections are left out.
    """
    cell, edge = 2 * max(scene.chosen.windows) + 2, scene.chosen.volume_voxels
    least = scene.chosen.bridge_sign.detections_min
    cubes = _crowded(scene.xyz // (cell * scene.edge_q), least) * cell
    spread = np.stack(np.meshgrid(*[[0, 2 * cell]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    volumes = np.unique(((cubes[:, None] + spread) // edge).reshape(-1, 3), axis=0)
    for volume in volumes:
        first, last = volume * edge, (volume + 1) * edge
        own = cubes[((cubes + 2 * cell >= first) & (cubes < last)).all(axis=1)]
        start = np.maximum(first, own.min(axis=0) - 1)
        stop = np.minimum(last, own.max(axis=0) + 2 * cell + 1)
        start[:2], stop[:2] = np.maximum(start[:2], low), np.minimum(stop[:2], high)
        if (stop > start).all():
            yield start, stop


def _crowded(cells: NDArray[np.int64], least: int) -> NDArray[np.int64]:
    """First cells of the cubes of 2 x 2 x 2 cells that hold enough detections: (b, 3)."""
    filled, count = np.unique(cells, axis=0, return_counts=True)
    spread = np.stack(np.meshgrid(*[[0, -1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cubes = (filled[:, None] + spread).reshape(-1, 3)
    first, inverse = np.unique(cubes, axis=0, return_inverse=True)
    total = np.bincount(inverse.ravel(), np.repeat(count, len(spread)), len(first))
    return first[total >= least]


def _volume(scene: Scene, low: NDArray[np.int64], high: NDArray[np.int64]) -> Points:
    """Points of one sub-volume."""
    chosen, rules, wide = scene.chosen, scene.chosen.rules, max(scene.chosen.windows)
    # Points just outside may be stronger than those inside: they are found as well. A raster's
    # outermost voxels are incomplete.
    rim, inner = halo(chosen) + 1, slice(wide + 1, -wide - 1)
    corner = low - rim
    raster = np.zeros(tuple((high - low + 2 * rim).tolist()), np.int64)
    first, last = (corner - 1) * scene.edge_q, (high + rim + 1) * scene.edge_q
    near = ((scene.xyz >= first) & (scene.xyz < last)).all(axis=1)
    rasters.deposit_all(scene.xyz[near], scene.edge_q, corner, raster)
    left = np.zeros(raster.shape, np.bool_)
    left[inner, inner, inner] = True
    crowded: dict[int, NDArray[np.int64]] = {}
    for half, least in chosen.windows.items():
        here = left & (rasters.box_sum(raster, half) >= least * rasters.UNIT)
        crowded[half] = np.argwhere(here)
        left &= ~here
    voxel = np.concatenate(list(crowded.values()))
    if not len(voxel):
        return Points.joined([])
    looks, at = _looks(scene, voxel + corner, wide + 1)
    parts = []
    for half, rows in crowded.items():
        summed = rasters.box_sum(looks, half)[tuple((rows + corner - at).T)]
        # A thin layer's peak falls as the window grows.
        threshold = (rules.threshold or 0.0) * rules.window_voxels / (2 * half + 1)
        limits = threshold, rules.looks_min, rules.curvature_ratio, rules.reach_voxels
        off_centre = fits.edge_offset(half) if rules.edge_rule else math.inf
        window = half, fits.fit_matrix(half)
        parts.append(fits.find_surfaces(raster, summed, rows, *window, *limits, off_centre))
    found = [np.concatenate(part) for part in zip(*parts, strict=True)]
    # In the order of the raster, of points alone.
    rows = np.lexsort(voxel.T[::-1])
    rows = rows[found[-1][rows] != fits.NOTHING]
    voxel, (offset, normal, value, kind) = voxel[rows], (values[rows] for values in found)
    row_of = np.full(raster.shape, -1, np.int32)
    row_of[tuple(voxel.T)] = np.arange(len(voxel))
    half = rules.window_voxels // 2
    along = half if rules.strongest_along_normal else -1
    reach = half + BESIDE
    own = fits.drop_weaker(voxel, offset, normal, value, row_of, along, reach, rules.edge_share)
    own &= ((voxel >= rim) & (voxel < np.array(raster.shape) - rim)).all(axis=1)
    xyz = (voxel[own] + corner + 0.5 + offset[own]) * scene.edge_q
    return Points(np.rint(xyz).astype(np.int64), value[own].astype(np.float32), kind[own])


def _looks(
    scene: Scene, voxel: NDArray[np.int64], half: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Raster of interrogations around voxels of the lattice, and its first voxel."""
    low, high = voxel.min(axis=0) - half, voxel.max(axis=0) + half + 1
    raster = np.zeros(tuple((high - low).tolist()), np.int64)
    array, edge_m = scene.array, scene.edge_q * QUANTUM_M
    rows = looking_at(scene.frames, array, (low - 1) * edge_m, (high + 1) * edge_m)
    frames = scene.frames.take(rows)
    seen = scene.detections.ranges_m(frames, array)
    gate = np.array([array.gate_start_m, array.gate_stop_m])
    look = frames.origin_m, frames.turn, seen, math.tan(array.ifov_rad), gate
    rasters.interrogate(*look, edge_m, low, raster)
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
    run = way[..., :2] / np.minimum(way[..., 2:], -1e-6)
    rise = np.array([low_m[2], high_m[2]])[:, None, None, None] - frames.origin_m[:, None, 2:]
    cross = frames.origin_m[:, None, :2] + run * rise
    near = (cross.min(axis=(0, 2)) <= high_m[:2]) & (cross.max(axis=(0, 2)) >= low_m[:2])
    return np.flatnonzero(near.all(axis=1) | (way[..., 2] > -1e-6).any(axis=1))


def sight_error(frames: Frames, detections: Detections, array: ArraySettings) -> float:
    """How far detections lie from their lines of sight: median [fields of view of a detector].

    Detections of other frames are left out, and 0 is none.
    """
    own, row, away = detections.seen_from(frames)
    if not len(own):
        return 0.0
    body = np.einsum("nji,nj->ni", frames.turn[row], away)
    at = body[:, :2] / -body[:, 2:]
    pixel = np.stack(np.divmod(own.detector, array.columns), axis=-1)
    middle = 0.5 * (np.array([array.rows, array.columns]) - 1)
    off = at - (pixel - middle) * math.tan(array.ifov_rad)
    return float(np.median(np.hypot(off[:, 0], off[:, 1])) / array.ifov_rad)
