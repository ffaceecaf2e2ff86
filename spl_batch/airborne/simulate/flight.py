r"""Flightlines: where the aircraft is, how it is turned, which shots meet the scene.

A rotating wedge scans with a square array of beamlets [W17 Eq. 2.8-2.15]. Body frame: x to
starboard, y to the nose, z up. The scan angle is zero at the nose and grows clockwise seen from
above.

Deviations. Eq. 2.11 as printed turns the array by :math:`+\alpha`, Eq. 2.12 the beam by
:math:`-\alpha`; here both turn the same way, so the array keeps its attitude to the scanned circle.
The :math:`z` of the pixel vector in Eq. 2.14, not defined there, is zero. Boresight angles and
lever arm of Eq. 2.8 are zero: delivered data is calibrated.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.scene.scene_file import Flight, Scene
from spl_batch.errors import WorkflowError
from spl_batch.numerics.attitude import rotations

CHUNK_S = 0.25
"""Flight time that is simulated at once, on an absolute grid [s]; it bounds the memory."""


def _wave(time_s: NDArray[np.float64], period_s: float, phase: float) -> NDArray[np.float64]:
    wave: NDArray[np.float64] = np.sin(2 * np.pi * time_s / period_s + phase)
    return wave


def pixel_offsets(
    columns: int, pitch_rad: float, rotation_rad: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angular places x, y of beamlets in a turned array, by channel [W17 Eq. 2.9, 2.10] [rad].

    Channel = columns * (i - 1) + j, from 1, is row i and column j.
    """
    centre = (columns + 1) / 2
    i, j = np.divmod(np.arange(columns * columns), columns)
    x = -(i + 1 - centre) * pitch_rad
    y = (j + 1 - centre) * pitch_rad
    c, s = np.cos(rotation_rad), np.sin(rotation_rad)
    return c * x - s * y, s * x + c * y


def central_vectors(angle: NDArray[np.float64], half_cone_rad: float) -> NDArray[np.float64]:
    """Unit vectors of the array's centre in the body frame [W17 Eq. 2.13]: (n, 3) float64.

    ``angle``: (n,) float64, scan angle [rad].
    """
    s = np.sin(half_cone_rad)
    z = np.full(len(angle), -np.cos(half_cone_rad))
    return np.column_stack([s * np.sin(angle), s * np.cos(angle), z])


@dataclass(frozen=True, slots=True)
class Chunk:
    """Shots of one pass that meet the scene, within one piece of time."""

    index: int  #: Which piece; with the pass it keys the random numbers.
    shot: NDArray[np.int64]  #: (n,): shot numbers since the pass's start second.
    #: (n,): slant range to the ground along the array's centre [m].
    ground_range_m: NDArray[np.float64]
    inside: NDArray[np.bool_]  #: (n,): whether the centre hits the extent itself.


