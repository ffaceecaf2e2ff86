"""Directions of all fired beamlets, silent ones and silent shots included; domain: time.

Source: [W17] Eq. 2.8-2.15 for the geometry (a rigid array behind a scanner), 8.2.2 for its use.
Each detection, noise too, lies on the axis of its beamlet. So a block of a few shots shows the path
of the array and its turn, and where it points in the shots and channels between.

Blocks lie on the absolute grid of shots, at most :data:`BLOCK_SHOTS` long, each by itself: where a
flightline is cut does not matter. The line model has which shots were fired, and how sensitive a
channel is.

Deviations: a channel's place in the array is that of Eq. 2.9 where the returns agree with it; else
the block's own returns give it, and a channel without any counts as not fired. A block that fits
neither is left out.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.link_budget import link_constant
from spl_batch.airborne.beams.rays import meet_planes
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.products.reflectance.shot_pattern import (
    TERMS,
    Rows,
    learn_pattern,
    misfit,
    motion,
    normal_equations,
)
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import BeamTable, PointTable, ShotClock

COLUMNS_NEEDED: Final = ("z", "channel", "shot")

BLOCK_SHOTS: Final = 60
"""Longest block: within 2 ms a scan of 25 Hz turns by 18 degrees, a cubic to millimetres. Half
moves 1472 + 1682 cells of the intensity, twice nothing."""

MISFIT_MAX_M: Final = 0.3
"""Spread about the fit, on the ground, beyond which it is not believed [m]."""

LEARNING_ROUNDS: Final = 4
"""Rounds in which an unknown array and its turn are fitted in alternation [count]."""

_RIDGE: Final = 1e-7
"""Weight of "zero" for coefficients that a block's few shots do not determine. Half moves 23 + 19
cells of the intensity, twice 39 + 42 cells of the intensity."""

BLOCK: Final = np.dtype(
    [
        ("first", np.int64),
        ("last", np.int64),
        ("middle", np.float64),
        ("half", np.float64),
        ("anchor", np.float64, 3),
        ("coefficient", np.float64, (TERMS, 2)),
        ("origin", np.float64, (2, 3)),
        ("pattern", np.int64),
    ]
)
"""A block: first and last shot fired; a shot's time within it is ``(shot - middle) / half``; place
on the reference plane that the fit is relative to, and its height [m]; where beamlets meet that
plane, see :mod:`~spl_batch.airborne.products.reflectance.shot_pattern` [m]; sensor relative to the
anchor at the middle, and its motion per unit of time [m]; which pattern it has."""

_NUMBERS: Final = ("constant_m2", "t0_s", "prf_hz", "dropped", "line")
"""What a part has once."""


@dataclass(frozen=True, slots=True)
class FiredPart:
    """Beamlets fired during one stretch."""

    blocks: NDArray[np.void]  #: (m,): of :data:`BLOCK`.
    #: (k, c, 2): places of the channels in the array; NaN where not known.
    patterns: NDArray[np.float64]
    #: (c,): sensitivity of each channel, median of the live ones one; 0 is dead.
    gain: NDArray[np.float64]
    constant_m2: float  #: Photo-electrons of a beamlet per reflectance, times square of range [m2].
    t0_s: float
    prf_hz: float
    dropped: int  #: Blocks with returns that no fit describes.
    line: int  #: Number of the flightline.

    @property
    def pattern(self) -> NDArray[np.float64]:
        """Place of each channel in the array, by block: (m, c, 2)."""
        found: NDArray[np.float64] = self.patterns[self.blocks["pattern"]]
        return found

    def raised(self, up_q: int) -> "FiredPart":
        """The same fired from higher up [quanta]."""
        blocks = self.blocks.copy()
        blocks["anchor"][:, 2] += up_q * QUANTUM_M
        return replace(self, blocks=blocks)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Few arrays, as an npz file holds them."""
        numbers = np.array([float(getattr(self, name)) for name in _NUMBERS])
        arrays = {"blocks": self.blocks, "patterns": self.patterns, "gain": self.gain}
        return {**arrays, "numbers": numbers}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> "FiredPart":
        """Part that :meth:`to_arrays` gave."""
        numbers = dict(zip(_NUMBERS, arrays["numbers"].tolist(), strict=True))
        whole = {name: int(numbers.pop(name)) for name in ("dropped", "line")}
        return cls(arrays["blocks"], arrays["patterns"], arrays["gain"], **numbers, **whole)

    def reach(self) -> list[int]:
        """Rectangle that the beamlets can meet near their reference planes [m]."""
        if not len(self.blocks):
            return [0, 0, 0, 0]
        a = self.blocks["coefficient"]
        spread = np.abs(a[:, 1:]).sum(axis=1)
        centre = self.blocks["anchor"][:, :2] + a[:, 0]
        low, high = np.floor((centre - spread).min(axis=0)), np.ceil((centre + spread).max(axis=0))
        return [int(low[0]), int(low[1]), int(high[0]), int(high[1])]


