"""Shots of a flightline against a scene: what every beamlet of every shot records."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.air import Air, NoiseGrid, add_air, deposit
from spl_batch.airborne.simulate.detector import (
    NO_PARENT,
    Receiver,
    add_background,
    add_event,
    poisson_count,
    record,
)
from spl_batch.airborne.simulate.scene.beam_layers import empty_layers, look
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.sunlight import brightness
from spl_batch.numerics.compiled import njit


class Optics(NamedTuple):
    """Instrument and air, as numbers."""

    #: (c,): angular place of each beamlet [rad], turned by alpha_R.
    pixel_x: NDArray[np.float64]
    pixel_y: NDArray[np.float64]
    gain: NDArray[np.float64]  #: (c,): sensitivity of each channel relative to the mean; 0 is dead.
    half_cone_rad: float
    sigma_rad: float  #: Spread of a beamlet about its axis, one direction [rad].
    range_sigma_m: float
    signal_m2: float  #: Instrument constant of Eq. 2.1 [m2].
    extinction_per_m: float  #: Atmospheric extinction [1/m].


class Shots(NamedTuple):
    """Shots in time order; positions relative to the scene's origin."""

    origin: NDArray[np.float64]  #: (n, 3): sensor position [m].
    turn: NDArray[np.float64]  #: (n, 3, 3): body frame to local frame.
    angle: NDArray[np.float64]  #: (n,): scan angle [rad].
    #: (n,): range gate [m].
    gate_start: NDArray[np.float64]
    gate_stop: NDArray[np.float64]
    #: (n,): background of a channel of gain 1, and what comes beside it from ground of mean
    #: brightness, where that is by albedo [1/m].
    noise_per_m: NDArray[np.float64]
    ground_per_m: NDArray[np.float64]
    time_s: NDArray[np.float64]  #: (n,): since the scene's take-off [s].


POINT: Final = np.dtype(
    [
        ("shot", np.int64),
        *((axis, np.float64) for axis in "xyz"),
        ("channel", np.uint8),
        ("return_number", np.uint8),
        ("number_of_returns", np.uint8),
        ("kind", np.uint8),
        ("parent", np.uint8),
        ("electrons", np.int64),
        ("parent_row", np.int64),
    ]
)
"""A recorded return: row of its shot; place along the beamlet's axis at the measured range [m];
channel from 1, LAS return numbers, truth; photo-electrons merged into the detection; row of an
afterpulse's parent in the same buffer, -1 for the rest."""


@njit()
def beam_direction(
    turn: NDArray[np.float64],
    angle: float,
    half_cone: float,
    px: float,
    py: float,
    out: NDArray[np.float64],
) -> None:
    """Unit vector of one beamlet in the local frame: fills ``out`` [W17 Eq. 2.11-2.15].

    ``turn``: body frame to local frame; the beamlet is at ``px, py`` of the array [rad].
    """
    ca, sa = math.cos(angle), math.sin(angle)
    cone = math.sin(half_cone)
    x = cone * sa + ca * px + sa * py
    y = cone * ca - sa * px + ca * py
    z = -math.cos(half_cone)
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    for k in range(3):
        out[k] = (turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z) * scale


@njit()
def _spread(rng: np.random.Generator, axis: Any, sigma: float, out: NDArray[np.float64]) -> None:
    """Direction of a photon inside a beam that points mostly downwards."""
    x = axis[0] + sigma * rng.standard_normal()
    y = axis[1] + sigma * rng.standard_normal()
    scale = 1.0 / math.sqrt(x * x + y * y + axis[2] * axis[2])
    out[0], out[1], out[2] = x * scale, y * scale, axis[2] * scale


@njit()
def add_signal(
    rng: np.random.Generator,
    scene: SceneArrays,
    optics: Optics,
    gain: float,
    ray: Any,
    layers: NDArray[np.float64],
    ranges: NDArray[np.float64],
    facts: NDArray[np.int64],
    n: int,
) -> tuple[int, float]:
    """Photo-electrons of the scene in one beamlet [W17 Eq. 2.1, 2.6; Beer-Lambert in crowns].

    ``ray``: origin, axis, room for the photons' direction; ``ranges, facts, n``: events so far, as
    in :func:`~spl_batch.airborne.simulate.detector.add_event`. Returned are the number of events,
    and the range of the hard surface that a photon met [m].
    """
    origin, axis, path = ray
    _spread(rng, axis, optics.sigma_rad, path)
    layer_count, hard, cosine, rho, kind = look(scene, origin, path, axis, optics.sigma_rad, layers)
    full = optics.signal_m2 * gain / (hard * hard) * math.exp(-2 * optics.extinction_per_m * hard)
    left = 1.0
    for k in range(layer_count):
        share = layers[k, 2]
        for _ in range(poisson_count(rng, full * left * share * layers[k, 3])):
            at = layers[k, 0]
            if layers[k, 1] > at:
                # depth of a Beer-Lambert photon, given that the layer stops it
                depth = math.log(1.0 - rng.random() * share) / math.log(1.0 - share)
                at += depth * (layers[k, 1] - at)
            if at < hard:
                at += optics.range_sigma_m * rng.standard_normal()
                n = add_event(ranges, facts, n, at, int(layers[k, 4]), NO_PARENT, -1)
        left *= 1.0 - share
    for _ in range(poisson_count(rng, full * left * rho * cosine)):
        at = hard + optics.range_sigma_m * rng.standard_normal()
        n = add_event(ranges, facts, n, at, int(kind), NO_PARENT, -1)
    return n, hard


