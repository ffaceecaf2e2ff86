"""Terrain, surface and reflectance of simulated surveys, and flightlines that lie apart."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.held import scenes, surveys, truth
from benchmarks.held.figures import Figure, Moves, chosen, figure
from benchmarks.held.surveys import Given
from benchmarks.held.truth import Grid, Mask, Points, share
from spl_batch import api
from spl_batch.constants import CLASS_GROUND

NINE: Final = np.ones((3, 3), dtype=np.bool_)
"""A cell and the eight around it."""

WOODS: Final[Moves] = {
    "DTM RMSE on open ground cm": ("cm", "more", 0.1),
    "DTM mean |d| but on water cm": ("cm", "more", 0.2),
    "DTM mean |d| under canopy cm": ("cm", "more", 0.5),
    "DTM mean |d| under roofs cm": ("cm", "more", 1.0),
    "DTM cells off by > 0.5 m per 10 000": ("1e-4", "more", 3.0),
    "DSM pits in roofs per 10 000": ("1e-4", "more", 0.5),
    "DSM pits in canopy per 10 000": ("1e-4", "more", 0.5),
    "DSM spikes per 10 000": ("1e-4", "more", 0.5),
}
STEEP: Final[Moves] = {
    "ground": ("%", "less", 0.2),
    "rmse": ("m", "more", 0.01),
    "> 0.5 m": ("%", "more", 0.1),
    "< -0.5 m": ("%", "more", 0.1),
    "floor": ("m", "more", 0.1),
    "objects": ("%", "more", 0.1),
}


def ground(given: Given) -> Iterator[Figure]:
    """Terrain and surface of simulated woods, a town, steep ground and a bridge."""
    for name in scenes.WOODS:
        survey = surveys.once(scenes.woods(name), given.scratch / "woods" / name)
        yield from chosen(_woods(survey), WOODS, f"{name}: ")
    for name in scenes.STEEP:
        survey = surveys.once(scenes.steep(name), given.scratch / "steep" / name.replace(" ", "_"))
        yield from chosen(_steep(survey), STEEP, f"{name}: ")


def _woods(survey: Path) -> dict[str, float]:
    """What DTM and DSM are off, by what is above the ground.

    A roof has a pit where the DSM lies 1 m below the lowest true surface within one cell; a canopy
    where it lies under half of the lowest true height above ground. A spike is a DSM cell 0.5 m
    above every true return of it and its neighbours.
    """
    table = truth.points(survey)
    terrain, surface = (truth.raster(survey / "truth" / f"{n}.tif") for n in ("dtm", "dsm"))
    dtm, dsm = truth.delivered(survey, "dtm"), truth.delivered(survey, "dsm")
    roofs, water = _cells_with(survey, table, "roof"), _cells_with(survey, table, "water")
    inner = ndimage.binary_opening(roofs, NINE)
    off, above = dtm - terrain, surface - terrain
    known = ~np.isnan(off) & ~water
    lowest = ndimage.minimum_filter(surface, 3)
    roof = ndimage.binary_erosion(inner, NINE)
    canopy = (lowest - terrain > 2) & ~roofs
    in_roofs, in_canopy = roof & ~(dsm >= lowest - 1.0), canopy & ~(dsm >= 0.5 * (lowest + terrain))
    near = truth.around(truth.highest(survey, table))
    seen = np.isfinite(near) & ~np.isnan(dsm)

    def mean_cm(where: Mask) -> float:
        return 100 * float(np.abs(off[where & known]).mean())

    return {
        "DTM RMSE on open ground cm": 100 * truth.rms(off[known & (np.abs(above) < 0.2)]),
        "DTM mean |d| but on water cm": mean_cm(known),
        "DTM mean |d| under canopy cm": mean_cm(~roofs & (above >= 0.2)),
        "DTM mean |d| under roofs cm": mean_cm(inner),
        "DTM cells off by > 0.5 m per 10 000": 1e4 * float(np.mean(np.abs(off[known]) > 0.5)),
        "DSM pits in roofs per 10 000": 1e4 * float(in_roofs.sum() / max(roof.sum(), 1)),
        "DSM pits in canopy per 10 000": 1e4 * float(in_canopy.sum() / max(canopy.sum(), 1)),
        "DSM spikes per 10 000": 1e4 * float(np.mean(dsm[seen] > near[seen] + 0.5)),
    }


def _cells_with(survey: Path, table: Points, kind: str) -> Mask:
    """Cells of the true rasters with returns of a kind."""
    row, column, inside = truth.cells(survey, table)
    inside &= truth.of(table, kind)
    found = np.zeros(truth.raster(survey / "truth" / "dtm.tif").shape, dtype=np.bool_)
    found[row[inside], column[inside]] = True
    return found


RIM: Final = 3
"""Cells that are left off at the edges of a survey [count]."""

CLIFF_M: Final = 6.0
"""Range of true heights in nine cells from which on they are a cliff's: over 70 degrees [m]."""

