"""Tasks of the space domain: tiles, blocks, ground cells, and what is delivered of them."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.local_noise import MARGIN_VOXELS
from spl_batch.airborne.plan.block_size import Holders
from spl_batch.airborne.plan.halo import surface_reach_m
from spl_batch.airborne.plan.inputs.survey_inputs import Source, source_args
from spl_batch.airborne.plan.memory.block_parts import parts_of
from spl_batch.airborne.plan.memory.cell_memory import Spread, cell_parts, whole_bytes
from spl_batch.airborne.plan.space_units import (
    Unit,
    fired_index,
    voxel_index,
)
from spl_batch.airborne.plan.survey_ledger import Survey, mosaic_parts
from spl_batch.airborne.plan.task_memory import (
    refusal,
    task_bytes,
)
from spl_batch.airborne.products.product_table import (
    ABOVE_GEOID,
    HILLSHADE,
    is_piece,
    products,
)
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.task import Task
from spl_batch.formats.las.header import waveform_file
from spl_batch.lattice.eastings import Eastings, Slab, Slabs
from spl_batch.lattice.tiles import CellId, cell_runs, grow, parse_cell, quanta


class _Pieces(NamedTuple):
    """Which row group of which stretch holds points of which tile: p pieces."""

    stretches: list[str]  #: Names of the stretches, sorted.
    tiles: list[CellId]  #: The tiles, in the order in which they were met.
    #: (p,): places in those lists, row group, and its points [count].
    tile: NDArray[np.int32]
    stretch: NDArray[np.int32]
    group: NDArray[np.int32]
    points: NDArray[np.int32]


def build(survey: Survey) -> Iterator[Task]:
    """Tiles that hold points, each from the stretches that have some of them."""
    pieces = _pieces(survey)
    order = np.argsort(pieces.tile, kind="stable")  # stretches stay in the order of names
    starts = np.searchsorted(pieces.tile[order], np.arange(len(pieces.tiles) + 1))
    for k in sorted(range(len(pieces.tiles)), key=pieces.tiles.__getitem__):
        mine, name = order[starts[k] : starts[k + 1]], str(pieces.tiles[k])
        stretches = [pieces.stretches[s] for s in pieces.stretch[mine].tolist()]
        listed = list(zip(stretches, pieces.group[mine].tolist(), strict=True))
        points = int(pieces.points[mine].sum(dtype=np.int64))
        yield Task(
            "build_tile",
            name,
            {"tile": name, "pieces": listed},
            tuple(("scatter", stretch) for stretch in stretches),
            points,
            refusal("build_tile", points, survey.memory_bytes),
        )


def _pieces(survey: Survey) -> _Pieces:
    scattered = survey.of("scatter")
    stretches = sorted(scattered)
    known: dict[str, int] = {}
    rows = []
    for number, stretch in enumerate(stretches):
        tiles = scattered[stretch].facts["tiles"]
        of_stretch = np.empty((4, len(tiles)), np.int32)
        of_stretch[0] = [known.setdefault(tile, len(known)) for tile in tiles]
        of_stretch[1] = number
        of_stretch[2:] = np.array(list(tiles.values()), np.int32).reshape(-1, 2).T
        rows.append(of_stretch)
    columns = np.concatenate(rows, axis=1) if rows else np.empty((4, 0), np.int32)
    return _Pieces(stretches, [parse_cell(tile) for tile in known], *columns)


def denoise(survey: Survey) -> Iterator[Task]:
    """Blocks of tiles, with the stretches whose noise reaches them."""
    voxel_q = quanta(survey.workflow.noise.voxel_m)
    stretch_of: dict[str, str] = {}
    voxels: dict[str, Sequence[int]] = {}
    for stretch, receipt in survey.of("scatter").items():
        boxes = dict(receipt.facts.get("voxels_apart", {}))
        boxes |= {stretch: receipt.facts["voxels"]} if "voxels" in receipt.facts else {}
        voxels |= boxes
        stretch_of |= dict.fromkeys(boxes, stretch)
    index = voxel_index(voxels, voxel_q)
    # what a density depends on, whatever the halo of the points
    margin = survey.halo_q + MARGIN_VOXELS * voxel_q
    for block in survey.blocks():
        parts = index.overlapping(grow(block.core, margin))
        args = {
            "block": block.name,
            "core": list(block.core),
            "tiles": [str(t) for t in block.tiles],
            "halo": survey.halo_q,
            "voxels": parts,
            "beamlets": survey.beamlets,
        }
        needs = (
            *tile_needs(block),
            *(("scatter", s) for s in dict.fromkeys(map(stretch_of.__getitem__, parts))),
        )
        points = Slabs.of(_slabs(block.tiles, survey)).within
        cut = parts_of(block.core, points, survey.workflow, survey.memory_bytes)
        worst = max(cut, key=lambda part: part.memory_bytes)
        refused = refusal("denoise", worst.held, survey.memory_bytes, worst.memory_bytes)
        how = {"parts": [list(part.core) for part in cut]}
        yield Task("denoise", block.name, args, needs, block.points, refused, how)


def ground(survey: Survey) -> Iterator[Task]:
    """Ground cells with their buffers."""
    halo = quanta(survey.workflow.ground.buffer_m)
    holders, (moved, first) = survey.holders, aligned(survey)
    several = survey.workflow.ground.method == "multiscale"
    told_by = survey.line_columns if several else ()
    lines = {"columns": list(told_by), "span_s": survey.workflow.survey.gap_s}
    for cell in survey.ground_cells.units(survey.counts, survey.tile_q, halo):
        noise = holders.of(cell.tiles)
        read = {"halo": halo, "noise": named_units("noise", noise), "lines": lines}
        args = {**cell_args(cell), **moved, **read}
        needs = (*tile_needs(cell), *label_needs("denoise", noise), *first)
        refused, how = cell_in_memory("ground", cell, survey)
        yield Task("ground", cell.name, args, needs, cell.points, refused, how)


def surface(survey: Survey) -> Iterator[Task]:
    """Ground cells whose ground is found, with what their rasters read around them."""
    halo = quanta(surface_reach_m(survey.workflow))
    index = fired_index(_boxes(survey, "fired")) if knows_reflectance(survey) else None
    holders, (moved, first) = survey.holders, aligned(survey)
    # Only the map of swaths and the flag of overlap ask which flightline a return belongs to.
    asked = survey.workflow.products.maps or survey.workflow.classes.overlap
    lines = survey.flown if asked else []
    passes = [[line.psid, line.first_s, line.last_s] for line in lines]
    for cell in survey.ground_cells.units(survey.counts, survey.tile_q, halo):
        noise = holders.of(cell.tiles)
        ground_of = survey.ground_cells.owners(cell.tiles, survey.tile_q)
        parts = None if index is None else index.overlapping(grow(cell.core, halo))
        args = {
            **cell_args(cell),
            **moved,
            "halo": halo,
            "noise": named_units("noise", noise),
            "ground": named_units("ground", ground_of),
            "polygons": [*survey.inputs.polygons, *survey.inputs.breaklines],
            "fired": parts,
            "passes": passes,
        }
        labels = (*label_needs("denoise", noise), *label_needs("ground", ground_of))
        needs = (*tile_needs(cell), *labels, *(("scatter", n) for n in parts or ()), *first)
        refused, how = cell_in_memory("surface", cell, survey)
        yield Task("surface", cell.name, args, needs, cell.points, refused, how)


def cell_in_memory(kind: str, cell: Unit, survey: Survey) -> tuple[str, dict[str, object]]:
    """Why a task of a ground cell cannot be started, empty if it can; and how it is cut."""
    limit = survey.memory_bytes
    most = sum(survey.counts[tile] for tile in cell.tiles)
    # wherever in the tiles they are
    if whole_bytes(kind, cell.core, most, survey.workflow) <= usable_bytes(limit):
        held = kind == "surface" and task_bytes("surface_held", most) <= usable_bytes(limit)
        return "", {"cuts": {}, **({"held": True} if held else {})}
    spread = spread_over(cell.tiles, survey)
    parts = cell_parts(kind, cell.core, spread, survey.workflow, limit)
    cuts = {look: list(cut) for look, cut in parts.cuts.items()}
    return refusal(kind, cell.held, limit, parts.memory_bytes), {"cuts": cuts}


def spread_over(tiles: Sequence[CellId], survey: Survey) -> Spread:
    """Where the points of some tiles lie."""
    return partial(Eastings.of_slabs, _slabs(tiles, survey))


def _slabs(tiles: Sequence[CellId], survey: Survey) -> list[Slab]:
    """Rectangles in which the points of some tiles lie, and how many in each."""
    built = survey.of("build_tile")
    found = (slab for tile in tiles for slab in built[str(tile)].facts["slabs"])
    return [(slab[:4], slab[4]) for slab in found]


def knows_reflectance(survey: Survey) -> bool:
    """Whether the intensity raster is made of detections, and not of the input's values."""
    workflow = survey.workflow
    if workflow.filter.method == "none" or workflow.products.intensity != "detection":
        return False
    return any(box[2] > box[0] for box in _boxes(survey, "fired").values())