@dataclass(frozen=True, slots=True)
class Pass:
    """One flightline as functions of time."""

    number: int  #: From 1; the ``point_source_id``.
    flight: Flight
    scene: Scene
    middle_s: float  #: When the aircraft is abeam the scene's centre, adjusted standard time [s].
    half_s: float  #: Half the time during which a shot can meet the scene [s].
    phases: NDArray[np.float64]  #: (6,): of the swings of attitude, height and sky [rad].
    chunks: tuple[Chunk, ...] = ()  #: Shots that meet the scene, in pieces of :data:`CHUNK_S`.

    def position(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sensor position relative to the scene's origin, height absolute: (n, 3) [m]."""
        heading = math.radians(self.flight.heading_deg)
        along = (time_s - self.middle_s) * self.flight.speed_m_s
        nose = np.array([math.sin(heading), math.cos(heading)])
        starboard = np.array([nose[1], -nose[0]])
        centre = np.array(self.scene.extent_m) / 2 + self.flight.offset_m * starboard
        xy = centre + along[:, None] * nose
        swing = _wave(time_s - self.middle_s, 11.0, self.phases[4])
        z = self.scene.origin_m[2] + self.flight.altitude_agl_m + 0.5 * swing
        return np.column_stack([xy, z])

    def attitude(
        self, time_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Heading, roll, pitch [rad]: slow swings and quicker, smaller ones."""
        swing = math.radians(self.scene.acquisition.wobble_deg)
        t, p = time_s - self.middle_s, self.phases
        heading = math.radians(self.flight.heading_deg) + swing * _wave(t, 13.0, p[0])
        roll = swing * (_wave(t, 7.0, p[1]) + 0.3 * _wave(t, 1.3, p[2]))
        pitch = swing * (_wave(t, 9.0, p[3]) + 0.3 * _wave(t, 1.7, p[0]))
        return heading, roll, pitch

    def sky(self, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sunlight relative to the scene's mean: (n,) float64."""
        sky = self.scene.sky
        wave = _wave(time_s - self.middle_s, sky.period_s, self.phases[5])
        return self.flight.sky * (1 + sky.variation * wave)

    def scan_angle(self, shot: NDArray[np.int64]) -> NDArray[np.float64]:
        """Angle of the wedge at a shot since the start second [rad]."""
        turns = shot.astype(np.float64) * (
            self.scene.instrument.scan_rate_hz / self.scene.acquisition.prf_hz
        )
        angle: NDArray[np.float64] = 2 * np.pi * (turns % 1.0)
        return angle

    @property
    def start_s(self) -> float:
        """Time of shot 0: a whole second before any shot meets the scene."""
        return math.floor(self.middle_s - self.half_s) - 1.0

    def time_of(self, shot: NDArray[np.int64]) -> NDArray[np.float64]:
        """Time of each shot, adjusted standard [s]."""
        time: NDArray[np.float64] = self.start_s + shot / self.scene.acquisition.prf_hz
        return time


def make_passes(scene: Scene, arrays: SceneArrays) -> list[Pass]:
    """Flightlines of a scene, one after the other.

    Raises WorkflowError if one has no shot that meets the scene.
    """
    sensor, passes = scene.instrument, []
    diagonal = math.hypot(*scene.extent_m) / 2 + scene.acquisition.margin_m
    for k, flight in enumerate(scene.flights):
        circle = flight.altitude_agl_m * math.tan(
            math.radians(sensor.half_cone_deg + 2 * scene.acquisition.wobble_deg)
        )
        half = (diagonal + 1.1 * circle + 20.0) / flight.speed_m_s
        middle = scene.acquisition.start_s + k * scene.acquisition.turn_s + half + 2.0
        phases = scene.chance(1, k).uniform(0, 2 * np.pi, 6)
        run = Pass(k + 1, flight, scene, middle, half, phases)
        found = tuple(_chunks(run, arrays))
        if not found:
            raise WorkflowError(
                f"flights.{k}: no shot meets the scene; offset_m {flight.offset_m:g} is outside "
                "the swath, choose a smaller one"
            )
        passes.append(replace(run, chunks=found))
    return passes


def array_reach_m(scene: Scene, flight: Flight) -> float:
    """Half the diagonal of the array's footprint on the ground [m]."""
    sensor = scene.instrument
    half = sensor.array_columns * sensor.beamlet_pitch_urad * 1e-6 / 2
    return (
        half
        * math.sqrt(2)
        * flight.altitude_agl_m
        / math.cos(math.radians(sensor.half_cone_deg)) ** 2
    )


def _chunks(run: Pass, arrays: SceneArrays) -> Iterator[Chunk]:
    """Shots whose footprint meets the scene."""
    prf = run.scene.acquisition.prf_hz
    reach = array_reach_m(run.scene, run.flight) + run.scene.acquisition.margin_m
    total = math.ceil((2 * run.half_s + 2) / CHUNK_S)
    for index in range(total):
        shot = np.arange(
            math.ceil(index * CHUNK_S * prf), math.ceil((index + 1) * CHUNK_S * prf), dtype=np.int64
        )
        ground, range_m = ground_points(run, shot, arrays)
        # how far it is off the extent, negative within [m]
        outside = np.maximum(-ground[:, :2], ground[:, :2] - run.scene.extent_m).max(axis=1)
        near = outside <= reach
        if near.any():
            yield Chunk(index, shot[near], range_m[near], outside[near] <= 0)


def ground_points(
    run: Pass, shot: NDArray[np.int64], arrays: SceneArrays
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Where the array's centre meets the bare ground, to a few centimetres, by shot.

    Places (n, 3), relative to the scene's origin, and slant ranges (n,) [m].
    """
    time = run.time_of(shot)
    origin = run.position(time)
    turn = rotations(*run.attitude(time))
    cone = math.radians(run.scene.instrument.half_cone_deg)
    beam = np.einsum("nij,nj->ni", turn, central_vectors(run.scan_angle(shot), cone))
    z = np.full(len(shot), run.scene.origin_m[2])
    ny, nx = arrays.ground.z.shape
    for _ in range(3):
        range_m = (z - origin[:, 2]) / beam[:, 2]
        place = (
            origin + range_m[:, None] * beam - [*arrays.ground.grid[:2], 0]
        ) / arrays.ground.grid[2]
        i = np.clip(np.rint(place[:, 0]).astype(np.int64), 0, nx - 1)
        j = np.clip(np.rint(place[:, 1]).astype(np.int64), 0, ny - 1)
        z = arrays.ground.z[j, i]
    return origin + range_m[:, None] * beam, range_m


def gate_of_chunk(run: Pass, index: int) -> int:
    """Number of the range gate's setting in a chunk of a pass, from its start."""
    return int(index * CHUNK_S / run.scene.acquisition.gate_moves_s)


def gate_centres(run: Pass) -> dict[int, float]:
    """Mean ground range that each setting of the gate is centred on [m]."""
    sums: dict[int, tuple[float, int]] = {}
    for piece in run.chunks:
        setting = gate_of_chunk(run, piece.index)
        total, count = sums.get(setting, (0.0, 0))
        sums[setting] = (total + float(piece.ground_range_m.sum()), count + len(piece.shot))
    return {setting: total / count for setting, (total, count) in sums.items()}
