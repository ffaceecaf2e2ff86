"""What a rough surface leaves below itself: as much as above.

High waves, and land that is level but rough, reach farther than the metre that counts as surface.
What lies below it would pass for scattered light, and hide the surface that it belongs to.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.emptiest import sums_around

ROUGH_M: Final = 2
"""How far beyond the surface's own metre it reaches, at most [m]."""

_SURE_SD: Final = 3.0
_WATERY_SD: Final = 2.0
_EVEN: Final = 1.5
"""Times as many photons on one side of a surface, in its own metre, as on the other, at most."""

_ROUGH_SHARE: Final = 0.05
"""Photons above a surface's own metre, over those in it, of what is too rough for water."""

_DEEP_M: Final = (3.0, 10.0)
"""Where light that water scatters is looked for, and as far above it [m]."""

_OWN_M: Final = (-0.5, 0.5)
_CROWN_M: Final = (1.5, 2.5)
_CROWN_SHARE: Final = 0.1
"""A crown holds more than this part of what lies in its fullest metre in one above that, too; waves
do not reach there [m]."""


def roughness(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    over_m: NDArray[np.float64],
    wet: NDArray[np.bool_],
    edges_m: tuple[float, float],
    reach: int,
) -> NDArray[np.float64]:
    """Photons of a rough surface in each cell, by metre below its own: (n, ROUGH_M) float64.

    That is what more than noise lies as far above. Reeds stand above a surface alone, and light is
    scattered below it alone: where its own metre is not even, there is none.

    Parameters
    ----------
    index, cell : (n,) int64, (p,) intp
        Cells, and the row of each photon's.
    over_m : (p,) float64
        Heights above the surface; what cells without one hold is not looked at [m].
    wet : (n,) bool
        Cells with a surface.
    edges_m : (float, float)
        Between these lies the surface's own metre, without the waves in its middle [m].
    reach : int
        Cells to each side [count].
    """
    wave_m, half_m = edges_m
    bands = [(half_m + i, half_m + i + 1.0) for i in range(ROUGH_M + 1)]
    bands += [(wave_m, half_m), (-half_m, -wave_m)]
    sums = _sums_by_band(index, cell, over_m, wet, bands, reach)
    over, sky, above, below, cells = np.split(sums, np.cumsum([ROUGH_M, 1, 1, 1]), axis=1)
    sure = over > sky + _SURE_SD * np.sqrt(2.0 * (sky + 1.0))
    sure &= (above <= _EVEN * below) & (below <= _EVEN * above) & wet[:, None]
    found: NDArray[np.float64] = np.where(sure, (over - sky) / np.maximum(cells, 1.0), 0.0)
    return found


def rough_land(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    over_m: NDArray[np.float64],
    wet: NDArray[np.bool_],
    edges_m: tuple[float, float],
    reach: int,
) -> NDArray[np.bool_]:
    """Cells whose surface is too rough for water, with no more below it than above: (n,) bool.

    Under crowns there is light too. They are no layer: much lies above their fullest metre.
    Parameters are those of :func:`roughness`.
    """
    bands = (
        (-edges_m[1], edges_m[1]), (-_DEEP_M[1], -_DEEP_M[0]), _DEEP_M, _OWN_M, _CROWN_M
    )  # fmt: skip
    sums = _sums_by_band(index, cell, over_m, wet, bands, reach).T
    surface, below, above, own, over, cells = sums
    rough = roughness(index, cell, over_m, wet, edges_m, reach).sum(axis=1) * cells
    sky = above / (_DEEP_M[1] - _DEEP_M[0])
    crown = over - sky > _CROWN_SHARE * (own - sky) + np.sqrt(over)
    found: NDArray[np.bool_] = crown | ((rough > _ROUGH_SHARE * surface) & ~_more(below, above))
    return wet & found


def lit_below(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    over_m: NDArray[np.float64],
    wet: NDArray[np.bool_],
    half_m: float,
    reach: int,
) -> NDArray[np.bool_]:
    """Cells with light from below their surface: more photons there than as far above, (n,) bool.

    Water scatters it, or a floor gives it back; of land there is none. Parameters are those of
    :func:`roughness`, and the half-thickness of a surface [m].
    """
    bands = ((-_DEEP_M[1], -half_m), (half_m, _DEEP_M[1]))
    below, above, _ = _sums_by_band(index, cell, over_m, wet, bands, reach).T
    found: NDArray[np.bool_] = wet & _more(below, above)
    return found


def _more(below: NDArray[np.float64], above: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Where photons below a surface are more than chance makes of those above it."""
    more: NDArray[np.bool_] = below > _EVEN * above + _WATERY_SD * np.sqrt(2.0 * (above + 1.0))
    return more


def _sums_by_band(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    over_m: NDArray[np.float64],
    wet: NDArray[np.bool_],
    bands: Sequence[tuple[float, float]],
    reach: int,
) -> NDArray[np.float64]:
    """Photons around each cell at each span of heights, and cells with a surface: (n, b + 1)."""
    own = wet[cell]
    counted = [
        np.bincount(cell[own & (over_m > low) & (over_m <= high)], minlength=len(index))
        for low, high in bands
    ]
    return sums_around(index, np.stack([*counted, wet], axis=1), reach)


def smooth_sums(
    index: NDArray[np.int64],
    count: NDArray[Any],
    rough: NDArray[np.float64],
    skip: NDArray[np.bool_],
    reach: int,
) -> NDArray[np.float64]:
    """Photons around each cell by metre of depth, less those of its rough surface.

    ``skip`` says which depths of which cells are left out.
    """
    total = sums_around(index, np.where(skip, 0, count), reach)
    less = sums_around(index, np.where(skip[:, :ROUGH_M], 0.0, rough), reach)
    total[:, :ROUGH_M] = np.maximum(total[:, :ROUGH_M] - less, 0.0)
    return total
