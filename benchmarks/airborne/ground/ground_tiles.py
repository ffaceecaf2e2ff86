"""Ground methods on classified real tiles.

Run ``python -m benchmarks.airborne.ground.ground_tiles FOLDER``.

Takes ``FOLDER [TILE ...] [--methods ptd smrf csf] [--cells] [--thin SHARE SEED]``.

FOLDER holds LAS or LAZ files that a producer has classified; files in folders below it count, and
TILE picks those whose name starts so. Files without a ground class are left out. Each method is
called on the points themselves, without the rest of the chain, as a tile whole or, with
``--cells``, cut into the ground cells of a run; with ``--thin`` on a share of the points, drawn by
chance. The table says, for each tile and method:

- ``RMSE``, ``> 0.5 m`` and ``< -0.5 m``: the TIN of the points that the method calls ground against
  that of the producer's ground, on a grid, edges off [m, %, %];
- ``bias``: median of that difference [m];
- ``roofs``, ``shrubs``: share of building points (class 6) and of medium vegetation (class 4) that
  are ground [%];
- ``recall``: share of the producer's ground that is ground [%];
- ``share``: share of all points that are ground [%];
- ``kappa``: Cohen's kappa of ground against the rest [%]; where the producer's ground is a choice
  of all ground points, it says little;
- ``raised``: raised flat patches in the ground that a run would warn of [count];
- ``s/M``: seconds of a processor per million points.

Beside the project's methods stands the cloth filter of the PyPI package
``cloth-simulation-filter`` [Zhang et al. 2016], if it is installed: the three stock settings of
its authors, steep slope (rigidness 1, smoothing), relief (2, smoothing) and flat terrain (3).
"""

import argparse
import importlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree

from benchmarks.airborne.ground.isprs import by_cells, score
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.ground.multiscale.raised_patches import raised_patches
from spl_batch.airborne.settings import GroundSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable

CLOTHS: Final = {"csf steep": (1, True), "csf relief": (2, True), "csf flat": (3, False)}
"""Rigidness and slope smoothing by stock setting; all else as the package has it."""

EDGE_M: Final = 5.0
"""What is left off at the edges of a tile, at most a tenth of its width [m]."""

CLEAR_M: Final = 0.5
"""A cell farther off than this is wrong [m]."""

FAR_M: Final = 10.0
"""Grid places farther than this from the producer's ground are left out [m]."""

DENSE_PER_M2: Final = 1.0
"""Tiles denser than this are compared on a grid of 1 m, others on one of 2 m [1/m2]."""

FEW: Final = 1000
"""Points that a method is tried on first [count]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Tile(NamedTuple):
    """A classified tile: points in canonical order, their class, and places on a grid [m]."""

    name: str
    table: PointTable
    classes: NDArray[np.uint8]
    grid: Float
    truth: Float

    @property
    def ground(self) -> Mask:
        """The producer's ground."""
        return self.classes == 2

    @property
    def xyz(self) -> Float:
        """Points less their corner: (n, 3) [m]."""
        found = np.column_stack([self.table[axis] for axis in "xyz"]) * QUANTUM_M
        return found - np.floor(found.min(axis=0))


def read(path: Path) -> Tile | None:
    """A tile of a file; None where the producer tells no ground.

    Overlap (class 12), noise (7, 18) and withheld points are left out; so is a second copy of a
    point.
    """
    las = laspy.read(path)
    classes = np.asarray(las.classification).astype(np.uint8)
    good = ~np.isin(classes, (7, 12, 18))
    xyz = np.column_stack(
        [np.rint(np.asarray(v) / QUANTUM_M).astype(np.int64) for v in (las.x, las.y, las.z)]
    )
    if good.sum() < 1000 or not (classes[good] == 2).any():
        return None
    xyz, first = np.unique(xyz[good], axis=0, return_index=True)
    x, y, z = xyz.T
    table = PointTable({"x": x.copy(), "y": y.copy(), "z": z.astype(np.int32)})
    tile = Tile(path.stem, table, classes[good][first], np.empty((0, 2)), np.empty(0))
    grid = _places(tile.xyz)
    ground = tile.xyz[tile.ground]
    near = cKDTree(ground[:, :2]).query(grid, distance_upper_bound=FAR_M)[0] <= FAR_M
    truth = terrain(ground, grid)
    kept = near & np.isfinite(truth)
    return tile._replace(grid=grid[kept], truth=truth[kept])


def _places(xyz: Float) -> Float:
    """Places of a grid, edges off: (m, 2) [m]."""
    low, high = xyz[:, :2].min(axis=0), xyz[:, :2].max(axis=0)
    cell = 1.0 if len(xyz) > DENSE_PER_M2 * np.prod(high - low) else 2.0
    edge = np.minimum(EDGE_M, (high - low) / 10)
    x, y = (np.arange(a, b, cell) for a, b in zip(low + edge, high - edge, strict=True))
    return np.column_stack([v.ravel() for v in np.meshgrid(x, y)])


def terrain(ground: Float, places: Float) -> Float:
    """Height of the TIN through ground points at places; NaN outside: (m,) [m].

    Of points at one place the lowest counts.
    """
    order = np.lexsort([ground[:, 2], ground[:, 1], ground[:, 0]])
    _, first = np.unique(ground[order, :2], axis=0, return_index=True)
    lowest = ground[order][first]
    found: Float = LinearNDInterpolator(lowest[:, :2], lowest[:, 2])(places)
    return found


