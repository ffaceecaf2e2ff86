"""Stage ``report``: what all receipts have together, as one report with its pictures."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.track import CELLS
from spl_batch.altimetry.filter.window import stands_out
from spl_batch.altimetry.photon_table import joined
from spl_batch.altimetry.report.model import Agreement, Beam, TrackCounts, TrackReport
from spl_batch.altimetry.report.page import render
from spl_batch.altimetry.report.pictures import MOST_PHOTONS, draw
from spl_batch.altimetry.tasks.context import Context
from spl_batch.altimetry.tasks.labels import segments_of
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.page import write_both
from spl_batch.engine.report.parts import Statistics
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    common_parts,
    indexed_file,
    input_file,
)
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.verified.parquet_npz import read_arrays, read_columns, read_groups, reading
from spl_batch.numerics.error_statistics import statistics

MOST_BEAMS: Final = 12
"""Beams that are drawn [count]."""


class _Finished(NamedTuple):
    """What is finished of a beam."""

    key: str
    file: str  #: Name of its file.
    name: str
    delivered: Receipt
    labelled: list[Mapping[str, Any]]  #: Facts of its segments.
    profile: Mapping[str, Any]  #: Facts of its profile.
    compared: Mapping[str, Any]  #: Facts of its comparison; empty without one.
    cells: Mapping[str, NDArray[Any]]
    density: NDArray[np.float64]  #: Noise density of each cell [1/m2].


def _finished(done: Receipts, context: Context) -> Iterator[_Finished]:
    """Beams that are delivered."""
    for key, delivered in done["deliver_beam"].items():
        source, _, name = key.partition("/")
        segments = [n for n, _, _ in segments_of(key, done["take_in"], done["label"])]
        compared = done.get("compare", {}).get(key)
        stored = (context.store.path("cells", f"{segment}.npz") for segment in segments)
        cells = joined([read_arrays(path) for path in stored], CELLS)
        yield _Finished(
            key,
            done["index_file"][source].facts["name"],
            name,
            delivered,
            [done["label"][segment].facts for segment in segments],
            done["profile"][key].facts,
            compared.facts if compared is not None else {},
            cells,
            cells["expected"] / (cells["gate_m"] * context.workflow.rate.cell_m),
        )


def summarise(done: Receipts, context: Context, facts: RunFacts) -> TrackReport:
    """Write ``report.json`` and ``report.html``; ``facts``: what the receipts do not have."""
    beams: list[Beam] = []
    pictures: list[Mapping[str, Picture]] = []
    found = list(facts.findings)
    for finished in _finished(done, context):
        beams.append(_beam(finished, context))
        kept, noise = (finished.delivered.facts["labels"].get(k, 0) for k in ("1", "0"))
        false = sum(segment["false"] for segment in finished.labelled)
        subject = f"{finished.file}: {finished.name}"
        warned = of_labels(kept, noise, false, beams[-1].floor)
        found += [one._replace(subject=subject) for one in warned]
        if len(pictures) < MOST_BEAMS:
            pictures.append(_pictures(finished, context))
    labels = {
        label: sum(r.facts["labels"].get(label, 0) for r in done["deliver_beam"].values())
        for label in ("0", "1", "255")
    }
    counts = TrackCounts(
        points_in=sum(r.points for r in done["take_in"].values()),
        points_out=sum(labels.values()),
        signal=labels["1"],
        background=labels["0"],
        not_assessed=labels["255"],
    )
    inputs = [indexed_file(r.facts, "photons") for r in done["index_file"].values()]
    inputs += [input_file(Path(p), "reference") for p in facts.reference]
    ground = _overall(done, "ground", context)
    report = TrackReport(
        name=context.workflow.track.name,
        method=context.workflow.signal.method,
        counts=counts,
        ground=ground,
        ground_reference=_reference_key(context) if ground is not None else None,
        baseline_ground=_overall(done, "baseline_ground", context),
        beams=tuple(beams),
        **common_parts(context, replace(facts, findings=tuple(found)), counts.points_in, inputs),
    )
    write_both(context.output, report, render(report, pictures))
    return report


def of_labels(kept: int, noise: int, false: float, floor: int = 0) -> Iterator[Finding]:
    """What photons kept, called noise, expected to be noise among the kept, and of a floor show."""
    if kept and not noise:
        yield Finding("P02", {"kind": "all", "kept": kept})
    if noise and not kept:
        yield Finding("P02", {"kind": "none", "noise": noise})
    if kept and false and not stands_out(kept, false):
        yield Finding("P02", {"kind": "clumps", "kept": kept, "noise": round(false)})
    elif 0 < floor <= false:
        yield Finding("P02", {"kind": "floor", "floor": floor, "noise": round(false)})


def _reference_key(context: Context) -> Literal["points", "dtm", "labels"]:
    """What of the reference the heights are taken from."""
    reference = context.workflow.reference
    if reference is None or (reference.points is None and reference.dtm is None):
        return "labels"
    return "dtm" if reference.points is None else "points"


def _beam(finished: _Finished, context: Context) -> Beam:
    photons, wet = (sum(facts[kind] for facts in finished.labelled) for kind in ("photons", "wet"))
    cells, density, delivered = finished.cells, finished.density, finished.delivered.facts
    ground, baseline = (
        Statistics(**found) if found and found["n"] else None
        for found in map(finished.compared.get, ("ground", "baseline_ground"))
    )
    # The published filters estimate no noise among what they keep.
    ours = context.workflow.signal.method == "likelihood"
    return Beam(
        file=finished.file,
        name=finished.name,
        photons=delivered["points"],
        signal=delivered["labels"].get("1", 0),
        estimated=max(photons - float(cells["expected"].sum()), 0.0),
        false_signal=float(cells["false"].sum()) if ours else None,
        length_km=len(cells["index"]) * context.workflow.rate.cell_m / 1000,
        gate_m=np.median(cells["gate_m"]) if len(density) else None,
        noise_per_m2=tuple(np.quantile(density, [0.05, 0.5, 0.95])) if len(density) else None,
        water=wet / photons if photons else 0.0,
        surface=delivered["surface"],
        floor=delivered["floor"],
        ground_cells=finished.profile["ground_cells"],
        canopy_cells=finished.profile["canopy_cells"],
        cells=finished.profile["cells"],
        ground=ground,
        baseline_ground=baseline,
        labels={k: agreement(**v) for k, v in finished.compared.get("labels", {}).items()},
    )


def _overall(done: Receipts, name: str, context: Context) -> Statistics | None:
    """Differences of all beams from the reference."""
    parts = [
        read_arrays(context.store.path("compared", f"{key}.npz"))[name]
        for key, receipt in done.get("compare", {}).items()
        if receipt.facts[name]["n"]
    ]
    return Statistics(**statistics(np.concatenate(parts))) if parts else None


def agreement(both: int, only_here: int, only_there: int, neither: int) -> Agreement:
    """Precision, recall and F1 of signal, from counts of photons."""
    here, there = both + only_here, both + only_there
    return Agreement(
        photons=here + only_there + neither,
        precision=both / here if here else None,
        recall=both / there if there else None,
        f1=2 * both / (here + there) if here + there else None,
    )


def _pictures(finished: _Finished, context: Context) -> Mapping[str, Picture]:
    names = ("along_track", "ground", "canopy_top", "water", "floor")
    profile = read_columns(context.store.table("profiles", finished.key), names)
    wet = profile["water"] > 0
    ground, surface = (np.where(wet == of, profile["ground"], np.nan) for of in (False, True))
    lines = (profile["along_track"], ground, profile["canopy_top"], surface, profile["floor"])
    differences = None
    if finished.compared.get("ground", {}).get("n"):
        arrays = read_arrays(context.store.path("compared", f"{finished.key}.npz"))
        columns = ("along_track", "ground", "baseline_ground")
        differences = np.column_stack([arrays[name] for name in columns])
    at = (finished.cells["index"] + 0.5) * context.workflow.rate.cell_m
    return draw(
        f"{Path(finished.file).name} {finished.name}",
        _thinned(finished.delivered, context),
        np.column_stack(lines),
        np.column_stack([at, finished.density]),
        differences,
    )


def _thinned(receipt: Receipt, context: Context) -> NDArray[np.float64]:
    """Evenly chosen photons with their labels and parts of the water, (n, 4) float64."""
    (delivered,) = (name for name in receipt.outputs if name.startswith("photons/"))
    step = max(-(-receipt.points // MOST_PHOTONS), 1)
    parts, first = [np.empty((0, 4))], 0
    with reading(context.output / delivered) as file:
        for group in range(file.num_row_groups):
            rows = read_groups(file, ("along_track", "height", "signal", "water"), [group])
            part = np.column_stack([*rows.values()]).astype(np.float64)
            parts.append(part[-first % step :: step])
            first += len(part)
    photons = np.concatenate(parts)
    return photons[np.isfinite(photons[:, 0])]
