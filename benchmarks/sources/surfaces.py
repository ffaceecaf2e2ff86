"""[W17] Tables 5-1, 5-2, 6-4 and 7-1, Fig. 7-7 and 7-8 on simulated twins.

Table 5-1, RMSE of the filtered returns against linear-mode lidar on roofs, bare ground and tree
tops, five regions each of about 200 m2. The source does not state which returns it compares. Here
roofs and ground take those within half a metre of the reference surface, as what lies farther off
would rule the figure alone (the second table counts it); tree tops compare the highest returns of
1 m cells. Table 5-2, share of the noise near roofs that is removed. Table 7-1, noise in the 5 m
beneath 20 roofs that is removed.
"""

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rasterio
import shapely
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from shapely.affinity import scale

from benchmarks.sources import methods
from benchmarks.sources.given import Figures, Given
from benchmarks.sources.methods import (
    AFTERPULSE,
    AS_W17,
    BACKGROUND,
    BY_PLANE,
    PUBLISHED_PLANE,
    ROOF,
    W17_FILTER,
    Columns,
    Method,
    is_noise,
)
from benchmarks.sources.twins import SHAPES
from spl_batch.constants import CLASS_BUILDING, CLASS_GROUND, QUANTUM_M
from spl_batch.formats.las.reader import iter_points

Patch = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Rows of the returns above a region, and their heights over the reference surface [m]."""

NEAR_M = 0.5
"""Returns farther from the reference surface are left out of the RMSE [m]."""

CLEAR_M, BENEATH_M = 0.3, 5.0
"""Noise this far from a roof is distinct from it by eye; down to this far it is counted [m]."""

ROOF_M2 = 75.0
"""Region on a roof in [W17] Table 7-1 [m2]."""

TOP_M = 10.0
"""Returns this far above the reference's highest are no tree tops but noise by eye [m]."""

SQUARE_M = 14
"""Side of a region on the ground or in trees [m], [W17] 5.4: about 200 m2."""

REGIONS = 5


def measure(given: Given) -> Figures:
    """Tables 5-1, 5-2 and 6-4 on twins of HRQLS and SPL100.

    Keys are ``TWIN.METHOD.roofs``, ``.ground``, ``.canopy`` (RMSE [m]), ``.removed``,
    ``.background``, ``.afterpulses`` (noise near roofs [%]), and ``vsaes.METHOD``.
    """
    found: Figures = {}
    known = methods.known_methods()
    for name in given.some(("canopy matched", "canopy")):
        survey = given.survey(name)
        points, reference = methods.load_truth(survey), reference_points(survey)
        roofs = _roofs(survey, points, reference)
        lawns, groves = lawns_and_groves(survey)
        ground = [patch_above(points, reference, r, CLASS_GROUND) for r in lawns]
        for key in ("aes", "voxel", "ours"):
            kept = methods.judge(survey, known[key]) == 0
            values = {
                "roofs": _mean([near_rmse(p, kept) for p in roofs]),
                "ground": _mean([near_rmse(p, kept) for p in ground]),
                "canopy": _mean([_top_rmse(points, reference, r, kept) for r in groves]),
                "removed": noise_removed(roofs, points, kept, (BACKGROUND, AFTERPULSE)),
                "background": noise_removed(roofs, points, kept, (BACKGROUND,)),
                "afterpulses": noise_removed(roofs, points, kept, (AFTERPULSE,)),
            }
            found |= {f"{name}.{key}.{what}": value for what, value in values.items()}
    return found | dict(_by_both_tests(given))


def _mean(values: Sequence[float]) -> float:
    return float(np.nanmean(values))


def _roofs(survey: Path, points: Columns, reference: Columns) -> list[Patch]:
    """Regions of 200 m2 on the roofs of a survey."""
    regions = roof_regions(survey, SQUARE_M**2)
    return [patch_above(points, reference, region, CLASS_BUILDING) for region in regions]


def _by_both_tests(given: Given) -> Iterator[tuple[str, float]]:
    """Table 6-4: RMSE on five roofs of the true returns, and of what either test keeps [m]."""
    survey, known = given.survey("easton matched"), methods.known_methods()
    points, reference = methods.load_truth(survey), reference_points(survey)
    roofs = _roofs(survey, points, reference)
    yield "vsaes.manual", _mean([near_rmse(p, ~is_noise(points["kind"])) for p in roofs])
    for key in given.some(("aes_alone", "published", "ours")):
        kept = methods.judge(survey, known[key]) == 0
        yield f"vsaes.{key}", _mean([near_rmse(p, kept) for p in roofs])