def deliver(survey: Survey) -> Iterator[Task]:
    """Input files, each with the tiles that hold its points."""
    tiles_of: dict[str, list[CellId]] = {}
    built = survey.of("build_tile")
    for tile in survey.counts:
        for source in built[str(tile)].facts["sources"]:
            tiles_of.setdefault(source, []).append(tile)
    holders, (moved, first) = survey.holders, aligned(survey)
    for source in survey.inputs.sources:
        key = str(source.key)
        receipt = survey.of("index_file").get(key)
        if receipt is None:
            continue
        labels = _label_units(survey, tiles_of.get(key, []), holders)
        args = {
            **source_args(source),
            **moved,
            "delivered": source.delivered,
            "points": receipt.points,
            "parts": len(receipt.facts["parts"]),
            "hash": receipt.facts["hash"],
            **_header_args(source, receipt.facts),
            "tiles": {str(tile): units_of for tile, units_of in labels.items()},
            "copies": [str(t) for t in labels if built[str(t)].facts["copies"]],
            **({"spans": receipt.facts["spans"]} if moved else {}),
        }
        needs = (*_delivery_needs(labels), *first)
        yield Task("deliver_file", key, args, needs, receipt.points)


def _header_args(source: Source, facts: Mapping[str, Any]) -> dict[str, Any]:
    """What decides the header of a delivered file: its clock, and waveforms beside the input."""
    ends = [end for mine in facts["spans"].values() for _, end, _ in mine]
    standard = facts["standard"]
    found = waveform_file(source.path, source.facts.point_format)
    waveforms = found and {
        "path": str(found),
        "stamp": stamp_if_there(found),
        "delivered": str(PurePath(source.delivered).with_suffix(found.suffix)),
    }
    last_s = max(ends) if standard == "adjusted" else None
    return {"standard": standard, "last_s": last_s, "waveforms": waveforms}


