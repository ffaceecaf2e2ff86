"""Companions of the flightlines: trajectory, reference, checkpoints, truth, workflow."""

import json
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.airborne.simulate.air import VOXEL_M, NoiseGrid
from spl_batch.airborne.simulate.file_writers import (
    add_points,
    cloud_writer,
    folder_of,
    las_header,
    sbet_records,
    write_polygons,
)
from spl_batch.airborne.simulate.flight import Pass
from spl_batch.airborne.simulate.scene.beam_layers import linear_returns, surfaces_at
from spl_batch.airborne.simulate.scene.layout import Layout
from spl_batch.airborne.simulate.scene.ray_trace import (
    KIND_GROUND,
    KIND_ROOF,
    KIND_WATER,
    SceneArrays,
)
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.constants import CLASS_BUILDING, CLASS_GROUND, CLASS_UNCLASSIFIED, CLASS_WATER
from spl_batch.formats.files.atomic import replacing, write_bytes
from spl_batch.formats.rasters.geotiff import write_cog

AT_ONCE: Final = 250_000
"""Pulses of the reference, or cells of the rasters, that are made at once [count]."""

TRIED: Final = 100
"""Locations that are tried for each checkpoint on open ground [count]."""

REFLECTANCE_SAMPLES: Final = 4
"""Locations along one side of a cell whose reflectance is averaged [count]."""


def deliver(
    scene: Scene, arrays: SceneArrays, grid: NoiseGrid, layout: Layout, passes: list[Pass],
    out: Path,
) -> dict[str, Any]:  # fmt: skip
    """Write everything but the flightlines; the content of a workflow for it."""
    _noise_density(scene, grid, out / "truth" / "noise_density.npz")
    _trajectory(scene, passes, out)
    _reference(scene, arrays, out / "reference_lml.laz")
    _checkpoints(scene, arrays, layout, out / "checkpoints.csv")
    _rasters(scene, arrays, out / "truth")
    east, north = scene.origin_m[:2]
    if scene.water:
        rings = [[(x + east, y + north) for x, y in water.ring_m] for water in scene.water]
        write_polygons(out / "water.gpkg", [shapely.Polygon(ring) for ring in rings], scene.crs)
    if scene.delivery.aoi:
        extent = shapely.box(east, north, east + scene.extent_m[0], north + scene.extent_m[1])
        write_polygons(out / "aoi.gpkg", [extent], scene.crs)
    truth = {
        "scene": scene.model_dump(mode="json", by_alias=True),
        "buildings": [b.model_dump(mode="json") for b in layout.buildings],
        "building_outlines": [
            [[x + east, y + north] for x, y in shape.exterior.coords] for shape in layout.footprints
        ],
        "crowns": len(arrays.crown),
        "wires": arrays.wire.tolist(),
        "wire_columns": ["x", "y", "ux", "uy", "span", "a", "vertex", "offset", "radius", "rho"],
    }
    write_bytes(out / "truth" / "scene.json", (json.dumps(truth, indent=1) + "\n").encode())
    return _workflow(scene)


def _noise_density(scene: Scene, grid: NoiseGrid, path: Path) -> None:
    """Expected background per cubic metre on the 10 m lattice."""
    corner = np.rint((grid.corner + np.array([*scene.origin_m[:2], 0.0])) / VOXEL_M)
    density = (grid.amount / VOXEL_M**3).astype(np.float32)
    # a file object: given a name, numpy would put .npz behind it
    with replacing(path) as part, part.open("wb") as file:
        np.savez_compressed(file, density=density, corner=corner.astype(np.int64), voxel_m=VOXEL_M)


