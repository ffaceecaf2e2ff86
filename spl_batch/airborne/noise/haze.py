r"""Noise that fills the air: haze and cloud between the start of the gate and the surface.

Domain: space. Deviation: [W17] Eq. 5.1 has the same noise all along a beamlet. Air that sends light
back has more in some heights and places, which a test takes for a signal. Squares of :data:`WINDOW`
x :data:`WINDOW` cubes of :data:`CUBE_M`, one layer high, hold air if they are

- *full*: three quarters of the cubes hold clearly more returns than the noise model expects. Wires,
  towers, trees with gaps and small roofs do not fill a square;
- *even upwards*: with c returns in a column of :data:`CELL_M` and n in each of its k cells,

  .. math:: \kappa = k \sum n (n - 1) / \sum c (c - 1)

  is 1 in air, k on level ground or a roof, and well above 1 in a canopy. Three layers hold much
  the same; crowns shade what is below them. Without enough pairs there is no air;
- *even across*: the upper quarter of the cubes holds no more than :data:`SMOOTH` times what the
  lower one does; crowns and gaps differ by more.

Edges of clouds taper, and tilted ones do in every square. There three layers need not hold the same
if :data:`CLEAR` clear layers lie below, as below no crowns, and if the columns hold as many pairs
as a plane through the cubes predicts, within :data:`ALIKE`: with n returns in each of the 25 cubes
of a square at u, v = -2..2, S = sum n, and c as above in its cubes of 25 columns each,

  .. math:: 1250 \sum c (c - 1) / (2 S^2 - 6 S + (\sum u n)^2 + (\sum v n)^2)

is 1 in air that changes from side to side alone, and more below the tops and gaps of crowns.

The noise there is the median of a cube and those beside it, which no wire moves; and the largest
of these around, as the edges of air are noise too. A point has the larger of this and the model's
noise. Signals weaker than the cloud are lost.

Counts are integers on absolute lattices; a point's noise depends on points up to :data:`REACH_M`.
"""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.lattice.tiles import quanta

CUBE_M: Final = 5.0
"""Edge of a cube [m]: air changes over tens of metres. Twice finds no haze: 102,695 + 0 labels."""

CELL_M: Final = 1.0
"""Edge of the cells in which clumping is looked for [m]."""

WINDOW: Final = 5
"""Cubes along the edge of a square that is looked at."""

REACH_M: Final = (WINDOW + 1) * CUBE_M
"""How far a point's noise looks: half a square to its middle, half a square on, one cube beside."""

LEFT_OUT: Final = WINDOW**2 // 4
"""A quarter of a square's cubes, which may hold less, or more [count]."""

CLEARLY: Final = 1.5
"""Multiple of the expected noise that fills a cube, beside one return more. Half moves 9 + 0
labels, twice nothing."""

EVEN: Final = 1.15
"""Largest clumping of air. Half moves 102695 + 0 labels, twice nothing."""

STEADY: Final = 1.4
"""Largest ratio between the returns of three layers, one above the other. Half moves 102695 + 0
labels, twice nothing."""

CLEAR: Final = 5
"""Layers of clear air below a square that excuse it from being steady: few trunks are so long.
Without that and :data:`ALIKE` 48 instead of 3 % of the returns of a closed cloud that tapers are
kept."""

ALIKE: Final = 1.02
"""Largest clumping across of such a square. Half moves nothing, twice 3 + 0 labels."""

SMOOTH: Final = 3.0
"""Largest ratio of the quarters of a square, and of a cube to its square's lower quarter, from
which on it holds a surface too. Half and twice move 1994 + 0 and 1 + 0 labels."""

PAIRS_LEAST: Final = 150
"""Pairs in columns that suffice: chance then leaves an error of a sixth. With 40, thin leaves of
trees without trunks are taken for air."""

EACH, THREE, ONE = (np.ones(n, np.int64) for n in (WINDOW, 3, 1))
"""Weights of cubes along the edge of a square, of three layers, and of one."""

UPRIGHT: Final = np.ones((1, 1, 3), np.bool_)
"""A cube, the one below and the one above."""

Axes = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]

Expected = Callable[[Axes], NDArray[np.float64]]
"""Noise that the model expects at places [quanta]: three (m,) int64 to (m,) [1/m3]."""


class Counts(NamedTuple):
    """Returns of cubes, and their pairs in columns and cells."""

    corner: tuple[int, int]  #: Index of the first cube along x and y on the absolute lattice.
    layer: NDArray[np.int64]  #: (l,): index of each layer that holds a return or lies beside one.
    held: NDArray[np.int32]  #: (nx, ny, l): returns [count].
    #: (nx, ny, l): ordered pairs of them that share a column, and a cell.
    columns: NDArray[np.int64]
    cells: NDArray[np.int64]