def deliver_tiles(survey: Survey) -> Iterator[Task]:
    """Tiles, where they are delivered."""
    if survey.workflow.outputs.tiles == "none":
        return
    holders, (moved, first) = survey.holders, aligned(survey)
    for tile, count in survey.counts.items():
        labels = _label_units(survey, [tile], holders)
        args = {**moved, "tile": str(tile), "units": labels[tile]}
        needs = (*_delivery_needs(labels), *first)
        yield Task("deliver_tile", str(tile), args, needs, count)


def mosaic(survey: Survey) -> Iterator[Task]:
    """Rasters of each piece of the survey."""
    for number, (cells, bounds) in enumerate(mosaic_parts(survey), start=1):
        keepers = dict.fromkeys(map(survey.ground_cells.keeper, cells))
        needs = tuple(("surface", str(cell)) for cell in keepers)
        maps = survey.workflow.products.maps
        for product in products(reflectance=knows_reflectance(survey), maps=maps):
            name = product.name if number == 1 else f"{product.name}_{number}"
            args = {
                "product": product.name,
                "name": name,
                "cells": cell_runs(cells),
                "bounds": list(bounds),
                "delivered": product.delivered,
                "meaning": product.meaning,
                "unit": product.unit,
                "colours": list(product.colours),
            }
            yield Task("mosaic", name, args, needs)


