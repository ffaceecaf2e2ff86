"""Companions of the flightlines: trajectory, reference, checkpoints, truth, workflow."""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Final, cast

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.airborne.simulate.file_writers import (
    folder_of,
    las_header,
    raster_rows,
    sbet_records,
    write_points,
    write_polygons,
    write_text,
    write_trajectory_csv,
)
from spl_batch.airborne.simulate.flight import Pass
from spl_batch.airborne.simulate.noise_grid import NoiseGrid
from spl_batch.airborne.simulate.scene.beam_layers import empty_layers
from spl_batch.airborne.simulate.scene.from_above import (
    linear_returns,
    mean_reflectance,
    surfaces_at,
)
from spl_batch.airborne.simulate.scene.layout import Layout, footprints
from spl_batch.airborne.simulate.scene.ray_trace import (
    KIND_GROUND,
    KIND_ROOF,
    KIND_WATER,
    SceneArrays,
)
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.constants import CLASS_BUILDING, CLASS_GROUND, CLASS_UNCLASSIFIED, CLASS_WATER
from spl_batch.formats.files.atomic import replacing, write_bytes

TRAJECTORY_HZ = 200.0
"""Records per second of the trajectory [Hz]."""

REFLECTANCE_SAMPLES = 4
"""Locations along one side of a cell whose reflectance is averaged [count]."""

PULSES_AT_ONCE = 250_000
"""Pulses of the reference that are simulated at once; they bound the memory [count]."""

ROWS_AT_ONCE = 64
"""Rows of the rasters that are made at once [count]."""

LINEAR_SPOT_M = 0.1
"""Spread of the reference's footprint [m]."""


CHECKPOINTS: Final = {"open": 40, "vegetated": 32}
"""Checkpoints of each kind, as far as the scene has room [count]."""

CHECKPOINTS_TRIED: Final = 4000
"""Locations that are tried [count]."""

CHECKPOINT_ACCURACY_M: Final = 0.015
"""Vertical accuracy of the field survey, one sigma [m]."""

OPEN_M: Final = 0.05
"""What stands on open ground is no higher [m]."""

CROWN_M: Final = 2.0
"""What stands on vegetated ground is no lower [m]."""

INSIDE_M: Final = 5.0
"""Distance to the scene's edge, to water and to houses, at the least [m]."""


def deliver(
    scene: Scene, arrays: SceneArrays, layout: Layout, passes: list[Pass], out: Path
) -> Path:
    """Write everything but the flightlines; the workflow's path."""
    _trajectory(scene, passes, out)
    _reference(scene, arrays, out)
    _checkpoints(scene, arrays, layout, out / "checkpoints.csv")
    _rasters(scene, arrays, out)
    origin = scene.origin_m[:2]
    water = [
        shapely.Polygon([(x + origin[0], y + origin[1]) for x, y in w.ring_m]) for w in scene.water
    ]
    if water:
        write_polygons(out / "water.gpkg", water, scene.crs)
    if scene.delivery.aoi:
        extent = shapely.box(*origin, *(o + e for o, e in zip(origin, scene.extent_m, strict=True)))
        write_polygons(out / "aoi.gpkg", [extent], scene.crs)
    roofs = [[[x + origin[0], y + origin[1]] for x, y in shape.exterior.coords]
             for shape in footprints(layout.buildings)]  # fmt: skip
    truth = {
        "scene": scene.model_dump(mode="json", by_alias=True),
        "buildings": [b.model_dump(mode="json") for b in layout.buildings],
        "building_outlines": roofs,
        "crowns": layout.crowns,
        "wires": [[float(v) for v in row] for row in arrays.wire],
        "wire_columns": ["x", "y", "ux", "uy", "span", "a", "vertex", "offset", "radius", "rho"],
    }
    write_text(out / "truth" / "scene.json", truth)
    return _workflow(scene, out, bool(water))


def deliver_noise(scene: Scene, grid: NoiseGrid, out: Path) -> None:
    """Write the expected background per cubic metre on the 10 m lattice."""
    corner = np.rint((grid.corner + np.array([*scene.origin_m[:2], 0.0])) / grid.voxel_m).astype(
        np.int64
    )
    density = (grid.amount / grid.voxel_m**3).astype(np.float32)
    path = out / "truth" / "noise_density.npz"
    # a file object: given a name, numpy would put .npz behind it
    with replacing(path) as part, part.open("wb") as file:
        np.savez_compressed(file, density=density, corner=corner, voxel_m=grid.voxel_m)


def _trajectory(scene: Scene, passes: list[Pass], out: Path) -> None:
    records, tables = [], []
    for run in passes:
        first = math.floor(run.start_s) - 1
        last = math.ceil(run.middle_s + run.half_s) + 3
        time_s = first + np.arange(round((last - first) * TRAJECTORY_HZ) + 1) / TRAJECTORY_HZ
        xyz = run.position(time_s) + np.array([*scene.origin_m[:2], 0.0])
        tables.append(np.column_stack([time_s, xyz]))
        records.append(sbet_records(scene.crs, time_s, xyz, run.attitude(time_s)))
    table = np.concatenate(tables)
    write_trajectory_csv(out / "trajectory.csv", table[:, 0], table[:, 1:])
    with replacing(out / "trajectory.sbet") as part:
        np.concatenate(records).astype("<f8").tofile(part)


