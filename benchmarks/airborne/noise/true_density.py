"""True noise density at places of a simulated survey, from the beamlets that it fires.

A beamlet's noise is even along its gate. So each leaves what it is expected to record in a metre in
cells of half a metre, a metre apart, from a random place on; the density at a place is the mean of
the cells around it that any beamlet crosses, whole up to where all noise ends. Beamlets have to be
many, ten and more in each cell.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.simulate.brightness import make_optics, solve_noise
from spl_batch.airborne.simulate.flight import CHUNK_S, GATE_S, chunks, gate_centres, make_passes
from spl_batch.airborne.simulate.scene.layout import lay_out
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.simulate.shots import Optics, beam_direction
from spl_batch.numerics.attitude import rotations

CELL_M, STEP_M = 0.5, 1.0
"""Edge of a cell, and the distance at which a beamlet is looked at along its gate [m]."""
BESIDE_M, ABOVE_M = 40.0, 25.0
"""What is looked at beside the scene's extent, and beyond its gate [m]."""
AROUND = (3, 3, 2)
"""Cells that are put together [count]."""
LEAST = 1e-3
"""Nowhere is the density less: where a return is some beamlet has listened [1/m3]."""

Floats = NDArray[np.float64]


def true_density(scene: Scene, xyz: Floats) -> Floats:
    """Noise expected at places by the simulator's own laws: (n,) [1/m3].

    Parameters
    ----------
    scene : Scene
        What is simulated.
    xyz : (n, 3) float64
        Places in the scene's coordinates [m].
    """
    gate, origin = scene.acquisition.gate_m, np.array(scene.origin_m)
    low = origin - [BESIDE_M, BESIDE_M, gate * scene.acquisition.gate_above + ABOVE_M]
    size = np.array([*scene.extent_m, gate]) + 2 * np.array([BESIDE_M, BESIDE_M, ABOVE_M])
    cells = np.zeros(tuple(np.ceil(size / CELL_M).astype(int)), dtype=np.float32)
    optics, passes = make_optics(scene), make_passes(scene)
    arrays = lay_out(scene).arrays
    pieces = [list(chunks(run, arrays)) for run in passes]
    noise = solve_noise(scene, passes, pieces)
    rng = np.random.default_rng([7, scene.seed])
    for run, mine in zip(passes, pieces, strict=True):
        centres = gate_centres(mine)
        for piece in mine:
            time_s = run.time_of(piece.shot)
            centre = centres[int(piece.index * CHUNK_S / GATE_S)]
            deposit(
                rng, run.position(time_s) - (low - [*origin[:2], 0.0]),
                rotations(*run.attitude(time_s)), run.scan_angle(piece.shot),
                centre - gate * scene.acquisition.gate_above, gate,
                noise.at(run.sky(time_s)), optics, cells,
            )  # fmt: skip
    return density_at(cells, (xyz - low) / CELL_M)


def density_at(cells: NDArray[np.float32], place: Floats) -> Floats:
    """Density around places: (n,) [1/m3].

    Parameters
    ----------
    cells : (nx, ny, nz) float32
        What beamlets are expected to record in each cell [count].
    place : (n, 3) float64
        From the corner of the cells [cells].
    """
    heard = ndimage.uniform_filter((cells > 0).astype(np.float32), AROUND)
    cells = ndimage.uniform_filter(cells, AROUND) / CELL_M**3
    # an even number of cells lies around the lower end of one
    middle = np.where(np.array(AROUND) % 2 == 0, 0.5, 0.0)
    index = np.floor(place + middle).astype(int)
    at = tuple(np.clip(index, 0, np.array(cells.shape) - 1).T)
    found: Floats = np.maximum(cells[at] / np.maximum(heard[at], 0.1), LEAST).astype(np.float64)
    return found


@njit(nogil=True, cache=True)
def deposit(
    rng: np.random.Generator,
    origin: Floats,
    turn: Floats,
    angle: Floats,
    start: float,
    gate: float,
    per_m: Floats,
    optics: Optics,
    cells: NDArray[np.float32],
) -> None:
    """Leave what each beamlet of some shots is expected to record in the cells that it crosses.

    Parameters
    ----------
    rng : Generator
        Where along a beamlet is looked.
    origin : (n, 3) float64
        Sensor, from the corner of the cells [m].
    turn, angle : (n, 3, 3), (n,) float64
        Body frame to local frame, and scan angle [rad].
    start, gate : float
        Range at which the gate begins, and its length [m].
    per_m : (n,) float64
        Noise of a channel of gain 1 [1/m].
    optics : Optics
        Places and gains of the beamlets.
    cells : (nx, ny, nz) float32
        Added to [count].
    """
    axis = np.empty(3)
    for shot in range(len(angle)):
        for c in range(len(optics.gain)):
            beam_direction(
                turn[shot], angle[shot], optics.half_cone_rad, optics.pixel_x[c],
                optics.pixel_y[c], axis,
            )  # fmt: skip
            expected = optics.gain[c] * per_m[shot] * STEP_M
            at = start + STEP_M * rng.random()
            while at < start + gate:
                i = math.floor((origin[shot, 0] + at * axis[0]) / CELL_M)
                j = math.floor((origin[shot, 1] + at * axis[1]) / CELL_M)
                k = math.floor((origin[shot, 2] + at * axis[2]) / CELL_M)
                if 0 <= i < cells.shape[0] and 0 <= j < cells.shape[1] and 0 <= k < cells.shape[2]:
                    cells[i, j, k] += expected
                at += STEP_M