def _trajectory(scene: Scene, passes: list[Pass], out: Path) -> None:
    records, tables, hz = [], [], scene.delivery.trajectory_hz
    for run in passes:
        first = math.floor(run.start_s) - 1
        last = math.ceil(run.middle_s + run.half_s) + 3
        time_s = first + np.arange(round((last - first) * hz) + 1) / hz
        xyz = run.position(time_s) + np.array([*scene.origin_m[:2], 0.0])
        tables.append(np.column_stack([time_s, xyz]))
        records.append(sbet_records(scene.crs, time_s, xyz, run.attitude(time_s)))
    with replacing(out / "trajectory.csv") as part:
        header, form = "gps_time,x,y,z", "%.6f,%.4f,%.4f,%.4f"
        np.savetxt(part, np.concatenate(tables), form, header=header, comments="")
    with replacing(out / "trajectory.sbet") as part:
        np.concatenate(records).tofile(part)


def _reference(scene: Scene, arrays: SceneArrays, path: Path) -> None:
    """A linear-mode cloud: one source of chance gives all places, all returns, then all noise."""
    rng, made = scene.chance(4), scene.reference
    n = round(made.density_per_m2 * scene.extent_m[0] * scene.extent_m[1])
    xy = rng.random((n, 2)) * scene.extent_m
    above = float(arrays.ground.z.max()) + 500.0
    z, kind = linear_returns(rng, arrays, xy, above, made.spot_m, made.seen_through, made.seen_wire)
    header = las_header(scene.crs, scene.origin_m, scene.acquisition.start_s)
    with replacing(path) as part, cloud_writer(part, header) as cloud:
        for first in range(0, n, AT_ONCE):
            some = slice(first, min(first + AT_ONCE, n))
            noisy = z[some] + made.noise_m * rng.standard_normal(z[some].shape)
            add_points(cloud, _reference_points(scene, first, xy[some], noisy, kind[some]))


def _reference_points(
    scene: Scene,
    first: int,
    xy: NDArray[np.float64],
    z: NDArray[np.float64],
    kind: NDArray[np.uint8],
) -> dict[str, NDArray[Any]]:
    """LAS dimensions of the returns of some pulses; ``first``: number of the first one."""
    n = len(xy)
    seen = np.isfinite(z)
    returns = seen.sum(axis=1).astype(np.uint8)
    number = np.column_stack([np.ones(n, dtype=np.uint8), returns])
    classes = np.full(256, CLASS_UNCLASSIFIED, dtype=np.uint8)
    classes[[KIND_GROUND, KIND_ROOF, KIND_WATER]] = CLASS_GROUND, CLASS_BUILDING, CLASS_WATER
    time_s = scene.acquisition.start_s + np.arange(first, first + n) / 400_000.0
    pulse = np.repeat(np.arange(n), 2).reshape(n, 2)[seen]
    return {
        "x": xy[pulse, 0] + scene.origin_m[0],
        "y": xy[pulse, 1] + scene.origin_m[1],
        "z": z[seen],
        "gps_time": time_s[pulse],
        "classification": classes[kind[seen]],
        "return_number": number[seen],
        "number_of_returns": returns[pulse],
        "point_source_id": np.ones(len(pulse), dtype=np.uint16),
    }


