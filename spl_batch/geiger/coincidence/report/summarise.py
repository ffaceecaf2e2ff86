"""Stage ``report``: what all receipts have together, as a page with its pictures."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.report import number_format as text
from spl_batch.engine.report import style
from spl_batch.engine.report.maps import Raster, draw_ramp, draw_relief, reduce_raster, spread
from spl_batch.engine.report.page import Front, render_page, write_both
from spl_batch.engine.report.parts import InputFile
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    common_parts,
    indexed_file,
    remember,
)
from spl_batch.engine.report.verdict import Verdict, failure_verdict
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.coincidence.report.model import CoincidenceReport, Counts, Intensity, Scene
from spl_batch.geiger.coincidence.tasks import MAP_CELLS, CoincidenceContext
from spl_batch.lattice.tiles import parse_cell


def _height(raster: Raster) -> Picture:
    title = "Highest points"
    limits = spread(reduce_raster(raster).values, 0.5, 99.5)
    caption = "Lone spikes would be noise taken for a surface, grey is without points."
    return style.picture(draw_relief(raster, title, "height [m]", limits), title, caption)


def _intensity(raster: Raster) -> Picture:
    title, top = "Intensity", spread(reduce_raster(raster).values, 1, 99)[1]
    drawn = draw_ramp(raster, title, "detections per look", ramp=style.DENSITY, limits=(0.0, top))
    caption = (
        "Detections for each look through a voxel: paint shows, and so do edges, which looks share "
        "with what lies behind."
    )
    return style.picture(drawn, title, caption)


def _slice(done: Receipts, context: CoincidenceContext) -> Picture:
    """A slice of the tile with most points."""
    made = {t: r.facts["points"] for t, r in done.get("coincide", {}).items() if r.facts["points"]}
    if not made:
        return Picture("Slice", "There are no points to show.")
    tile = max(sorted(made), key=lambda name: made[name])
    arrays = read_arrays(context.store.path("maps", f"{tile}.npz"))
    height = arrays["slice_points"][:, 1]
    with style.type_context():
        figure = style.figure(style.WIDTH_IN, 4.8)
        upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, name in ((upper, "detections"), (lower, "points")):
            places = arrays[f"slice_{name}"]
            axes.plot(places[:, 0], places[:, 1], ".", ms=2.5, mew=0, color=style.SIGNAL)
            axes.set(title=name.title(), ylabel="height [m]")
            axes.spines[["top", "right"]].set_visible(False)
        lower.set_xlabel("distance along the slice [m]")
        lower.set_ylim(height.min() - 2.0, height.max() + 2.0)
    caption = "A slice of the fullest tile: detections above, points below."
    return style.picture(figure, "A slice, before and after", caption)


def render(report: CoincidenceReport, shown: Mapping[str, Picture]) -> str:
    """The page as HTML."""
    counts, scene = report.counts, report.scene
    front = Front(
        scene.name,
        "Geiger-mode lidar, coincidence processing",
        tuple(filter(None, (scene.crs, f"voxels of {text.centimetres(scene.voxel_m)}"))),
        (("points", "Points"),),
        tuple(verdicts(report)),
        (
            ("Looks", text.large(counts.looks), f"{text.number(counts.frames)} frames"),
            ("Detections", text.large(counts.detections), _share(counts.detections, counts.looks)),
            ("Points", text.large(counts.points), f"{text.number(counts.tiles)} tiles"),
        ),
    )
    return render_page(
        "page_coincidence.html.j2", report, front, package=__package__, pictures=shown
    )


def _share(part: int, whole: int) -> str:
    return f"{text.percent(part / whole)} of the looks" if whole else ""


def verdicts(report: CoincidenceReport) -> list[Verdict]:
    """Sentences that state whether the result can be used."""
    counts, found = report.counts, failure_verdict(report.failures, report.findings)
    if not counts.points:
        return [
            Verdict("bad", "No points: nowhere do enough detections coincide for the threshold."),
            found,
        ]
    made = (
        f"{text.number(counts.detections)} detections became {text.number(counts.points)} points."
    )
    return sorted([Verdict("good", made), found], key=lambda verdict: verdict.tone != "bad")


LARGEST_MAP: Final = 4_000
"""More cells along a side are thinned, whole tiles at a time [count]."""


def summarise(done: Receipts, context: CoincidenceContext, facts: RunFacts) -> CoincidenceReport:
    """Write ``report.json`` and ``report.html``."""
    counts = _counts(done, context)
    workflow = context.workflow
    report = CoincidenceReport(
        scene=Scene(
            name=workflow.survey.name,
            crs=context.crs.name if context.crs is not None else None,
            method=workflow.coincidence.method,
            voxel_m=workflow.voxel_q / QUANTA_PER_M,
            tile_m=workflow.tiling.tile_m,
        ),
        counts=counts,
        intensity=_spread(done),
        **common_parts(context, facts, counts.detections, list(_inputs(done))),
    )
    shown = {"slice": _slice(done, context)}
    for name, draw in (("height", _height), ("intensity", _intensity)):
        raster = _map(done, context, name)
        none = Picture(name.title(), "There are no points to show.")
        shown[name] = draw(raster) if raster is not None and raster.any_value else none
    write_both(context.output, report, render(report, shown))
    remember(done, context, facts)
    return report


def _counts(done: Receipts, context: CoincidenceContext) -> Counts:
    frames = sum(r.facts["frames"] for r in done.get("frames", {}).values())
    made = [r.facts for r in done.get("coincide", {}).values()]
    kinds = np.sum([f["kinds"] for f in made], axis=0).tolist() if made else [0] * 4
    return Counts(
        frames=frames,
        looks=frames * context.workflow.array.detectors,
        detections=sum(r.facts["points"] for r in done.get("index_file", {}).values()),
        tiles=sum(1 for facts in made if facts["points"]),
        points=sum(f["points"] for f in made),
        surface=kinds[1],
        ridge=kinds[2],
        peak=kinds[3],
    )


def _spread(done: Receipts) -> Intensity:
    made = [r.facts for r in done.get("coincide", {}).values() if r.facts["points"]]
    if not made:
        return Intensity()
    weight = [f["points"] for f in made]
    low, middle, high = np.average([f["intensity"] for f in made], axis=0, weights=weight)
    return Intensity(p05=low, median=middle, p95=high)


def _inputs(done: Receipts) -> Iterable[InputFile]:
    for kind, role in (("frames", "frames"), ("index_file", "detections")):
        for receipt in done.get(kind, {}).values():
            held = receipt.facts["frames" if kind == "frames" else "points"]
            yield indexed_file(receipt.facts, role, held)


def _map(done: Receipts, context: CoincidenceContext, name: str) -> Raster | None:
    """Maps of all tiles side by side, north first."""
    tiles = [parse_cell(tile) for tile, r in done.get("coincide", {}).items() if r.facts["points"]]
    if not tiles:
        return None
    west, east = min(t.i for t in tiles), max(t.i for t in tiles) + 1
    south, north = min(t.j for t in tiles), max(t.j for t in tiles) + 1
    # One cell of several where all would be too many for a picture.
    skip = max(1, -(-max(east - west, north - south) * MAP_CELLS // LARGEST_MAP))
    cells = len(range(0, MAP_CELLS, skip))
    values = np.full(((north - south) * cells, (east - west) * cells), np.nan, np.float32)
    for tile in tiles:
        arrays = read_arrays(context.store.path("maps", f"{tile}.npz"))
        part: NDArray[Any] = arrays[name][::skip, ::skip]
        row, column = (north - 1 - tile.j) * cells, (tile.i - west) * cells
        values[row : row + cells, column : column + cells] = part
    edge = context.workflow.tiling.tile_m
    return Raster(values, (west * edge, east * edge, south * edge, north * edge))
