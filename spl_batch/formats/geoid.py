"""Heights of a geoid above the ellipsoid, from a grid that PROJ reads."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.datadir import get_data_dir
from pyproj.exceptions import ProjError

from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import horizontal, with_vertical

KEY: Final = "outputs.geoid.grid"

_STEPS: Final = (
    "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
    '+step +proj=vgridshift +grids="{}" +multiplier=1 '
    "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
)


class Geoid:
    """A geoid over a survey.

    Parameters
    ----------
    grid : str
        Name of a grid in PROJ's data folder, or of a file.
    file : Path
        Where it is if it is a file.
    crs : CRS or None
        CRS of the survey.

    Raises
    ------
    WorkflowError
        If PROJ does not have the grid or cannot read it, or the survey has no CRS.
    """

    def __init__(self, grid: str, file: Path, crs: CRS | None) -> None:
        if crs is None or crs.geodetic_crs is None:
            raise WorkflowError(f"{KEY}: the survey has no CRS on earth to look it up by")
        # PROJ takes a list, and passes over what is marked as optional.
        if set(grid) & set('@,"'):
            raise WorkflowError(f"{KEY}: {grid} is no name of one grid that must be there")
        try:
            name = str(file.resolve()) if file.is_file() else grid
            self._heights = Transformer.from_pipeline(_STEPS.format(name))
        except ProjError:
            raise WorkflowError(
                f"{KEY}: {grid} is no grid that PROJ can read, neither as {file} nor in its data "
                f"folder {get_data_dir()}; put it there, or give its path"
            ) from None
        self._flat = horizontal(crs)
        self._place = Transformer.from_crs(self._flat, self._flat.geodetic_crs, always_xy=True)

    def heights(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height above the ellipsoid at places in the survey's CRS, NaN beyond the grid [m]."""
        east, north = self._place.transform(x, y)
        *_, height = self._heights.transform(east, north, np.zeros(len(x)))
        return np.where(np.isfinite(height), height, np.nan)

    def crs_above(self, vertical_crs: str | None) -> CRS:
        """CRS of heights above it: the survey's, without its own heights, with those named.

        Raises
        ------
        WorkflowError
            If what is named is no vertical CRS in metres.
        """
        if vertical_crs is None:
            return self._flat
        return with_vertical(self._flat, vertical_crs, "outputs.geoid.crs")
