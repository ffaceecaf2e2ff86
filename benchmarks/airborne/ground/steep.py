"""Steep ground with truth: ``python -m benchmarks.airborne.ground.steep [FOLDER]``.

Small surveys of ridges and gorges of 45 to 60 degrees, of cliffs of 15 m, in the open and under
trees, of bridges, a mountain and a town run with the default settings; ``--times`` changes heights
and depths. Of each the table says

- ``ground``: returns of the ground that the run calls ground [%], of those that its filter kept;
- ``rmse``, ``> 0.5 m``, ``< -0.5 m``: the delivered terrain model against the truth [m, %, %]. At a
  cliff a cell holds all heights between foot and top: a height counts as right within those that
  the truth has in the cell and the eight around it;
- ``largest``: the largest difference [m], and ``floor`` that on the floor: the level part of the
  lowest fifth of all heights;
- ``objects``: returns of trees, decks and roofs more than 0.5 m above the ground that are called
  ground [%].

``run`` is the delivered result. It is *held* where ground, RMSE or, below bridges, the largest
error of the floor are within bounds, else *told* if the run has a warning that level ground under
trees has not, and of a kind that says what is off (:data:`SAYS`), or *SILENT*; ``--say`` prints the
new warnings. ``before`` is the result of another version, ``--before CHECKOUT``. The other rows
are methods on the points that the run kept, less noise more than 5 m below all ground, which the
cloth filter does not stand, or without any noise (``--clean``), with the TIN of what they call
ground as terrain: the project's, and the three stock settings of the cloth filter of PyPI
(``cloth-simulation-filter``).
"""

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.airborne.filter.methods import is_noise
from benchmarks.airborne.ground.ground_tiles import CLOTHS, cloth, project, terrain
from benchmarks.airborne.ground.ground_tiles import Tile as Points
from benchmarks.airborne.ground.steep_scenes import SCENES, content
from benchmarks.airborne.other_version import OUT, run_by
from benchmarks.airborne.quality import KINDS
from benchmarks.airborne.told import new_warnings, telling, told_by
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.constants import CLASS_GROUND, QUANTUM_M
from spl_batch.engine.verbs.running import run
from spl_batch.lattice.tables import PointTable

RIM: Final = 3
"""Cells that are left off at the edges of a survey [count]."""

GROUND: Final = 97.0
RMSE_M: Final = 0.30
LARGEST_M: Final = 0.5
SMALL: Final = 1.0
"""What is held: ground that is found at least [%], RMSE at most, below bridges the largest error of
the valley's floor [m], and of small forms the share of cells that are off by more than 0.5 m
[%]."""


_CUT_OFF: Final = ("steep", "block", "gaps", "unsure")
SAYS: Final = dict.fromkeys(SCENES, ("G01", "G02"))
"""Codes of findings that say what is off."""


Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Truth(NamedTuple):
    """True heights of a survey's cells [m], north up, and where their first corner lies [m]."""

    height: Grid
    left: float
    top: float


class Kept(NamedTuple):
    """Points that a run kept.

    Parameters
    ----------
    xyz : (n, 3) int64
        Places [quanta].
    kind : (n,) integer
        What they are, as in ``KINDS``.
    called : (n,) bool
        Whether the run calls them ground.
    """

    xyz: NDArray[np.int64]
    kind: NDArray[Any]
    called: Mask


def process(name: str, seed: int, times: float, folder: Path) -> Path:
    """Simulate and run one survey."""
    survey = simulated(name, seed, times, folder)
    run(survey / "workflow.yaml", workers=0)
    return survey


def simulated(name: str, seed: int, times: float, folder: Path) -> Path:
    """Folder of a survey, made where it is not there."""
    survey = folder / f"{name}_{seed}_{times:g}".replace(" ", "_").replace(",", "")
    if not (survey / "workflow.yaml").exists():
        simulate(parse_scene(content(name, seed, times), name), survey)
    return survey


