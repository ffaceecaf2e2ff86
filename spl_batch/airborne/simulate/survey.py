"""Fly a scene: flightlines with truth, trajectory, reference, and a workflow to run them."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.air import Air, NoiseGrid, empty_grid, make_air
from spl_batch.airborne.simulate.brightness import (
    Noise,
    make_optics,
    make_receiver,
    solve_noise,
    tune_wires,
)
from spl_batch.airborne.simulate.companion_files import deliver
from spl_batch.airborne.simulate.detector import Receiver
from spl_batch.airborne.simulate.file_writers import PointFiles
from spl_batch.airborne.simulate.flight import (
    Chunk,
    Pass,
    gate_centres,
    gate_of_chunk,
    make_passes,
)
from spl_batch.airborne.simulate.scene.beam_layers import layer_room
from spl_batch.airborne.simulate.scene.layout import lay_out
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.simulate.shots import (
    POINT,
    Optics,
    Shots,
    event_room,
    fire,
)
from spl_batch.airborne.simulate.sunlight import lit
from spl_batch.engine.verbs.simulation import Simulated, finished
from spl_batch.formats.las.records import SCAN_ANGLE_STEP_DEG
from spl_batch.numerics.attitude import rotations

BUFFER_POINTS = 400_000
"""Rows of the buffers that a kernel fills at once."""


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
) -> Simulated:
    """Simulate a survey.

    Written are ``flightlines/line_NN.laz`` (points in time order, without truth),
    ``trajectory.csv`` and ``trajectory.sbet``, ``reference_lml.laz``, ``checkpoints.csv``,
    ``water.gpkg`` where there is water, ``workflow.yaml``, and ``truth/``:
    ``line_NN.parquet`` with a row for each point in the file's order (``kind``: index in
    :data:`~spl_batch.airborne.simulate.scene.ray_trace.KINDS`; ``parent``: kind of the surface
    behind an afterpulse, else 255; ``parent_row``: row of its parent, else -1),
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
    layout, optics = lay_out(scene), make_optics(scene)
    passes = make_passes(scene, layout.arrays)
    noise = solve_noise(scene, passes)
    arrays = tune_wires(scene, layout, optics, passes)
    rig = _Rig(
        scene,
        lit(scene, arrays) if scene.sky.by_albedo else arrays,
        optics,
        make_receiver(scene),
        noise,
        make_air(scene, float(noise.at(np.ones(1))[0])),
        empty_grid(scene),
    )
    shots = sum(len(piece.shot) for run in passes for piece in run.chunks)
    done = points = 0
    with ExitStack() as stack:
        files = PointFiles(scene, out, stack)
        for run in passes:
            for fired, returned in _fly(rig, run, files):
                done += fired
                points += returned
                if progress is not None:
                    progress(done / shots)
    workflow = deliver(scene, rig.arrays, rig.grid, layout, passes, out)
    return finished(out, workflow, {"returns": points, "flightlines": len(passes)})


def _most_events(rig: _Rig, run: Pass) -> int:
    """Events that a beamlet of a flightline must have room for."""
    gate = rig.scene.gate_of(run.flight)
    sky = np.array([run.flight.sky * (1 + rig.scene.sky.variation)])
    peak = rig.noise.at(sky) + rig.noise.ground_at(sky) * rig.arrays.ground.light.max(initial=0.0)
    gain = float(rig.optics.gain.max(initial=0.0))
    nearest = min(float(piece.ground_range_m.min()) for piece in run.chunks) - gate / 2
    brightest = gain * rig.optics.signal_m2 / max(nearest, 1.0) ** 2
    # tuned wires may send back more than falls on them
    brightest *= max(1.0, float(rig.arrays.wire[:, 9].max(initial=0.0)))
    air = float(rig.air.layers[:, 3].sum())
    noise = gate * gain * (float(peak[0]) * (1 + abs(rig.air.gate_fall)) + air)
    return event_room(noise, brightest, layer_room(rig.arrays))


def _fly(rig: _Rig, run: Pass, files: PointFiles) -> Iterator[tuple[int, int]]:
    """Write one flightline piece by piece: shots that were fired, and their returns [count]."""
    centres = gate_centres(run)
    room = _most_events(rig, run)
    buffer = np.empty(max(BUFFER_POINTS, 2 * room * len(rig.optics.gain)), POINT)
    for piece in run.chunks:
        gate = rig.scene.gate_of(run.flight)
        centre = centres[gate_of_chunk(run, piece.index)]
        shots = _shots(rig, run, piece, centre - gate * rig.scene.acquisition.gate_above)
        rng = rig.scene.chance(3, run.number, piece.index)
        first = 0
        while first < len(piece.shot):
            last, count = fire(
                rng, rig.arrays, rig.optics, rig.receiver, rig.air, shots, first, room,
                rig.grid, buffer,
            )  # fmt: skip
            points = buffer[:count]
            time_s = run.time_of(piece.shot)[points["shot"]]
            files.write(run, _columns(rig, run, time_s, points, rng), points)
            yield last - first, count
            first = last


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
    rig: _Rig,
    run: Pass,
    time_s: NDArray[np.float64],
    points: NDArray[np.void],
    rng: np.random.Generator,
) -> dict[str, NDArray[Any]]:
    """Recorded returns as LAS dimensions.

    The scan angle is the beam's across the flight direction. LAS has no place for the part along
    it, which a circular scan has too.
    """
    xyz = np.column_stack([points[axis] for axis in "xyz"])
    beam = xyz - run.position(time_s)
    heading = np.radians(run.flight.heading_deg)
    starboard = beam[:, 0] * np.cos(heading) - beam[:, 1] * np.sin(heading)
    angle = np.degrees(np.arctan2(starboard, -beam[:, 2]))
    # a silicon photomultiplier's pulse grows with the cells that fire [W17 2.2.1]
    pulse = 8000.0 + 1500.0 * (points["electrons"] - 1) + 600.0 * rng.standard_normal(len(time_s))
    recorded = xyz + run.flight.strip_offset_m
    recorded[:, :2] += rig.scene.origin_m[:2]
    return {
        **dict(zip("xyz", recorded.T, strict=True)),
        "gps_time": time_s,
        **{name: points[name] for name in ("channel", "return_number", "number_of_returns")},
        "intensity": np.clip(np.rint(pulse), 1, 65535).astype(np.uint16),
        "scan_angle": np.rint(angle / SCAN_ANGLE_STEP_DEG).astype(np.int16),
    }