@njit()
def _in_gate(ranges: NDArray[np.float64], facts: NDArray[np.int64], n: int, start: float) -> int:
    """Drop events in front of the gate; the number that is left."""
    first = 0
    while first < n and ranges[first] < start:
        first += 1
    for k in range(first, n):
        ranges[k - first] = ranges[k]
        facts[k - first] = facts[k]
    return n - first


@njit()
def fire(
    rng: np.random.Generator,
    scene: SceneArrays,
    optics: Optics,
    receiver: Receiver,
    air: Air,
    shots: Shots,
    first: int,
    room: int,
    grid: NoiseGrid,
    out: NDArray[np.void],
) -> tuple[int, int]:
    """Simulate shots from row ``first`` on, until they are done or the buffer might overflow.

    Chance is consumed in the order of shots and channels. ``room``: of a beamlet for events, see
    :func:`event_room`. ``out`` are returns (:data:`POINT`), in shot, channel and range order, room
    for two shots at least. Returned are the first shot that was not fired, and rows filled.
    """
    channels, row = len(optics.gain), 0
    most = len(out) - channels * room
    axis, layers = np.empty(3), empty_layers(scene)
    ranges, facts = np.empty(room), np.empty((room, 3), np.int64)
    kept, electrons = np.empty(room, np.int64), np.empty(room, np.int64)
    for shot in range(first, len(shots.angle)):
        if row > most:
            return shot, row
        for c in range(channels):
            if optics.gain[c] > 0.0:
                held = _look(
                    rng, scene, optics, air, shots, shot, c, axis, layers, ranges, facts, grid
                )
                count = record(
                    rng, ranges, facts, held, shots.gate_stop[shot], receiver, kept, electrons
                )
                _write(shots, shot, c, axis, ranges, facts, kept[:count], electrons, out, row)
                row += count
    return len(shots.angle), row


@njit()
def _look(  # type: ignore[no-untyped-def]
    rng, scene, optics, air, shots, shot, c, axis, layers, ranges, facts, grid
):
    """Photo-electrons of one beamlet, before the receiver: how many [count]."""
    origin, path = shots.origin[shot], np.empty(3)
    start, stop, gain = shots.gate_start[shot], shots.gate_stop[shot], optics.gain[c]
    beam_direction(
        shots.turn[shot], shots.angle[shot], optics.half_cone_rad, optics.pixel_x[c],
        optics.pixel_y[c], axis,
    )  # fmt: skip
    glow = 0.0
    if scene.ground.light.shape[0] > 0:
        glow = brightness(scene, (origin, axis), optics.sigma_rad, layers)
    noise = gain * (shots.noise_per_m[shot] + glow * shots.ground_per_m[shot])
    n = add_background(rng, ranges, facts, (start, stop), noise, air.gate_fall)
    ray = (origin, axis, path)
    n, hard = add_signal(rng, scene, optics, gain, ray, layers, ranges, facts, n)
    span, time_s = (start, min(hard, stop)), shots.time_s[shot]
    n = add_air(rng, scene, air, gain, time_s, (origin, axis), span, ranges, facts, n)
    deposit(grid, scene, air, gain, time_s, (origin, axis), (start, stop), noise, span[1])
    return _in_gate(ranges, facts, n, start)


@njit()
def _write(shots, shot, c, axis, ranges, facts, kept, electrons, out, row):  # type: ignore[no-untyped-def]
    """What one beamlet has recorded, from a row on."""
    origin = shots.origin[shot]
    for k in range(len(kept)):
        at, source, point = ranges[kept[k]], facts[kept[k], 2], out[row + k]
        point.shot = shot
        point.x = origin[0] + at * axis[0]
        point.y = origin[1] + at * axis[1]
        point.z = origin[2] + at * axis[2]
        point.channel = c + 1
        point.return_number = min(k + 1, 15)
        point.number_of_returns = min(len(kept), 15)
        point.kind = facts[kept[k], 0]
        point.parent = facts[kept[k], 1]
        point.electrons = electrons[k]
        point.parent_row = row + source if source >= 0 else -1


def event_room(background: float, signal: float, layers: int) -> int:
    """Events that one beamlet must have room for, far beyond what chance makes likely.

    ``background`` and ``signal``: highest expected photo-electrons of background, and of one
    surface; ``layers``: most that one beam can meet [count].
    """
    mean = background + signal
    return int(2 * (mean + 12 * math.sqrt(mean + 1))) + 16 * (layers + 8)
