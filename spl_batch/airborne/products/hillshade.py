"""Shaded relief of a terrain model [Horn 1981].

Source: B. K. P. Horn (1981): Hill Shading and the Reflectance Map. Proceedings of the IEEE 69:
slopes by weighted differences over 3 x 3 cells, light from the north-west, 45 degrees high. The
scale is that of gdaldem: 1 to 255.
"""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NODATA

AZIMUTH_DEG: Final = 315.0
"""Where the light comes from, clockwise from north [deg]."""

ALTITUDE_DEG: Final = 45.0
"""How high it stands [deg]."""

BLOCK: Final = 1024
"""Rows and columns that are shaded at once [cells]."""

Window = Callable[[int, int, int, int], NDArray[np.float32]]
"""Heights of rows and columns from, to; beyond the raster nodata [m]."""


def shade(heights_m: NDArray[np.float32], cell_m: float) -> NDArray[np.float32]:
    """Relief of all cells but the outermost.

    Parameters
    ----------
    heights_m : (rows, cols) float32
        Terrain, row 0 northernmost; nodata :data:`~spl_batch.constants.NODATA` [m].

    Returns
    -------
    (rows - 2, cols - 2) float32
        1 in full shadow to 255 in full light; nodata where one of the nine cells has no height.
    """
    z = np.where(heights_m == np.float32(NODATA), np.nan, heights_m.astype(np.float64))
    north, middle, south = z[:-2], z[1:-1], z[2:]
    east = north[:, 2:] + 2 * middle[:, 2:] + south[:, 2:]
    west = north[:, :-2] + 2 * middle[:, :-2] + south[:, :-2]
    dx = (east - west) / (8 * cell_m)
    dy = (
        (north[:, :-2] + 2 * north[:, 1:-1] + north[:, 2:])
        - (south[:, :-2] + 2 * south[:, 1:-1] + south[:, 2:])
    ) / (8 * cell_m)
    azimuth, altitude = np.radians(AZIMUTH_DEG), np.radians(ALTITUDE_DEG)
    light = np.sin(altitude) - np.cos(altitude) * (dx * np.sin(azimuth) + dy * np.cos(azimuth))
    grey = 1.0 + 254.0 * np.maximum(light / np.sqrt(1.0 + dx**2 + dy**2), 0.0)
    known = ~np.isnan(grey + middle[:, 1:-1])
    return np.where(known, grey, NODATA).astype(np.float32)


def blocks(
    read: Window, shape: tuple[int, int], cell_m: float
) -> Iterator[tuple[int, int, NDArray[np.float32]]]:
    """Relief of a whole raster, some of it at a time.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.

    Yields
    ------
    row, col, block
        Place, row 0 northernmost, and values.
    """
    rows, cols = shape
    for row in range(0, rows, BLOCK):
        for col in range(0, cols, BLOCK):
            last_row, last_col = min(row + BLOCK, rows), min(col + BLOCK, cols)
            wide = read(row - 1, last_row + 1, col - 1, last_col + 1)
            yield row, col, shade(wide, cell_m)
