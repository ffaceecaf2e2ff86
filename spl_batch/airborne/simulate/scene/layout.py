"""A scene laid out: everything random is drawn, and objects are rows of arrays."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import brentq

from spl_batch.airborne.simulate.scene.landscape import Bridge, Building, Wires
from spl_batch.airborne.simulate.scene.ray_trace import (
    KIND_OTHER,
    KIND_ROOF,
    Ground,
    SceneArrays,
    bilinear,
)
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.simulate.scene.terrain import make_ground

CELL_M = 4.0
"""Edge of the cells that list objects [m]."""

FACES = 6
"""Half-spaces of the most complicated solid."""


class Box(NamedTuple):
    """A footprint: a rectangle, in metres from the scene's origin."""

    centre: NDArray[np.float64]
    along: NDArray[np.float64]  #: (2,): unit vector of its length.
    half_m: tuple[float, float]  #: Half its length and width.

    @property
    def sides(self) -> list[tuple[NDArray[np.float64], float]]:
        """Unit normal and distance from the centre of each side [m]."""
        across = np.array([self.along[1], -self.along[0]])
        pairs = zip((self.along, across), self.half_m, strict=True)
        return [(sign * axis, half) for axis, half in pairs for sign in (1.0, -1.0)]

    @property
    def outline(self) -> shapely.Polygon:
        """Its four corners."""
        (along, half_l), _, (across, half_w), _ = self.sides
        corners = [
            self.centre + a * half_l * along + b * half_w * across
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        return shapely.Polygon(corners)


class Listed(NamedTuple):
    """An object as a row of an array, and what of the ground it hides from slanted beams."""

    row: tuple[float, ...]
    shape: shapely.Geometry  #: Its footprint, less ``reach_m`` all around.
    reach_m: float
    top_m: float
    planes: NDArray[np.float64] = np.empty((0, 4))  #: Half-spaces of a solid.


def solid(
    box: Box, caps: list[NDArray[np.float64]], row: tuple[float, ...], top_m: float,
    lean: float = 0.0, foot_m: float = 0.0,
) -> Listed:  # fmt: skip
    """Convex solid: caps (4,) above a box, whose walls lean inwards from the height of its foot."""
    planes = np.zeros((FACES, 4))
    planes[:, 3] = np.inf
    scale = 1 / math.hypot(1.0, lean)
    for k, (axis, half) in enumerate(box.sides):
        offset = float(axis @ box.centre) + half + lean * foot_m
        planes[k] = np.array([*axis, lean, offset]) * scale
    planes[4 : 4 + len(caps)] = caps
    return Listed(row, box.outline, 0.0, top_m, planes)


def ground_at(ground: Ground, x: float, y: float) -> float:
    """Height of the ground at a place [m]."""
    return float(bilinear(ground.z, ground.grid, x, y)[0])


def random_buildings(
    scene: Scene, rng: np.random.Generator, taken: list[shapely.Geometry]
) -> list[Building]:
    """Buildings of a scene, then random ones that touch nothing ``taken``; appended to it."""
    found = list(scene.buildings.items)
    taken.extend(box_of(b).outline.buffer(3.0) for b in found)
    roofs = ("flat", "gable", "shed")
    for k in range(scene.buildings.count):
        for _ in range(200):
            size = (rng.uniform(12, 24), rng.uniform(8, 14))
            reach = 0.5 * math.hypot(*size)
            candidate = Building(
                centre_m=tuple(_inside(rng, extent, reach + 2) for extent in scene.extent_m),
                size_m=size,
                heading_deg=rng.uniform(0, 180),
                eave_m=rng.uniform(*scene.buildings.eave_m),
                roof=roofs[k % 3],
                pitch_deg=rng.uniform(15, 35),
                reflectance=rng.uniform(0.1, 0.7),
            )
            shape = box_of(candidate).outline.buffer(3.0)
            if not any(shape.intersects(other) for other in taken):
                found.append(candidate)
                taken.append(shape)
                break
    return found


def _inside(rng: np.random.Generator, extent: float, margin: float) -> float:
    return float(rng.uniform(min(margin, extent / 2), max(extent - margin, extent / 2)))


def box_of(building: Building) -> Box:
    """Footprint of a building."""
    heading = math.radians(building.heading_deg)
    along = np.array([math.sin(heading), math.cos(heading)])
    return Box(np.array(building.centre_m), along, (building.size_m[0] / 2, building.size_m[1] / 2))


def building_solid(building: Building, ground: Ground) -> Listed:
    """A building; its eaves count from the highest ground at the corners."""
    box = box_of(building)
    across, half_w = box.sides[2]
    eave = building.eave_m + max(ground_at(ground, x, y) for x, y in box.outline.exterior.coords)
    tilt = math.radians(building.pitch_deg if building.roof != "flat" else 0.0)
    caps = []
    for side in {"flat": (0.0,), "shed": (1.0,), "gable": (1.0, -1.0)}[building.roof]:
        normal = np.array([*(side * math.sin(tilt) * across), math.cos(tilt)])
        edge = np.array([*(box.centre + side * half_w * across), eave])
        caps.append(np.array([*normal, float(normal @ edge)]))
    rise = {"flat": 0.0, "gable": half_w, "shed": 2 * half_w}[building.roof] * math.tan(tilt)
    row = (0.0, building.reflectance, float(KIND_ROOF), float(KIND_OTHER))
    return solid(box, caps, row, eave + rise)


def deck(bridge: Bridge) -> Box:
    """Footprint of a bridge."""
    start, end = (np.array(place) for place in bridge.ends_m)
    span = float(np.hypot(*(end - start)))
    return Box((start + end) / 2, (end - start) / span, (span / 2, bridge.width_m / 2))


def bridge_solid(bridge: Bridge, ground: Ground) -> Listed:
    """Deck of a bridge, from the ground at one end to that at the other."""
    box = deck(bridge)
    heights = [ground_at(ground, *place) for place in bridge.ends_m]
    rise = (heights[1] - heights[0]) / (2 * box.half_m[0])
    top = np.array([*(-rise * box.along), 1.0]) / math.hypot(rise, 1.0)
    offset = float(top @ [*bridge.ends_m[0], heights[0]])
    caps = [np.array([*top, offset]), np.array([*-top, bridge.thickness_m - offset])]
    row = (0.0, bridge.reflectance, float(KIND_OTHER), float(KIND_OTHER))
    return solid(box, caps, row, max(heights))


def tower_solid(x: float, y: float, wires: Wires, ground: Ground) -> Listed:
    """A tower or pole: a slim pyramid, turbid because a lattice is."""
    lattice = wires.kind == "transmission"
    foot, tip, extinction = (2.5, 0.8, 0.15) if lattice else (0.2, 0.12, 5.0)
    height, base_m = wires.height_m + (5.0 if wires.shield else 0.3), ground_at(ground, x, y)
    box = Box(np.array([x, y]), np.array([1.0, 0.0]), (foot, foot))
    row = (extinction, 0.3, float(KIND_OTHER), float(KIND_OTHER))
    top_m = base_m + height
    lid = np.array([0.0, 0.0, 1.0, top_m])
    return solid(box, [lid], row, top_m, (foot - tip) / height, base_m)


def strands_of(wires: Wires, ground: Ground) -> list[Listed]:
    """Conductors and shield of every span as catenaries."""
    middle = (wires.conductors - 1) / 2
    strands = [((k - middle) * wires.spacing_m, 0.0, wires.diameter_m, wires.sag_m)
               for k in range(wires.conductors)]  # fmt: skip
    if wires.shield:
        strands.append((0.0, 5.0, wires.shield_diameter_m, 0.8 * wires.sag_m))
    found = []
    for (x0, y0), (x1, y1) in zip(wires.points_m[:-1], wires.points_m[1:], strict=True):
        span = math.hypot(x1 - x0, y1 - y0)
        ux, uy = (x1 - x0) / span, (y1 - y0) / span
        z0 = ground_at(ground, x0, y0) + wires.height_m
        z1 = ground_at(ground, x1, y1) + wires.height_m
        for aside, above, diameter, sag in strands:
            a, vertex, offset = catenary(span, z0 + above, z1 + above, sag)
            start = (x0 + aside * uy, y0 - aside * ux)
            row = (*start, ux, uy, span, a, vertex, offset, diameter / 2, wires.reflectance)
            end = (start[0] + span * ux, start[1] + span * uy)
            top_m = offset + a * math.cosh(max(abs(vertex), abs(span - vertex)) / a)
            found.append(Listed(row, shapely.LineString([start, end]), 0.0, top_m))
    return found


def catenary(span_m: float, z0_m: float, z1_m: float, sag_m: float) -> tuple[float, float, float]:
    """Catenary through two ends with a given sag at mid-span.

    Its a, vertex and offset: z(s) = offset + a cosh((s - vertex) / a) [m].
    """
    rise = z1_m - z0_m

    def vertex_of(a: float) -> float:
        return span_m / 2 - a * math.asinh(rise / (2 * a * math.sinh(span_m / (2 * a))))

    def sag_error(log_a: float) -> float:
        a = math.exp(log_a)
        v = vertex_of(a)
        ends = (math.cosh(v / a) + math.cosh((span_m - v) / a)) / 2
        return a * (ends - math.cosh((span_m / 2 - v) / a)) - sag_m

    a = math.exp(float(brentq(sag_error, math.log(span_m / 100), math.log(span_m * 1e4))))
    vertex = vertex_of(a)
    return a, vertex, z0_m - a * math.cosh(vertex / a)


def crowns_of(
    scene: Scene, ground: Ground, rng: np.random.Generator, taken: list[shapely.Geometry]
) -> list[Listed]:
    """Crowns on places that are not taken, never in water, until the asked cover is reached."""
    trees = scene.trees
    rows: list[tuple[float, ...]] = []
    area = scene.extent_m[0] * scene.extent_m[1]
    # Random discs overlap: n of them of mean area m cover 1 - exp(-n m / area).
    wanted, planted, tries = -math.log1p(-trees.cover) * area, 0.0, 0
    free = shapely.unary_union(taken) if taken else shapely.Point()
    shapely.prepare(free)
    while planted < wanted and tries < 100_000:
        tries += 1
        x, y = (float(rng.uniform(0, extent)) for extent in scene.extent_m)
        radius = float(rng.uniform(*trees.radius_m))
        height = float(rng.uniform(*trees.height_m))
        shrub = rng.random() < trees.understory
        if shapely.intersects(free, shapely.Point(x, y).buffer(0.7 * radius)):
            continue
        base = ground_at(ground, x, y)
        half = 0.5 * trees.crown_share * height
        look = (trees.extinction_per_m, trees.reflectance, trees.gaps)
        rows.append((x, y, base + height - half, radius, half, *look))
        if shrub:
            rows.append((x, y, base + 0.6, 0.6 * radius, 0.9, *look))
        planted += math.pi * radius**2
    return [Listed(r, shapely.Point(r[0], r[1]), r[3], r[2] + r[4]) for r in rows]


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
    corner = -math.ceil(scene.terrain.apron_m / CELL_M) * CELL_M
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
