"""Fly a scene: flightlines with truth, trajectory, reference, and a workflow to run them."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.brightness import (
    Noise,
    make_optics,
    make_receiver,
    solve_noise,
    tune_wires,
)
from spl_batch.airborne.simulate.companion_files import deliver, deliver_noise
from spl_batch.airborne.simulate.detector import Receiver
from spl_batch.airborne.simulate.file_writers import SCAN_ANGLE_DEG, PointFiles
from spl_batch.airborne.simulate.flight import (
    CHUNK_S,
    GATE_S,
    Chunk,
    Pass,
    chunks,
    gate_centres,
    make_passes,
)
from spl_batch.airborne.simulate.haze import Air, make_air
from spl_batch.airborne.simulate.noise_grid import NoiseGrid
from spl_batch.airborne.simulate.scene.beam_layers import layer_room
from spl_batch.airborne.simulate.scene.layout import lay_out
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.simulate.shots import (
    Optics,
    Points,
    Shots,
    empty_beamlet,
    empty_points,
    event_room,
    fire,
    first_rows,
)
from spl_batch.airborne.simulate.sunlight import lit
from spl_batch.errors import WorkflowError, grouped
from spl_batch.numerics.attitude import rotations

BUFFER_POINTS = 400_000
"""Rows of the buffers that a kernel fills at once."""

VOXEL_M = 10.0
"""Edge of the voxels of the true noise density [m]."""

KINDS = (
    "background",
    "ground",
    "roof",
    "vegetation",
    "wire",
    "water",
    "afterpulse",
    "other",
    "bottom",
)
"""Names of the values of the truth column ``kind``."""


@dataclass(frozen=True, slots=True)
class SimulationSummary:
    """What was written."""

    out: Path
    workflow: Path  #: Workflow file, ready to run.
    points: int
    lines: tuple[int, ...]  #: Returns of each flightline.
    kinds: dict[str, int]  #: Returns by what gave them.
    wall_s: float

    @property
    def rows(self) -> list[tuple[str, str]]:
        """Label and value of what a user is told."""
        return [("returns", grouped(self.points)), ("flightlines", str(len(self.lines)))]


@dataclass(frozen=True, slots=True)
class _Rig:
    """All that firing a shot needs beside the shot."""

    scene: Scene
    arrays: SceneArrays
    optics: Optics
    receiver: Receiver
    noise: Noise
    air: Air
    grid: NoiseGrid


def simulate(
    scene: Scene, out: Path, *, progress: Callable[[float], None] | None = None
) -> SimulationSummary:
    """Simulate a survey.

    Written are ``flightlines/line_NN.laz`` (points in time order, without truth),
    ``trajectory.csv`` and ``trajectory.sbet``, ``reference_lml.laz``, ``checkpoints.csv``,
    ``water.gpkg`` where there is water, ``workflow.yaml``, and ``truth/``:
    ``line_NN.parquet`` with a row for each point in the file's order (``kind``: index in
    :data:`KINDS`; ``parent``: kind of the surface behind an afterpulse, else 255;
    ``parent_row``: row of its parent, else -1),
    ``dtm.tif``, ``dsm.tif`` (at cell centres), ``reflectance.tif`` (cell means),
    ``noise_density.npz`` (expected background per cubic metre, lattice index of the first
    voxel, edge) and ``scene.json``.

    A delivery by tile has ``tiles/tile_I_J.laz`` and their truth in place of those of the lines,
    flightline after flightline; a ``parent_row`` is -1 where the parent is in another file.

    Only shots whose footprint meets the extent are there, so a flightline's shots come in
    arcs with pauses of thousands of shots between them, as in a delivery cut to an area.

    Parameters
    ----------
    out : Path
        Folder to write into; files of the same names are replaced.
    progress : callable, optional
        Called with the share that is done, 0 to 1.

    References
    ----------
    [W17] ch. 2 for signal, noise and scan; 7.1 for afterpulses.
    """
    begin = time.perf_counter()
    layout, optics, receiver = lay_out(scene), make_optics(scene), make_receiver(scene)
    passes = make_passes(scene)
    pieces = [list(chunks(run, layout.arrays)) for run in passes]
    _check_coverage(passes, pieces)
    noise = solve_noise(scene, passes, pieces)
    arrays = tune_wires(scene, layout, optics, passes, pieces)
    rig = _Rig(
        scene,
        lit(scene, arrays) if scene.sky.by_albedo else arrays,
        optics,
        receiver,
        noise,
        make_air(scene, float(noise.at(np.ones(1))[0])),
        _noise_grid(scene),
    )
    shots = max(sum(len(p.shot) for chunk_list in pieces for p in chunk_list), 1)
    done, counts = 0, np.zeros((len(passes), len(KINDS)), dtype=np.int64)

    def advance(fired: int) -> None:
        nonlocal done
        done += fired
        if progress is not None:
            progress(done / shots)

    with ExitStack() as stack:
        files = PointFiles(scene, out, stack)
        for k, (run, chunk_list) in enumerate(zip(passes, pieces, strict=True)):
            counts[k] = _fly(rig, run, chunk_list, files, advance)
    deliver_noise(scene, rig.grid, out)
    workflow = deliver(scene, rig.arrays, layout, passes, out)
    return SimulationSummary(
        out,
        workflow,
        int(counts.sum()),
        tuple(int(n) for n in counts.sum(axis=1)),
        {name: int(n) for name, n in zip(KINDS, counts.sum(axis=0), strict=True)},
        time.perf_counter() - begin,
    )


def _check_coverage(passes: list[Pass], pieces: list[list[Chunk]]) -> None:
    for run, chunk_list in zip(passes, pieces, strict=True):
        if not chunk_list:
            raise WorkflowError(
                f"flights.{run.number - 1}: no shot meets the scene; offset_m "
                f"{run.flight.offset_m:g} is outside the swath, choose a smaller one"
            )


def _noise_grid(scene: Scene) -> NoiseGrid:
    """Voxels on the absolute lattice over the extent, as high as the gates reach."""
    gate = max(map(scene.gate_of, scene.flights))
    # 20 m more than the gate, for relief and for what the aircraft's wobble does to ranges
    low = np.array([*scene.origin_m[:2], scene.origin_m[2] - gate - 20])
    high = low + np.array([*scene.extent_m, 2 * gate + 40])
    first, last = np.floor(low / VOXEL_M), np.ceil(high / VOXEL_M)
    corner = first * VOXEL_M - np.array([*scene.origin_m[:2], 0.0])
    return NoiseGrid(np.zeros(tuple((last - first).astype(int))), corner, VOXEL_M)


def _fly(
    rig: _Rig, run: Pass, pieces: list[Chunk], files: PointFiles, advance: Callable[[int], None]
) -> NDArray[np.int64]:
    """Write one flightline; returns the number of points of each kind."""
    centres = gate_centres(pieces)
    counts = np.zeros(len(KINDS), dtype=np.int64)
    gate = rig.scene.gate_of(run.flight)
    sky = np.array([run.flight.sky * (1 + rig.scene.sky.variation)])
    peak = rig.noise.at(sky) + rig.noise.ground_at(sky) * rig.arrays.light.max(initial=0.0)
    gain = float(rig.optics.gain.max(initial=0.0))
    nearest = min(float(piece.ground_range_m.min()) for piece in pieces) - gate / 2
    brightest = gain * rig.optics.signal_m2 / max(nearest, 1.0) ** 2
    # tuned wires may send back more than falls on them
    brightest *= max(1.0, float(rig.arrays.wire[:, 9].max(initial=0.0)))
    noise = gate * gain * (float(peak[0]) * (1 + abs(rig.air.gate_fall)) + _thickest(rig.air))
    room = event_room(noise, brightest, layer_room(rig.arrays))
    channels = len(rig.optics.gain)
    beamlet = empty_beamlet(rig.arrays, room)
    buffers = empty_points(max(BUFFER_POINTS, 2 * room * channels))
    for piece in pieces:
        centre = centres[int(piece.index * CHUNK_S / GATE_S)]
        shots = _shots(rig, run, piece, centre - gate * rig.scene.acquisition.gate_above)
        key = np.random.SeedSequence(rig.scene.seed, spawn_key=(3, run.number, piece.index))
        rng = np.random.default_rng(key)
        first = 0
        while first < len(piece.shot):
            last, count = fire(
                rng,
                rig.arrays,
                rig.optics,
                rig.receiver,
                rig.air,
                shots,
                first,
                beamlet,
                rig.grid,
                buffers,
            )
            points = first_rows(buffers, count)
            time_s = run.time_of(piece.shot)[points.shot]
            truth_columns: dict[str, NDArray[Any]] = {
                "kind": points.kind,
                "parent": points.parent,
                "parent_row": points.parent_row,
            }
            files.write(run, _columns(rig, run, time_s, points, rng), truth_columns)
            counts += np.bincount(points.kind, minlength=len(KINDS))
            advance(last - first)
            first = last
    return counts


def _thickest(air: Air) -> float:
    """Most that haze and fog add to the rate of a channel of gain 1 [1/m]."""
    return float(air.layers[:, 3].sum() + air.fog[:, 0].sum())


def _shots(rig: _Rig, run: Pass, piece: Chunk, gate_start_m: float) -> Shots:
    time_s = run.time_of(piece.shot)
    start = np.full(len(time_s), gate_start_m)
    return Shots(
        run.position(time_s),
        rotations(*run.attitude(time_s)),
        run.scan_angle(piece.shot),
        start,
        start + rig.scene.gate_of(run.flight),
        *_background(rig, run.sky(time_s)),
        time_s - rig.scene.acquisition.start_s,
    )


def _background(
    rig: _Rig, sky: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Background of one rate, and what follows the albedo: (n,) float64 each [1/m]."""
    everywhere, ground = rig.noise.at(sky), rig.noise.ground_at(sky)
    if rig.scene.sky.by_albedo:
        return everywhere - ground, ground
    return everywhere, np.zeros(len(sky))