LEVEL_M: Final = 2.0
"""Range of true heights in 25 cells below which they are level [m]."""


def _steep(survey: Path) -> dict[str, float]:
    """Ground found of what the filter kept, terrain, its floor, and objects taken for ground.

    At a cliff a cell holds all heights between foot and top: a height counts as right within those
    that the truth has in the cell and the eight around it. The floor is the level part of the
    lowest fifth of all heights.
    """
    table = truth.points(survey)
    true, dtm = truth.raster(survey / "truth" / "dtm.tif"), truth.delivered(survey, "dtm")
    low, high = ndimage.minimum_filter(true, 3), ndimage.maximum_filter(true, 3)
    off = np.where(dtm > true, np.maximum(dtm - high, 0), np.minimum(dtm - low, 0))
    off = np.where(high - low > CLIFF_M, off, dtm - true)[RIM:-RIM, RIM:-RIM]
    level = ndimage.maximum_filter(true, 5) - ndimage.minimum_filter(true, 5) < LEVEL_M
    floor = (level & (true < true.min() + 0.2 * np.ptp(true)))[RIM:-RIM, RIM:-RIM]
    row, column, inside = truth.cells(survey, table)
    inside &= table["noise_class"] == 0
    above = np.zeros(len(row))
    above[inside] = table["z"][inside] - high[row[inside], column[inside]]
    objects = inside & truth.of(table, "vegetation", "roof", "other") & (above > 0.5)
    called = table["classification"] == CLASS_GROUND
    known = off[np.isfinite(off)]
    return {
        "ground": share(called, inside & truth.of(table, "ground")),
        "rmse": truth.rms(known),
        "> 0.5 m": 100 * float(np.mean(known > 0.5)),
        "< -0.5 m": 100 * float(np.mean(known < -0.5)),
        "floor": float(np.abs(off[floor & np.isfinite(off)]).max(initial=0.0)),
        "objects": share(called, objects) if objects.any() else 0.0,
    }


def coverage(off: Grid, sigma: Grid, of: str) -> Iterator[Figure]:
    """Share of differences within one and 1.96 standard deviations."""
    known = np.isfinite(off) & np.isfinite(sigma)
    for times in (1.0, 1.96):
        within = 100 * float(np.mean(np.abs(off[known]) <= times * sigma[known]))
        yield figure(f"{of}within {times:g} sigma", within, "%", "either", 1.0)


def sigma(given: Given) -> Iterator[Figure]:
    """Share of the quickstart's terrain that lies within its standard deviations of the truth."""
    survey = surveys.quickstart(given)
    off = truth.delivered(survey, "dtm") - truth.raster(survey / "truth" / "dtm.tif")
    yield from coverage(off, truth.delivered(survey, "dtm_quality"), "quickstart: ")


