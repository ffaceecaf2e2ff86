"""Stray light: bloom and crosstalk, which reach channels that they were not meant for.

A retro-reflector sends so much light back that the optics spread it over the whole array: all
channels of a shot that lights it see it, at its range. Crosstalk, electrical or optical: a
detection in one channel may set off a channel beside it at the same moment. Channels stand in the
array as [W17] Eq. 2.9 counts them; [W17] has neither effect.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.detector import NO_PARENT, add_event, poisson_count
from spl_batch.airborne.simulate.scene.ray_trace import KIND_BLOOM, KIND_CROSSTALK
from spl_batch.numerics.compiled import njit


class StrayLight(NamedTuple):
    """What sends light astray, as numbers for the kernels."""

    #: (k, 4): place relative to the scene's origin, height absolute [m]; photo-electrons per
    #: channel.
    reflectors: NDArray[np.float64]
    half_array_rad: float  #: Half the edge of the array [rad].
    crosstalk: float  #: Chance that a photo-electron sets off one given channel beside its own.
    columns: int  #: Channels along one side of the array.


@njit()
def lit_reflectors(stray: StrayLight, origin: Any, centre: Any, lit: NDArray[np.float64]) -> int:
    """Ranges of the reflectors within a shot's array, taken as a circle of its area.

    Parameters
    ----------
    origin, centre : (3,) float64
        Sensor position [m], unit vector of the array's centre.
    lit : (k, 2) float64
        Filled: range [m], photo-electrons per channel.
    """
    radius, n = stray.half_array_rad * 2.0 / math.sqrt(math.pi), 0
    for r in range(len(stray.reflectors)):
        dx = stray.reflectors[r, 0] - origin[0]
        dy = stray.reflectors[r, 1] - origin[1]
        dz = stray.reflectors[r, 2] - origin[2]
        range_m = math.sqrt(dx * dx + dy * dy + dz * dz)
        cosine = (dx * centre[0] + dy * centre[1] + dz * centre[2]) / range_m
        if cosine > math.cos(radius):
            lit[n, 0], lit[n, 1] = range_m, stray.reflectors[r, 3]
            n += 1
    return n


@njit()
def add_bloom(
    rng: np.random.Generator, lit: NDArray[np.float64], count: int, gain: float, sigma_m: float,
    ranges: NDArray[np.float64], facts: NDArray[np.int64], n: int,
) -> int:  # fmt: skip
    """Photo-electrons of lit reflectors in one channel.

    Parameters
    ----------
    rng : Generator
        Source of chance; not consumed where nothing is lit.
    lit, count
        From :func:`lit_reflectors`.
    ranges, facts, n
        Events so far, as in :func:`~spl_batch.airborne.simulate.detector.add_event`.
    """
    for k in range(count):
        for _ in range(poisson_count(rng, gain * lit[k, 1])):
            at = lit[k, 0] + sigma_m * rng.standard_normal()
            n = add_event(ranges, facts, n, at, KIND_BLOOM, NO_PARENT, -1)
    return n


@njit()
def set_off_neighbours(
    rng: np.random.Generator, stray: StrayLight, gains: NDArray[np.float64],
    ranges: NDArray[np.float64], facts: NDArray[np.int64], count: NDArray[np.int64],
) -> None:  # fmt: skip
    """Photo-electrons that those of a shot set off in the channels beside theirs.

    What is set off sets nothing off.

    Parameters
    ----------
    gains : (c,) float64
        Of the channels; those of 0 are dead.
    ranges : (c, m) float64
        Events of each channel, ascending [m].
    facts : (c, m, 3) int64
        As in :func:`~spl_batch.airborne.simulate.detector.add_event`.
    count : (c,) int64
        Events of each channel, updated.
    """
    columns = stray.columns
    for c in range(len(count)):
        for e in range(count[c]):
            if facts[c, e, 0] == KIND_CROSSTALK:
                continue
            for side in range(4):
                row, col = c // columns, c % columns
                row += (side == 0) - (side == 1)
                col += (side == 2) - (side == 3)
                if not (0 <= row < columns and 0 <= col < columns):
                    continue
                other = row * columns + col
                if gains[other] > 0.0 and rng.random() < stray.crosstalk:
                    count[other] = add_event(
                        ranges[other], facts[other], count[other], ranges[c, e], KIND_CROSSTALK,
                        NO_PARENT, -1,
                    )  # fmt: skip
