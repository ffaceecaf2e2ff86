"""Heights of a geoid above the ellipsoid, from a grid that PROJ reads."""

import os
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.datadir import get_data_dir, get_user_data_dir  # type: ignore[attr-defined]
from pyproj.exceptions import ProjError

from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import crs_name, horizontal, vertical
from spl_batch.formats.heights import heights_above, is_above_ellipsoid, with_vertical
from spl_batch.formats.units import Units, in_words

KEY: Final = "outputs.geoid.grid"

_STEPS: Final = (
    "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
    '+step +proj=vgridshift +grids="{}" +multiplier=1 '
    "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
)


def grid_file(grid: str, file: Path) -> Path | None:
    """The file of a grid: the one named, else the one in PROJ's data folders; None without one."""
    folders = [*get_data_dir().split(os.pathsep), get_user_data_dir()]
    files = (file, *(Path(folder) / grid for folder in folders))
    return next((path for path in files if path.is_file()), None)


class Geoid:
    """A geoid over a survey.

    Parameters
    ----------
    grid : str
        Name of a grid in PROJ's data folder, or of a file.
    file : Path
        Where it is if it is a file.

    Raises
    ------
    WorkflowError
        If PROJ does not have the grid or cannot read it, the survey has no CRS, or its heights
        are not above the ellipsoid.
    """

    def __init__(self, grid: str, file: Path, crs: CRS | None) -> None:
        if crs is None or crs.geodetic_crs is None:
            raise WorkflowError(f"{KEY}: the survey has no CRS on earth to look it up by")
        if heights_above(crs) and not is_above_ellipsoid(crs):
            raise WorkflowError(
                f"{KEY}: heights are already {crs_name(vertical(crs) or crs)}, not above the "
                "ellipsoid: leave outputs.geoid out"
            )
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
        self._flat, self._units = horizontal(crs), Units.of(crs)
        self._geodetic = Transformer.from_crs(self._flat, self._flat.geodetic_crs, always_xy=True)

    def heights(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Height above the ellipsoid at points of the survey [m], NaN beyond the grid [m]."""
        unit_m = self._units.horizontal_m
        east, north = self._geodetic.transform(x / unit_m, y / unit_m)
        *_, height = self._heights.transform(east, north, np.zeros(len(x)))
        return np.where(np.isfinite(height), height, np.nan)

    def crs_above(self, vertical_crs: str | None) -> CRS:
        """CRS of heights above it: the survey's, without its own heights, with those named.

        Raises
        ------
        WorkflowError
            If what is named is no vertical CRS in the unit of the survey's heights.
        """
        key, unit = "outputs.geoid.crs", self._units.vertical
        if vertical_crs is None:
            eastings = self._units.horizontal
            if unit != eastings:
                raise WorkflowError(
                    f"{key}: heights are in {in_words(unit)}, eastings in {in_words(eastings)}: "
                    "name a vertical CRS, "
                    "so that files state the unit of heights above the geoid"
                )
            return self._flat
        found = with_vertical(self._flat, vertical_crs, key)
        if Units.of(found).vertical != unit:
            raise WorkflowError(
                f"{key}: {vertical_crs} is not in {in_words(unit)}, as heights are: name one"
            )
        return found
