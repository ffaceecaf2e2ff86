"""Tasks of the space domain: tiles, cells, and what is delivered of them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.noise.local_noise import MARGIN_VOXELS
from spl_batch.airborne.plan.cells import fired_index, voxel_index
from spl_batch.airborne.plan.grid import Unit
from spl_batch.airborne.plan.halo import surface_reach_m
from spl_batch.airborne.plan.inputs.file_positions import FAR_M
from spl_batch.airborne.plan.inputs.survey_inputs import Source, source_args
from spl_batch.airborne.plan.survey_ledger import Survey, mosaic_bounds
from spl_batch.airborne.plan.task_memory import cell_bytes, refusal
from spl_batch.airborne.products.product_table import ABOVE_GEOID, products
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.task import Task
from spl_batch.errors import grouped
from spl_batch.formats.las.header import waveform_file
from spl_batch.lattice.tiles import (
    Bounds,
    CellId,
    cell_runs,
    far_apart,
    grow,
    parse_cell,
    quanta,
    shared,
)

MOST_PIXELS: Final = 2**34
"""Cells of a raster of a whole survey, at most [count]: 130 km x 130 km of square metres."""


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
            {"tile": name, "pieces": listed, "by_line": survey.filtering},
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
    """Cells of tiles, with the stretches whose noise reaches them."""
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
    for cell in survey.denoise_cells():
        parts = index.overlapping(grow(cell.core, margin))
        args = {
            **cell_args(cell),
            "halo": survey.halo_q,
            "voxels": parts,
            "beamlets": survey.beamlets,
        }
        needs = (
            *tile_needs(cell),
            *(("scatter", s) for s in dict.fromkeys(map(stretch_of.__getitem__, parts))),
        )
        refused = refused_cell("denoise", cell, survey)
        yield Task("denoise", cell.name, args, needs, cell.points, refused)


def ground(survey: Survey) -> Iterator[Task]:
    """Ground cells with their buffers."""
    halo, (moved, first) = quanta(survey.workflow.ground.buffer_m), aligned(survey)
    for cell in survey.ground_cells(halo):
        noise = survey.denoised_in(cell.tiles)
        args = {**cell_args(cell), **moved, "halo": halo, "noise": named_units("noise", noise)}
        needs = (*tile_needs(cell), *label_needs("denoise", noise), *first)
        refused = refused_cell("ground", cell, survey)
        yield Task("ground", cell.name, args, needs, cell.points, refused)


def surface(survey: Survey) -> Iterator[Task]:
    """Ground cells whose ground is found, with what their rasters read around them."""
    halo = quanta(surface_reach_m(survey.workflow))
    index = fired_index(_boxes(survey, "fired")) if knows_reflectance(survey) else None
    moved, first = aligned(survey)
    for cell in survey.ground_cells(halo):
        noise, ground_of = survey.denoised_in(cell.tiles), survey.grounded_in(cell.tiles)
        parts = None if index is None else index.overlapping(grow(cell.core, halo))
        args = {
            **cell_args(cell),
            **moved,
            "halo": halo,
            "noise": named_units("noise", noise),
            "ground": named_units("ground", ground_of),
            "polygons": [*survey.inputs.polygons, *survey.inputs.breaklines],
            "fired": parts,
        }
        labels = (*label_needs("denoise", noise), *label_needs("ground", ground_of))
        needs = (*tile_needs(cell), *labels, *(("scatter", n) for n in parts or ()), *first)
        refused = refused_cell("surface", cell, survey)
        yield Task("surface", cell.name, args, needs, cell.points, refused)


def refused_cell(kind: str, cell: Unit, survey: Survey) -> str:
    """Why a task of a cell cannot be started, empty if it can."""
    needed = cell_bytes(kind, cell.core, cell.held, survey.workflow)
    return refusal(kind, cell.held, survey.memory_bytes, needed)


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
    moved, first = aligned(survey)
    for source in survey.inputs.sources:
        key = str(source.key)
        receipt = survey.of("index_file").get(key)
        if receipt is None:
            continue
        labels = _label_units(survey, tiles_of.get(key, []))
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
    found = waveform_file(source.path, source.facts.point_format)
    waveforms = found and {
        "path": str(found),
        "stamp": stamp_if_there(found),
        "delivered": str(PurePath(source.delivered).with_suffix(found.suffix)),
    }
    return {"standard": facts["standard"], "waveforms": waveforms}


def deliver_tiles(survey: Survey) -> Iterator[Task]:
    """Tiles, where they are delivered."""
    if survey.workflow.outputs.tiles == "none":
        return
    moved, first = aligned(survey)
    for tile, count in survey.counts.items():
        labels = _label_units(survey, [tile])
        args = {**moved, "tile": str(tile), "units": labels[tile]}
        needs = (*_delivery_needs(labels), *first)
        yield Task("deliver_tile", str(tile), args, needs, count)


def mosaic(survey: Survey) -> Iterator[Task]:
    """Rasters of the survey."""
    cells = sorted(map(parse_cell, survey.of("surface")))
    if not cells:
        return
    bounds = mosaic_bounds(survey)
    if bounds.area_m2 > MOST_PIXELS * survey.workflow.products.cell_m**2:  # some lie astray
        cells, bounds = _main_part(survey, cells, bounds)
    pixels = bounds.area_m2 / survey.workflow.products.cell_m**2
    refused = (
        ""
        if pixels <= MOST_PIXELS
        else (
            f"a raster of the whole survey has {grouped(pixels)} cells, more than "
            f"{grouped(MOST_PIXELS)}; leave out the files that lie far from the others"
        )
    )
    squares = [square for cell in cells for square in survey.grid.squares(cell)]
    needs = tuple(("surface", str(cell)) for cell in cells)
    for product in products(reflectance=knows_reflectance(survey)):
        args = {
            "product": product.name,
            "name": product.name,
            "cells": cell_runs(sorted(squares)),
            "bounds": list(bounds),
            "delivered": product.delivered,
            "meaning": product.meaning,
            "unit": product.unit,
        }
        yield Task("mosaic", product.name, args, needs, 0, refused)


def _main_part(
    survey: Survey, cells: Sequence[CellId], bounds: Bounds
) -> tuple[list[CellId], Bounds]:
    """Of groups of ground cells far apart the one with most points, and its bounds."""
    cores = [survey.grid.core(cell) for cell in cells]
    corners = np.array([(core.xmin, core.ymin) for core in cores], np.int64)
    points = np.array([survey.of("surface")[str(cell)].points for cell in cells])
    rows = max(map(np.sort, far_apart(corners, quanta(FAR_M))), key=lambda k: points[k].sum())
    west, south, east, north = zip(*(shared(cores[k], bounds) for k in rows), strict=True)
    return [cells[k] for k in rows], Bounds(min(west), min(south), max(east), max(north))


def geoid(survey: Survey) -> Iterator[Task]:
    """Terrain and surface above a geoid, where one is named."""
    if survey.workflow.outputs.geoid is None:
        return
    for product in ABOVE_GEOID:
        source = product.name.removesuffix("_geoid")
        if source in survey.of("mosaic"):
            args = {
                "source": f"{source}.tif",
                "target": f"{product.name}.tif",
                "meaning": product.meaning,
                "unit": product.unit,
                "grid": [*survey.inputs.geoid],
            }
            yield Task("deliver_geoid", product.name, args, (("mosaic", source),))


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
    """A cell as the arguments of a task name it."""
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


def _label_units(survey: Survey, tiles: list[CellId]) -> dict[CellId, dict[str, list[str]]]:
    """Units that hold the delivered labels of each tile, by tile and label."""
    noise, classes = survey.denoised_in(tiles), survey.grounded_in(tiles)
    return {t: {"noise": noise[t], "classes": classes[t]} for t in tiles}


def _delivery_needs(labels: Mapping[CellId, dict[str, list[str]]]) -> tuple[tuple[str, str], ...]:
    built = tuple(("build_tile", str(tile)) for tile in labels)
    noise = {tile: units_of["noise"] for tile, units_of in labels.items()}
    classes = {tile: units_of["classes"] for tile, units_of in labels.items()}
    return (*built, *label_needs("denoise", noise), *label_needs("surface", classes))
