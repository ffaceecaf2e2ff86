"""Tasks of the space domain: tiles, cells, and what is delivered of them."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.accuracy.evidence import LEVELS
from spl_batch.airborne.noise.local_noise import MARGIN_VOXELS
from spl_batch.airborne.plan.flightlines import swath_totals
from spl_batch.airborne.plan.grid import Unit
from spl_batch.airborne.plan.inputs.file_positions import FAR_M
from spl_batch.airborne.plan.inputs.survey_inputs import Source, source_args
from spl_batch.airborne.plan.survey_ledger import Survey, mosaic_bounds
from spl_batch.airborne.plan.task_memory import cell_bytes, refusal, surface_reach_m
from spl_batch.airborne.products.product_table import ABOVE_GEOID, MOST_PIXELS, products
from spl_batch.airborne.store.label_tables import SHIFTED
from spl_batch.airborne.tasks.delivered_points import terrain_margin_q
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.task import Need, Task
from spl_batch.errors import grouped
from spl_batch.formats.las.header import waveform_file
from spl_batch.lattice.tiles import (
    Bounds,
    BoxIndex,
    CellId,
    cell_runs,
    far_apart,
    grow,
    parse_cell,
    quanta,
    shared,
)


class _Pieces(NamedTuple):
    """Which rows of which stretch are points of which tile: p pieces."""

    stretches: list[str]  #: Names of the stretches, sorted.
    tiles: list[CellId]  #: The tiles, in the order in which they were met.
    #: (p,): places in those lists, first row in the stretch's file, and points [count].
    tile: NDArray[np.int32]
    stretch: NDArray[np.int32]
    first: NDArray[np.int32]
    points: NDArray[np.int32]


def build(survey: Survey) -> Iterator[Task]:
    """Tiles that hold points, each from the stretches that have some of them."""
    pieces = _pieces(survey)
    order = np.argsort(pieces.tile, kind="stable")  # stretches stay in the order of names
    starts = np.searchsorted(pieces.tile[order], np.arange(len(pieces.tiles) + 1))
    for k in sorted(range(len(pieces.tiles)), key=pieces.tiles.__getitem__):
        mine, name = order[starts[k] : starts[k + 1]], str(pieces.tiles[k])
        stretches = [pieces.stretches[s] for s in pieces.stretch[mine].tolist()]
        rows = pieces.first[mine].tolist(), pieces.points[mine].tolist()
        listed = list(zip(stretches, *rows, strict=True))
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
        boxes = receipt.facts.get("voxels", {})
        voxels |= {name: (x0, y0, x1, y1) for name, (x0, y0, _, x1, y1, _) in boxes.items()}
        stretch_of |= dict.fromkeys(boxes, stretch)
    index = index_of_boxes(voxels, voxel_q)
    # what a density depends on, whatever the halo of the points
    margin = survey.halo_q + MARGIN_VOXELS * voxel_q
    for cell in survey.denoise_cells():
        parts = index.overlapping(grow(cell.core, margin))
        args = {"halo": survey.halo_q, "voxels": parts, "beamlets": survey.beamlets}
        needs = (("scatter", s) for s in dict.fromkeys(map(stretch_of.__getitem__, parts)))
        yield cell_task("denoise", cell, survey, args, needs)


def ground(survey: Survey) -> Iterator[Task]:
    """Ground cells with their buffers."""
    halo = quanta(survey.workflow.ground.buffer_m)
    for cell in survey.ground_cells(halo):
        needs = labels_of(survey, cell.tiles, "denoise")
        yield cell_task("ground", cell, survey, {"halo": halo}, needs)


def surface(survey: Survey) -> Iterator[Task]:
    """Ground cells whose ground is found, with what their rasters read around them."""
    halo = quanta(surface_reach_m(survey.workflow))
    known = knows_reflectance(survey)
    index = index_of_boxes(_fired(survey), QUANTA_PER_M) if known else None
    for cell in survey.ground_cells(halo):
        parts = None if index is None else index.overlapping(grow(cell.core, halo))
        args = {
            "halo": halo,
            "polygons": survey.inputs.checksums("aoi", "water", "breaklines"),
            "fired": parts,
        }
        needs = labels_of(survey, cell.tiles, "denoise", "ground")
        needs += [("scatter", n) for n in parts or ()]
        yield cell_task("surface", cell, survey, args, needs)


def cell_task(
    kind: str,
    cell: Unit,
    survey: Survey,
    args: Mapping[str, object],
    needs: Iterable[Need],
) -> Task:
    """A task of a cell: what it owns, and the tiles that it reads."""
    tiles = [str(tile) for tile in cell.tiles]
    place = {"cell": str(cell.cell), "core": list(cell.core), "tiles": tiles}
    needed = cell_bytes(kind, cell.core, cell.held, survey.workflow)
    refused = refusal(kind, cell.held, survey.memory_bytes, needed)
    whole = (*(("build_tile", tile) for tile in tiles), *needs)
    return Task(kind, cell.name, {**place, **args}, whole, cell.points, refused)


def knows_reflectance(survey: Survey) -> bool:
    """Whether the intensity raster is made of detections, and not of the input's values."""
    workflow = survey.workflow
    if workflow.filter.method == "none" or workflow.products.intensity != "detection":
        return False
    return any(box[2] > box[0] for box in _fired(survey).values())


