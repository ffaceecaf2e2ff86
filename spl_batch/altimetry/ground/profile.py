"""Ground and canopy top along the track, from signal photons.

[W17] 4.3 compares an "extracted ground surface" with lidar (Fig. 4-7 to 4-12) and leaves open how
it was extracted; nor has it a canopy. Here the ground of a cell is the lowest dense layer of its
signal photons and its neighbours', under the slope that packs them best; what neighbouring cells
contradict is put right; and a line is fitted through the layer with bisquare weights
(:mod:`spl_batch.altimetry.ground.cell_ground` names the sources of both steps). ATL08 goes another
way:
it smooths the medians of photons iteratively from below, and takes for the canopy's top the 98 %
quantile of heights above that ground, as here (A. Neuenschwander and K. Pitts, *The ATL08 land and
vegetation product for the ICESat-2 Mission*, Remote Sens. Environ. 221, 2019). A cell's result
depends on photons within :attr:`Layers.reach_cells` of it.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.ground.cell_ground import (
    Cells,
    around,
    fit_ground,
    lowest_layers,
    with_bends,
)
from spl_batch.altimetry.settings import ProfileSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

_DENSE: Final = 0.3
_DENSE_THIN: Final = 0.23
"""Share of the fullest layer that ground holds at least, and where layers are thin: ground that
bends fills several thin layers, and each holds less of it."""

_UNSURE: Final = 1.5
"""Standard errors by which what a line leaves of the ground's shape is estimated too large."""

_ALONE: Final = 3
"""How many times the least photons a layer needs that no two neighbours confirm."""

_MISSED: Final = 0.3
"""A layer of three cells with less than this share of the cell's own layer is not its ground."""
_OWN: Final = 5
"""How many times the least photons of a layer a cell's own layer needs [count]."""
_ERRORS: Final = 2.0
"""Standard errors of a Poisson count that few photons are allowed [count]."""

COLUMNS: Final = {
    "cell": np.int64,
    "along_track": np.float64,
    "ground": np.float64,
    "slope": np.float64,
    "ground_error": np.float64,
    "ground_photons": np.int64,
    "canopy_top": np.float64,
    "canopy_height": np.float64,
    "canopy_photons": np.int64,
}
"""Columns of a profile: cell number, its middle, heights [m], counts; NaN where unknown."""

LAYER_M: Final = 1.5
"""Thickness of a layer of ground where none is set [m]."""

ATL03_LAYER_M: Final = 0.75
"""The same of ATL03: a slope of 0.1 under 11 m of light spreads pulses of 1.5 ns to 0.7 m."""

ATL03_LIGHT_M: Final = 11.0
"""Width of the light on the ground [m]."""

_SPREAD: Final = 0.6
_PULSE_M: Final = 0.225
"""Part of the rise under the light that most photons span; length of a pulse of 1.5 ns [m]."""

STRETCH_CELLS: Final = 25
"""Cells to each side whose slopes decide how thick a layer is [count]."""


class Layers(NamedTuple):
    """How the layer that is ground is sought."""

    settings: ProfileSettings
    layer_m: float = LAYER_M  #: Thickness [m].
    spread_m: float = 0.0  #: What a slope of 1 adds to a pulse [m]; 0 where all layers are alike.

    @property
    def reach_cells(self) -> int:
        """Cells to each side that decide a cell's heights [count]."""
        return 4 * self.settings.reach_cells + 1 + (STRETCH_CELLS if self.spread_m else 0)


def layers_of(settings: ProfileSettings, layout: str) -> Layers:
    """Thickness that is set, or that of a layout's ground, where none is."""
    if settings.layer_m is not None:
        return Layers(settings, settings.layer_m)
    if layout == "atl03":
        return Layers(settings, ATL03_LAYER_M, _SPREAD * ATL03_LIGHT_M)
    return Layers(settings)


