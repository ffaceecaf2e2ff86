"""The chain as a list of phases; each turns what is finished into the next tasks.

A phase looks only at receipts of the phases before it. What failed there is left out:
its points stay unlabelled, the rest goes on.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from spl_batch.model import Task
from spl_batch.plan.flightlines import Flightline
from spl_batch.plan.inputs import Source
from spl_batch.plan.space import Unit, fired_parts, owners, units, voxel_parts
from spl_batch.plan.survey import Survey, mosaic_parts
from spl_batch.stages.local_noise import MARGIN_VOXELS
from spl_batch.stages.reflectance import reach_m as fired_reach_m
from spl_batch.stages.surface import reach_m as surface_reach_m
from spl_batch.tiling import CellId, grow, quanta

RANGE_POINTS = 2_000_000
"""Points of a piece of a file without times [count]."""

PRODUCTS = ("dtm", "dsm", "chm", "density", "intensity")
"""Rasters that are delivered."""

MEANINGS = ("mean LAS intensity of first returns", "reflectance from detections")
"""What the intensity raster holds, as its band is called."""


@dataclass(frozen=True, slots=True)
class Phase:
    """Tasks of one kind, made when everything before them is finished."""

    kind: str
    tasks: Callable[[Survey], Iterator[Task]]


def _index(survey: Survey) -> Iterator[Task]:
    for source in survey.inputs.sources:
        args = {**_source_args(source), "name": source.name, "stamp": _stamp(source)}
        yield Task("index_file", str(source.key), args, (), source.facts.n_points)


def _trajectory(survey: Survey) -> Iterator[Task]:
    lines = survey.flightlines
    if not survey.inputs.trajectory or not lines:
        return
    facts = [r.facts for r in survey.of("index_file").values() if r.facts["bounds"]]
    low = [min(f["bounds"][a] for f in facts) / 1000 for a in range(3)]
    high = [max(f["bounds"][a + 3] for f in facts) / 1000 for a in range(3)]
    args = {
        "paths": [str(p) for p in survey.inputs.trajectory],
        "stamps": [[p.stat().st_size, p.stat().st_mtime_ns] for p in survey.inputs.trajectory],
        "time_span_s": [min(x.first_s for x in lines), max(x.last_s for x in lines)],
        "bounds_m": [*low, *high],
    }
    yield Task("trajectory", "all", args)


def _heading(survey: Survey) -> Iterator[Task]:
    if survey.inputs.trajectory:
        return
    for line in survey.flightlines:
        args = {
            "psid": line.psid,
            "sources": list(line.sources),
            "seconds": [int(line.first_s // 1), int(line.last_s // 1)],
        }
        yield Task("heading", line.name, args, tuple(("index_file", k) for k in line.sources))


def _sort(survey: Survey) -> Iterator[Task]:
    timed = {key for line in survey.flightlines for key in line.sources}
    for source in survey.inputs.sources:
        receipt = survey.of("index_file").get(str(source.key))
        if receipt and str(source.key) in timed and not receipt.facts["in_order"]:
            needs = (("index_file", str(source.key)),)
            yield Task("sort_file", str(source.key), _source_args(source), needs, receipt.points)


def _gather(survey: Survey) -> Iterator[Task]:
    by_key = {str(s.key): s for s in survey.inputs.sources}
    trajectory = (("trajectory", "all"),) if survey.of("trajectory") else ()
    for line in survey.flightlines:
        sources = [
            {**_source_args(by_key[k]), "sorted": k in survey.of("sort_file")} for k in line.sources
        ]
        needs = (*(("index_file", k) for k in line.sources), *trajectory)
        needs += tuple(("sort_file", k) for k in line.sources if k in survey.of("sort_file"))
        stretches = list(line.stretches())
        for name, k in stretches:
            args = {
                **_line_args(survey, line),
                "stretch": name,
                "sources": sources,
                "shots": [k * line.stretch_shots, (k + 1) * line.stretch_shots],
                "window_s": line.window_s(k),
                "span_s": [line.first_s, line.last_s],
            }
            yield Task("gather", name, args, needs, line.points // len(stretches))


def _gather_range(survey: Survey) -> Iterator[Task]:
    if survey.filtering:
        return
    for source in survey.inputs.sources:
        key = str(source.key)
        if key not in survey.of("index_file"):
            continue
        for start in range(0, source.facts.n_points, RANGE_POINTS):
            stop = min(start + RANGE_POINTS, source.facts.n_points)
            name = f"file_{key}/{start}"
            args = {**_source_args(source), "stretch": name, "start": start, "stop": stop}
            yield Task("gather_range", name, args, (("index_file", key),), stop - start)


def _gathered(survey: Survey, line: Flightline) -> list[str]:
    """Stretches of a flightline that hold points."""
    gathered = survey.of("gather")
    return [n for n, _ in line.stretches() if n in gathered and gathered[n].facts["points"]]


def _sensor_path(survey: Survey) -> Iterator[Task]:
    if survey.inputs.trajectory:
        return
    for line in survey.flightlines:
        names = _gathered(survey, line)
        if names:
            args = {
                "line": line.name,
                "stretches": names,
                "points": line.points,
                "span_s": [line.first_s, line.last_s],
            }
            needs = tuple(("gather", n) for n in names)
            yield Task("sensor_path", line.name, args, needs)


def _observe(survey: Survey) -> Iterator[Task]:
    if survey.inputs.trajectory:
        return
    for line in survey.flightlines:
        for name in _gathered(survey, line):
            args = {**_line_args(survey, line), "stretch": name}
            needs = (("gather", name), *_path_needs(survey, line))
            yield Task("observe", name, args, needs, survey.of("gather")[name].points)


def _fit(survey: Survey) -> Iterator[Task]:
    observing = "gather" if survey.inputs.trajectory else "observe"
    for line in survey.flightlines:
        names = [n for n in _gathered(survey, line) if n in survey.of(observing)]
        if names:
            args = {
                **_line_args(survey, line),
                "stretches": names,
                "points": line.points,
                "span_s": [line.first_s, line.last_s],
                "prf_basis": line.prf_basis,
            }
            yield Task("fit_line", line.name, args, tuple((observing, n) for n in names))


def _scatter(survey: Survey) -> Iterator[Task]:
    filtering = survey.workflow.filter
    # Only that one filter reads what shots say: the others share the points as they are.
    dcc = filtering.dcc.model_dump() if filtering.method == "dcc" else None
    for line in survey.flightlines:
        if line.name not in survey.of("fit_line"):
            continue
        for name, _ in line.stretches():
            receipt = survey.of("gather").get(name)
            if receipt and receipt.facts["points"]:
                args = {**_line_args(survey, line), "stretch": name, "timeless": False}
                args["dcc"] = dcc
                args["polygons"] = list(survey.inputs.polygons)
                needs = (("gather", name), ("fit_line", line.name), *_path_needs(survey, line))
                yield Task("scatter", name, args, needs, receipt.points)
    for name, receipt in sorted(survey.of("gather_range").items()):
        args = {"stretch": name, "timeless": True, "polygons": list(survey.inputs.polygons)}
        yield Task("scatter", name, args, (("gather_range", name),), receipt.points)


def _build(survey: Survey) -> Iterator[Task]:
    pieces: dict[str, list[tuple[str, int]]] = {}
    points: dict[str, int] = {}
    for name, receipt in sorted(survey.of("scatter").items()):
        for tile, (group, count) in receipt.facts["tiles"].items():
            pieces.setdefault(tile, []).append((name, group))
            points[tile] = points.get(tile, 0) + count
    for tile, listed in sorted(pieces.items()):
        needs = tuple(("scatter", name) for name, _ in listed)
        yield Task("build_tile", tile, {"tile": tile, "pieces": listed}, needs, points[tile])


def _denoise(survey: Survey) -> Iterator[Task]:
    boxes = {
        name: r.facts["voxels"] for name, r in survey.of("scatter").items() if "voxels" in r.facts
    }
    voxel_q = quanta(survey.workflow.noise.voxel_m)
    for block in survey.blocks:
        # what a density depends on, whatever the halo of the points
        margin = survey.halo_q + MARGIN_VOXELS * voxel_q
        parts = voxel_parts(boxes, grow(block.core, margin), voxel_q)
        args = {
            "block": str(block.cell),
            "core": list(block.core),
            "tiles": [str(t) for t in block.tiles],
            "voxels": parts,
            "beamlets": _beamlets(survey),
        }
        needs = (*_tile_needs(block), *(("scatter", p) for p in parts))
        yield Task("denoise", str(block.cell), args, needs, block.points)


def _ground(survey: Survey) -> Iterator[Task]:
    halo = quanta(survey.workflow.ground.buffer_m)
    for cell in units(survey.counts, survey.tile_q, survey.cell_q, halo):
        noise = owners(cell.tiles, survey.tile_q, survey.block_q, survey.of("denoise"))
        args = {**_cell_args(cell), "noise": _named("noise", noise)}
        needs = (*_tile_needs(cell), *_label_needs("denoise", noise))
        yield Task("ground", str(cell.cell), args, needs, cell.points)


def _surface(survey: Survey) -> Iterator[Task]:
    halo = quanta(
        max(reach(survey.workflow.products) for reach in (surface_reach_m, fired_reach_m))
    )
    fired = _fired(survey)
    for cell in units(survey.counts, survey.tile_q, survey.cell_q, halo):
        if str(cell.cell) not in survey.of("ground"):
            continue
        noise = owners(cell.tiles, survey.tile_q, survey.block_q, survey.of("denoise"))
        ground = owners(cell.tiles, survey.tile_q, survey.cell_q, survey.of("ground"))
        parts = fired if fired is None else fired_parts(fired, grow(cell.core, halo))
        args = {
            **_cell_args(cell),
            "noise": _named("noise", noise),
            "ground": _named("ground", ground),
            "polygons": list(survey.inputs.polygons),
            "fired": parts,
        }
        labels = (*_label_needs("denoise", noise), *_label_needs("ground", ground))
        needs = (*_tile_needs(cell), *labels, *(("scatter", n) for n in parts or ()))
        yield Task("surface", str(cell.cell), args, needs, cell.points)


def _fired(survey: Survey) -> dict[str, list[int]] | None:
    """Rectangles that each stretch fired at; None where intensity is the input's."""
    workflow = survey.workflow
    boxes = {n: r.facts["fired"] for n, r in survey.of("scatter").items() if "fired" in r.facts}
    known = workflow.filter.method != "none" and any(box[2] > box[0] for box in boxes.values())
    return boxes if workflow.products.intensity == "detection" and known else None