def hillshade(survey: Survey) -> Iterator[Task]:
    """Relief of each terrain model, where maps are asked for."""
    if not survey.workflow.products.maps:
        return
    for name in sorted(survey.of("mosaic")):
        if is_piece(name, "dtm"):
            made = name.replace("dtm", HILLSHADE.name)
            args = {"source": f"{name}.tif", "target": f"{made}.tif"}
            yield Task("deliver_hillshade", made, args, (("mosaic", name),))


def geoid(survey: Survey) -> Iterator[Task]:
    """Terrain and surface above a geoid, where one is named."""
    if survey.workflow.outputs.geoid is None:
        return
    for name in sorted(survey.of("mosaic")):
        for product in ABOVE_GEOID:
            source = product.name.removesuffix("_geoid")
            if is_piece(name, source):
                made = name.replace(source, product.name)
                args = {
                    "source": f"{name}.tif",
                    "target": f"{made}.tif",
                    "meaning": product.meaning,
                    "unit": product.unit,
                    "grid": [*survey.inputs.geoid],
                }
                yield Task("deliver_geoid", made, args, (("mosaic", name),))


def _boxes(survey: Survey, fact: str) -> dict[str, Sequence[int]]:
    """What the stretches say of a place, by name."""
    scattered = ((name, r.facts) for name, r in survey.of("scatter").items())
    return {name: facts[fact] for name, facts in scattered if fact in facts}


def aligned(survey: Survey) -> tuple[dict[str, object], tuple[tuple[str, str], ...]]:
    """Argument of tasks that read shifted points, and the task that finds the shifts."""
    if "all" not in survey.of("align"):
        return {}, ()
    return {"aligned": True}, (("align", "all"),)


def cell_args(cell: Unit) -> dict[str, object]:
    """What the tasks of a ground cell are told of it."""
    return {
        "cell": str(cell.cell),
        "core": list(cell.core),
        "tiles": [str(t) for t in cell.tiles],
    }


def named_units(kind: str, listed: Mapping[CellId, list[str]]) -> dict[str, list[list[str]]]:
    """Units that hold labels of each tile, as the arguments of a task carry them."""
    return {str(tile): [[kind, name] for name in names] for tile, names in listed.items()}


def tile_needs(unit: Unit) -> tuple[tuple[str, str], ...]:
    """The tiles that a unit reads."""
    return tuple(("build_tile", str(t)) for t in unit.tiles)


def label_needs(kind: str, listed: Mapping[CellId, list[str]]) -> tuple[tuple[str, str], ...]:
    """The tasks that gave the labels of some tiles."""
    return tuple((kind, name) for name in sorted({n for names in listed.values() for n in names}))


def _label_units(
    survey: Survey, tiles: list[CellId], holders: Holders
) -> dict[CellId, dict[str, list[str]]]:
    """Units that hold the delivered labels of each tile, by tile and label."""
    noise = holders.of(tiles)
    classes = survey.ground_cells.owners(tiles, survey.tile_q)
    return {t: {"noise": noise[t], "classes": classes[t]} for t in tiles}


def _delivery_needs(labels: Mapping[CellId, dict[str, list[str]]]) -> tuple[tuple[str, str], ...]:
    built = tuple(("build_tile", str(tile)) for tile in labels)
    noise = {tile: units_of["noise"] for tile, units_of in labels.items()}
    classes = {tile: units_of["classes"] for tile, units_of in labels.items()}
    return (*built, *label_needs("denoise", noise), *label_needs("surface", classes))
