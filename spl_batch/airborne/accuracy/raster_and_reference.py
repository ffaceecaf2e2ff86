"""Rasters and reference points where they lie, in metres."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import CLASS_HIGH_NOISE, CLASS_LOW_NOISE, NODATA
from spl_batch.formats.rasters.parts import RasterPart, known, read_part


@dataclass(frozen=True, slots=True)
class Raster(RasterPart):
    """A raster that points are looked up in; nodata :data:`~spl_batch.constants.NODATA`."""

    @classmethod
    def around(cls, path: Path, xy_m: NDArray[np.float64]) -> "Raster | None":
        """Part of a file that places, (n, 2), lie on; None where it does not reach them."""
        if not len(xy_m):
            return None
        # A column at a time: along rows of two numbers numpy takes twenty times as long.
        x, y = xy_m.T
        west, south, east, north = map(float, (x.min(), y.min(), x.max(), y.max()))
        part = read_part(path, (west, south, east, north))
        return None if part is None else cls(part.values, part.left_m, part.top_m, part.cell_m)

    def slope_deg(self) -> "Raster":
        """Steepest slope by central differences [deg]; nodata beside voids and at the rim."""
        rows, cols = self.values.shape
        slope = np.full((rows, cols), NODATA, dtype=np.float32)
        if rows > 2 and cols > 2:
            z = known(self.values)
            dx = (z[1:-1, 2:] - z[1:-1, :-2]) / (2 * self.cell_m)
            dy = (z[2:, 1:-1] - z[:-2, 1:-1]) / (2 * self.cell_m)
            angle = np.degrees(np.arctan(np.hypot(dx, dy)))
            slope[1:-1, 1:-1] = np.where(np.isnan(angle), NODATA, angle)
        return Raster(slope, self.left_m, self.top_m, self.cell_m)


@dataclass(frozen=True, slots=True)
class Reference:
    """Reference points."""

    xyz_m: NDArray[np.float64]  #: (n, 3): easting, northing, height [m].
    #: (n,): ASPRS classes: 2 ground, 6 building, 9 water, 7 and 18 noise; all else counts as
    #: vegetation.
    classification: NDArray[np.uint8]
    #: (n,): points that enter the statistics. The others, from a margin around a chunk, only show
    #: what stands nearby. By default all.
    counted: NDArray[np.bool_] | None = None

    def without_noise(self) -> "Reference":
        """The same without points of class 7 or 18 or with coordinates that are not finite."""
        kept = ~np.isin(self.classification, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
        for axis in self.xyz_m.T:
            kept &= np.isfinite(axis)
        if kept.all():
            return self
        counted = None if self.counted is None else self.counted[kept]
        return Reference(self.xyz_m[kept], self.classification[kept], counted)

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Which points enter the statistics: (n,) bool."""
        return np.ones(len(self.xyz_m), np.bool_) if self.counted is None else self.counted