def _deliver(survey: Survey) -> Iterator[Task]:
    holders: dict[str, list[CellId]] = {}
    for tile in survey.counts:
        for source in survey.of("build_tile")[str(tile)].facts["sources"]:
            holders.setdefault(source, []).append(tile)
    for source in survey.inputs.sources:
        key = str(source.key)
        receipt = survey.of("index_file").get(key)
        if receipt is None:
            continue
        labels = _label_units(survey, holders.get(key, []))
        args = {
            **_source_args(source),
            "delivered": source.delivered,
            "points": receipt.points,
            "hash": receipt.facts["hash"],
            "tiles": {str(tile): units_of for tile, units_of in labels.items()},
        }
        yield Task("deliver_file", key, args, _delivery_needs(labels), receipt.points)


def _deliver_tiles(survey: Survey) -> Iterator[Task]:
    if survey.workflow.outputs.tiles == "none":
        return
    for tile, count in survey.counts.items():
        labels = _label_units(survey, [tile])
        args = {"tile": str(tile), "units": labels[tile]}
        yield Task("deliver_tile", str(tile), args, _delivery_needs(labels), count)


def _mosaic(survey: Survey) -> Iterator[Task]:
    for number, (cells, bounds) in enumerate(mosaic_parts(survey), start=1):
        needs = tuple(("surface", str(cell)) for cell in cells)
        for product in (*PRODUCTS, "noise"):
            name = product if number == 1 else f"{product}_{number}"
            args = {
                "product": product,
                "name": name,
                "cells": [list(cell) for cell in cells],
                "bounds": list(bounds),
                "delivered": product in PRODUCTS,
            }
            if product == "intensity":
                args["meaning"] = MEANINGS[_fired(survey) is not None]
            yield Task("mosaic", name, args, needs)