def afterpulses(given: Given) -> Figures:
    """Table 7-1 and Fig. 7-7, 7-8 on a campus of 20 roofs.

    Keys are ``METHOD.removed``, ``.lost``, ``.SHAPE`` [%], ``shot.signal``, ``shot.afterpulses``
    (most common in a shot [count]) and ``r2``.
    """
    survey = given.survey("houston")
    points, reference = methods.load_truth(survey), reference_points(survey)
    regions = roof_regions(survey, ROOF_M2)
    roofs = [patch_above(points, reference, region, CLASS_BUILDING) for region in regions]
    found: Figures = {}
    for name, method in given.some(roof_methods().items()):
        kept = methods.judge(survey, method) == 0
        table = np.array([_beneath(patch, points, kept) for patch in roofs])
        found |= {f"{name}.removed": _percent(table[:, 0], table[:, 1])}
        found |= {f"{name}.lost": _percent(table[:, 2], table[:, 3])}
        for k, shape in enumerate(SHAPES):
            of = np.arange(len(table)) % len(SHAPES) == k
            found[f"{name}.{shape}"] = _percent(table[of, 0], table[of, 1])
    return found | _relations(survey, points, roofs)


def _percent(part: NDArray[np.int64], whole: NDArray[np.int64]) -> float:
    return 100.0 * float(part.sum()) / max(float(whole.sum()), 1.0)


def _relations(survey: Path, points: Columns, roofs: Sequence[Patch]) -> Figures:
    """Fig. 7-7, on what the differential cell count leaves, and Fig. 7-8.

    The brightness of a roof is its reflectance, which the intensity of the source's linear-mode
    lidar represents.
    """
    truth = json.loads((survey / "truth" / "scene.json").read_text(encoding="utf-8"))
    bright = np.array([b["reflectance"] for b in truth["buildings"]])
    kept = methods.judge(survey, methods.known_methods()["dcc"]) == 0
    _, shot = np.unique(
        np.stack([points["line"][kept], points["gps_time"][kept]]), axis=1, return_inverse=True
    )
    late = points["kind"][kept] == AFTERPULSE
    afterpulses, signal = (np.bincount(shot, weights=w) for w in (late, ~late))
    pairs, count = np.unique(np.stack([signal, afterpulses]), axis=1, return_counts=True)
    common = pairs[:, int(count.argmax())]
    beneath = np.array([_beneath(p, points, np.ones(len(points["x"]), np.bool_))[1] for p in roofs])
    return {
        "shot.signal": float(common[0]),
        "shot.afterpulses": float(common[1]),
        "r2": float(np.corrcoef(bright, beneath)[0, 1] ** 2),
    }


def roof_methods() -> dict[str, Method]:
    """Rows of Table 7-1, and what each claims to be."""
    return {
        "plane": Method("", W17_FILTER, PUBLISHED_PLANE, claims=AS_W17 | BY_PLANE),
        "ours": methods.known_methods()["ours"],
    }


def roof_regions(survey: Path, area_m2: float) -> list[shapely.Polygon]:
    """The middle of each roof of a simulated survey, this large or as the roof allows."""
    truth = json.loads((survey / "truth" / "scene.json").read_text(encoding="utf-8"))
    roofs = [shapely.Polygon(ring).buffer(-1.0) for ring in truth["building_outlines"]]
    factors = [min(1.0, math.sqrt(area_m2 / roof.area)) for roof in roofs]
    return [scale(roof, f, f) for roof, f in zip(roofs, factors, strict=True)]


def reference_points(survey: Path) -> Columns:
    """Returns of the linear-mode lidar: x, y, z [m], class."""
    tables = list(iter_points(survey / "reference_lml.laz", channel_dimension=None, source=0))
    columns = {a: np.concatenate([t[a] * QUANTUM_M for t in tables]) for a in "xyz"}
    return columns | {"class": np.concatenate([t["input_class"] for t in tables])}


def patch_above(
    points: Columns, reference: Columns, region: shapely.Polygon, class_code: int
) -> Patch:
    """Returns above a region, and their height over a TIN of the reference's returns of a class.

    The TIN is linear between returns: a gable's ridge is cut by less than their spacing.
    """
    near = region.buffer(1.0)
    rows = np.flatnonzero(_within(reference, near) & (reference["class"] == class_code))
    nodes = np.column_stack([reference["x"][rows], reference["y"][rows]])
    origin = nodes.mean(axis=0)
    surface = LinearNDInterpolator(nodes - origin, reference["z"][rows])
    at = np.flatnonzero(_within(points, region))
    xy = np.column_stack([points["x"][at], points["y"][at]]) - origin
    above = points["z"][at] - surface(xy)
    known = np.isfinite(above)
    return at[known], above[known]