def profile(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    sure: NDArray[np.bool_],
    owned: tuple[int, int],
    layers: Layers,
) -> dict[str, NDArray[Any]]:
    """Heights of the cells of a piece of track that hold signal, as in :data:`COLUMNS`.

    Parameters
    ----------
    along, height : (n,) int64, (n,) int32
        Photons that may be signal, of the piece and of ``layers.reach_cells`` to each side, in
        order of distance and height [quanta].
    sure : (n,) bool
        Those that are labelled signal; canopy is made of them alone.
    owned : (int, int)
        First cell of the piece, and the one after its last.
    """
    settings = layers.settings
    size = quanta(settings.cell_m)
    index = np.unique(along // size)
    z = height / QUANTA_PER_M
    first, stop = (np.searchsorted(along, (index + beside) * size) for beside in (-1, 2))
    cells = Cells(along, z, first, stop, index * size + size // 2)
    thick = np.full(len(index), layers.layer_m)
    found = _lowest(cells, thick, settings)
    if layers.spread_m:
        thick = _thick(index, found[:, 1], thick, layers.spread_m)
        found = _lowest(cells, thick, settings)
    agreed, asked = _settled(cells, index, found, thick, settings)
    # A clump of noise reaches into the cells beside it, which then confirm it: photons that are
    # labelled signal have to vouch for a layer, more of them where no neighbour does.
    vouch = sum(
        photons_in_layers(along[sure], z[sure], (index, size), agreed, thick, beside)
        for beside in (-1, 0, 1)
    )
    agreed[vouch < np.where(asked >= 2, 1, _ALONE * settings.photons_min)] = np.nan
    half_m, least = settings.cell_m / 4.0, settings.photons_min
    fit = with_bends(index, fit_ground(*cells, agreed, thick, half_m, least), settings.reach_cells)
    mine = np.flatnonzero((index >= owned[0]) & (index < owned[1]))
    top, leaves = _canopy(cells, sure, index, fit, mine, settings)
    ground = fit[mine, 0]
    bare = np.where(np.isfinite(ground), 0.0, np.nan)
    error2 = fit[:, 2] ** 2 + _misfit2(index, fit[:, 4], settings)
    return {
        "cell": index[mine],
        "along_track": cells.centre[mine] / QUANTA_PER_M,
        "ground": ground,
        "slope": fit[mine, 1],
        "ground_error": np.sqrt(error2)[mine],
        "ground_photons": np.nan_to_num(fit[mine, 3]).astype(np.int64),
        "canopy_top": np.where(leaves > 0, top, ground),
        "canopy_height": np.where(leaves > 0, top - ground, bare),
        "canopy_photons": leaves,
    }


def _thick(
    index: NDArray[np.int64], slope: NDArray[np.float64], least: NDArray[np.float64], spread: float
) -> NDArray[np.float64]:
    """Thickness of each cell's layer by the median slope of its stretch, (c,) [m]."""
    steep = np.abs(slope)
    first = np.searchsorted(index, index - STRETCH_CELLS)
    stop = np.searchsorted(index, index + STRETCH_CELLS, side="right")
    median = np.zeros(len(index))
    for c, (a, b) in enumerate(zip(first.tolist(), stop.tolist(), strict=True)):
        known = steep[a:b][np.isfinite(steep[a:b])]
        median[c] = np.median(known) if len(known) else 0.0
    return np.maximum(np.hypot(_PULSE_M, spread * median), least)


def _lowest(
    cells: Cells, thick: NDArray[np.float64], settings: ProfileSettings
) -> NDArray[np.float64]:
    """Layers of cells: (c, 2) float64."""
    # A step of slope moves the ends of three cells by a layer at most.
    steps = np.ceil(1.5 * settings.cell_m * settings.slope_max / thick)
    found: NDArray[np.float64] = lowest_layers(
        *cells, thick, np.where(thick >= LAYER_M, _DENSE, _DENSE_THIN),
        np.maximum(steps, 1.0).astype(np.int64), settings.slope_max, settings.photons_min,
    )  # fmt: skip
    return found


def photons_in_layers(
    along: NDArray[np.int64],
    z: NDArray[np.float64],
    cells: tuple[NDArray[np.int64], int],
    layers: NDArray[np.float64],
    reach_m: NDArray[np.float64],
    beside: int = 0,
) -> NDArray[np.int64]:
    """Photons within ``reach_m`` of the layer of the cell so many beside their own, (c,) int64.

    ``cells``: numbers, in order, and their length [quanta].
    """
    index, size = cells
    number = along // size + beside
    at = np.minimum(np.searchsorted(index, number), len(index) - 1)
    dx = (along - index[at] * size - size // 2) / QUANTA_PER_M
    inside = np.abs(z - layers[at, 0] - layers[at, 1] * dx) <= reach_m[at]
    return np.bincount(at[inside & (index[at] == number)], minlength=len(index))


def _settled(
    cells: Cells,
    index: NDArray[np.int64],
    found: NDArray[np.float64],
    thick: NDArray[np.float64],
    settings: ProfileSettings,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Layers as the cell itself and then its neighbours have them, as of :func:`agree`."""
    size = quanta(settings.cell_m)
    first, stop = (np.searchsorted(cells.along, (index + end) * size) for end in (0, 1))
    own = _lowest(cells._replace(first=first, stop=stop), thick, settings)
    in_found, in_own = (
        photons_in_layers(cells.along, cells.height_m, (index, size), layers, thick / 2.0)
        for layers in (found, own)
    )
    found = not_beside(found, own, in_found, in_own, settings.photons_min)
    return agree(index, found, settings, thick)


def not_beside(
    found: NDArray[np.float64],
    own: NDArray[np.float64],
    in_found: NDArray[np.int64],
    in_own: NDArray[np.int64],
    photons_min: int,
) -> NDArray[np.float64]:
    """Layers of three cells, or a cell's own where the cell holds no part of that, (c, 2) float64.

    Crevassed ice, lava and boulders rise and fall by metres within 60 m: the lowest layer of three
    cells is then the hollow beside the cell. Such ground is bare, and a cell holds dozens of its
    photons. The rule is this project's own. ``found``, ``own``: (c, 2), height and slope of the
    lowest layer of three cells, and of the cell alone; then photons of the cell itself in either.
    """
    # Sparse ground under dense trees is a small part of its cell by chance as well.
    at_most = in_found + _ERRORS * (np.sqrt(in_found) + 1.0)
    missed = (in_own >= _OWN * photons_min) & (at_most < _MISSED * in_own)
    return np.where((missed & np.isfinite(found[:, 0]))[:, None], own, found)


def agree(
    index: NDArray[np.int64],
    found: NDArray[np.float64],
    settings: ProfileSettings,
    thick: NDArray[np.float64] | float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Layers, those put to what their neighbours expect that these contradict, and who was asked.

    A neighbour expects its own height, carried along by the mean of both slopes. The median
    of at least two decides where a layer is farther from it than two layers' thickness; a
    single neighbour's word is enough to take it away. ``index``: cells, in order; ``found``:
    (c, 2), height [m] and slope of their layers, NaN where there is none; ``thick``: (c,) [m].
    """
    expected = np.full((2 * settings.reach_cells + 1, len(index)), np.nan)
    for row, step in enumerate(range(-settings.reach_cells, settings.reach_cells + 1)):
        at = np.clip(np.searchsorted(index, index + step), 0, max(len(index) - 1, 0))
        there = (index[at] == index + step) & (step != 0)
        slope = (found[at, 1] + found[:, 1]) / 2.0
        there &= np.isfinite(slope)
        carried = found[at, 0] - slope * step * settings.cell_m
        expected[row] = np.where(there, carried, np.nan)
    asked = np.isfinite(expected).sum(axis=0)
    # NaN sorts to the end: the median is that of those before it.
    ordered = np.sort(expected, axis=0)
    columns = np.arange(len(index))
    middle = (ordered[np.maximum(asked - 1, 0) // 2, columns] + ordered[asked // 2, columns]) / 2.0
    out = found.copy()
    wrong = np.abs(found[:, 0] - middle) > 2.0 * np.asarray(thick)
    out[wrong, 0] = np.where(asked[wrong] >= 2, middle[wrong], np.nan)
    return out, asked


def _misfit2(
    index: NDArray[np.int64], off2: NDArray[np.float64], settings: ProfileSettings
) -> NDArray[np.float64]:
    """Squared error that the ground's shape leaves, from the cells around each, (c,) float64 [m2].

    In one cell what its photons show is mostly chance; over several that averages out. What is left
    of chance is added, so that the error is estimated too small nowhere by it.
    """
    known = np.isfinite(off2)
    value = np.where(known, off2, 0.0)
    counted = [np.rint(v * 1e9).astype(np.int64) for v in (value, value**2)]
    counted.append(known.astype(np.int64))
    total, squares, count = around(index, settings.reach_cells, *counted)
    n = np.maximum(count, 2)
    mean = total * 1e-9 / n
    error = np.sqrt(np.maximum(squares * 1e-9 / n - mean**2, 0.0) / (n - 1))
    misfit2: NDArray[np.float64] = np.maximum(mean + _UNSURE * error, 0.0)
    return misfit2


def _canopy(
    cells: Cells,
    sure: NDArray[np.bool_],
    index: NDArray[np.int64],
    fit: NDArray[np.float64],
    mine: NDArray[np.intp],
    settings: ProfileSettings,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Top of the canopy and photons in it, of the cells that are owned."""
    size = quanta(settings.cell_m)
    ends = (np.searchsorted(cells.along, (index[mine] + end) * size) for end in (0, 1))
    top = np.full(len(mine), np.nan)
    photons = np.zeros(len(mine), np.int64)
    for i, (c, a, b) in enumerate(zip(mine, *ends, strict=True)):
        dx = (cells.along[a:b] - cells.centre[c]) / QUANTA_PER_M
        above = cells.height_m[a:b] - fit[c, 0] - fit[c, 1] * dx
        leaf = above[(above >= settings.canopy_min_m) & sure[a:b]]
        if len(leaf) >= settings.photons_min:
            top[i] = fit[c, 0] + np.quantile(leaf, settings.canopy_share)
            photons[i] = len(leaf)
    return top, photons
