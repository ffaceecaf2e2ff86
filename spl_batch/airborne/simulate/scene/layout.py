"""A scene laid out: everything random is drawn, everything is in arrays."""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.objects import (
    FACES,
    Listed,
    box_of,
    bridge_solid,
    building_solid,
    crowns_of,
    deck,
    random_buildings,
    strands_of,
    tower_solid,
)
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.scene.scene_file import Building, Scene
from spl_batch.airborne.simulate.scene.terrain import APRON_M, make_ground

CELL_M = 4.0
"""Edge of the cells that list objects [m]."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A scene in arrays, and what was placed in it."""

    arrays: SceneArrays
    buildings: tuple[Building, ...]  #: All of them, random ones included.
    #: For each wire, which entry of the scene's ``wires`` it belongs to.
    wire_line: tuple[int, ...]

    @property
    def footprints(self) -> list[shapely.Polygon]:
        """Outlines of the buildings, in metres from the scene's origin."""
        return [box_of(building).outline for building in self.buildings]


def steepest_rad(scene: Scene) -> float:
    """Angle off nadir that no beamlet exceeds [rad]."""
    sensor = scene.instrument
    array = sensor.array_columns * sensor.beamlet_pitch_urad * 1e-6
    return math.radians(sensor.half_cone_deg + 2 * scene.acquisition.wobble_deg + 0.5) + array


def lay_out(scene: Scene) -> Layout:
    """Draw everything random of a scene and put it into arrays."""
    rng, lean = scene.chance(0), math.tan(steepest_rad(scene))
    ground = make_ground(scene, rng, lean)
    taken: list[shapely.Geometry] = [shapely.Polygon(w.ring_m).buffer(2.0) for w in scene.water]
    for wires in scene.wires:
        width = wires.conductors * wires.spacing_m / 2 + 3.0
        taken.append(shapely.LineString(wires.points_m).buffer(width))
    taken.extend(deck(bridge).outline.buffer(2.0) for bridge in scene.bridges)
    buildings = random_buildings(scene, rng, taken)
    solids = [building_solid(b, ground) for b in buildings]
    solids.extend(bridge_solid(bridge, ground) for bridge in scene.bridges)
    for wires in scene.wires:
        solids.extend(tower_solid(x, y, wires, ground) for x, y in wires.points_m)
    crowns = crowns_of(scene, ground, rng, taken)
    strands = [strands_of(wires, ground) for wires in scene.wires]
    wires_of = [strand for line in strands for strand in line]
    arrays = SceneArrays(
        ground,
        np.array([s.planes for s in solids]).reshape(-1, FACES, 4),
        _rows(solids, 4),
        _rows(crowns, 8),
        _rows(wires_of, 10),
        *_cell_lists(scene, [*solids, *crowns, *wires_of], float(ground.z.min()), lean),
    )
    lines = (k for k, line in enumerate(strands) for _ in line)
    return Layout(arrays, tuple(buildings), tuple(lines))


def _rows(objects: list[Listed], columns: int) -> NDArray[np.float64]:
    return np.array([one.row for one in objects], dtype=np.float64).reshape(-1, columns)


def _cell_lists(
    scene: Scene, objects: list[Listed], floor_m: float, lean: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Which objects a ray may meet whose ground hit, no lower than the floor, lies in a cell."""
    corner = -math.ceil(APRON_M / CELL_M) * CELL_M
    nx, ny = (math.ceil((size - 2 * corner) / CELL_M) for size in scene.extent_m)
    cell = np.array([corner, corner, CELL_M])
    if not objects:
        return cell, np.zeros((ny, nx + 1), dtype=np.int64), np.empty(0, dtype=np.int64)
    tree = shapely.STRtree(
        [one.shape.buffer(one.reach_m + (one.top_m - floor_m) * lean + 1.0) for one in objects]
    )
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
