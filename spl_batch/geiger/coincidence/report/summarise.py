"""Stage ``report``: what all receipts have together, as a page with its pictures."""

from collections.abc import Iterable, Mapping

import numpy as np

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.report import number_format as text
from spl_batch.engine.report import run_record, style
from spl_batch.engine.report.maps import Raster, draw_ramp, draw_relief, reduce_raster, spread
from spl_batch.engine.report.page import Front, render_page, write_both
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.run_record import Receipts, RunFacts
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


def _slice(made: Mapping[str, int], context: CoincidenceContext) -> Picture:
    """A slice of the tile with most points."""
    tile = max(sorted(made), key=lambda name: made[name])
    arrays = read_arrays(context.store.path("maps", f"{tile}.npz"))
    height = arrays["slice_points"][:, 1]
    with style.type_context():
        figure = style.figure(style.WIDTH_IN, 4.8)
        both = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, name in zip(both, ("detections", "points"), strict=True):
            axes.plot(*arrays[f"slice_{name}"].T, ".", ms=2.5, mew=0, color=style.SIGNAL)
            axes.set(title=name.title(), ylabel="height [m]")
            axes.spines[["top", "right"]].set_visible(False)
        axes.set(xlabel="distance along the slice [m]")
        axes.set_ylim(height.min() - 2.0, height.max() + 2.0)
    caption = "A slice of the fullest tile: detections above, points below."
    return style.picture(figure, "A slice, before and after", caption)


def render(report: CoincidenceReport, shown: Mapping[str, Picture]) -> str:
    """The page as HTML."""
    scene = report.scene
    front = Front(
        scene.name,
        "Geiger-mode lidar, coincidence processing",
        tuple(filter(None, (scene.crs, f"voxels of {text.centimetres(scene.voxel_m)}"))),
        (("points", "Points"),),
        tuple(verdicts(report)),
        cards(report),
    )
    return render_page(
        "page_coincidence.html.j2", report, front, package=__package__, pictures=shown
    )


def cards(report: CoincidenceReport) -> tuple[tuple[str, str, str], ...]:
    """Label, value and remark of each key number."""
    counts = report.counts
    share = f"{text.percent(counts.detections / counts.looks)} of the looks" if counts.looks else ""
    return (
        ("Looks", text.large(counts.looks), f"{text.number(counts.frames)} frames"),
        ("Detections", text.large(counts.detections), share),
        ("Points", text.large(counts.points), f"{text.number(counts.tiles)} tiles"),
    )


def verdicts(report: CoincidenceReport) -> list[Verdict]:
    """Sentences that state whether the result can be used."""
    counts, found = report.counts, failure_verdict(report.failures, report.findings)
    if not counts.points:
        none = "No points: nowhere do enough detections coincide for the threshold."
        return [Verdict("bad", none), found]
    detections, points = text.number(counts.detections), text.number(counts.points)
    made = Verdict("good", f"{detections} detections became {points} points.")
    return [found, made] if found.tone == "bad" else [made, found]


def summarise(done: Receipts, context: CoincidenceContext, facts: RunFacts) -> CoincidenceReport:
    """Write ``report.json`` and ``report.html``."""
    workflow = context.workflow
    tiles = {t: r.facts for t, r in done.get("coincide_tile", {}).items() if r.facts["points"]}
    frames, detections = (
        {r.facts["name"]: r.facts for r in done.get(step, {}).values()}
        for step in ("index_frames", "index_file")
    )
    pulses = sum(f["frames"] for f in frames.values())
    kinds = np.sum([np.zeros(4, int), *(f["kinds"] for f in tiles.values())], axis=0).tolist()
    counts = Counts(
        frames=pulses,
        looks=pulses * workflow.array.detectors,
        detections=sum(f["points"] for f in detections.values()),
        tiles=len(tiles),
        points=sum(kinds),
        **dict(zip(("surface", "ridge", "peak"), kinds[1:], strict=True)),
    )
    inputs = [run_record.indexed_file(f, "frames", f["frames"]) for f in frames.values()]
    inputs += [run_record.indexed_file(f, "detections", f["points"]) for f in detections.values()]
    weight = [f["points"] for f in tiles.values()]
    shares = [f["intensity"] for f in tiles.values()]
    spread = np.average(shares, axis=0, weights=weight).tolist() if tiles else ()
    report = CoincidenceReport(
        scene=Scene(
            name=workflow.survey.name,
            crs=context.crs.name if context.crs is not None else None,
            method=workflow.coincidence.method,
            voxel_m=workflow.voxel_q / QUANTA_PER_M,
            tile_m=workflow.tiling.tile_m,
        ),
        counts=counts,
        intensity=Intensity(**dict(zip(("p05", "median", "p95"), spread, strict=False))),
        **run_record.common_parts(context, facts, counts.detections, inputs),
    )
    none = "There are no points to show."
    shown = {name: Picture(name.title(), none) for name in ("slice", "height", "intensity")}
    if tiles:
        shown["slice"] = _slice({tile: f["points"] for tile, f in tiles.items()}, context)
        for name, draw in (("height", _height), ("intensity", _intensity)):
            shown[name] = draw(_map(tiles, context, name))
    write_both(context.output, report, render(report, shown))
    return report


def _map(tiles: Iterable[str], context: CoincidenceContext, name: str) -> Raster:
    """Maps of all tiles side by side, north first."""
    cells = {tile: parse_cell(tile) for tile in tiles}
    west, east = min(c.i for c in cells.values()), max(c.i for c in cells.values()) + 1
    south, north = min(c.j for c in cells.values()), max(c.j for c in cells.values()) + 1
    # One cell of several where a side would have more than a picture's 4000, in whole tiles.
    skip = max(1, -(-max(east - west, north - south) * MAP_CELLS // 4_000))
    size = len(range(0, MAP_CELLS, skip))
    values = np.full(((north - south) * size, (east - west) * size), np.nan, np.float32)
    for tile, cell in cells.items():
        arrays = read_arrays(context.store.path("maps", f"{tile}.npz"))
        row, column = (north - 1 - cell.j) * size, (cell.i - west) * size
        values[row : row + size, column : column + size] = arrays[name][::skip, ::skip]
    edge = context.workflow.tiling.tile_m
    return Raster(values, (west * edge, east * edge, south * edge, north * edge))
