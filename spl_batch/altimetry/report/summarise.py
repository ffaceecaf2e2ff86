"""Stage ``report``: what all receipts have together, as one report with its pictures."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.window import stands_out
from spl_batch.altimetry.report.model import Agreement, Beam, TrackCounts, TrackReport
from spl_batch.altimetry.report.page import render
from spl_batch.altimetry.report.pictures import MOST_PHOTONS, BeamPictures, draw
from spl_batch.altimetry.tasks.context import Context, place
from spl_batch.altimetry.tasks.labels import labelled, read_cells
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.page import write_both
from spl_batch.engine.report.parts import Statistics
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.reported import reported
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    common_parts,
    indexed_file,
    input_file,
    remember,
)
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.verified.parquet_npz import read_arrays, read_columns, read_groups, reading
from spl_batch.numerics.error_statistics import statistics


def beam_findings(done: Receipts) -> Iterator[Finding]:
    """Beams whose signal may be noise, or all of whose photons are one."""
    for key, delivered in done["deliver_beam"].items():
        source, _, name = key.partition("/")
        beam = f"{done['index_file'][source].facts['name']}: {name}"
        kept, noise = (delivered.facts["labels"].get(k, 0) for k in ("1", "0"))
        false = sum(done["label"][segment].facts["false"] for segment in labelled(done, key))
        for one in of_labels(kept, noise, false, delivered.facts["floor"]):
            yield one._replace(subject=beam)


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


MOST_BEAMS: Final = 12
"""Beams that are drawn [count]."""


def summarise(done: Receipts, context: Context, facts: RunFacts) -> TrackReport:
    """Write ``report.json`` and ``report.html``.

    Parameters
    ----------
    facts : RunFacts
        What the receipts do not say.
    """
    delivered = list(done["deliver_beam"].items())
    counts = _counts(done)
    inputs = [indexed_file(r.facts, "photons") for r in done["index_file"].values()]
    inputs += [input_file(Path(p), "reference") for p in facts.reference]
    parts = common_parts(context, facts, counts.points_in, inputs)
    found = [*beam_findings(done)]
    parts["findings"] = reported((*facts.findings, *found), context.workflow.report.ignore)
    ground = _overall(done, "ground", context)
    report = TrackReport(
        name=context.workflow.track.name,
        method=context.workflow.signal.method,
        counts=counts,
        ground=ground,
        ground_reference=_reference_key(context) if ground is not None else None,
        baseline_ground=_overall(done, "baseline_ground", context),
        beams=tuple(_beam(done, key, receipt, context) for key, receipt in delivered),
        **parts,
    )
    pictures = [_pictures(done, key, context) for key, _ in delivered[:MOST_BEAMS]]
    write_both(context.output, report, render(report, pictures))
    remember(done, context, facts)
    return report


def _reference_key(context: Context) -> Literal["points", "dtm", "labels"]:
    """What of the reference the heights are taken from."""
    reference = context.workflow.reference
    if reference is not None and reference.points is not None:
        return "points"
    return "dtm" if reference is not None and reference.dtm is not None else "labels"


def _counts(done: Receipts) -> TrackCounts:
    labels: dict[str, int] = {}
    for receipt in done["deliver_beam"].values():
        for label, count in receipt.facts["labels"].items():
            labels[label] = labels.get(label, 0) + count
    return TrackCounts(
        points_in=sum(r.points for r in done["take_in"].values()),
        points_out=sum(labels.values()),
        signal=labels.get("1", 0),
        background=labels.get("0", 0),
        not_assessed=labels.get("255", 0),
    )


def _beam(done: Receipts, key: str, delivered: Receipt, context: Context) -> Beam:
    source, _, name = key.partition("/")
    cells = _cells(done, key, context)
    density = _density(cells, context)
    photons, wet = (
        sum(done["label"][name].facts[kind] for name in labelled(done, key))
        for kind in ("photons", "wet")
    )
    profile = done["profile"][key].facts
    compared: Mapping[str, Any] = (
        done["compare"][key].facts if key in done.get("compare", {}) else {}
    )
    return Beam(
        file=done["index_file"][source].facts["name"],
        name=name,
        photons=delivered.facts["points"],
        signal=delivered.facts["labels"].get("1", 0),
        estimated=max(photons - float(cells["expected"].sum()), 0.0),
        false_signal=_false(cells, context),
        length_km=len(cells["index"]) * context.workflow.rate.cell_m / 1000,
        gate_m=float(np.median(cells["gate_m"])) if len(density) else None,
        noise_per_m2=_quantiles(density),
        water=wet / photons if photons else 0.0,
        surface=delivered.facts["surface"],
        floor=delivered.facts["floor"],
        ground_cells=profile["ground_cells"],
        canopy_cells=profile["canopy_cells"],
        cells=profile["cells"],
        ground=_statistics(compared.get("ground")),
        baseline_ground=_statistics(compared.get("baseline_ground")),
        labels={k: agreement(**v) for k, v in compared.get("labels", {}).items()},
    )


def _cells(done: Receipts, key: str, context: Context) -> dict[str, NDArray[Any]]:
    return read_cells(labelled(done, key), context)


def _density(cells: Mapping[str, NDArray[Any]], context: Context) -> NDArray[np.float64]:
    """Noise density of each cell, (c,) float64 [1/m2]."""
    density: NDArray[np.float64] = cells["expected"] / (
        cells["gate_m"] * context.workflow.rate.cell_m
    )
    return density


def _quantiles(density: NDArray[np.float64]) -> tuple[float, float, float] | None:
    if not len(density):
        return None
    low, middle, high = np.quantile(density, [0.05, 0.5, 0.95]).tolist()
    return low, middle, high


def _false(cells: Mapping[str, NDArray[Any]], context: Context) -> float | None:
    """Noise expected among the signal; the published filters estimate none."""
    if context.workflow.signal.method != "likelihood":
        return None
    return float(cells["false"].sum())


def _statistics(found: Mapping[str, Any] | None) -> Statistics | None:
    return Statistics(**found) if found and found["n"] else None


def _overall(done: Receipts, name: str, context: Context) -> Statistics | None:
    """Differences of all beams from the reference."""
    parts = [
        read_arrays(place(context, "compared", key, ".npz"))[name]
        for key, receipt in done.get("compare", {}).items()
        if receipt.facts[name]["n"]
    ]
    return Statistics(**statistics(np.concatenate(parts))) if parts else None


def agreement(both: int, only_here: int, only_there: int, neither: int) -> Agreement:
    """Precision, recall and F1 of signal, from counts of photons."""
    precision = both / (both + only_here) if both + only_here else None
    recall = both / (both + only_there) if both + only_there else None
    either = 2 * both + only_here + only_there
    return Agreement(
        photons=both + only_here + only_there + neither,
        precision=precision,
        recall=recall,
        f1=2 * both / either if either else None,
    )


def _pictures(done: Receipts, key: str, context: Context) -> Mapping[str, Picture]:
    cells = _cells(done, key, context)
    source, _, name = key.partition("/")
    names = ("along_track", "ground", "canopy_top", "water", "floor")
    profile = read_columns(place(context, "profiles", key, ".parquet"), names)
    wet = profile["water"] > 0
    ground, surface = (np.where(wet == of, profile["ground"], np.nan) for of in (False, True))
    compared = None
    if key in done.get("compare", {}) and done["compare"][key].facts["ground"]["n"]:
        arrays = read_arrays(place(context, "compared", key, ".npz"))
        compared = np.stack(
            [arrays["along_track"], arrays["ground"], arrays["baseline_ground"]], axis=1
        )
    at = (cells["index"] + 0.5) * context.workflow.rate.cell_m
    return draw(
        BeamPictures(
            f"{Path(done['index_file'][source].facts['name']).name} {name}",
            _thinned(done["deliver_beam"][key], context),
            np.column_stack(
                [profile["along_track"], ground, profile["canopy_top"], surface, profile["floor"]]
            ),
            np.stack([at, _density(cells, context)], axis=1),
            compared,
        )
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
