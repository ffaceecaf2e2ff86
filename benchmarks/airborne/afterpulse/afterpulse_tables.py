"""Surveys as the space domain sees them, with truth and the true rates of the simulation.

For :mod:`benchmarks.airborne.afterpulse.afterpulses`. The stages run on whole flightlines, without
a graph, so that a scene takes seconds.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyproj import CRS

from benchmarks.airborne.afterpulse.afterpulse_bound import echo_chance
from spl_batch.airborne.afterpulse import afterpulse_law, candidates
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.noise import line_noise, voxel_noise
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings.workflow import Workflow, load_workflow
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.brightness import make_receiver
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.formats.las.reader import iter_points
from spl_batch.formats.polygons import contains, read_polygons
from spl_batch.lattice.tables import (
    SOURCE_COLUMNS,
    PointFlag,
    PointTable,
    ShotClock,
    Trajectory,
    VoxelPart,
    canonical_order,
    concat,
)
from spl_batch.lattice.tiles import cell_index, quanta

COLUMNS = (
    *SOURCE_COLUMNS,
    "shot",
    "line_density",
    "afterpulse",
    "afterpulse_rate",
    "afterpulse_share",
    "range_sigma",
)

TINY = 1e-12
"""Keeps returns that nothing is in front of from 0 / 0."""


@dataclass(frozen=True)
class Prepared:
    """A survey before the space domain.

    Parameters
    ----------
    table : PointTable
        All flightlines in canonical order.
    density : (n,) float64
        Expected noise [1/m3].
    kind, parent : (n,) uint8
        Truth.
    bound : (n,) float64
        Probability of an afterpulse by the simulation's own laws; 0 without a parent.
    place : (n,) float64
        The same where only the true rate at the place is known, of a channel as others are
        (:class:`~benchmarks.airborne.afterpulse.afterpulse_bound.Best`), and the fitted law.
    laws : list of AfterpulseLaw
        Fitted, by flightline.
    """

    table: PointTable
    density: NDArray[np.float64]
    kind: NDArray[np.uint8]
    parent: NDArray[np.uint8]
    bound: NDArray[np.float64]
    place: NDArray[np.float64]
    laws: list[afterpulse_law.AfterpulseLaw]


def prepare(content: dict[str, Any], folder: Path, *, polygons: bool = True) -> Prepared:
    """Simulate a scene unless the folder holds it, and run the time domain on it."""
    scene = parse_scene(content, content["name"])
    if not (folder / "workflow.yaml").exists():
        simulate(scene, folder)
    workflow = load_workflow(folder / "workflow.yaml")
    record = np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=1)
    trajectory = Trajectory(record[:, 0], record[:, 1:4])
    lines = [
        _line(path, k, trajectory, workflow, scene)
        for k, path in enumerate(sorted((folder / "flightlines").glob("*.laz")))
    ]
    table = concat([line.table for line in lines], COLUMNS)
    order = canonical_order(table)
    table = table.take(order)
    if polygons and (folder / "water.gpkg").exists():
        water = contains(
            read_polygons(folder / "water.gpkg", CRS(scene.crs)), table["x"], table["y"]
        )
        flags = table["flags"] | np.where(water, np.uint8(PointFlag.WATER), np.uint8(0))
        table = table.with_columns(flags=flags)
    kind, parent, bound, place = (
        np.concatenate([getattr(line, name) for line in lines])[order]
        for name in ("kind", "parent", "bound", "place")
    )
    density = _density(table, [line.part for line in lines], workflow)
    return Prepared(table, density, kind, parent, bound, place, [line.law for line in lines])


@dataclass(frozen=True)
class _Line:
    table: PointTable
    kind: NDArray[np.uint8]
    parent: NDArray[np.uint8]
    bound: NDArray[np.float64]
    place: NDArray[np.float64]
    part: VoxelPart
    law: afterpulse_law.AfterpulseLaw


def _line(
    path: Path, number: int, trajectory: Trajectory, workflow: Workflow, scene: Scene
) -> _Line:
    """One flightline through the time domain; it knows the preset, not the scene's sensor."""
    sensor = load_preset("spl100").model_copy(
        update={"prf_hz": workflow.acquisition.prf_hz, "gate_m": workflow.acquisition.gate_m}
    )
    table = concat(
        list(iter_points(path, channel_dimension="channel", source=number)), SOURCE_COLUMNS
    )
    order = np.lexsort([table[k] for k in ("index", "return_number", "channel", "gps_time")])
    table = table.take(order)
    clock = ShotClock(math.floor(table["gps_time"][0]), scene.acquisition.prf_hz)
    table = table.with_columns(shot=clock.shot(table["gps_time"]))
    beams = geometry.beams(table, trajectory)
    observed = line_noise.observe(table, beams, workflow.noise)
    model = line_noise.fit(line_noise.merge([observed]), workflow.noise, sensor)
    lags = candidates.observe(table, beams, sensor)
    law = afterpulse_law.fit([lags], model.mean_rate, sensor)
    chance = candidates.probability(
        table, beams, workflow.afterpulse, sensor, gate_m=model.gate_m, law=law
    )
    best = echo_chance(
        scene, table["gps_time"], table["channel"], beams, model.mean_rate, make_receiver(scene)
    )
    truth = pq.read_table(path.parents[1] / "truth" / f"{path.stem}.parquet")
    rate = afterpulse_law.rate(table, beams, law)
    return _Line(
        table.with_columns(
            line_density=line_noise.line_density(table, model),
            afterpulse=chance,
            afterpulse_rate=rate,
            afterpulse_share=np.full(len(table), law.probability, np.float32),
            range_sigma=np.full(len(table), law.sigma_m, np.float32),
        ),
        truth["kind"].to_numpy()[order],
        truth["parent"].to_numpy()[order],
        best.chance,
        np.where(rate > 0, rate / (rate + best.true_per_m + TINY), 0.0),
        voxel_noise.deposit(table, beams, model, workflow.noise),
        law,
    )


def _density(table: PointTable, parts: list[VoxelPart], workflow: Workflow) -> NDArray[np.float64]:
    """Expected noise density in each point's voxel [1/m3]."""
    edge = quanta(workflow.noise.voxel_m)
    index = np.stack([cell_index(table[axis].astype(np.int64), edge) for axis in "xyz"])
    low = np.minimum(index.min(axis=1), np.min([p.corner for p in parts], axis=0))
    ends = [np.add(p.corner, p.amount.shape) for p in parts]
    high = np.maximum(index.max(axis=1) + 1, np.max(ends, axis=0))
    total = np.zeros(tuple(high - low), dtype=np.int64)
    for part, end in zip(parts, ends, strict=True):
        start = np.subtract(part.corner, low)
        total[tuple(slice(a, b) for a, b in zip(start, end - low, strict=True))] += part.amount
    density = voxel_noise.density(
        total, workflow.noise, shots=None, beamlets=None, beamlets_per_shot=100
    )
    return np.asarray(density[tuple(index - low[:, None])], dtype=np.float64)


def scene_of(folder: Path) -> Scene:
    """Scene that a survey was simulated from."""
    content = json.loads((folder / "truth" / "scene.json").read_text(encoding="utf-8"))
    return parse_scene(content["scene"], str(folder))
