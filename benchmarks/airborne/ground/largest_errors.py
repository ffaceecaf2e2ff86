"""Where the terrain of a simulated survey is off by the most: a picture.

Run ``python -m benchmarks.airborne.ground.largest_errors FOLDER [PICTURE] [--surveys ...]``.

FOLDER is that of :mod:`~benchmarks.airborne.ground.terrain`; surveys that are not there yet are
simulated. Each is run with the default method and with densification (``ptd``). For the patch in
which the default terrain is farthest off, prints its size, how many true returns of the ground lie
in its cells or beside them, how many of these the noise filter kept, and which points were called
ground. PICTURE shows a profile through each patch.
"""

import argparse
from pathlib import Path
from typing import Any, Final, NamedTuple

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.airborne.ground.terrain import beside, cut, simulated
from benchmarks.airborne.quality import KINDS
from spl_batch import api
from spl_batch.airborne.settings import GroundSettings
from spl_batch.constants import CLASS_GROUND, CLASS_HIGH_NOISE, CLASS_LOW_NOISE

SURVEYS: Final = ("hill 11", "hill 12", "dense 12")
"""Where the default method's largest error is greater than that of densification."""

METHODS: Final = (GroundSettings().method, "ptd")

OFF_M: Final = 0.5
"""A patch is made of cells that are off by more [m]."""

WIDE_M: Final = 1.5
LONG_M: Final = 16.0
"""Half the width and the length of a profile [m]."""

BELOW_M: Final = 2.5
ABOVE_M: Final = 7.0
"""How far a profile shows points below and above the true terrain in its middle [m]."""