def _within(points: Columns, region: shapely.Polygon) -> NDArray[np.bool_]:
    west, south, east, north = region.bounds
    x, y = points["x"], points["y"]
    out: NDArray[np.bool_] = (x >= west) & (x <= east) & (y >= south) & (y <= north)
    rows = np.flatnonzero(out)
    shapely.prepare(region)
    out[rows] = shapely.contains_xy(region, x[rows], y[rows])
    return out


def near_rmse(patch: Patch, kept: NDArray[np.bool_], near_m: float = NEAR_M) -> float:
    """RMSE of the kept returns this near to the surface [m]."""
    rows, above = patch
    used = above[kept[rows] & (np.abs(above) <= near_m)]
    return float(np.sqrt(np.mean(used**2)))


def noise_removed(
    roofs: Sequence[Patch], points: Columns, kept: NDArray[np.bool_], kinds: Sequence[int]
) -> float:
    """Share of the noise near roofs, of some kinds, that is not kept [%]."""
    gone = total = 0
    for rows, above in roofs:
        near = (np.abs(above) >= CLEAR_M) & (np.abs(above) <= BENEATH_M)
        noise = rows[near & np.isin(points["kind"][rows], kinds)]
        gone, total = gone + int((~kept[noise]).sum()), total + len(noise)
    return 100.0 * gone / max(total, 1)


def _beneath(patch: Patch, points: Columns, kept: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Counts of one roof: noise beneath removed, all; its own returns lost, all."""
    rows, above = patch
    kind = points["kind"][rows]
    beneath = (above <= -CLEAR_M) & (above >= -BENEATH_M)
    groups = (beneath & is_noise(kind), kind == ROOF)
    return np.array([v for g in groups for v in ((g & ~kept[rows]).sum(), g.sum())])


def lawns_and_groves(survey: Path) -> tuple[list[shapely.Polygon], list[shapely.Polygon]]:
    """The barest and the most wooded cells, five each, apart from roofs and each other."""
    with (
        rasterio.open(survey / "truth" / "dtm.tif") as low,
        rasterio.open(survey / "truth" / "dsm.tif") as top,
    ):
        height, at = top.read(1) - low.read(1), low.transform
    truth = json.loads((survey / "truth" / "scene.json").read_text(encoding="utf-8"))
    roofs = shapely.union_all([shapely.Polygon(ring) for ring in truth["building_outlines"]])
    tall = {}
    for row in range(0, height.shape[0] - SQUARE_M + 1, SQUARE_M):
        for column in range(0, height.shape[1] - SQUARE_M + 1, SQUARE_M):
            west, north = at.c + column, at.f - row
            cell = shapely.box(west, north - SQUARE_M, west + SQUARE_M, north)
            if not cell.intersects(roofs):
                window = height[row : row + SQUARE_M, column : column + SQUARE_M]
                tall[cell] = float((window > NEAR_M).mean())
    ordered = sorted(tall, key=lambda cell: tall[cell])
    return ordered[:REGIONS], ordered[-REGIONS:]


def _top_rmse(
    points: Columns, reference: Columns, region: shapely.Polygon, kept: NDArray[np.bool_]
) -> float:
    """RMSE of the highest returns of 1 m cells, spikes far above the reference left out [m]."""
    theirs = {a: reference[a][_within(reference, region)] for a in "xyz"}
    rows = np.flatnonzero(_within(points, region) & kept)
    rows = rows[points["z"][rows] <= theirs["z"].max() + TOP_M]
    off = _tops({a: points[a][rows] for a in "xyz"}, region) - _tops(theirs, region)
    return float(np.sqrt(np.mean(off[np.isfinite(off)] ** 2)))


def _tops(points: Columns, region: shapely.Polygon) -> NDArray[np.float64]:
    west, south, _, _ = region.bounds
    top = np.full((SQUARE_M, SQUARE_M), -np.inf)
    cell = [np.minimum((points[a] - o).astype(int), SQUARE_M - 1)
            for a, o in (("x", west), ("y", south))]  # fmt: skip
    np.maximum.at(top, (cell[1], cell[0]), points["z"])
    return top
