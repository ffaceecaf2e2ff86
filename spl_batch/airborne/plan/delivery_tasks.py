"""Tasks of what is delivered: clouds, tiles, rasters, and what a client asks for beside them."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np
import shapely

from spl_batch.airborne.catalogue import REPROJECTED
from spl_batch.airborne.context import reprojection, tiles_follow
from spl_batch.airborne.plan.flightlines import swath_totals
from spl_batch.airborne.plan.inputs.file_positions import FAR_M
from spl_batch.airborne.plan.inputs.survey_inputs import Source, source_args
from spl_batch.airborne.plan.space_tasks import aligned, knows_reflectance, points_of
from spl_batch.airborne.plan.survey_ledger import Survey, mosaic_bounds
from spl_batch.airborne.plan.task_memory import refusal
from spl_batch.airborne.products.product_table import ABOVE_GEOID, HEIGHTS, MOST_PIXELS, products
from spl_batch.airborne.settings.standards import LEVELS
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
    cells_touching,
    far_apart,
    parse_cell,
    quanta,
    shared,
)


def deliver_file(survey: Survey) -> Iterator[Task]:
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
        near = tiles_of.get(key, ())
        tiles = [str(tile) for tile in near]
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
        yield Task("deliver_file", key, args, _needs(survey, near), receipt.points)


def _header_args(source: Source, facts: Mapping[str, Any]) -> dict[str, Any]:
    """What decides the header of a delivered file: its clock, and waveforms beside the input."""
    found = waveform_file(source.path, source.facts.point_format)
    waveforms = found and {
        "path": str(found),
        "stamp": stamp_if_there(found),
        "delivered": str(PurePath(source.delivered).with_suffix(found.suffix)),
    }
    return {"standard": facts["standard"], "waveforms": waveforms}


def _needs(survey: Survey, tiles: Collection[CellId]) -> tuple[Need, ...]:
    """Tasks that give the points of delivered tiles, their labels, and the terrain below them."""
    margin = terrain_margin_q(survey.workflow)
    return points_of(survey, tiles, "denoise", "surface", margin=margin)


def deliver_tile(survey: Survey) -> Iterator[Task]:
    """Tiles, where they are delivered."""
    if survey.workflow.outputs.tiles != "none":
        for tile, count in survey.counts.items():
            args = {"tile": str(tile)}
            yield Task("deliver_tile", str(tile), args, _needs(survey, [tile]), count)


def mosaic(survey: Survey) -> Iterator[Task]:
    """Rasters of the survey."""
    cells = sorted(map(parse_cell, survey.of("surface")), key=lambda cell: (-cell.j, cell.i))
    if not cells:
        return
    bounds = mosaic_bounds(survey)
    if bounds.area_m2 > MOST_PIXELS * survey.workflow.products.cell_m**2:  # some lie astray
        cells, bounds = _main_part(survey, cells, bounds)
    pixels = bounds.area_m2 / survey.workflow.products.cell_m**2
    refused = ""
    if pixels > MOST_PIXELS:
        refused = (
            f"a raster of the whole survey has {grouped(pixels)} cells, more than "
            f"{grouped(MOST_PIXELS)}; leave out the files that lie far from the others"
        )
    needs = tuple(("surface", str(cell)) for cell in cells)
    for product in products(reflectance=knows_reflectance(survey)):
        place = {"cells": [str(cell) for cell in cells], "bounds": list(bounds)}
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


def deliver_geoid(survey: Survey) -> Iterator[Task]:
    """Terrain and surface above a geoid, where one is named."""
    if survey.workflow.outputs.geoid is None:
        return
    for product in ABOVE_GEOID:
        source = product.name.removesuffix("_geoid")
        if source in survey.of("mosaic"):
            grid = survey.inputs.checksums("outputs.geoid.grid")
            args = {**product._asdict(), "source": source, "grid": grid}
            yield Task("deliver_geoid", product.name, args, (("mosaic", source),))


def copc_name(delivered: str) -> str:
    """Name below the output of the COPC twin of a delivered cloud."""
    return f"copc/{delivered.removesuffix('.laz')}.copc.laz"


def deliver_copc(survey: Survey) -> Iterator[Task]:
    """Delivered clouds, each to be written once more as an octree."""
    if survey.workflow.outputs.copc:
        yield from _written_again("deliver_copc", survey, copc_name)


def reproject_file(survey: Survey) -> Iterator[Task]:
    """Delivered clouds in another CRS or unit, unless these are the survey's."""
    moved = reprojection(survey.workflow.outputs, survey.inputs.crs)
    if moved is not None and moved.moves_points:
        yield from _written_again("reproject_file", survey, f"{REPROJECTED}/laz/{{}}".format)


def _written_again(step: str, survey: Survey, named: Callable[[str], str]) -> Iterator[Task]:
    """Delivered clouds, each to be written once more; ``named``: what it is called there."""
    for key, receipt in sorted(survey.of("deliver_file").items()):
        name = receipt.facts["name"]
        args = {"source": f"laz/{name}", "target": named(name)}
        refused = refusal(step, receipt.points, survey.memory_bytes)
        yield Task(step, key, args, (("deliver_file", key),), receipt.points, refused)