def deliver(survey: Survey) -> Iterator[Task]:
    """Input files, each with the tiles that hold its points."""
    tiles_of: dict[str, list[CellId]] = {}
    built = survey.of("build_tile")
    for tile in survey.counts:
        for source in built[str(tile)].facts["sources"]:
            tiles_of.setdefault(source, []).append(tile)
    outside = int("outside" in survey.workflow.outputs.drop)
    for source in survey.inputs.sources:
        key = str(source.key)
        receipt = survey.of("index_file").get(key)
        if receipt is None:
            continue
        tiles = [str(tile) for tile in tiles_of.get(key, ())]
        args = {
            **source_args(source),
            "delivered": source.delivered,
            "points": receipt.points,
            "hash": receipt.facts["hash"],
            **_header_args(source, receipt.facts),
            "tiles": tiles,
            "copies": [tile for tile in tiles if built[tile].facts["copies"]],
            "spans": receipt.facts["spans"],
            "aoi": outside * survey.inputs.checksums("aoi"),
        }
        needs = [("build_tile", tile) for tile in tiles]
        margin = terrain_margin_q(survey.workflow)
        near = tiles_of.get(key, ())
        needs += labels_of(survey, near, "denoise", "surface", margin=margin)
        yield Task("deliver_file", key, args, tuple(needs), receipt.points)


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
    for tile, count in survey.counts.items():
        labels = labels_of(
            survey, [tile], "denoise", "surface", margin=terrain_margin_q(survey.workflow)
        )
        needs = (("build_tile", str(tile)), *labels)
        yield Task("deliver_tile", str(tile), {"tile": str(tile)}, needs, count)


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
        place = {"cells": cell_runs(sorted(squares)), "bounds": list(bounds)}
        args = {**product._asdict(), **place}
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
            grid = survey.inputs.checksums("outputs.geoid.grid")
            args = {**product._asdict(), "source": source, "grid": grid}
            yield Task("deliver_geoid", product.name, args, (("mosaic", source),))


def _fired(survey: Survey) -> dict[str, Sequence[int]]:
    """Where stretches fired, near the ground: west, south, east, north [m]."""
    scattered = ((name, r.facts) for name, r in survey.of("scatter").items())
    return {name: facts["fired"] for name, facts in scattered if "fired" in facts}


def aligned(survey: Survey) -> tuple[Need, ...]:
    """The task that finds the shifts of heights, if one has."""
    return (SHIFTED,) if SHIFTED[1] in survey.of(SHIFTED[0]) else ()


def labels_of(
    survey: Survey, tiles: Collection[CellId], *steps: str, margin: int = 0
) -> list[Need]:
    """Tasks of steps that may label points of some tiles, and the one that shifts their heights.

    ``margin``: of the tiles [quanta].
    """
    grids = {step: survey.denoise_grid if step == "denoise" else survey.grid for step in steps}
    needs = [
        (step, unit)
        for step, grid in grids.items()
        for unit in grid.owners(tiles, survey.tile_q, margin)
    ]
    return [*needs, *aligned(survey)]