def flightlines(given: Given) -> Iterator[Figure]:
    """Error of the shift that is found between two flightlines, and its standard deviation."""
    for number, shift in enumerate(scenes.SHIFTS):
        survey = surveys.simulated(scenes.shifted(shift), given.scratch / f"shift_{number}")
        report = api.run(survey / "workflow.yaml", workers=0).report
        pair = next(p for p in report.strips if p.second.startswith("00002"))
        name = "shift of " + " ".join(f"{v:g}" for v in shift)
        found = pair.east_m, pair.north_m, pair.up_m
        for axis, one, true in zip(("east", "north", "up"), found, shift, strict=True):
            off = np.nan if one is None else 100 * abs(one - true)
            tolerance = 0.1 if axis == "up" else 0.5
            yield figure(f"{name}: error of {axis}", off, "cm", "more", tolerance)
        spread = np.nan if pair.up_sd_m is None else 100 * pair.up_sd_m
        yield figure(f"{name}: standard deviation of up", spread, "cm", "more", 0.1)


PATCH: Final = 5
"""Edge of a square of open ground [cells]."""

RIM_M: Final = 1.5
"""Margin along the edges of roofs that is left out [m]."""

CLEAR: Final = 7
"""Edge of the window in which nothing may be above open ground [cells]."""


def reflectance(given: Given) -> Iterator[Figure]:
    """Intensity against true reflectance, over patches of one reflectance and their cells."""
    survey = surveys.once(scenes.reflectances(), given.scratch / "intensity")
    found = truth.delivered(survey, "intensity")
    true, patch = truth.raster(survey / "truth" / "reflectance.tif"), patches(survey)
    by_patch = scores(means(found, patch), means(true, patch))
    by_cell = scores(found[patch > 0], true[patch > 0])
    for name, (squared, about, ratio) in (("patches", by_patch), ("cells", by_cell)):
        yield figure(f"{name}: squared correlation", squared, "", "less", 0.005)
        yield figure(f"{name}: R2 about the 1:1 line", about, "", "less", 0.005)
        yield figure(f"{name}: median ratio", ratio, "", "either", 0.01)


def patches(survey: Path) -> NDArray[np.int64]:
    """Number of the patch of each cell, from 1, north up; 0 for cells of none."""
    dsm, dtm = (truth.raster(survey / "truth" / f"{name}.tif") for name in ("dsm", "dtm"))
    open_ground = ndimage.maximum_filter(np.abs(dsm - dtm), CLEAR) < 0.05
    rows, columns = dsm.shape
    patch = np.zeros(dsm.shape, dtype=np.int64)
    last = 0
    for row in range(0, rows - PATCH + 1, PATCH):
        for column in range(0, columns - PATCH + 1, PATCH):
            square = slice(row, row + PATCH), slice(column, column + PATCH)
            if open_ground[square].all():
                last += 1
                patch[square] = last
    content = json.loads((survey / "truth" / "scene.json").read_text(encoding="utf-8"))
    west, south = content["scene"]["origin_m"][:2]
    x, y = np.meshgrid(np.arange(columns) + 0.5 + west, rows - np.arange(rows) - 0.5 + south)
    for ring in content["building_outlines"]:
        inside = shapely.contains_xy(shapely.Polygon(ring).buffer(-RIM_M), x, y)
        if inside.any():
            last += 1
            patch[inside] = last
    return patch


def means(values: Grid, patch: NDArray[np.int64]) -> Grid:
    """Mean over each patch, cells without a value left out."""
    used = (patch > 0) & np.isfinite(values)
    count = np.bincount(patch[used], minlength=int(patch.max()) + 1)[1:]
    total = np.bincount(patch[used], values[used], minlength=int(patch.max()) + 1)[1:]
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def scores(found: Grid, true: Grid) -> tuple[float, float, float]:
    """Squared correlation, R2 about the 1:1 line, median ratio."""
    known = np.isfinite(found) & np.isfinite(true)
    found, true = found[known], true[known]
    about = 1 - float(((found - true) ** 2).sum() / ((true - true.mean()) ** 2).sum())
    return float(np.corrcoef(found, true)[0, 1] ** 2), about, float(np.median(found / true))
