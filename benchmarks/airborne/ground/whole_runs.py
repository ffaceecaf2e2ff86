"""Whole runs on classified real tiles: terrain as it is delivered.

Run ``python -m benchmarks.airborne.ground.whole_runs FOLDER TILE [...] [--linear] [--cell M]``.

Each tile is a survey of its own, with the sensor ``spl100`` and the beamlet in ``user_data``, or of
linear-mode lidar. Of the cloud that a run delivers, the points that it calls ground are compared
with the producer's, as :mod:`~benchmarks.airborne.ground.ground_tiles` does with a method alone:
here the filter has taken its part, and the flightlines have told their ranging spread. A second
line says how many of the differences of ``dtm.tif`` from the TIN of the producer's ground lie
within one and 1.96 standard deviations of ``dtm_quality.tif``, as
:mod:`~benchmarks.airborne.products.dtm_quality` does.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import laspy
import numpy as np
import rasterio
from numpy.typing import NDArray

from benchmarks.airborne.ground.ground_tiles import Tile, figures, read, show
from benchmarks.airborne.products import dtm_quality
from spl_batch import api
from spl_batch.constants import CLASS_GROUND, QUANTUM_M

WORKFLOWS: Final = {
    "spl100": (
        "{{survey: {{flightlines: {0}, sensor: spl100, channel_dimension: user_data}}, "
        "output: out}}"
    ),
    "linear": (
        "{{survey: {{flightlines: {0}}}, filter: {{method: none}}, afterpulse: {{enabled: false}}, "
        "output: out}}"
    ),
}


def process(path: Path, folder: Path, kind: str, cell_m: float) -> Path:
    """Run a tile with rasters of such cells; its output."""
    workflow = folder / "workflow.yaml"
    workflow.write_text(WORKFLOWS[kind].format(path))
    api.run(workflow, overrides=[f"products.cell_m={cell_m}"])
    return folder / "out"


def called_ground(tile: Tile, out: Path) -> NDArray[np.bool_]:
    """Which points of a tile a run calls ground."""
    ground: set[tuple[int, int, int]] = set()
    for path in sorted((out / "laz").rglob("*.laz")):
        las = laspy.read(path)
        chosen = np.asarray(las.classification) == CLASS_GROUND
        places = [np.rint(np.asarray(v)[chosen] / QUANTUM_M) for v in (las.x, las.y, las.z)]
        ground |= set(map(tuple, np.column_stack(places).astype(np.int64).tolist()))
    places = np.column_stack([tile.table[axis] for axis in "xyz"]).tolist()
    return np.array([tuple(place) in ground for place in places])


def delivered(tile: Tile, out: Path) -> dtm_quality.Compared:
    """Delivered terrain against that of the producer's ground, and the deviation that is said."""
    corner = [np.floor(tile.table[axis].min() * QUANTUM_M) for axis in "xyz"]
    found = []
    for name in ("dtm", "dtm_quality"):
        with rasterio.open(out / f"{name}.tif") as source:
            values = np.array([v[0] for v in source.sample(tile.grid + corner[:2])], np.float64)
            found.append(np.where(values == source.nodata, np.nan, values))
    off, said = found[0] - tile.truth - corner[2], found[1]
    told = np.isfinite(off) & np.isfinite(said)
    return dtm_quality.Compared(off[told], said[told])


def main(folder: Path, names: Sequence[str], kind: str, cell_m: float) -> None:
    """Run tiles, and print."""
    for name in names:
        for path in sorted(folder.rglob(f"{name}*.la[sz]")):
            tile = read(path)
            if tile is None:
                continue
            with tempfile.TemporaryDirectory() as temporary:
                out = process(path.resolve(), Path(temporary), kind, cell_m)
                show(tile, {"whole run": figures(tile, called_ground(tile, out), np.nan)})
                dtm_quality.show(tile.name, "rasters", delivered(tile, out))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tiles", nargs="+")
    parser.add_argument("--linear", action="store_const", const="linear", default="spl100")
    parser.add_argument("--cell", type=float, default=1.0, help="edge of a raster cell [m]")
    given = parser.parse_args()
    main(given.folder, given.tiles, given.linear, given.cell)
