"""Ground and canopy top along the track, from signal photons.

[W17] 4.3 compares an "extracted ground surface" with lidar (Fig. 4-7 to 4-12) and does not say how
it was extracted; nor has it a canopy. Here the ground of a cell is the lowest dense layer of its
signal photons and its neighbours', under the slope that packs them best; what neighbouring cells
contradict is put right; and a line is fitted through the layer with bisquare weights
(:mod:`spl_batch.altimetry.ground.cell_ground` names the sources of both steps). ATL08 goes another
way:
it smooths the medians of photons iteratively from below, and takes for the canopy's top the 98 %
quantile of heights above that ground, as here (A. Neuenschwander and K. Pitts, *The ATL08 land and
vegetation product for the ICESat-2 Mission*, Remote Sens. Environ. 221, 2019). A cell's result
depends on photons within :func:`reach_cells` of it.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.ground.cell_ground import fit_ground, held, lowest_layers, with_bends
from spl_batch.altimetry.settings import ProfileSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

_DENSE: Final = 0.3
_DENSE_THIN: Final = 0.23
_UNSURE: Final = 1.5
"""Standard errors by which what a line leaves of the ground's shape is told too large."""

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
"""Columns of a profile: cell number, its middle, heights [m], counts; NaN
where unknown."""


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

_STEPS: Final = 2
"""Steps in which a thickness doubles [count]."""


def thickness_m(settings: ProfileSettings) -> float:
    """Thickness of the layer that is ground [m]."""
    return LAYER_M if settings.layer_m is None else settings.layer_m


def dense_share(layer_m: float) -> float:
    """Share of the fullest layer that ground holds at least: 0.3, or 0.23 where layers are thin.

    Ground that bends fills several thin layers, and each holds less of it.
    """
    return _DENSE if layer_m >= LAYER_M else _DENSE_THIN


def for_layout(settings: ProfileSettings, layout: str) -> ProfileSettings:
    """The settings with the thickness of a layout's ground, where none is set."""
    if settings.layer_m is not None or layout != "atl03":
        return settings
    return settings.model_copy(update={"layer_m": ATL03_LAYER_M})


def spread_m(settings: ProfileSettings, layout: str) -> float:
    """What a slope of 1 spreads a pulse to [m]; 0 where a thickness is set or light is narrow."""
    return _SPREAD * ATL03_LIGHT_M if settings.layer_m is None and layout == "atl03" else 0.0


def reach_cells(settings: ProfileSettings, spread: float = 0.0) -> int:
    """Cells to each side that decide a cell's heights [count]; ``spread`` as of :func:`profile`."""
    return 4 * settings.reach_cells + 1 + (STRETCH_CELLS if spread else 0)