def figures(tile: Tile, found: Mask, seconds: float) -> dict[str, float]:
    """What a method is worth on a tile."""
    off = (
        terrain(tile.xyz[found], tile.grid) - tile.truth if found.sum() > 3 else np.array([np.nan])
    )
    off = off[np.isfinite(off)]

    def share(of: Mask) -> float:
        return 100 * float(np.mean(found[of])) if of.any() else np.nan

    return {
        "RMSE": float(np.sqrt(np.mean(off**2))),
        "> 0.5 m": 100 * float(np.mean(off > CLEAR_M)),
        "< -0.5 m": 100 * float(np.mean(off < -CLEAR_M)),
        "bias": float(np.median(off)),
        "roofs": share(tile.classes == 6),
        "shrubs": share(tile.classes == 4),
        "recall": share(tile.ground),
        "share": 100 * float(found.mean()),
        "kappa": score(found, tile.ground).kappa,
        "raised": float(len(raised_patches(_means(tile.xyz[found]), 1.0))),
        "s/M": 1e6 * seconds / len(found),
    }


def _means(ground: Float) -> Float:
    """Mean height of ground points in each cell of 1 m; NaN without any."""
    column, row = np.floor(ground[:, :2] - np.floor(ground[:, :2].min(axis=0))).astype(int).T
    shape = row.max() + 1, column.max() + 1
    number = row * shape[1] + column
    count, total = (
        np.bincount(number, weights=w, minlength=shape[0] * shape[1]).reshape(shape)
        for w in (None, ground[:, 2])
    )
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def cloth(xyz: Float, rigidness: int, *, smooth: bool) -> Mask:
    """Ground by the cloth filter of PyPI."""
    package = importlib.import_module("CSF")
    filtered = package.CSF()
    filtered.params.rigidness = rigidness
    filtered.params.bSloopSmooth = smooth
    filtered.setPointCloud(xyz)
    ground, rest = package.VecInt(), package.VecInt()
    exported = False
    filtered.do_filtering(ground, rest, exported)
    found = np.zeros(len(xyz), dtype=np.bool_)
    found[np.array(ground, dtype=np.int64)] = True
    return found


def project(method: str, *, cells: bool) -> Callable[[Tile], Mask]:
    """One of the project's methods, whole or by cells."""
    settings = GroundSettings.model_validate({"method": method})

    def found(tile: Tile) -> Mask:
        if cells:
            return by_cells(tile.table, settings)
        return ground_mask(tile.table, np.ones(len(tile.table), dtype=np.bool_), settings)

    return found


def methods(names: Sequence[str], *, cells: bool) -> dict[str, Callable[[Tile], Mask]]:
    """Methods by name; ``csf`` stands for its stock settings."""
    found: dict[str, Callable[[Tile], Mask]] = {}
    for name in names:
        if name == "csf":
            for stock, (rigid, smooth) in CLOTHS.items():
                found[stock] = lambda tile, r=rigid, s=smooth: cloth(tile.xyz, r, smooth=s)  # type: ignore[misc]
        else:
            found[name] = project(name, cells=cells)
    return found


def tiles(folder: Path, wanted: Sequence[str]) -> list[Tile]:
    """Tiles of a folder and those below it."""
    paths = sorted(path for path in folder.rglob("*.la[sz]"))
    chosen = [p for p in paths if not wanted or any(p.name.startswith(w) for w in wanted)]
    return [tile for tile in map(_read_or_say, chosen) if tile is not None]


def _read_or_say(path: Path) -> Tile | None:
    try:
        return read(path)
    except (laspy.errors.LaspyException, ValueError) as error:
        print(f"{path.name}: left out: {error}")
        return None


def run(tile: Tile, chosen: Mapping[str, Callable[[Tile], Mask]]) -> dict[str, dict[str, float]]:
    """All methods on one tile."""
    results = {}
    corner = _corner(tile)
    for name, method in chosen.items():
        method(corner)  # what is compiled at the first call is none of the method's time
        started = time.process_time()
        found = method(tile)
        results[name] = figures(tile, found, time.process_time() - started)
    return results


def thinned(tile: Tile, share: float, seed: int) -> Tile:
    """A tile with a share of its points; the producer's terrain stays that of all."""
    kept = np.random.default_rng(seed).random(len(tile.table)) < share
    kept[tile.xyz.argmin(axis=0)] = True  # heights and places count from the corner
    return tile._replace(table=tile.table.take(np.flatnonzero(kept)), classes=tile.classes[kept])


def _corner(tile: Tile) -> Tile:
    """A thousand points of a tile."""
    few = np.arange(len(tile.table)) < FEW
    return tile._replace(table=tile.table.take(few), classes=tile.classes[few])


def show(tile: Tile, results: Mapping[str, Mapping[str, Any]]) -> None:
    """Print one tile's table."""
    first = next(iter(results.values()))
    print(f"\n{tile.name} ({len(tile.table)} points)".ljust(42) + "".join(f"{n:>9}" for n in first))
    for name, row in results.items():
        print(f"  {name:39}" + "".join(f"{value:9.2f}" for value in row.values()), flush=True)


def main(
    folder: Path, wanted: Sequence[str], names: Sequence[str], thin: Sequence[float], *, cells: bool
) -> None:
    """Run all methods on all tiles, and print."""
    chosen = methods(names, cells=cells)
    for whole in tiles(folder, wanted):
        tile = thinned(whole, thin[0], int(thin[1])) if thin else whole
        show(tile, run(tile, chosen))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("tiles", nargs="*")
    parser.add_argument("--methods", nargs="+", default=["multiscale", "ptd", "smrf", "csf"])
    parser.add_argument("--cells", action="store_true")
    parser.add_argument("--thin", nargs=2, type=float, default=(), metavar=("SHARE", "SEED"))
    given = parser.parse_args()
    main(given.folder, given.tiles, given.methods, given.thin, cells=given.cells)
