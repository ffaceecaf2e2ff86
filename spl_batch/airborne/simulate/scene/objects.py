"""Buildings, trees, towers and wires of a scene, as rows of arrays."""

import math
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.optimize import brentq

from spl_batch.airborne.simulate.scene.ray_trace import KIND_OTHER, KIND_ROOF, bilinear
from spl_batch.airborne.simulate.scene.scene_file import Bridge, Building, Scene, Wires
from spl_batch.airborne.simulate.scene.terrain import Ground

FACES = 6
"""Half-spaces of the most complicated solid."""


class Solid(NamedTuple):
    """A convex solid before it becomes rows."""

    planes: NDArray[np.float64]
    row: tuple[float, float, float, float]
    outline: shapely.Polygon
    top_m: float


def ground_at(ground: Ground, x: float, y: float) -> float:
    """Height of the ground at a place [m]."""
    return float(bilinear(ground.z, ground.grid, x, y)[0])


def random_buildings(
    scene: Scene, rng: np.random.Generator, taken: list[shapely.Geometry]
) -> list[Building]:
    """Buildings at random places that touch nothing; appended to ``taken``.

    ``scene``: the scene; its explicit buildings come first. ``taken``: areas that are not free.
    """
    found = list(scene.buildings.items)
    taken.extend(outline(b).buffer(3.0) for b in found)
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
            shape = outline(candidate).buffer(3.0)
            if not any(shape.intersects(other) for other in taken):
                found.append(candidate)
                taken.append(shape)
                break
    return found


def _inside(rng: np.random.Generator, extent: float, margin: float) -> float:
    return float(rng.uniform(min(margin, extent / 2), max(extent - margin, extent / 2)))


