"""[W17] Tables 5-1, 5-2 and 7-1 on simulated twins.

Table 5-1, RMSE of the filtered returns against linear-mode lidar on roofs, bare ground and tree
tops, five regions each of about 200 m2. The source does not say which returns it compares. Here
roofs and ground take those within half a metre of the reference surface, as what lies farther off
would rule the figure alone (the second table counts it); tree tops compare the highest returns of
1 m cells. Table 5-2, share of the noise near roofs that is removed. Table 7-1, noise in the 5 m
beneath 20 roofs that is removed.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import rasterio
import shapely
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from shapely.affinity import scale

from benchmarks.airborne.published import methods
from benchmarks.airborne.published.methods import (
    AFTERPULSE,
    AS_W17,
    BACKGROUND,
    BY_PLANE,
    LEFT_IN,
    NO_RULE,
    OWN_FILTER,
    PUBLISHED_PLANE,
    ROOF,
    W17_FILTER,
    Columns,
    Method,
    is_noise,
)
from benchmarks.airborne.published.twins import SHAPES, canopy, houston
from spl_batch.airborne.compare.comparison import PUBLISHED_NOISE
from spl_batch.constants import CLASS_BUILDING, CLASS_GROUND, QUANTUM_M
from spl_batch.formats.las.reader import iter_points

Patch = tuple[NDArray[np.int64], NDArray[np.float64]]
"""Rows of the returns above a region, and their heights over the reference surface [m]."""

RMSE_M: Mapping[str, Mapping[str, float]] = {
    "roofs": {"aes": 0.09, "voxel": 0.11},
    "ground": {"aes": 0.12, "voxel": 0.14},
    "canopy": {"aes": 2.07, "voxel": 2.55},
}
"""Means of [W17] Table 5-1 [m]."""

REMOVED = {"aes": 81.7, "voxel": 41.9}
"""Noise near eight roofs removed, [W17] Table 5-2: 1467 and 753 of 1795 [%]."""

ROOFS_REMOVED = 90.6
"""Noise beneath 20 roofs removed, [W17] Table 7-1: 8754 of 9662 [%]."""

NEAR_M = 0.5
"""Returns farther from the reference surface are left out of the RMSE [m]."""

CLEAR_M, BENEATH_M = 0.3, 5.0
"""Noise this far from a roof can be told from it by eye; down to this far it is counted [m]."""

ROOF_M2 = 75.0
"""Region on a roof in [W17] Table 7-1 [m2]."""

TOP_M = 10.0
"""Returns this far above the reference's highest are no tree tops but noise by eye [m]."""

SQUARE_M = 14
"""Side of a region on the ground or in trees [m], [W17] 5.4: about 200 m2."""

REGIONS = 5