class Air(NamedTuple):
    """Noise that is seen in cubes."""

    cube: NDArray[np.int64]  #: (m, 3): index of each cube on the absolute lattice.
    density: NDArray[np.float64]  #: (m,): noise in it [1/m3].
    held: NDArray[np.bool_]  #: (m,): cubes found to hold air; the others lie beside one.
    returns: NDArray[np.int64]  #: (m,): returns in the cube.
    expected: NDArray[np.float64]  #: (m,): noise that the model expects at its centre [1/m3].


def count_cubes(xyz: Axes, counted: NDArray[np.bool_]) -> Counts | None:
    """Returns of each cube, and their pairs; None where nothing counts.

    Half a square of empty cubes lies around: edges of the points and ragged edges within them are
    treated alike.

    Parameters
    ----------
    xyz : three of (n,) integer
        Absolute coordinates [quanta].
    counted : (n,) bool
        Returns that count: independent ones.
    """
    rows = np.flatnonzero(counted)
    if not len(rows):
        return None
    half, parts = WINDOW // 2, round(CUBE_M / CELL_M)
    cell = [axis[rows].astype(np.int64, copy=False) // quanta(CELL_M) for axis in xyz]
    cube = [axis // parts for axis in cell]
    low = [int(axis.min()) for axis in cube]
    nx, ny, nz = (int(axis.max()) - least + 1 for axis, least in zip(cube, low, strict=True))
    above = cube[2] - low[2] + 1
    near = ndimage.binary_dilation(np.bincount(above, minlength=nz + 2) > 0)
    layer = np.flatnonzero(near)
    cube[2] = (np.cumsum(near) - 1)[above]
    corner = (low[0] - half, low[1] - half)
    shape = (nx + 2 * half, ny + 2 * half, len(layer))
    # One number for each cell: those of a column follow each other, and those of a cube.
    number = (cube[0] - corner[0]) * shape[1] + cube[1] - corner[1]
    number = number * shape[2] + cube[2]
    for axis in cell:
        number *= parts
        number += axis % parts
    number.sort()
    starts = run_starts(number)
    number, in_cell = number[starts[:-1]], np.diff(starts)
    starts = run_starts(number // parts)[:-1]
    in_column = np.add.reduceat(in_cell, starts)
    of_cell, of_column = number // parts**3, number[starts] // parts**3
    count, columns, cells = (
        np.bincount(at, values, np.prod(shape)).reshape(shape).astype(np.int64)
        for at, values in (
            (of_cell, in_cell),
            (of_column, in_column * (in_column - 1)),
            (of_cell, in_cell * (in_cell - 1)),
        )
    )
    return Counts(corner, layer + low[2] - 1, count.astype(np.int32), columns, cells)


def find_air(counts: Counts, expected: Expected) -> Air | None:
    """Cubes of air with the noise in them; None where there is none."""
    candidate, steady = _even(counts)
    if not candidate.any():
        return None
    lowest, highest = quarters(counts.held, ndimage.binary_dilation(candidate, UPRIGHT))
    level = (lowest > 1) & (highest <= SMOOTH * lowest)
    candidate &= ndimage.binary_erosion(level, UPRIGHT)
    tapering = candidate & ~steady
    if tapering.any():
        candidate &= steady | _hung(counts, tapering & _alike(counts), expected)
    level &= ndimage.binary_dilation(candidate, UPRIGHT)
    at = np.nonzero(level)
    if not len(at[0]):
        return None
    model = expected(centres(counts, at))
    # Where nothing is listened to nothing is known either.
    level[at] = (lowest[at] >= CLEARLY * model * CUBE_M**3 + 1.0) & (model > 0.0)
    seed = ndimage.binary_dilation(candidate & ndimage.binary_erosion(level, UPRIGHT), UPRIGHT)
    return _around(counts, seed, lowest, expected) if seed.any() else None


def noise_with_air(xyz: Axes, noise: NDArray[np.float64], air: Air | None) -> NDArray[np.float64]:
    """The larger of a noise and that of the air around points: (n,) [1/m3]."""
    if air is None:
        return noise
    low = air.cube.min(axis=0)
    density = np.zeros(air.cube.max(axis=0) - low + 1)
    density[tuple((air.cube - low).T)] = air.density
    at = [axis // quanta(CUBE_M) - first for axis, first in zip(xyz, low, strict=True)]
    within = [(index >= 0) & (index < n) for index, n in zip(at, density.shape, strict=True)]
    inside = np.logical_and.reduce(within)
    out: NDArray[np.float64] = noise.copy()
    out[inside] = np.maximum(out[inside], density[tuple(index[inside] for index in at)])
    return out


def _even(counts: Counts) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Middles of squares, three layers high, that are even upwards; those with as much in each."""
    seen = sum_of_square(counts.held)
    steady = ndimage.maximum_filter1d(seen, 3) <= STEADY * ndimage.minimum_filter1d(seen, 3)
    in_columns = sum_of_square(counts.columns, EACH, EACH, THREE)
    even = in_columns >= 2 * PAIRS_LEAST
    in_columns = EVEN * in_columns
    even &= round(CUBE_M / CELL_M) * sum_of_square(counts.cells, EACH, EACH, THREE) <= in_columns
    return even, steady


def _alike(counts: Counts) -> NDArray[np.bool_]:
    """Squares, three layers high, whose columns hold what a plane through their cubes predicts."""
    slope = np.arange(WINDOW) - WINDOW // 2
    held = counts.held.astype(np.int64)
    total, east, north = (
        sum_of_square(held, *weights) for weights in ((EACH, EACH), (slope, EACH), (EACH, slope))
    )
    # Of 5 x 5 cubes of 5 x 5 columns.
    planar = sum_of_square(2 * total**2 - 6 * total + east**2 + north**2, ONE, ONE, THREE)
    pairs = 1250 * sum_of_square(counts.columns, EACH, EACH, THREE)
    return pairs <= ALIKE * planar


def _hung(counts: Counts, asked: NDArray[np.bool_], expected: Expected) -> NDArray[np.bool_]:
    """Asked squares with :data:`CLEAR` clear layers between them and something below."""
    edge, out = quanta(CUBE_M), np.zeros(asked.shape, np.bool_)
    i, j = np.nonzero(asked.any(axis=2))
    if not len(i):
        return out
    x, y = ((k + low) * edge + edge // 2 for k, low in zip((i, j), counts.corner, strict=True))
    seen = sum_of_square(counts.held)[i, j]
    run = np.zeros(len(i), np.int64)
    solid, hung = np.zeros((2, len(i)), np.bool_)
    for layer in range(int(counts.layer[0]), int(counts.layer[-1]) + 1):
        h = int(np.searchsorted(counts.layer, layer))
        held = counts.layer[h] == layer
        model = expected((x, y, np.full(len(i), layer * edge + edge // 2))) * CUBE_M**3
        more = held & (seen[:, h] > WINDOW**2 * (CLEARLY * model + 1.0))
        if held:
            out[i, j, h] = hung
        run = np.where((model > 0.0) & ~more, run + 1, 0)
        hung |= solid & (run >= CLEAR)
        solid |= more & (model > 0.0)
    return out & asked


def quarters(
    held: NDArray[np.int32], asked: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Count that all but :data:`LEFT_OUT` cubes of each asked square reach, and do not exceed."""
    lower, upper = np.zeros((2, *held.shape), np.int32)
    inner = (slice(WINDOW // 2, -(WINDOW // 2)),) * 2
    chosen = asked[inner]
    squares = sliding_window_view(held, (WINDOW, WINDOW), axis=(0, 1))[chosen]
    ranked = np.sort(squares.reshape(-1, WINDOW**2), axis=1)
    lower[inner][chosen], upper[inner][chosen] = ranked[:, LEFT_OUT], ranked[:, -1 - LEFT_OUT]
    return lower, upper


def sum_of_square(values: NDArray[np.integer[Any]], *weights: NDArray[np.int64]) -> NDArray[Any]:
    """Sum over the square around each cube; with ``weights`` along x, y, and upwards."""
    for axis, along in enumerate(weights or (EACH, EACH)):
        values = ndimage.convolve1d(values, along, axis=axis, mode="constant")
    return values


def centres(counts: Counts, at: tuple[NDArray[np.intp], ...]) -> Axes:
    """Centres of cubes [quanta]."""
    edge = quanta(CUBE_M)
    index = (at[0] + counts.corner[0], at[1] + counts.corner[1], counts.layer[at[2]])
    x, y, z = (axis.astype(np.int64) * edge + edge // 2 for axis in index)
    return x, y, z


def _around(
    counts: Counts, seed: NDArray[np.bool_], lowest: NDArray[np.int32], expected: Expected
) -> Air:
    """Air in the squares of the seeds, and in the cubes beside."""
    size = (WINDOW, WINDOW, 1)
    level = ndimage.maximum_filter(np.where(seed, lowest, 0), size, mode="constant")
    held = (level > 0) & (counts.held > 0) & (counts.held <= SMOOTH * level)
    middle = np.where(held, ndimage.median_filter(counts.held, (3, 3, 1), mode="constant"), 0)
    middle = np.minimum(middle, SMOOTH * level)
    wide = ndimage.maximum_filter(middle, 3, mode="constant").astype(np.float64)
    # A cube beside the air that holds much more holds something else.
    wide[counts.held > SMOOTH * wide] *= level[counts.held > SMOOTH * wide] > 0
    at = np.nonzero(wide)
    cube = np.column_stack(
        [at[0] + counts.corner[0], at[1] + counts.corner[1], counts.layer[at[2]]]
    )
    return Air(
        cube.astype(np.int64), wide[at] / CUBE_M**3, held[at], counts.held[at].astype(np.int64),
        expected(centres(counts, at)),
    )  # fmt: skip