PHASES = (
    Phase("index_file", _index),
    Phase("trajectory", _trajectory),
    Phase("heading", _heading),
    Phase("sort_file", _sort),
    Phase("gather", _gather),
    Phase("gather_range", _gather_range),
    Phase("sensor_path", _sensor_path),
    Phase("observe", _observe),
    Phase("fit_line", _fit),
    Phase("scatter", _scatter),
    Phase("build_tile", _build),
    Phase("denoise", _denoise),
    Phase("ground", _ground),
    Phase("surface", _surface),
    Phase("deliver_file", _deliver),
    Phase("deliver_tile", _deliver_tiles),
    Phase("mosaic", _mosaic),
)
"""Every phase of a run, in order."""


def _source_args(source: Source) -> dict[str, str]:
    return {"source": str(source.key), "path": str(source.path)}


def _stamp(source: Source) -> list[int]:
    """What changes when a file does: its size and time of writing."""
    stat = source.path.stat()
    return [stat.st_size, stat.st_mtime_ns]


def _beamlets(survey: Survey) -> int:
    """Beamlets of a shot; without a channel dimension a shot is one beamlet."""
    return survey.workflow.sensor.beamlets if survey.workflow.survey.channel_dimension else 1


def _line_args(survey: Survey, line: Flightline) -> dict[str, object]:
    heading = survey.of("heading").get(line.name)
    path = survey.of("sensor_path").get(line.name)
    return {
        "line": line.name,
        "psid": line.psid,
        "t0_s": line.clock.t0_s,
        "prf_hz": line.clock.prf_hz,
        "beamlets": _beamlets(survey),
        "trajectory": bool(survey.of("trajectory")),
        "sensor_path": bool(path and path.facts["found"]),
        "heading_rad": heading.facts["heading_rad"] if heading else None,
    }


