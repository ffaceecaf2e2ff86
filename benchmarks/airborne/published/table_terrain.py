"""The experiment of [W17] 7.4 again: terrain with and without afterpulse removal.

Published: mean |difference| to linear-mode lidar 1.95 m without and 0.23 m with removal. Three
chains: noise, plane rule and filter of [W17] with PTD; the same with our ground; and ours. Our PTD
starts from the lowest returns, as the source's, but refuses pits and what lies under hard surfaces,
so afterpulses hardly move it. Two twins: the campus with the sensor's lags, 0.24 to 3 m, and with
lags up to 5 m, as deep as differences reach in Fig. 7-6.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.airborne.published import methods
from benchmarks.airborne.published.methods import (
    AS_W17,
    BY_BEAMLET,
    BY_PLANE,
    LEFT_IN,
    NO_RULE,
    OWN_FILTER,
    PUBLISHED_PLANE,
    W17_FILTER,
    Method,
)
from benchmarks.airborne.published.twins import houston, houston_deep
from spl_batch import api
from spl_batch.airborne.accuracy import Reference, terrain_differences
from spl_batch.airborne.accuracy.raster_and_reference import Raster
from spl_batch.constants import QUANTUM_M
from spl_batch.formats.las.reader import iter_points
from spl_batch.formats.rasters.parts import read_overview

Rules = Mapping[str, tuple[tuple[str, ...], dict[str, object]]]
"""Steps before the filter and what they claim, by whether afterpulses are removed."""

PUBLISHED_M = {"left in": 1.95, "removed": 0.23}
"""Mean absolute difference of [W17] 7.4, University of Houston campus, by removal [m]."""

PIT_M = 2.0
"""Differences beyond this are counted as pits and peaks [m]."""

LOWEST = (
    "ground.method=ptd", "ground.ptd.layer_m=0.001", "ground.ptd.seed_cell_m=20",
    "ground.ptd.node_m=1",
)  # fmt: skip
"""PTD whose layers are the lowest return of a cell."""

TWINS = {"houston": houston, "houston_deep": houston_deep}
"""The campus by the sensor's lags, and by longer ones."""


def terrain_methods() -> dict[str, Method]:
    """Rows of the table, and what each claims to be; labels end in a key of the published."""
    ours = methods.known_methods()["ours"].settings
    ptd: dict[str, object] = {"ground.method": "ptd"}
    scales: dict[str, object] = {"ground.method": "multiscale"}
    removed: Rules = {"left in": (LEFT_IN, NO_RULE), "removed": ((), BY_BEAMLET)}
    planes: Rules = {
        "left in": (("noise.correction=published", *LEFT_IN), NO_RULE),
        "removed": (PUBLISHED_PLANE, BY_PLANE),
    }
    chains: Mapping[str, tuple[tuple[str, ...], dict[str, object], Rules]] = {
        "published filters, PTD": ((*W17_FILTER, *LOWEST), AS_W17 | ptd, planes),
        "published filters, our ground": (W17_FILTER, AS_W17 | scales, planes),
        "ours": (ours, OWN_FILTER | scales, removed),
    }
    return {
        f"{name}, {how}": Method("", settings, shots, claims=claims | rule)
        for name, (settings, claims, rules) in chains.items()
        for how, (shots, rule) in rules.items()
    }


def terrain_table(folder: Path, seeds: Sequence[int]) -> dict[str, float]:
    """Run the chains on both twins of each seed and print the tables; mean |d| by row [m]."""
    means: dict[str, float] = {}
    for twin in TWINS:
        means |= _terrain_of(twin, folder, seeds)
    return means


def _terrain_of(twin: str, folder: Path, seeds: Sequence[int]) -> dict[str, float]:
    names = ("mean |d|", "[W17]", "mean d", "RMSE", "P95 |d|", "> 2 m %", "n")
    print(f"\n[W17] 7.4, {twin}: DTM minus linear-mode ground [m], afterpulses removed or not")
    print(f"{'':44s}" + "".join(f"{n:>10s}" for n in names))
    means = {}
    for label, method in terrain_methods().items():
        parts = [_differences(twin, folder, seed, method) for seed in seeds]
        d = np.concatenate(parts).astype(np.float64)
        size = float(np.abs(d).mean())
        means[f"{twin}: {label}"] = size
        rmse, p95 = float(np.sqrt(np.mean(d * d))), float(np.percentile(np.abs(d), 95))
        pits = 100.0 * float(np.mean(np.abs(d) > PIT_M))
        said = PUBLISHED_M[label.rpartition(", ")[2]]
        figures = (size, said, float(d.mean()), rmse, p95, pits)
        print(f"{label:44s}" + "".join(f"{v:10.3f}" for v in figures) + f"{len(d):10d}")
    return means


def _differences(twin: str, folder: Path, seed: int, method: Method) -> NDArray[np.float32]:
    """DTM minus reference ground of one run [m]."""
    survey = methods.make_survey(TWINS[twin](seed), folder / f"{twin}_{seed}")
    overrides = [*method.settings, *method.shots, "output=out_dtm"]
    methods.check(survey / "workflow.yaml", overrides, method.claims)
    result = api.run(survey / "workflow.yaml", overrides=overrides, until="deliver", workers=0)
    if result.exit_status:
        raise SystemExit(f"{survey}: the run failed; see out_dtm/log.jsonl")
    part = read_overview(survey / "out_dtm" / "dtm.tif", largest=10**9)
    raster = Raster(part.values, part.left_m, part.top_m, part.cell_m)
    return terrain_differences(raster, _reference(survey / "reference_lml.laz"))["all"]


def _reference(path: Path) -> Reference:
    tables = list(iter_points(path, channel_dimension=None, source=0))
    xyz = [np.column_stack([t[axis] * QUANTUM_M for axis in "xyz"]) for t in tables]
    return Reference(np.concatenate(xyz), np.concatenate([t["input_class"] for t in tables]))