def aim(
    table: PointTable,
    beams: BeamTable,
    model: LineModel,
    sensor: Sensor,
    clock: ShotClock,
    line: int,
) -> FiredPart:
    """Beamlets fired during a stretch.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...).
    beams : BeamTable
        Their beams from true sensor positions; rows without a known beam take no part.
    model : LineModel
        Which shots were fired, and the gain of each channel.
    sensor : Sensor
        Array and link budget [W17 Eq. 2.1].
    line : int
        Number of the flightline.
    """
    table = table.select(COLUMNS_NEEDED)
    origin, direction = beams.origin_m, beams.direction
    usable = beams.known & (direction[:, 2] < -0.1)
    if not usable.all():
        table, origin, direction = table.take(usable), origin[usable], direction[usable]
    start, first, last = _blocks(table["shot"], model)
    size = np.diff(start)
    place, anchor = meet_planes(start, table["z"], QUANTUM_M, origin, direction)
    middle: NDArray[np.float64] = (first + last).astype(np.float64) / 2
    half = np.maximum(0.5 * (last - first), 0.5)
    tau = (table["shot"] - np.repeat(middle, size)) / np.repeat(half, size)
    channels = int(max(table["channel"].max(initial=0), sensor.beamlets)) + 1
    data = (start, tau, table["channel"], place)
    grid = _grid(sensor, channels)
    coefficient, rms = _fit(data, np.repeat(grid[None], len(size), axis=0))
    wrong = np.flatnonzero(~(rms <= MISFIT_MAX_M))
    learnt = np.empty((0, channels, 2))
    if len(wrong):
        learnt, coefficient[wrong], rms[wrong] = _learn(_only(data, wrong), channels)
    good = rms <= MISFIT_MAX_M
    moving = np.empty((len(size), 2, 3))
    motion(start, tau, origin, anchor, moving)
    which = np.zeros(len(size), np.int64)
    which[wrong] = np.arange(1, len(wrong) + 1)
    blocks = np.empty(len(size), BLOCK)
    columns = first, last, middle, half, anchor, coefficient, moving, which
    for name, values in zip(BLOCK.names or (), columns, strict=True):
        blocks[name] = values
    return FiredPart(
        blocks[good], np.concatenate([grid[None], learnt]), _sensitivity(model, channels),
        link_constant(sensor), clock.t0_s, clock.prf_hz, int(np.count_nonzero(~good)), line,
    )  # fmt: skip


def _blocks(
    shot: NDArray[np.int64], model: LineModel
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Blocks with returns: first rows (m + 1,), first and last shot fired (m,) each."""
    length = model.interval_shots
    parts = -(-length // BLOCK_SHOTS)
    interval = np.floor_divide(shot, length)
    part = (shot - interval * length) * parts // length
    block = interval * parts + part
    start = np.flatnonzero(np.diff(block, prepend=block[:1] - 1))
    row = model.row(shot[start])
    base = interval[start] * length
    # part = offset * parts // length, solved for the first and the last offset
    low = -(-part[start] * length // parts)
    high = -(-(part[start] + 1) * length // parts) - 1
    first = base + np.maximum(low, model.first[row])
    last = base + np.minimum(high, model.last[row])
    return np.append(start, len(shot)).astype(np.int64), first, last


def _grid(sensor: Sensor, channels: int) -> NDArray[np.float64]:
    """Place of each channel in the array, -1 to 1 [W17 Eq. 2.9]; NaN for others: (c, 2)."""
    columns = sensor.array_columns
    place = np.full((channels, 2), np.nan)
    used = np.arange(1, min(columns * columns, channels - 1) + 1)
    scale = max((columns - 1) / 2, 0.5)
    for axis, number in enumerate(np.divmod(used - 1, columns)):
        place[used, axis] = (number - (columns - 1) / 2) / scale
    return place


def _fit(
    data: Rows, pattern: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coefficients of each block, and the root mean square distance from them [m]."""
    m = len(data[0]) - 1
    matrix, right = np.empty((m, TERMS, TERMS)), np.empty((m, TERMS, 2))
    normal_equations(data, pattern, matrix, right)
    diagonal = np.arange(TERMS)
    matrix[:, diagonal, diagonal] += _RIDGE * np.maximum(np.diff(data[0]), 1)[:, None]
    coefficient: NDArray[np.float64] = np.linalg.solve(matrix, right).astype(np.float64)
    rms = np.empty(m)
    misfit(data, pattern, coefficient, rms)
    return coefficient, rms


def _learn(
    data: Rows, channels: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Array, coefficients and misfit of blocks whose channels are numbered otherwise."""
    pattern = np.zeros((len(data[0]) - 1, channels, 2))
    coefficient, rms = _fit(data, pattern)
    for _ in range(LEARNING_ROUNDS):
        learn_pattern(data, coefficient, pattern)
        scale = np.nanmax(np.abs(pattern), axis=(1, 2), initial=0.0, keepdims=True)
        pattern /= np.where(scale > 0, scale, 1.0)
        coefficient, rms = _fit(data, pattern)
    return pattern, coefficient, rms


def _only(data: Rows, blocks: NDArray[np.intp]) -> Rows:
    """Rows of some blocks."""
    start, tau, channel, place = data
    rows = np.concatenate([np.arange(start[b], start[b + 1]) for b in blocks])
    size = np.diff(start)[blocks]
    begin = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    return begin, tau[rows], channel[rows], place[rows]


def _sensitivity(model: LineModel, channels: int) -> NDArray[np.float64]:
    """Gain of each channel relative to the ordinary one: (c,) float64."""
    gain = model.gain[:channels].copy()
    gain[0] = 0.0
    live = gain[gain > 0]
    return gain / np.median(live) if len(live) else gain
