"""The experiment of [W17] 7.4 again: terrain with and without afterpulse removal.

Three chains: noise, plane rule and filter of [W17] with PTD; the same with our ground; and ours.
PTD starts from the lowest returns, as the source's does, and takes those far below the ground that
the published filter leaves. Lags reach 5 m, as deep as differences do in Fig. 7-6.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.sources import methods
from benchmarks.sources.given import Figures, Given
from benchmarks.sources.methods import (
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
from spl_batch import api
from spl_batch.airborne.accuracy.differences import terrain_differences
from spl_batch.airborne.accuracy.raster_and_reference import Raster, Reference
from spl_batch.constants import QUANTUM_M
from spl_batch.formats.las.reader import iter_points
from spl_batch.formats.rasters.parts import read_overview

Rules = Mapping[str, tuple[tuple[str, ...], dict[str, object]]]
"""Steps before the filter and what they claim, by whether afterpulses are removed."""

LOWEST = (
    "ground.method=ptd", "ground.ptd.layer_m=0.001", "ground.ptd.seed_cell_m=20",
    "ground.ptd.node_m=1",
)  # fmt: skip
"""PTD whose layers are the lowest return of a cell."""


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


def measure(given: Given) -> Figures:
    """Mean absolute difference of each chain on the twin with long lags, ``CHAIN, HOW`` [m]."""
    survey = given.survey("houston deep")
    return {
        name: float(np.abs(_differences(survey, method).astype(np.float64)).mean())
        for name, method in given.some([*terrain_methods().items()][::-1])
    }


def _differences(survey: Path, method: Method) -> NDArray[np.float32]:
    """DTM minus reference ground of one run [m]."""
    overrides = [*method.settings, *method.shots, "output=out_dtm"]
    methods.check(survey / "workflow.yaml", overrides, method.claims)
    overrides.append("reference=null")
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