def surface_tables(folder: Path, seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """Print Tables 5-1 and 5-2, means over regions and seeds; figures by method."""
    known = {k: m for k, m in methods.known_methods().items() if not m.alone}
    figures: dict[str, dict[str, list[float]]] = {key: {} for key in known}
    for seed in seeds:
        survey = methods.make_survey(canopy(seed), folder / f"canopy_{seed}")
        points, reference = methods.load_truth(survey), reference_points(survey)
        roofs = [
            patch_above(points, reference, r, CLASS_BUILDING)
            for r in roof_regions(survey, SQUARE_M**2)
        ]
        lawns, groves = lawns_and_groves(survey)
        ground = [patch_above(points, reference, r, CLASS_GROUND) for r in lawns]
        for key, method in known.items():
            kept = methods.judge(survey, method) == 0
            tops = [_top_rmse(points, reference, r, kept) for r in groves]
            values = {
                "roofs": [near_rmse(p, kept) for p in roofs],
                "ground": [near_rmse(p, kept) for p in ground],
                "canopy": [rmse for rmse, _ in tops],
                "spikes %": [share for _, share in tops],
                "removed %": [noise_removed(roofs, points, kept, (BACKGROUND, AFTERPULSE))],
                "backgr. %": [noise_removed(roofs, points, kept, (BACKGROUND,))],
                "afterp. %": [noise_removed(roofs, points, kept, (AFTERPULSE,))],
            }
            for name, found in values.items():
                figures[key].setdefault(name, []).extend(found)
    means = {key: {n: float(np.mean(v)) for n, v in f.items()} for key, f in figures.items()}
    _print_surfaces(means, known)
    return means


def _print_surfaces(means: Mapping[str, Mapping[str, float]], known: Mapping[str, Method]) -> None:
    print(
        "\n[W17] Tables 5-1 and 5-2: RMSE to linear-mode lidar [m], cells of tree tops with noise"
    )
    print(f"more than {TOP_M:g} m above them, noise {CLEAR_M}-{BENEATH_M:g} m from roofs removed:")
    print("all, background, afterpulses")
    names = (*RMSE_M, "spikes %", "removed %", "backgr. %", "afterp. %")
    print(f"{'':24s}" + "".join(f"{n:>10s}{'[W17]':>8s}" for n in names))
    for key, values in means.items():
        said = {name: RMSE_M[name].get(key) for name in RMSE_M} | {"removed %": REMOVED.get(key)}
        cells = [
            f"{values[n]:10.{1 if '%' in n else 3}f}{'-' if said.get(n) is None else said[n]:>8}"
            for n in names
        ]
        print(f"{known[key].label:24s}" + "".join(cells))


def roof_table(folder: Path, seeds: Sequence[int]) -> dict[str, float]:
    """Print Table 7-1 for 20 roofs of each seed; noise removed by variant [%]."""
    variants = roof_methods()
    counts: dict[str, list[NDArray[np.int64]]] = {name: [] for name in variants}
    for seed in seeds:
        survey = methods.make_survey(houston(seed), folder / f"houston_{seed}")
        points, reference = methods.load_truth(survey), reference_points(survey)
        roofs = [
            patch_above(points, reference, r, CLASS_BUILDING) for r in roof_regions(survey, ROOF_M2)
        ]
        for name, method in variants.items():
            kept = methods.judge(survey, method) == 0
            counts[name] += [_beneath(patch, points, kept) for patch in roofs]
    removed = {}
    names = ("removed", "[W17]", "least", "most", "noise", "afterp.", "roof lost", *SHAPES)
    print("\n[W17] Table 7-1: noise 0.3-5 m beneath roofs removed [%]; least and most of a roof;")
    print("noise counted there; true afterpulses of roofs removed at any lag; roof returns lost;")
    print("noise removed by shape of roof")
    print(f"{'':28s}" + "".join(f"{n:>10s}" for n in names))
    for name, rows in counts.items():
        table = np.array(rows)
        gone, noise, echo_gone, echo, lost, roof = table.sum(axis=0)
        each = 100.0 * table[:, 0] / np.maximum(table[:, 1], 1)
        removed[name] = 100.0 * gone / max(noise, 1)
        shape = np.arange(len(table)) % len(roofs) % len(SHAPES)
        sums = np.array([table[shape == k].sum(axis=0) for k in range(len(SHAPES))])
        shares = 100.0 * sums[:, 0] / np.maximum(sums[:, 1], 1)
        said = ROOFS_REMOVED if name == "published plane, VSAES" else np.nan
        print(
            f"{name:28s}{removed[name]:10.1f}"
            + (f"{said:10.1f}" if np.isfinite(said) else f"{'-':>10s}")
            + f"{each.min():10.1f}{each.max():10.1f}{noise:10d}"
            f"{100.0 * echo_gone / max(echo, 1):10.1f}{100.0 * lost / max(roof, 1):10.2f}"
            + "".join(f"{share:10.1f}" for share in shares)
        )
    return removed


def roof_methods() -> dict[str, Method]:
    """Rows of Table 7-1, and what each claims to be."""
    ours = methods.known_methods()["ours"]
    return {
        "VSAES alone": Method("", W17_FILTER, PUBLISHED_NOISE, claims=AS_W17 | NO_RULE),
        "published plane, VSAES": Method("", W17_FILTER, PUBLISHED_PLANE, claims=AS_W17 | BY_PLANE),
        "ours, no afterpulse stage": replace(ours, shots=LEFT_IN, claims=OWN_FILTER | NO_RULE),
        "ours": ours,
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
    """Counts of one roof: noise beneath removed, all; its afterpulses removed, all; lost, all."""
    rows, above = patch
    kind = points["kind"][rows]
    beneath = (above <= -CLEAR_M) & (above >= -BENEATH_M)
    groups = (
        beneath & is_noise(kind),
        (kind == AFTERPULSE) & (points["parent"][rows] == ROOF),
        kind == ROOF,
    )
    return np.array([v for g in groups for v in ((g & ~kept[rows]).sum(), g.sum())])


def lawns_and_groves(survey: Path) -> tuple[list[shapely.Polygon], list[shapely.Polygon]]:
    """The barest and the most wooded squares, five each, apart from roofs and each other."""
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
            square = shapely.box(west, north - SQUARE_M, west + SQUARE_M, north)
            if not square.intersects(roofs):
                window = height[row : row + SQUARE_M, column : column + SQUARE_M]
                tall[square] = float((window > NEAR_M).mean())
    ordered = sorted(tall, key=lambda square: tall[square])
    return ordered[:REGIONS], ordered[-REGIONS:]


def _top_rmse(
    points: Columns, reference: Columns, region: shapely.Polygon, kept: NDArray[np.bool_]
) -> tuple[float, float]:
    """RMSE of the highest returns of 1 m cells [m], and cells with a spike above them [%]."""
    theirs = {a: reference[a][_within(reference, region)] for a in "xyz"}
    said = _tops(theirs, region)
    rows = np.flatnonzero(_within(points, region) & kept)
    spike = points["z"][rows] > theirs["z"].max() + TOP_M
    ours = _tops({a: points[a][rows[~spike]] for a in "xyz"}, region)
    above = _tops({a: points[a][rows[spike]] for a in "xyz"}, region)
    both = np.isfinite(ours) & np.isfinite(said)
    rmse = float(np.sqrt(np.mean((ours[both] - said[both]) ** 2)))
    return rmse, 100.0 * float(np.isfinite(above).mean())


def _tops(points: Columns, region: shapely.Polygon) -> NDArray[np.float64]:
    west, south, _, _ = region.bounds
    top = np.full((SQUARE_M, SQUARE_M), -np.inf)
    cell = [np.minimum((points[a] - o).astype(int), SQUARE_M - 1)
            for a, o in (("x", west), ("y", south))]  # fmt: skip
    np.maximum.at(top, (cell[1], cell[0]), points["z"])
    return top