def outline(building: Building) -> shapely.Polygon:
    """Footprint of a building, in metres from the scene's origin."""
    along, across = _axes(building)
    half_l, half_w = building.size_m[0] / 2, building.size_m[1] / 2
    corners = [
        np.array(building.centre_m) + a * half_l * along + b * half_w * across
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return shapely.Polygon(corners)


def _axes(building: Building) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    heading = math.radians(building.heading_deg)
    along = np.array([math.sin(heading), math.cos(heading)])
    return along, np.array([along[1], -along[0]])


def building_solid(building: Building, ground: Ground) -> Solid:
    """Walls and roof of a building as half-spaces.

    ``ground``: stands below it; the eaves count from the highest ground at the corners.
    """
    along, across = _axes(building)
    centre = np.array(building.centre_m)
    half_l, half_w = building.size_m[0] / 2, building.size_m[1] / 2
    shape = outline(building)
    eave = building.eave_m + max(ground_at(ground, x, y) for x, y in shape.exterior.coords)
    planes = [
        _wall(axis, float(axis @ centre) + half)
        for axis, half in ((along, half_l), (-along, half_l), (across, half_w), (-across, half_w))
    ]
    tilt = math.radians(building.pitch_deg if building.roof != "flat" else 0.0)
    sides = {"flat": (0.0,), "shed": (1.0,), "gable": (1.0, -1.0)}[building.roof]
    for side in sides:
        normal = np.array([*(side * math.sin(tilt) * across), math.cos(tilt)])
        edge = np.array([*(centre + side * half_w * across), eave])
        planes.append(np.array([*normal, float(normal @ edge)]))
    rise = {"flat": 0.0, "gable": half_w, "shed": 2 * half_w}[building.roof] * math.tan(tilt)
    row = (0.0, building.reflectance, float(KIND_ROOF), float(KIND_OTHER))
    return Solid(np.array(planes), row, shape, eave + rise)


def _wall(axis: NDArray[np.float64], offset: float) -> NDArray[np.float64]:
    return np.array([axis[0], axis[1], 0.0, offset])


def bridge_solid(bridge: Bridge, ground: Ground) -> Solid:
    """Deck of a bridge, from the ground at one end to that at the other."""
    start, end = (np.array(place) for place in bridge.ends_m)
    heights = [ground_at(ground, *place) for place in (start, end)]
    span = float(np.hypot(*(end - start)))
    along = (end - start) / span
    across = np.array([along[1], -along[0]])
    rise = (heights[1] - heights[0]) / span
    top = np.array([*(-rise * along), 1.0]) / math.hypot(rise, 1.0)
    offset = float(top @ [*start, heights[0]])
    planes = [
        _wall(along, float(along @ end)),
        _wall(-along, float(-along @ start)),
        *(_wall(side, float(side @ start) + bridge.width_m / 2) for side in (across, -across)),
        np.array([*top, offset]),
        np.array([*-top, bridge.thickness_m - offset]),
    ]
    row = (0.0, bridge.reflectance, float(KIND_OTHER), float(KIND_OTHER))
    return Solid(np.array(planes), row, deck_outline(bridge), max(heights))


def deck_outline(bridge: Bridge) -> shapely.Polygon:
    """Footprint of a bridge's deck, in metres from the scene's origin."""
    line = shapely.LineString(bridge.ends_m)
    return line.buffer(bridge.width_m / 2, cap_style="flat")


def tower_solid(x: float, y: float, base_m: float, wires: Wires) -> Solid:
    """A tower or pole: a slim pyramid, turbid because a lattice is.

    Parameters
    ----------
    x, y, base_m : float
        Place, and height of the ground there [m].
    """
    lattice = wires.kind == "transmission"
    foot, tip, extinction = (2.5, 0.8, 0.15) if lattice else (0.2, 0.12, 5.0)
    height = wires.height_m + (5.0 if wires.shield else 0.3)
    lean = (foot - tip) / height
    scale = 1 / math.hypot(1.0, lean)
    planes = [np.array([0.0, 0.0, 1.0, base_m + height])]
    for ux, uy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        offset = ux * x + uy * y + foot + lean * base_m
        planes.append(np.array([ux, uy, lean, offset]) * scale)
    shape = shapely.box(x - foot, y - foot, x + foot, y + foot)
    row = (extinction, 0.3, float(KIND_OTHER), float(KIND_OTHER))
    return Solid(np.array(planes), row, shape, base_m + height)


def wire_rows(wires: Wires, ground: Ground) -> list[tuple[float, ...]]:
    """Conductors and shield of every span as catenaries.

    Returns
    -------
    list of tuple
        Rows of :attr:`~spl_batch.airborne.simulate.scene.ray_trace.SceneArrays.wire`.
    """
    middle = (wires.conductors - 1) / 2
    strands = [((k - middle) * wires.spacing_m, 0.0, wires.diameter_m, wires.sag_m)
               for k in range(wires.conductors)]  # fmt: skip
    if wires.shield:
        strands.append((0.0, 5.0, wires.shield_diameter_m, 0.8 * wires.sag_m))
    rows: list[tuple[float, ...]] = []
    for (x0, y0), (x1, y1) in zip(wires.points_m[:-1], wires.points_m[1:], strict=True):
        span = math.hypot(x1 - x0, y1 - y0)
        ux, uy = (x1 - x0) / span, (y1 - y0) / span
        z0 = ground_at(ground, x0, y0) + wires.height_m
        z1 = ground_at(ground, x1, y1) + wires.height_m
        for aside, above, diameter, sag in strands:
            a, vertex, offset = catenary(span, z0 + above, z1 + above, sag)
            start = (x0 + aside * uy, y0 - aside * ux)
            rows.append((*start, ux, uy, span, a, vertex, offset, diameter / 2, wires.reflectance))
    return rows


def catenary(span_m: float, z0_m: float, z1_m: float, sag_m: float) -> tuple[float, float, float]:
    """Catenary through two ends with a given sag at mid-span.

    Returns
    -------
    a, vertex, offset : float
        z(s) = offset + a cosh((s - vertex) / a) [m].
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


def crown_rows(
    scene: Scene, ground: Ground, rng: np.random.Generator, taken: list[shapely.Geometry]
) -> list[tuple[float, ...]]:
    """Crowns on free places until the asked cover is reached.

    Parameters
    ----------
    ground : Ground
        The trees stand on it, never in water.
    taken : list of geometries
        Areas that are not free.

    Returns
    -------
    list of tuple
        Rows of :attr:`~spl_batch.airborne.simulate.scene.ray_trace.SceneArrays.crown`.
    """
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
    return rows