def _path_needs(survey: Survey, line: Flightline) -> tuple[tuple[str, str], ...]:
    return (("sensor_path", line.name),) if line.name in survey.of("sensor_path") else ()


def _cell_args(cell: Unit) -> dict[str, object]:
    return {
        "cell": str(cell.cell),
        "ij": list(cell.cell),
        "tiles": [str(t) for t in cell.tiles],
    }


def _named(kind: str, listed: Mapping[CellId, list[str]]) -> dict[str, list[list[str]]]:
    return {str(tile): [[kind, name] for name in names] for tile, names in listed.items()}


def _tile_needs(unit: Unit) -> tuple[tuple[str, str], ...]:
    return tuple(("build_tile", str(t)) for t in unit.tiles)


def _label_needs(kind: str, listed: Mapping[CellId, list[str]]) -> tuple[tuple[str, str], ...]:
    return tuple((kind, name) for name in sorted({n for names in listed.values() for n in names}))


def _label_units(survey: Survey, tiles: list[CellId]) -> dict[CellId, dict[str, list[str]]]:
    """Finished units that hold the delivered labels of each tile, by tile and label."""
    noise = owners(tiles, survey.tile_q, survey.block_q, survey.of("denoise"))
    classes = owners(tiles, survey.tile_q, survey.cell_q, survey.of("surface"))
    return {t: {"noise": noise[t], "classes": classes[t]} for t in tiles}


def _delivery_needs(labels: Mapping[CellId, dict[str, list[str]]]) -> tuple[tuple[str, str], ...]:
    built = tuple(("build_tile", str(tile)) for tile in labels)
    noise = {tile: units_of["noise"] for tile, units_of in labels.items()}
    classes = {tile: units_of["classes"] for tile, units_of in labels.items()}
    return (*built, *_label_needs("denoise", noise), *_label_needs("surface", classes))