DRAWN: Final = {
    "ground": ("tab:orange", "returns of the ground"),
    "vegetation": ("tab:green", "vegetation"),
    "background": ("tab:red", "noise that the filter kept"),
}
"""Colour and name of each kind of point."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Points(NamedTuple):
    """Returns of all flightlines: places [m], true kind, delivered class, cell of the raster."""

    xyz: Float
    kind: NDArray[np.uint8]
    label: NDArray[np.uint8]
    row: NDArray[np.int64]
    column: NDArray[np.int64]

    def within(self, cells: Mask) -> Mask:
        """Points in some cells: (n,) bool."""
        rows, columns = cells.shape
        inside = (self.row >= 0) & (self.row < rows) & (self.column >= 0) & (self.column < columns)
        inside[inside] = cells[self.row[inside], self.column[inside]]
        return inside


def ran(name: str, folder: Path) -> Path:
    """One survey, run by each method: its folder."""
    kind, seed = name.split()
    survey = simulated(kind, int(seed), folder)
    for method in METHODS:
        api.run(
            survey / "workflow.yaml", overrides=[f"output=by_{method}", f"ground.method={method}"]
        )
    return survey


def points_of(survey: Path) -> Points:
    """What the default method was given, and gave."""
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        at = source.transform
    xyz, kinds, labels = [], [], []
    for path in sorted((survey / "truth").glob("line_*.parquet")):
        las = laspy.read(survey / f"by_{METHODS[0]}" / "laz" / "flightlines" / f"{path.stem}.laz")
        xyz.append(np.column_stack([las.x, las.y, las.z]))
        kinds.append(pq.read_table(path, columns=["kind"])["kind"].to_numpy())
        labels.append(np.asarray(las.classification))
    places = np.concatenate(xyz)
    row = np.ceil(at.f - places[:, 1]).astype(np.int64) - 1
    column = np.floor(places[:, 0] - at.c).astype(np.int64)
    return Points(places, np.concatenate(kinds), np.concatenate(labels), row, column)


def worst_patch(off: Float) -> tuple[Mask, tuple[int, int]]:
    """Cells that hang together about the one that is off by the most, and that one."""
    size = np.nan_to_num(np.abs(off))
    worst = np.unravel_index(int(size.argmax()), size.shape)
    patches, _ = ndimage.label(size > OFF_M, np.ones((3, 3)))
    return patches == patches[worst], (int(worst[0]), int(worst[1]))


def tell(name: str, off: dict[str, Float], patch: Mask, of: Points) -> None:
    """Print what the patch holds."""
    ground = of.kind == KINDS.index("ground")
    kept = ~np.isin(of.label, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
    own = of.within(patch)
    largest = ", ".join(f"{m} {np.nanmax(np.abs(off[m])):.2f} m" for m in METHODS)
    print(f"{name}: largest error: {largest}; patch of {patch.sum()} cells")
    for where, there in (("in its cells", own), ("there or beside them", of.within(beside(patch)))):
        print(
            f"  {where}: {(there & ground).sum()} returns of the ground, "
            f"{(there & ground & kept).sum()} of them kept, of {(there & kept).sum()} kept in all"
        )
    called = own & (of.label == CLASS_GROUND)
    counts = np.bincount(of.kind[called], minlength=len(KINDS))
    found = ", ".join(f"{n} {k}" for n, k in zip(counts, KINDS, strict=True) if n) or "none"
    print(f"  called ground in its cells: {found}")


def profile(axes: Any, survey: Path, of: Points, middle: tuple[int, int], name: str) -> None:
    """Points and terrains along the row of the worst cell."""
    row, column = middle
    with rasterio.open(survey / "truth" / "dtm.tif") as source:
        at, truth = source.transform, source.read(1).astype(np.float64)
    x, y, level = at.c + column + 0.5, at.f - row - 0.5, truth[row, column]
    kept = ~np.isin(of.label, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
    near = (np.abs(of.xyz[:, 1] - y) < WIDE_M) & (np.abs(of.xyz[:, 0] - x) < LONG_M)
    for kind, (colour, label) in DRAWN.items():
        own = near & kept & (of.kind == KINDS.index(kind))
        size = 3 if kind == "vegetation" else 16
        axes.scatter(of.xyz[own, 0] - x, of.xyz[own, 2] - level, size, colour, label=label)
    along = np.arange(truth.shape[1]) + at.c + 0.5 - x
    lines = {"true terrain": (truth, "black"), "terrain, default method":
             (cut(survey / f"by_{METHODS[0]}" / "dtm.tif", survey), "tab:blue"), "terrain, PTD":
             (cut(survey / f"by_{METHODS[1]}" / "dtm.tif", survey), "tab:purple")}  # fmt: skip
    for label, (heights, colour) in lines.items():
        axes.plot(along, heights[row] - level, color=colour, label=label, linewidth=1.4)
    axes.set(
        xlim=(-LONG_M, LONG_M), ylim=(-BELOW_M, ABOVE_M), title=f"{name}: {2 * WIDE_M:g} m wide",
        xlabel="east of the worst cell [m]", ylabel="height above the truth there [m]",
    )  # fmt: skip


def main(folder: Path, picture: Path | None, surveys: list[str]) -> None:
    """Print, and draw."""
    figure = Figure(figsize=(5.5 * len(surveys), 4.6), layout="constrained")
    all_axes = np.atleast_1d(figure.subplots(1, len(surveys)))
    for axes, name in zip(all_axes, surveys, strict=True):
        survey = ran(name, folder)
        truth = cut(survey / "truth" / "dtm.tif", survey)
        off = {m: cut(survey / f"by_{m}" / "dtm.tif", survey) - truth for m in METHODS}
        patch, middle = worst_patch(off[METHODS[0]])
        of = points_of(survey)
        tell(name, off, patch, of)
        profile(axes, survey, of, middle, name)
    all_axes[0].legend(fontsize=7, loc="upper left")
    if picture:
        figure.savefig(picture, dpi=90)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("picture", type=Path, nargs="?")
    parser.add_argument("--surveys", nargs="+", default=list(SURVEYS))
    given = parser.parse_args()
    main(given.folder, given.picture, given.surveys)