def _columns(
    rig: _Rig, run: Pass, time_s: NDArray[np.float64], points: Points, rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """Recorded returns as LAS dimensions.

    The scan angle is the beam's across the flight direction. LAS has no place for the part along
    it, which a circular scan has too.
    """
    beam = points.xyz - run.position(time_s)
    heading = np.radians(run.flight.heading_deg)
    starboard = beam[:, 0] * np.cos(heading) - beam[:, 1] * np.sin(heading)
    angle = np.degrees(np.arctan2(starboard, -beam[:, 2]))
    # a silicon photomultiplier's pulse grows with the cells that fire [W17 2.2.1]
    pulse = 8000.0 + 1500.0 * (points.electrons - 1) + 600.0 * rng.standard_normal(len(time_s))
    recorded = points.xyz + run.flight.strip_offset_m
    recorded[:, :2] += rig.scene.origin_m[:2]
    return {
        "x": recorded[:, 0],
        "y": recorded[:, 1],
        "z": recorded[:, 2],
        "gps_time": time_s,
        "channel": points.channel,
        "intensity": np.clip(np.rint(pulse), 1, 65535).astype(np.uint16),
        "scan_angle": np.rint(angle / SCAN_ANGLE_DEG).astype(np.int16),
        "return_number": points.return_number,
        "number_of_returns": points.returns,
    }