def _checkpoints(scene: Scene, arrays: SceneArrays, layout: Layout, path: Path) -> None:
    """Checkpoints of a field survey: true ground, open and below crowns, with a field's error."""
    asked, rng = scene.reference.checkpoints, scene.chance(8)
    size, tried = np.array(scene.extent_m), TRIED * max(asked.open, 1)
    room = np.maximum(size - 2 * asked.margin_m, 0.0)
    xy = asked.margin_m + rng.random((tried, 2)) * room
    error_m = asked.accuracy_m * rng.standard_normal(tried)
    ground, surface, _ = surfaces_at(arrays, *np.ascontiguousarray(xy.T))
    free, cover_m = ~_built(scene, layout, xy), surface - ground
    kinds = (
        ("open", asked.open, cover_m <= asked.open_below_m),
        ("vegetated", asked.vegetated, cover_m >= asked.vegetated_above_m),
    )
    lines = ["id,x,y,z,surface,accuracy_m"]
    for name, most, there in kinds:
        for number, k in enumerate(np.flatnonzero(free & there)[:most], start=1):
            x, y = xy[k] + scene.origin_m[:2]
            z = ground[k] + error_m[k]
            lines.append(
                f"{name[0].upper()}{number:02d},{x:.3f},{y:.3f},{z:.3f},{name},{asked.accuracy_m}"
            )
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _built(scene: Scene, layout: Layout, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Places in or beside houses and water."""
    shapes = [*layout.footprints, *(shapely.Polygon(w.ring_m) for w in scene.water)]
    if not shapes:
        return np.zeros(len(xy), np.bool_)
    taken = shapely.union_all(shapes).buffer(scene.reference.checkpoints.margin_m)
    found: NDArray[np.bool_] = shapely.contains_xy(taken, xy[:, 0], xy[:, 1])
    return found


def _rasters(scene: Scene, arrays: SceneArrays, folder: Path) -> None:
    """True ground, surface and reflectance of 1 m cells on whole metres."""
    west, south = (math.floor(v) for v in scene.origin_m[:2])
    east, north = (
        math.ceil(v + size) for v, size in zip(scene.origin_m, scene.extent_m, strict=False)
    )
    shape = north - south, east - west
    found = np.empty((3, *shape), np.float32)
    corner = west - scene.origin_m[0], north - scene.origin_m[1]
    columns, at_once = np.arange(shape[1]), max(AT_ONCE // shape[1], 1)
    for first in range(0, shape[0], at_once):
        rows = np.arange(first, min(first + at_once, shape[0]))
        found[:2, rows] = _surfaces(arrays, corner, columns, rows, (0.5, 0.5))[:2]
        total, side = np.zeros((len(rows), shape[1])), REFLECTANCE_SAMPLES
        for k in range(side**2):
            within = (k % side + 0.5) / side, (k // side + 0.5) / side
            total += _surfaces(arrays, corner, columns, rows, within)[2]
        found[2, rows] = total / side**2
    for name, values in zip(("dtm", "dsm", "reflectance"), found, strict=True):
        write_cog(
            folder / f"{name}.tif", values, shape=shape, origin_xy_m=(west, north), cell_m=1.0,
            crs=scene.crs, description=f"true {name}",
        )  # fmt: skip


def _surfaces(
    arrays: SceneArrays, corner: tuple[float, float], columns: NDArray[np.int64],
    rows: NDArray[np.int64], within: tuple[float, float],
) -> NDArray[np.float64]:  # fmt: skip
    """Ground, surface and reflectance at one place of cells of 1 m: (3, rows, columns)."""
    x, y = np.meshgrid(corner[0] + columns + within[0], corner[1] - rows - within[1])
    above: NDArray[np.float64] = surfaces_at(arrays, x.ravel(), y.ravel())
    return above.reshape(3, *x.shape)


def _workflow(scene: Scene) -> dict[str, Any]:
    content: dict[str, Any] = {
        "survey": {
            "name": scene.name,
            "flightlines": f"{folder_of(scene)}/*.laz",
            "trajectory": "trajectory.csv",
            "sensor": scene.instrument.model_dump(mode="json")
            if scene.sensor_overrides or not isinstance(scene.sensor, str)
            else scene.sensor,
            "channel_dimension": scene.delivery.channel_dimension,
        },
        "reference": {"points": "reference_lml.laz", "checkpoints": "checkpoints.csv"},
        "output": "out",
        "acquisition": {"prf_hz": scene.acquisition.prf_hz},
    }
    gates = set(map(scene.gate_of, scene.flights))
    if len(gates) == 1:  # else each flightline shows its own
        content["acquisition"]["gate_m"] = gates.pop()
    if scene.water:
        content["water"] = "water.gpkg"
    if scene.delivery.aoi:
        content["aoi"] = "aoi.gpkg"
    return content
