"""A scene laid out: everything random is drawn, everything is in arrays."""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.objects import (
    FACES,
    Solid,
    bridge_solid,
    building_solid,
    crown_rows,
    deck_outline,
    ground_at,
    outline,
    random_buildings,
    tower_solid,
    wire_rows,
)
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.scene.scene_file import Building, Scene
from spl_batch.airborne.simulate.scene.terrain import APRON_M, Ground, make_ground

STEEPEST = 0.7
"""Slope times tangent off nadir from which on beams are followed down to the ground."""

CELL_M = 4.0
"""Edge of the cells that list objects [m]."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A scene in arrays, and what was placed in it."""

    arrays: SceneArrays
    buildings: tuple[Building, ...]  #: All of them, random ones included.
    crowns: int
    wires: int
    #: For each wire, which entry of the scene's ``wires`` it belongs to.
    wire_line: tuple[int, ...]


def steepest_rad(scene: Scene) -> float:
    """Angle off nadir that no beamlet exceeds [rad]."""
    sensor = scene.instrument
    array = sensor.array_columns * sensor.beamlet_pitch_urad * 1e-6
    return math.radians(sensor.half_cone_deg + 2 * scene.acquisition.wobble_deg + 0.5) + array


def lay_out(scene: Scene) -> Layout:
    """Draw everything random of a scene and put it into arrays.

    ``scene``: the scene; the same one gives the same layout.
    """
    rng = np.random.default_rng(np.random.SeedSequence(scene.seed, spawn_key=(0,)))
    ground = make_ground(scene, rng)
    taken: list[shapely.Geometry] = [shapely.Polygon(w.ring_m).buffer(2.0) for w in scene.water]
    for wires in scene.wires:
        width = wires.conductors * wires.spacing_m / 2 + 3.0
        taken.append(shapely.LineString(wires.points_m).buffer(width))
    taken.extend(deck_outline(bridge).buffer(2.0) for bridge in scene.bridges)
    buildings = random_buildings(scene, rng, taken)
    solids = [building_solid(b, ground) for b in buildings]
    solids.extend(bridge_solid(bridge, ground) for bridge in scene.bridges)
    for wires in scene.wires:
        solids.extend(tower_solid(x, y, ground_at(ground, x, y), wires) for x, y in wires.points_m)
    crowns = crown_rows(scene, ground, rng, taken)
    strands = [(k, row) for k, wires in enumerate(scene.wires) for row in wire_rows(wires, ground)]
    arrays = _arrays(scene, ground, solids, crowns, [row for _, row in strands])
    return Layout(arrays, tuple(buildings), len(crowns), len(strands), tuple(k for k, _ in strands))


def _arrays(
    scene: Scene,
    ground: Ground,
    solids: list[Solid],
    crowns: list[tuple[float, ...]],
    wires: list[tuple[float, ...]],
) -> SceneArrays:
    planes = np.zeros((len(solids), FACES, 4))
    for k, solid in enumerate(solids):
        planes[k, : len(solid.planes)] = solid.planes
    crown = np.array(crowns, dtype=np.float64).reshape(-1, 8)
    wire = np.array(wires, dtype=np.float64).reshape(-1, 10)
    lean = math.tan(steepest_rad(scene))
    floor = float(ground.z.min())
    shapes = [s.outline.buffer((s.top_m - floor) * lean + 1.0) for s in solids]
    shapes += [
        shapely.Point(c[0], c[1]).buffer(c[3] + (c[2] + c[4] - floor) * lean + 1.0) for c in crown
    ]
    shapes += [_wire_shape(w, floor, lean) for w in wire]
    cell, first, item = _cell_lists(scene, shapes)
    return SceneArrays(
        ground.z,
        ground.rho,
        ground.kind,
        ground.pond_at,
        ground.ponds,
        ground.grid,
        planes,
        np.array([len(s.planes) for s in solids], dtype=np.int64),
        np.array([s.row for s in solids], dtype=np.float64).reshape(-1, 4),
        crown,
        wire,
        cell,
        first,
        item,
        _steep_top(ground, lean),
    )


def _steep_top(ground: Ground, lean: float) -> float:
    """Highest ground where some is so steep that a beam may meet it twice, else -inf [m]."""
    rise = max(float(np.abs(np.diff(ground.z, axis=axis)).max(initial=0.0)) for axis in (0, 1))
    return float(ground.z.max()) if rise * lean > STEEPEST * ground.grid[2] else -math.inf


def _wire_shape(w: NDArray[np.float64], floor: float, lean: float) -> shapely.Geometry:
    ends = [(w[0] + s * w[2], w[1] + s * w[3]) for s in (0.0, w[4])]
    top = w[7] + w[5] * math.cosh(max(abs(w[6]), abs(w[4] - w[6])) / w[5])
    return shapely.LineString(ends).buffer((top - floor) * lean + 1.0)


def _cell_lists(
    scene: Scene, shapes: list[shapely.Geometry]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Which objects a ray may meet whose ground hit lies in a cell."""
    corner = -math.ceil(APRON_M / CELL_M) * CELL_M
    nx, ny = (math.ceil((size - 2 * corner) / CELL_M) for size in scene.extent_m)
    cell = np.array([corner, corner, CELL_M])
    if not shapes:
        return cell, np.zeros((ny, nx + 1), dtype=np.int64), np.empty(0, dtype=np.int64)
    tree = shapely.STRtree(shapes)
    west = corner + CELL_M * np.arange(nx)
    first, items, before = np.empty((ny, nx + 1), dtype=np.int64), [], 0
    for row in range(ny):  # a whole survey's cells as polygons would take gigabytes
        south = corner + CELL_M * row
        boxes = shapely.box(west, south, west + CELL_M, south + CELL_M)
        owners, found = tree.query(boxes, predicate="intersects")
        order = np.lexsort((found, owners))
        first[row] = before + np.searchsorted(owners[order], np.arange(nx + 1))
        items.append(found[order].astype(np.int64))
        before += len(found)
    return cell, first, np.concatenate(items)


def footprints(buildings: tuple[Building, ...]) -> list[shapely.Polygon]:
    """Outlines of buildings, in metres from the scene's origin."""
    return [outline(b) for b in buildings]