def _reference(scene: Scene, arrays: SceneArrays, out: Path) -> None:
    header = las_header(scene.crs, scene.origin_m, scene.acquisition.start_s)
    write_points(out / "reference_lml.laz", header, _reference_pieces(scene, arrays, out))


def _reference_pieces(
    scene: Scene, arrays: SceneArrays, out: Path
) -> Iterator[dict[str, NDArray[Any]]]:
    """Points of the reference, of some pulses at a time.

    One source of chance gives all places, then all returns, then all noise; in between they wait on
    disk. So the points do not depend on how many are made at once.
    """
    seed = np.random.SeedSequence(scene.seed, spawn_key=(4,))
    n = round(scene.reference.density_per_m2 * scene.extent_m[0] * scene.extent_m[1])
    sizes = [min(PULSES_AT_ONCE, n - first) for first in range(0, n, PULSES_AT_ONCE)]
    places, rng = np.random.default_rng(seed), np.random.default_rng(seed)
    cast("np.random.PCG64", rng.bit_generator).advance(2 * n)
    above = float(arrays.ground_z.max()) + 500.0
    with TemporaryFile(dir=out) as returns:
        for size in sizes:
            z, kind = np.empty((size, 2)), np.zeros((size, 2), dtype=np.uint8)
            xy = places.random((size, 2)) * scene.extent_m
            linear_returns(rng, arrays, xy, above, LINEAR_SPOT_M, empty_layers(arrays), z, kind)
            returns.write(z.tobytes() + kind.tobytes())
        returns.seek(0)
        places = np.random.default_rng(seed)
        first = 0
        for size in sizes:
            z = np.frombuffer(returns.read(16 * size)).reshape(size, 2)
            kind = np.frombuffer(returns.read(2 * size), dtype=np.uint8).reshape(size, 2)
            xy = places.random((size, 2)) * scene.extent_m
            noisy = z + scene.reference.noise_m * rng.standard_normal(z.shape)
            yield _reference_points(scene, first, xy, noisy, kind)
            first += size


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
    rng = np.random.default_rng(np.random.SeedSequence(scene.seed, spawn_key=(8,)))
    size = np.array(scene.extent_m)
    xy = INSIDE_M + rng.random((CHECKPOINTS_TRIED, 2)) * np.maximum(size - 2 * INSIDE_M, 0.0)
    error_m = CHECKPOINT_ACCURACY_M * rng.standard_normal(CHECKPOINTS_TRIED)
    above = np.empty((3, CHECKPOINTS_TRIED))
    surfaces_at(arrays, xy[:, 0].copy(), xy[:, 1].copy(), above)
    ground, surface = above[:2]
    free = ~_built(scene, layout, xy)
    kinds = {"open": surface - ground <= OPEN_M, "vegetated": surface - ground >= CROWN_M}
    lines = ["id,x,y,z,surface,accuracy_m"]
    for name, there in kinds.items():
        for number, k in enumerate(np.flatnonzero(free & there)[: CHECKPOINTS[name]], start=1):
            x, y = xy[k] + scene.origin_m[:2]
            z = ground[k] + error_m[k]
            lines.append(
                f"{name[0].upper()}{number:02d},{x:.3f},{y:.3f},{z:.3f},{name},{CHECKPOINT_ACCURACY_M}"
            )
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _built(scene: Scene, layout: Layout, xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Places in or beside houses and water."""
    shapes = [*footprints(layout.buildings), *(shapely.Polygon(w.ring_m) for w in scene.water)]
    if not shapes:
        return np.zeros(len(xy), np.bool_)
    taken = shapely.union_all(shapes).buffer(INSIDE_M)
    found: NDArray[np.bool_] = shapely.contains_xy(taken, xy[:, 0], xy[:, 1])
    return found


def _rasters(scene: Scene, arrays: SceneArrays, out: Path) -> None:
    """True ground, surface and reflectance of 1 m cells on whole metres."""
    west, south = (math.floor(v) for v in scene.origin_m[:2])
    east, north = (
        math.ceil(v + size) for v, size in zip(scene.origin_m, scene.extent_m, strict=False)
    )
    x = np.arange(west, east) + 0.5 - scene.origin_m[0]
    y = np.arange(north, south, -1) - 0.5 - scene.origin_m[1]
    corner = west - scene.origin_m[0], north - scene.origin_m[1]
    place = (len(y), len(x)), float(west), float(north), scene.crs
    with ExitStack() as open_files:
        write = [
            open_files.enter_context(raster_rows(out / "truth" / f"{name}.tif", *place))
            for name in ("dtm", "dsm", "reflectance")
        ]
        for first in range(0, len(y), ROWS_AT_ONCE):
            xs, ys = np.meshgrid(x, y[first : first + ROWS_AT_ONCE])
            above = np.empty((3, *xs.shape))
            surfaces_at(arrays, xs.ravel(), ys.ravel(), above.reshape(3, -1))
            mean_reflectance(
                arrays, corner[0], corner[1] - first, 1.0, REFLECTANCE_SAMPLES, above[2]
            )
            for values, to in zip(above, write, strict=True):
                to(first, values)


def _workflow(scene: Scene, out: Path, water: bool) -> Path:  # noqa: FBT001 - one caller
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
    if water:
        content["water"] = "water.gpkg"
    if scene.delivery.aoi:
        content["aoi"] = "aoi.gpkg"
    path = out / "workflow.yaml"
    write_text(path, content)
    return path
