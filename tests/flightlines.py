"""A small flightline with known noise, for the tests of the time domain.

Simple on purpose and independent of the project's simulator: beams on a circle, a surface
given by a function, Poisson background along the gate, nothing recorded for silent shots.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tables import COLUMNS, PointTable, ShotClock, Trajectory

CLOCK = ShotClock(200_000.0, 50_000.0)
ALTITUDE_M = 3000.0
SPEED_M_S = 90.0

Surface = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


@dataclass(frozen=True)
class Flight:
    """Returns, the trajectory, and which returns are background."""

    table: PointTable
    trajectory: Trajectory
    noise: NDArray[np.bool_]


def flat(x: NDArray[np.float64], _: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.full_like(x, 40.0)


def relief(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Hills of 140 m from valley to top."""
    return 80.0 + 70.0 * np.sin(x / 250.0) * np.cos(y / 300.0)


def fly(
    *,
    seed: int = 1,
    shots: int = 3000,
    first_shot: int = 12_345,
    surface: Surface = flat,
    noise_per_m: float | Callable[[NDArray[np.int64]], NDArray[np.float64]] = 1.3e-3,
    detection: float = 0.2,
    gate_m: float = 300.0,
    gate_ahead_m: float | None = None,
    gate_kind: str = "range",
    gains: NDArray[np.float64] | None = None,
    canopy_m: float = 0.0,
    scan_m: float = 400.0,
    albedo: Surface | None = None,
) -> Flight:
    """Fly a line to the east.

    ``albedo`` multiplies the noise of a beamlet by the brightness of the ground that it looks at.

    ``gate_kind``: "range" opens the gate at one slant range, "height" cuts at two heights,
    "surface" opens it ``gate_ahead_m`` in front of the surface under each shot.
    """
    rng = np.random.default_rng(seed)
    lead_m = gate_m / 2 if gate_ahead_m is None else gate_ahead_m
    gains = np.ones(100) if gains is None else gains
    shot = np.arange(first_shot, first_shot + shots)
    time = CLOCK.t0_s + shot / CLOCK.prf_hz
    angle = 2 * np.pi * 25.0 * (time - CLOCK.t0_s)
    sensor = np.column_stack(
        [SPEED_M_S * (time - CLOCK.t0_s), np.zeros(shots), np.full(shots, ALTITUDE_M)]
    )
    i, j = np.divmod(np.arange(100), 10)
    ground_x = sensor[:, :1] + scan_m * np.sin(angle)[:, None] + 0.35 * (i - 4.5)
    ground_y = scan_m * np.cos(angle)[:, None] + 0.35 * (j - 4.5)
    aim = np.stack([ground_x, ground_y, np.zeros_like(ground_x)], axis=-1) - sensor[:, None]
    direction = aim / np.linalg.norm(aim, axis=-1, keepdims=True)
    cosine = -direction[..., 2]
    hit = (ALTITUDE_M - 40.0) / cosine
    for _ in range(20):
        xyz = sensor[:, None] + direction * hit[..., None]
        hit += (xyz[..., 2] - surface(xyz[..., 0], xyz[..., 1])) / cosine
    near, far = _gate(gate_kind, hit, cosine, lead_m, gate_m)
    rate = noise_per_m(shot) if callable(noise_per_m) else np.full(shots, noise_per_m)
    expected = rate[:, None] * gains * (far - near)
    if albedo is not None:
        xyz = sensor[:, None] + direction * hit[..., None]
        expected = expected * albedo(xyz[..., 0], xyz[..., 1])
    count = rng.poisson(expected)
    s_noise, c_noise = (np.repeat(v.ravel(), count.ravel()) for v in np.indices(count.shape))
    r_noise = rng.uniform(near[s_noise, c_noise], far[s_noise, c_noise])
    seen = rng.random(hit.shape) < detection * np.minimum(gains, 1.0)
    seen &= (hit > near) & (hit < far)
    s_signal, c_signal = np.nonzero(seen)
    r_signal = hit[seen] + rng.normal(0, 0.05, seen.sum()) - canopy_m * rng.random(seen.sum())
    s, c = np.concatenate([s_noise, s_signal]), np.concatenate([c_noise, c_signal])
    r = np.concatenate([r_noise, r_signal])
    points = sensor[s] + direction[s, c] * r[:, None]
    noise = np.arange(len(s)) < len(s_noise)
    columns = {
        "gps_time": time[s],
        "channel": c + 1,
        "shot": shot[s],
        **{k: np.rint(points[:, a] * 1000) for a, k in enumerate("xyz")},
    }
    order = np.lexsort([r, columns["channel"], columns["gps_time"]])
    table = PointTable({k: v[order].astype(COLUMNS[k].dtype) for k, v in columns.items()})
    ends = np.array([time[0] - 1.0, time[-1] + 1.0])
    path = np.column_stack([SPEED_M_S * (ends - CLOCK.t0_s), [0, 0], [ALTITUDE_M] * 2])
    return Flight(table, Trajectory(ends, path, max_gap_s=1e6), noise[order])


def _gate(
    kind: str,
    hit: NDArray[np.float64],
    cosine: NDArray[np.float64],
    lead_m: float,
    gate_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if kind == "height":
        top = ALTITUDE_M - 40.0 - lead_m
        return top / cosine, (top + gate_m) / cosine
    middle = hit.mean(axis=1, keepdims=True) if kind == "surface" else np.median(hit)
    near = np.broadcast_to(middle - lead_m, hit.shape)
    return near, near + gate_m


def cut(table: PointTable, shots: int) -> list[PointTable]:
    """Stretches of a flightline between whole multiples of a number of shots."""
    stretch = table["shot"] // shots
    return [table.take(stretch == k) for k in np.unique(stretch)]
