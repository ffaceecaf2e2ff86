"""Profile of a track that crosses water: its surface, and the floor apart.

Over water ``ground`` is the surface, as ATL08 has it, and never the floor: one line that jumped
between both would be neither. The floor is sought like ground among the photons below the surface,
and has columns of its own. What lies above water is no canopy.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.ground import profile as profiles
from spl_batch.altimetry.water.surface import NO_WATER, SURFACE_M, refracted
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

FLOOR: Final = {
    "floor": np.float64,
    "floor_error": np.float64,
    "floor_photons": np.int64,
    "floor_refracted": np.float64,
}
"""Columns of the floor: height [m], its standard error [m], photons, and the height corrected for
refraction [m]; NaN where unknown."""

_NEAR_M: Final = 0.5
"""Photons of a water surface that its height is fitted to: below them a reef may lie [m]."""

COLUMNS: Final = {**profiles.COLUMNS, "water": np.int64, **FLOOR}
"""Columns of a profile that knows water; ``water`` is 1 where ground is a water surface."""


def profile(
    photons: tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.bool_]],
    level: NDArray[np.int64],
    owned: tuple[int, int],
    layers: profiles.Layers,
    off_nadir_deg: float,
) -> dict[str, NDArray[Any]]:
    """Columns as in :data:`COLUMNS`, of the cells of a piece that hold signal.

    Parameters
    ----------
    photons : ((n,) int64, (n,) int32, (n,) bool)
        Along the track, height, and which are labelled signal, as of
        :func:`spl_batch.altimetry.ground.profile.profile` [quanta].
    level : (n,) int64
        Water surface where each photon lies [quanta]; ``NO_WATER`` where there is none.
    """
    along, height, sure = photons
    wet, off = level != NO_WATER, height - level
    below = wet & (off < -quanta(SURFACE_M))
    dry = ~wet | (np.abs(off) <= quanta(_NEAR_M))
    top, floor = (
        profiles.profile(along[some], height[some], sure[some], owned, layers)
        for some in (dry, below)
    )
    cells = np.union1d(top["cell"], floor["cell"])
    columns = {name: _spread(top, name, cells) for name in profiles.COLUMNS}
    size = quanta(layers.settings.cell_m)
    columns |= {"cell": cells, "along_track": (cells * size + size // 2) / QUANTA_PER_M}
    mine = np.isin(along // size, cells)
    at = np.searchsorted(cells, along[mine] // size)
    wet_count = np.bincount(at, wet[mine], len(cells))
    water = wet_count > np.bincount(at, minlength=len(cells)) / 2
    for name in ("canopy_top", "canopy_height"):
        columns[name][water] = np.nan
    columns["canopy_photons"][water] = 0
    for name, source in zip(FLOOR, ("ground", "ground_error", "ground_photons"), strict=False):
        values = _spread(floor, source, cells)
        values[~water] = 0 if values.dtype == np.int64 else np.nan
        columns[name] = values
    level_sum = np.bincount(at, np.where(wet, level, 0)[mine], len(cells))
    surface_m = level_sum / np.maximum(wet_count, 1.0) / QUANTA_PER_M
    up_m = refracted(surface_m - columns["floor"], off_nadir_deg)
    return {**columns, "water": water.astype(np.int64), "floor_refracted": columns["floor"] + up_m}


def _spread(columns: dict[str, NDArray[Any]], name: str, cells: NDArray[np.int64]) -> NDArray[Any]:
    """A column at other cells too: NaN there, or 0."""
    values = columns[name]
    out = np.full(len(cells), 0 if values.dtype == np.int64 else np.nan, values.dtype)
    out[np.searchsorted(cells, columns["cell"])] = values
    return out