def reproject_raster(survey: Survey) -> Iterator[Task]:
    """Delivered rasters in another CRS, unit or cell."""
    if reprojection(survey.workflow.outputs, survey.inputs.crs) is None:
        return
    for made in products(reflectance=knows_reflectance(survey)):
        if made.delivered and made.name in survey.of("mosaic"):
            args = {
                "source": f"{made.name}.tif",
                "target": f"{REPROJECTED}/{made.name}.tif",
                "above_datum": made.name in HEIGHTS,
                "meaning": made.meaning,
                "unit": made.unit,
            }
            yield Task("reproject_raster", made.name, args, (("mosaic", made.name),))


def deliver_contours(survey: Survey) -> Iterator[Task]:
    """Contours of the terrain, where they are asked for."""
    interval = survey.workflow.outputs.contour_interval
    if interval is not None and "dtm" in survey.of("mosaic"):
        yield Task("deliver_contours", "all", {"interval": interval}, (("mosaic", "dtm"),))


def deliver_client_tile(survey: Survey) -> Iterator[Task]:
    """Named areas, each with the delivered clouds and rasters that it is cut out of.

    Where outputs.units names another unit than the survey's, these are the ones in it; where
    outputs.cell names another cell, rasters have it.
    """
    settings = survey.workflow.outputs.client_tiles
    if settings is None:
        return
    delivered, indexed = survey.of("deliver_file"), survey.of("index_file")
    boxes = {key: indexed[key].facts["bounds"] for key in delivered}
    index = BoxIndex({key: Bounds(b[0], b[1], b[3] + 1, b[4] + 1) for key, b in boxes.items() if b})
    outputs = survey.workflow.outputs
    moved = reprojection(outputs, survey.inputs.crs)
    elsewhere = tiles_follow(outputs, moved)
    again = outputs.crs is None and moved is not None
    kinds = ("reproject_raster" if again else "mosaic", *("deliver_geoid",) * (not elsewhere))
    rasters, of_rasters = delivered_rasters(survey, kinds)
    for one in survey.inputs.areas:
        low_x, low_y, high_x, high_y = (QUANTA_PER_M * end for end in shapely.bounds(one.shape))
        # A point within may have been rounded to the next quantum.
        north_east = math.ceil(high_x) + 1, math.ceil(high_y) + 1
        bounds = Bounds(math.floor(low_x), math.floor(low_y), *north_east)
        keys = sorted(index.overlapping(bounds), key=lambda key: str(delivered[key].facts["name"]))
        args = {
            "name": one.name,
            "area": shapely.to_wkb(one.shape, hex=True),
            "sources": [[key, delivered[key].facts["name"]] for key in keys],
            "clouds": f"{REPROJECTED}/laz" if elsewhere else "laz",
            "rasters": rasters,
            "in_another_unit": elsewhere,
            "aligned": bool(aligned(survey)),
        }
        steps = ("deliver_file", "reproject_file")[: 1 + elsewhere]
        of_clouds = ((step, key) for step in steps for key in keys)
        needs = (*of_clouds, *of_rasters, *aligned(survey))
        flown = cells_touching(shared(bounds, mosaic_bounds(survey)), survey.tile_q)
        points = sum(survey.counts.get(tile, 0) for tile in flown)
        refused = ""
        if settings.format == "copc":
            refused = refusal("deliver_client_tile", points, survey.memory_bytes)
        yield Task("deliver_client_tile", one.name, args, needs, points, refused)


def delivered_rasters(survey: Survey, kinds: Sequence[str]) -> tuple[list[str], list[Need]]:
    """Names of rasters below the output, and the tasks that make them, of these kinds."""
    made = [(kind, name, r) for kind in kinds for name, r in sorted(survey.of(kind).items())]
    names = [n for *_, r in made for n in r.outputs if "store/" not in n]
    return names, [(kind, name) for kind, name, _ in made]


def deliver_catalogue(survey: Survey) -> Iterator[Task]:
    """One task, once there is anything to list."""
    delivered = survey.of("deliver_file")
    if not survey.workflow.outputs.catalogue or not delivered:
        return
    rasters, needs = delivered_rasters(survey, ("mosaic", "deliver_geoid", "reproject_raster"))
    clouds = {key: _cloud(survey, key) for key in sorted(delivered)}
    moved = sorted(survey.of("reproject_file").items())
    checkpoints = survey.of("checkpoints").values()
    args = {
        "clouds": list(clouds.values()),
        "rasters": rasters,
        "reprojected": [{**clouds[key], "href": one} for key, r in moved for one in r.outputs],
        "flightlines": list(_flightlines(survey, clouds)),
        "checkpoints": [one for r in checkpoints for one in r.facts["checkpoints"]],
        "cells": sorted(survey.of("surface")),
    }
    listed = ("deliver_file", "deliver_copc", "reproject_file", "checkpoints", "surface")
    needs += [(step, name) for step in listed for name in sorted(survey.of(step))]
    yield Task("deliver_catalogue", "all", args, tuple(needs))


def _cloud(survey: Survey, key: str) -> dict[str, Any]:
    """A delivered cloud, or its octree, and when it was flown, as catalogues list it."""
    name = survey.of("deliver_file")[key].facts["name"]
    facts = survey.of("index_file")[key].facts
    spans = [span for mine in facts["spans"].values() for span in mine]
    known = facts["standard"] == "adjusted" and spans
    return {
        "href": copc_name(name) if key in survey.of("deliver_copc") else f"laz/{name}",
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
