"""Why AES and voxels change places near roofs and on the ground.

Run ``python -m benchmarks.airborne.published.tables order``.

[W17] Tables 5-1 and 5-2 put AES before voxels of 3 m x 3 m x 0.3 m; on the twin it is the other way
round. The twin is simulated again with fewer afterpulses and with more background, and what each
filter leaves is told apart: RMSE of all that is kept within half a metre of the surface, and of the
true returns among it; share of the noise near roofs that goes, of either kind, and how much of it
there is. The source counts 1795 noise returns near eight roofs of about 200 m2 each.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.airborne.filter import methods
from benchmarks.airborne.filter.methods import AFTERPULSE, BACKGROUND, Columns
from benchmarks.airborne.published.table_surfaces import (
    BENEATH_M,
    CLEAR_M,
    SQUARE_M,
    Patch,
    lawns_and_groves,
    near_rmse,
    noise_removed,
    patch_above,
    reference_points,
    roof_regions,
)
from benchmarks.airborne.published.twins import canopy
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.constants import CLASS_BUILDING, CLASS_GROUND

FILTERS = ("aes", "voxel")

NOISE = {"all": (BACKGROUND, AFTERPULSE), "backgr.": (BACKGROUND,), "afterp.": (AFTERPULSE,)}
"""Kinds of noise that are counted together."""


class Variant(NamedTuple):
    """A twin with other noise.

    Parameters
    ----------
    afterpulses : float or None
        For each detection; None as the sensor's preset has it.
    background : float or None
        [1/m3]; None as the link budget has it.
    """

    afterpulses: float | None
    background: float | None


VARIANTS = (
    Variant(None, None),
    Variant(0.04, None),
    Variant(0.0, None),
    Variant(None, 0.12),
    Variant(0.04, 0.12),
    Variant(0.0, 0.12),
)


def order_table(folder: Path, seeds: Sequence[int]) -> dict[tuple[Variant, str], dict[str, float]]:
    """Print the table, means over regions and seeds; figures by variant and filter."""
    known = methods.known_methods()
    names = (
        "roofs",
        "true",
        "ground",
        "true",
        *(f"{n} %" for n in NOISE),
        "of backgr.",
        "per roof",
    )
    print(
        "\nAES and voxels by noise: RMSE [m], and of true returns alone; noise near roofs removed"
    )
    print("[%]; share of it that is background [%]; noise returns per roof")
    print(f"{'afterpulses, background /m3':34s}" + "".join(f"{n:>11s}" for n in names))
    found = {}
    for variant in VARIANTS:
        rows: dict[str, list[dict[str, float]]] = {key: [] for key in FILTERS}
        for seed in seeds:
            survey = methods.make_survey(scene(seed, variant), folder / _name(variant, seed))
            points = methods.load_truth(survey)
            roofs, ground = regions(survey, points)
            for key in FILTERS:
                kept = methods.judge(survey, known[key]) == 0
                rows[key].append(_figures(points, roofs, ground, kept))
        for key in FILTERS:
            mean = {n: float(np.mean([row[n] for row in rows[key]])) for n in rows[key][0]}
            found[variant, key] = mean
            print(f"{_title(variant):24s}{key:10s}" + _cells(mean), flush=True)
    return found


def scene(seed: int, variant: Variant) -> Scene:
    """The twin of [W17] 5.3 with other noise."""
    content = canopy(seed).model_dump(mode="json", by_alias=True)
    if variant.afterpulses is not None:
        content["sensor_overrides"]["afterpulse_probability"] = variant.afterpulses
    if variant.background is not None:
        content["sky"]["background_per_m3"] = variant.background
    return parse_scene(content, content["name"])


def regions(survey: Path, points: Columns) -> tuple[list[Patch], list[Patch]]:
    """Returns above roofs and above lawns."""
    reference = reference_points(survey)
    lawns, _ = lawns_and_groves(survey)
    roofs = [
        patch_above(points, reference, r, CLASS_BUILDING) for r in roof_regions(survey, SQUARE_M**2)
    ]
    return roofs, [patch_above(points, reference, r, CLASS_GROUND) for r in lawns]


def _figures(
    points: Columns, roofs: Sequence[Patch], ground: Sequence[Patch], kept: NDArray[np.bool_]
) -> dict[str, float]:
    true = kept & ~np.isin(points["kind"], NOISE["all"])
    near = {
        name: sum(
            int((np.isin(points["kind"][rows], kinds) & (np.abs(above) >= CLEAR_M)
                 & (np.abs(above) <= BENEATH_M)).sum())
            for rows, above in roofs
        )
        for name, kinds in NOISE.items()
    }  # fmt: skip
    return {
        "roofs": float(np.mean([near_rmse(p, kept) for p in roofs])),
        "roofs, true": float(np.mean([near_rmse(p, true) for p in roofs])),
        "ground": float(np.mean([near_rmse(p, kept) for p in ground])),
        "ground, true": float(np.mean([near_rmse(p, true) for p in ground])),
        **{f"{n} %": noise_removed(roofs, points, kept, kinds) for n, kinds in NOISE.items()},
        "of backgr. %": 100.0 * near["backgr."] / max(near["all"], 1),
        "per roof": near["all"] / len(roofs),
    }


def _cells(figures: Mapping[str, float]) -> str:
    return "".join(f"{v:11.{1 if '%' in n or 'per' in n else 4}f}" for n, v in figures.items())


def _title(variant: Variant) -> str:
    return ", ".join("as it is" if part is None else f"{part:g}" for part in variant)


def _name(variant: Variant, seed: int) -> str:
    if variant == Variant(None, None):
        return f"canopy_{seed}"
    return f"canopy_{_title(variant).replace(', ', '_').replace(' ', '')}_{seed}"
