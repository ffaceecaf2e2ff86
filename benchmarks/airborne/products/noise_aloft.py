"""What the noise around raster cells is worth to the surface model.

Run ``python -m benchmarks.airborne.products.noise_aloft SURVEY``.

SURVEY is a folder as for ``benchmarks.airborne.quality``. Its delivered labels become a surface
model three times: with the noise around each cell as a run has it, with the median of a ground cell
for all of its raster cells, and with none. Printed are the cells that differ from the first, and
those that noise sets, as ``benchmarks.airborne.quality`` counts them.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final
from unittest import mock

import laspy
import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.transform import from_origin

from benchmarks.airborne import quality
from spl_batch.airborne.arrays.surfaces import Rasters, rasterize
from spl_batch.airborne.products.noise_aloft import RefusedReturns
from spl_batch.constants import NODATA

Float = NDArray[np.float64]

WAYS: Final[dict[str, Callable[[Float], Float]]] = {
    "as a run has it": lambda noise: noise,
    "median of the ground cell": lambda noise: np.full_like(noise, np.median(noise)),
    "none": np.zeros_like,
}


def surface(clouds: list[laspy.LasData], way: Callable[[Float], Float]) -> Rasters:
    """Rasters of delivered clouds with other noise around their cells."""
    xyz = np.concatenate([cloud.xyz for cloud in clouds])
    labels = np.concatenate([np.asarray(cloud["noise_class"]) for cloud in clouds])
    ground = np.concatenate([np.asarray(cloud.classification) == 2 for cloud in clouds])
    plain = RefusedReturns.by_cell
    with mock.patch.object(RefusedReturns, "by_cell", lambda *given: way(plain(*given))):
        return rasterize(xyz, labels, ground)


def spikes(survey: Path, made: Rasters) -> float:
    """Cells that noise sets, of 10 000."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "out").mkdir()
        for path in survey.iterdir():
            if path.name != "out":
                (folder / path.name).symlink_to(path.resolve())
        rows, cols = made.dsm.shape
        place = from_origin(made.west_m, made.north_m, made.cell_m, made.cell_m)
        with rasterio.open(
            folder / "out" / "dsm.tif", "w", driver="GTiff", dtype="float32", count=1,
            width=cols, height=rows, transform=place, nodata=NODATA,
        ) as target:  # fmt: skip
            target.write(np.nan_to_num(made.dsm, nan=NODATA), 1)
        points = quality._load(survey)  # noqa: SLF001 - the same count
        return quality._spikes(folder, points)["DSM cells set by noise per 10 000"]  # noqa: SLF001


def main(survey: Path) -> None:
    """Print a line for each way."""
    clouds = [laspy.read(path) for path in sorted((survey / "out" / "laz").rglob("*.laz"))]
    first = None
    for name, way in WAYS.items():
        made = surface(clouds, way)
        first = made.dsm if first is None else first
        differ = np.count_nonzero(np.nan_to_num(made.dsm) != np.nan_to_num(first))
        print(
            f"{name:28s} {differ:7d} of {first.size} cells differ   "
            f"{spikes(survey, made):7.1f} of 10 000 set by noise"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