def load(survey: Path, out: str = "out") -> tuple[Truth, Kept]:
    """Truth of a survey, and the points that its run kept."""
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        truth = Truth(source.read(1).astype(np.float64), source.bounds.left, source.bounds.top)
    parts: list[Kept] = []
    for path in sorted((survey / out / "laz").rglob("*.laz")):
        las = laspy.read(path)
        kept = np.asarray(las["noise_class"]) == 0
        kind = pq.read_table(survey / "truth" / f"{path.stem}.parquet")["kind"].to_numpy()
        places = [np.rint(np.asarray(v)[kept] / QUANTUM_M) for v in (las.x, las.y, las.z)]
        called = np.asarray(las.classification)[kept] == CLASS_GROUND
        parts.append(Kept(np.column_stack(places).astype(np.int64), kind[kept], called))
    return truth, Kept(*(np.concatenate(some) for some in zip(*parts, strict=True)))


def delivered(survey: Path, truth: Truth, out: str = "out") -> Grid:
    """The run's terrain on the cells of the truth."""
    rows, columns = truth.height.shape
    with rasterio.open(survey / out / "dtm.tif") as source:
        frame = truth.left, truth.top - rows, truth.left + columns, truth.top
        window = source.window(*frame).round_offsets().round_lengths()
        found = source.read(1, window=window, boundless=True, fill_value=source.nodata)
        return np.where(found == source.nodata, np.nan, found.astype(np.float64))


def figures(truth: Truth, kept: Kept, called: Mask, dtm: Grid) -> dict[str, float]:
    """What a result is worth."""
    low, high = ndimage.minimum_filter(truth.height, 3), ndimage.maximum_filter(truth.height, 3)
    # At a cliff any height between foot and top is right.
    off = np.where(dtm > truth.height, np.maximum(dtm - high, 0), np.minimum(dtm - low, 0))
    cliff = high - low > CLIFF_M
    off = np.where(cliff, off, dtm - truth.height)[RIM:-RIM, RIM:-RIM]
    floor = np.abs(off[_floor(truth.height)[RIM:-RIM, RIM:-RIM] & np.isfinite(off)])
    off = off[np.isfinite(off)]
    row = np.floor(truth.top - kept.xyz[:, 1] * QUANTUM_M).astype(int)
    column = np.floor(kept.xyz[:, 0] * QUANTUM_M - truth.left).astype(int)
    rows, columns = truth.height.shape
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    above = np.zeros(len(row))
    above[inside] = kept.xyz[inside, 2] * QUANTUM_M - high[row[inside], column[inside]]
    names = ("vegetation", "roof", "other")
    objects = inside & np.isin(kept.kind, [KINDS.index(n) for n in names]) & (above > 0.5)
    return {
        "ground": 100 * float(called[inside & (kept.kind == KINDS.index("ground"))].mean()),
        "rmse": float(np.sqrt(np.mean(off**2))),
        "> 0.5 m": 100 * float(np.mean(off > 0.5)),
        "< -0.5 m": 100 * float(np.mean(off < -0.5)),
        "largest": float(np.abs(off).max()),
        "floor": float(floor.max(initial=0.0)),
        "objects": 100 * float(called[objects].mean()) if objects.any() else 0.0,
    }


def _floor(height: Grid) -> Mask:
    """Cells of the lowest fifth of all heights, where it is level."""
    level = ndimage.maximum_filter(height, 5) - ndimage.minimum_filter(height, 5) < LEVEL_M
    low: Mask = height < height.min() + 0.2 * np.ptp(height)
    return low & level


LEVEL_M: Final = 2.0
"""Range of true heights in 25 cells below which they are level [m]."""

CLIFF_M: Final = 6.0
"""Range of true heights in nine cells from which on they are a cliff's: over 70 degrees [m]."""


DEEP_M: Final = 5.0
"""Kept points so far below all ground are left out for methods alone [m]."""


def by_methods(
    truth: Truth, kept: Kept, names: Sequence[str], *, clean: bool = False
) -> dict[str, dict[str, float]]:
    """Methods on the points that a run kept."""
    out = kept.xyz[:, 2] * QUANTUM_M < truth.height.min() - DEEP_M
    if clean:
        out = is_noise(kept.kind)
    kept = Kept(*(some[~out] for some in kept))
    x, y, z = kept.xyz.T
    order = np.lexsort([z, y, x])
    table = PointTable({"x": x[order], "y": y[order], "z": z[order].astype(np.int32)})
    points = Points("", table, np.zeros(len(x), np.uint8), np.empty((0, 2)), np.empty(0))
    places = _centres(truth, points)
    found = {}
    for name in names:
        if name in CLOTHS:
            rigid, smooth = CLOTHS[name]
            mask = cloth(points.xyz, rigid, smooth=smooth)
        else:
            mask = project(name, cells=False)(points)
        base = float(np.floor(z.min() * QUANTUM_M))
        dtm = base + terrain(points.xyz[mask], places).reshape(truth.height.shape)
        called = np.zeros(len(x), np.bool_)
        called[order] = mask
        found[name] = figures(truth, kept, called, dtm)
    return found