def profile(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    sure: NDArray[np.bool_],
    owned: tuple[int, int],
    settings: ProfileSettings,
    spread: float = 0.0,
) -> dict[str, NDArray[Any]]:
    """Heights of the cells of a piece of track that hold signal, as in :data:`COLUMNS`.

    Parameters
    ----------
    along, height : (n,) int64, (n,) int32
        Photons that may be signal, of the piece and of :func:`reach_cells` to each side, in
        order of distance and height [quanta].
    sure : (n,) bool
        Those that are labelled signal; canopy is made of them alone.
    owned : (int, int)
        First cell of the piece, and the one after its last.
    settings : ProfileSettings
        Cells, layer, canopy.
    spread : float
        By :func:`spread_m`: layers are as much thicker as the slope of a kilometre asks for [m].
    """
    size = quanta(settings.cell_m)
    index = np.unique(along // size)
    z = height / QUANTA_PER_M
    centre = index * size + size // 2
    first = np.searchsorted(along, (index - 1) * size)
    stop = np.searchsorted(along, (index + 2) * size)
    photons = along, z, first, stop, centre
    thick = np.full(len(index), thickness_m(settings))
    found = _lowest(photons, thick, settings)
    if spread:
        thick = _thick(index, found[:, 1], thick, spread)
        steep = np.flatnonzero(thick > thickness_m(settings))
        some = along, z, first[steep], stop[steep], centre[steep]
        found[steep] = _lowest(some, thick[steep], settings)
    agreed, asked = _settled(photons, index, found, thick, settings)
    # A clump of noise reaches into the cells beside it, which then confirm it: photons that are
    # labelled signal have to vouch for a layer, more of them where no neighbour does.
    for c in np.flatnonzero(np.isfinite(agreed[:, 0])):
        rows = slice(first[c], stop[c])
        line = agreed[c, 0] + agreed[c, 1] * ((along[rows] - centre[c]) / QUANTA_PER_M)
        inside = sure[rows] & (np.abs(z[rows] - line) <= thick[c])
        if np.count_nonzero(inside) < (1 if asked[c] >= 2 else _ALONE * settings.photons_min):
            agreed[c] = np.nan
    fit = with_bends(index, _fitted(photons, thick, agreed, settings), settings.reach_cells)
    mine = np.flatnonzero((index >= owned[0]) & (index < owned[1]))
    top, leaves = _canopy(along, z, sure, index, centre, fit, mine, settings)
    ground = fit[mine, 0]
    bare = np.where(np.isfinite(ground), 0.0, np.nan)
    error2 = fit[:, 2] ** 2 + _misfit2(index, fit[:, 4], settings)
    return {
        "cell": index[mine],
        "along_track": (index[mine] * size + size // 2) / QUANTA_PER_M,
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
    """Thickness of each cell's layer by the median slope of its stretch, in steps, (c,) [m]."""
    steep = np.abs(slope)
    first = np.searchsorted(index, index - STRETCH_CELLS)
    stop = np.searchsorted(index, index + STRETCH_CELLS, side="right")
    median = np.zeros(len(index))
    for c, (a, b) in enumerate(zip(first.tolist(), stop.tolist(), strict=True)):
        known = steep[a:b][np.isfinite(steep[a:b])]
        median[c] = np.median(known) if len(known) else 0.0
    wanted = np.maximum(np.hypot(_PULSE_M, spread * median), least)
    whole = np.rint(_STEPS * np.log2(wanted / least))
    thick: NDArray[np.float64] = least * 2.0 ** (whole / _STEPS)
    return thick


_Photons = tuple[
    NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]
]


def _lowest(
    photons: _Photons, thick: NDArray[np.float64], settings: ProfileSettings
) -> NDArray[np.float64]:
    """Layers of cells, those of one thickness together: (c, 2) float64."""
    along, z, first, stop, centre = photons
    out = np.empty((len(thick), 2))
    for layer_m in np.unique(thick):
        own = thick == layer_m
        # A step of slope moves the ends of three cells by a layer at most.
        steps = max(math.ceil(1.5 * settings.cell_m * settings.slope_max / layer_m), 1)
        part = np.empty((np.count_nonzero(own), 2))
        cells = along, z, first[own], stop[own], centre[own]
        slopes = float(layer_m), settings.slope_max, steps
        lowest_layers(*cells, *slopes, dense_share(layer_m), settings.photons_min, part)
        out[own] = part
    return out


def _settled(
    photons: _Photons,
    index: NDArray[np.int64],
    found: NDArray[np.float64],
    thick: NDArray[np.float64],
    settings: ProfileSettings,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Layers as the cell itself and then its neighbours have them, as of :func:`agree`."""
    along, z, *_, centre = photons
    size = quanta(settings.cell_m)
    first = np.searchsorted(along, index * size)
    stop = np.searchsorted(along, (index + 1) * size)
    alone = along, z, first, stop, centre

    own = _lowest(alone, thick, settings)
    inside = np.empty((2, len(index)), np.int64)
    for layers, out in zip((found, own), inside, strict=True):
        held(*alone, layers, thick / 2.0, out)
    found = not_beside(found, own, inside[0], inside[1], settings.photons_min)
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


def _fitted(
    photons: _Photons,
    thick: NDArray[np.float64],
    layers: NDArray[np.float64],
    settings: ProfileSettings,
) -> NDArray[np.float64]:
    """Ground fitted to layers of cells, those of one thickness together: (c, 9) float64."""
    along, z, first, stop, centre = photons
    out = np.empty((len(thick), 9))
    for layer_m in np.unique(thick):
        own = thick == layer_m
        part = np.empty((np.count_nonzero(own), 9))
        fit_ground(
            along, z, first[own], stop[own], centre[own], float(layer_m), settings.cell_m / 4.0,
            settings.photons_min, layers[own], part,
        )  # fmt: skip
        out[own] = part
    return out


def agree(
    index: NDArray[np.int64],
    found: NDArray[np.float64],
    settings: ProfileSettings,
    thick: NDArray[np.float64] | float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Layers, those put to what their neighbours expect that these contradict, and who was asked.

    A neighbour expects its own height, carried along by the mean of both slopes. The median
    of at least two decides where a layer is farther from it than two layers' thickness; a
    single neighbour's word is enough to take it away.

    Parameters
    ----------
    index, thick : (c,) int64, (c,) float64 or float
        Cells, in order; thickness of their layers [m].
    found : (c, 2) float64
        Height [m] and slope [m/m] of each cell's layer; NaN where there is none.

    Returns
    -------
    (c, 2) float64, (c,) int64
        Layers put right; neighbours that expect something [count].
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

    In one cell what its photons tell is mostly chance; over several that averages out. What is left
    of chance is added, so that the error is told too small nowhere by it.
    """
    known = np.isfinite(off2)
    value = np.where(known, off2, 0.0)
    # Whole numbers: their sums have no order.
    counted = [np.rint(v * 1e9).astype(np.int64) for v in (value, value**2)]
    first = np.searchsorted(index, index - settings.reach_cells)
    stop = np.searchsorted(index, index + settings.reach_cells, side="right")
    total, squares, count = (
        (sums := np.concatenate([[0], np.cumsum(v)]))[stop] - sums[first]
        for v in (*counted, known.astype(np.int64))
    )
    n = np.maximum(count, 2)
    mean = total * 1e-9 / n
    error = np.sqrt(np.maximum(squares * 1e-9 / n - mean**2, 0.0) / (n - 1))
    misfit2: NDArray[np.float64] = np.maximum(mean + _UNSURE * error, 0.0)
    return misfit2


def _canopy(
    along: NDArray[np.int64],
    z: NDArray[np.float64],
    sure: NDArray[np.bool_],
    index: NDArray[np.int64],
    centre: NDArray[np.int64],
    fit: NDArray[np.float64],
    mine: NDArray[np.intp],
    settings: ProfileSettings,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Top of the canopy and photons in it, of the cells that are owned."""
    size = quanta(settings.cell_m)
    start = np.searchsorted(along, index[mine] * size)
    stop = np.searchsorted(along, (index[mine] + 1) * size)
    top = np.full(len(mine), np.nan)
    photons = np.zeros(len(mine), np.int64)
    for i, (c, a, b) in enumerate(zip(mine, start, stop, strict=True)):
        above = z[a:b] - fit[c, 0] - fit[c, 1] * ((along[a:b] - centre[c]) / QUANTA_PER_M)
        leaf = above[(above >= settings.canopy_min_m) & sure[a:b]]
        if len(leaf) >= settings.photons_min:
            top[i] = fit[c, 0] + np.quantile(leaf, settings.canopy_share)
            photons[i] = len(leaf)
    return top, photons