def copc_name(delivered: str) -> str:
    """Name below the output of the COPC twin of a delivered cloud."""
    return f"copc/{delivered.removesuffix('.laz')}.copc.laz"


def deliver_copc(survey: Survey) -> Iterator[Task]:
    """Delivered clouds, each to be written once more as an octree."""
    if not survey.workflow.outputs.copc:
        return
    for key, receipt in sorted(survey.of("deliver_file").items()):
        name = receipt.facts["name"]
        args = {"source": f"laz/{name}", "target": copc_name(name)}
        refused = refusal("deliver_copc", receipt.points, survey.memory_bytes)
        yield Task("deliver_copc", key, args, (("deliver_file", key),), receipt.points, refused)


def catalogue(survey: Survey) -> Iterator[Task]:
    """One task, once there is anything to list."""
    delivered = survey.of("deliver_file")
    if not survey.workflow.outputs.catalogue or not delivered:
        return
    twins = survey.of("deliver_copc")
    rasters, of_rasters = delivered_rasters(survey)
    clouds = {key: _cloud(survey, key, as_copc=key in twins) for key in sorted(delivered)}
    moved = {key: r.outputs for key, r in sorted(survey.of("reproject_file").items())}
    elsewhere = survey.of("reproject_raster")
    checkpoints = survey.of("checkpoints")
    args = {
        "clouds": list(clouds.values()),
        "rasters": [*rasters, *(name for _, r in sorted(elsewhere.items()) for name in r.outputs)],
        "reprojected": [
            {**clouds[key], "href": one} for key, made in moved.items() for one in made
        ],
        "flightlines": list(_flightlines(survey, clouds)),
        "checkpoints": [one for r in checkpoints.values() for one in r.facts["checkpoints"]],
        "cells": sorted(survey.of("surface")),
    }
    needs = (
        *(("deliver_file", key) for key in clouds),
        *(("deliver_copc", key) for key in sorted(twins)),
        *of_rasters,
        *(("reproject_file", key) for key in moved),
        *(("reproject_raster", name) for name in sorted(elsewhere)),
        *(("checkpoints", name) for name in sorted(checkpoints)),
        *(("surface", name) for name in sorted(survey.of("surface"))),
    )
    yield Task("deliver_catalogue", "all", args, needs)


def delivered_rasters(
    survey: Survey, kinds: Sequence[str] = ("mosaic", "deliver_geoid")
) -> tuple[list[str], list[Need]]:
    """Names of rasters below the output, and the tasks that make them, of these kinds."""
    made = [(kind, name, r) for kind in kinds for name, r in sorted(survey.of(kind).items())]
    names = [n for *_, r in made for n in r.outputs if "store/" not in n]
    return names, [(kind, name) for kind, name, _ in made]


def _cloud(survey: Survey, key: str, *, as_copc: bool) -> dict[str, Any]:
    name = survey.of("deliver_file")[key].facts["name"]
    facts = survey.of("index_file")[key].facts
    spans = [span for mine in facts["spans"].values() for span in mine]
    known = facts["standard"] == "adjusted" and spans
    return {
        "href": copc_name(name) if as_copc else f"laz/{name}",
        "span_s": [min(s[0] for s in spans), max(s[1] for s in spans)] if known else None,
    }


def _flightlines(survey: Survey, clouds: dict[str, dict[str, Any]]) -> Iterator[dict[str, Any]]:
    level = LEVELS[survey.workflow.requirements.quality_level].spacing
    swaths = swath_totals(survey.of("surface").values(), survey.flown, level)
    for line in survey.flown:
        swath = swaths.get(line.name)
        files = [clouds[key]["href"] for key in line.sources if key in clouds]
        if files:
            yield {
                "id": line.name,
                "number": line.number,
                "points": line.points,
                "first_s": line.first_s,
                "last_s": line.last_s,
                "area_m2": None if swath is None else swath.area_m2,
                "per_m2": None if swath is None else swath.pulses / swath.area_m2,
                "files": files,
            }


def index_of_boxes(boxes: Mapping[str, Sequence[int]], unit_q: int) -> BoxIndex:
    """Stretches by place; ``boxes``: xmin, ymin, xmax, ymax of each, in units [quanta]."""
    return BoxIndex({name: Bounds(*(unit_q * end for end in box)) for name, box in boxes.items()})