def _centres(truth: Truth, points: Points) -> Grid:
    """Middles of the truth's cells from the corner that the points count from: (m, 2) [m]."""
    rows, columns = truth.height.shape
    corner = [np.floor(points.table[axis].min() * QUANTUM_M) for axis in "xy"]
    x = truth.left + 0.5 + np.arange(columns) - corner[0]
    y = truth.top - 0.5 - np.arange(rows) - corner[1]
    return np.column_stack([v.ravel() for v in np.meshgrid(x, y)])


def verdict(found: Mapping[str, float], name: str, told: Sequence[str]) -> str:
    """Held, told or silent, and the figures that are worse than is held."""
    found = {**found, "off": found["> 0.5 m"] + found["< -0.5 m"]}
    bad = {"ground": found["ground"] < GROUND, "rmse": found["rmse"] > RMSE_M}
    if SCENES[name].small:
        bad["off"] = found["off"] > SMALL
    if SCENES[name].deck_m:
        bad = {"floor": found["floor"] > LARGEST_M}
    worse = [key for key, is_worse in bad.items() if is_worse]
    if not worse:
        return "held"
    return f"{'told' if told else 'SILENT'}: {', '.join(f'{k} {found[k]:.2f}' for k in worse)}"


def main() -> None:
    """Simulate, run, and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(SCENES), default=list(SCENES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[11])
    parser.add_argument("--times", nargs="+", type=float, default=[1.0])
    parser.add_argument("--methods", nargs="*", default=["multiscale", "ptd", *CLOTHS])
    parser.add_argument("--say", action="store_true", help="print the warnings")
    parser.add_argument("--clean", action="store_true", help="methods see no noise")
    parser.add_argument("--before", type=Path, metavar="CHECKOUT", help="another version")
    given = parser.parse_args()
    rows = [("level", 11, 1.0)]
    rows += [(n, seed, times) for n in given.only for seed in given.seeds for times in given.times]
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        versions = {"run": "out"}
        if given.before:
            versions = {"before": OUT} | versions
            surveys = [simulated(*row, folder) for row in dict.fromkeys(rows)]
            run_by(given.before, [(survey / "workflow.yaml", ()) for survey in surveys])
        level = process(*rows[0], folder)
        usual = {out: warnings(level, out) for out in versions.values()}
        for name, seed, times in rows[1:]:
            survey = process(name, seed, times, folder)
            truth, kept = load(survey)
            columns = figures(truth, kept, kept.called, truth.height)
            print(
                f"{name}, seed {seed}, {times:g}".ljust(38) + "".join(f"{n:>10}" for n in columns)
            )
            for version, out in versions.items():
                _print(survey, name, (version, out), usual[out], say=given.say)
            for method, row in by_methods(truth, kept, given.methods, clean=given.clean).items():
                print(_row(method, row), flush=True)


def warnings(survey: Path, out: str) -> list[str]:
    """What the run of a survey warns of."""
    return told_by(json.loads((survey / out / "report.json").read_text()))


def _row(method: str, row: Mapping[str, float]) -> str:
    return f"  {method:36}" + "".join(f"{value:10.2f}" for value in row.values())


def _print(
    survey: Path,
    name: str,
    version: tuple[str, str],
    usual: Sequence[str],
    *,
    say: bool,
) -> None:
    """One survey by the run of a version, its name and where its result lies."""
    method, out = version
    truth, kept = load(survey, out)
    found = figures(truth, kept, kept.called, delivered(survey, truth, out))
    new = new_warnings(warnings(survey, out), usual)
    words = verdict(found, name, telling(new, SAYS[name]))
    print(f"{_row(method, found)}  {words} [{', '.join(dict.fromkeys(new))}]", flush=True)
    for text in new if say else []:
        print(f"    {text}")


if __name__ == "__main__":
    main()
