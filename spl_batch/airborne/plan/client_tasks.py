"""Tasks of what a client asks for beside a survey's own files: tiles, contours, another CRS."""

import math
from collections.abc import Iterator

import shapely

from spl_batch.airborne.catalogue.delivered_files import REPROJECTED
from spl_batch.airborne.context import reprojection, tiles_follow
from spl_batch.airborne.plan.space_tasks import aligned, delivered_rasters, knows_reflectance
from spl_batch.airborne.plan.survey_ledger import Survey, mosaic_bounds
from spl_batch.airborne.plan.task_memory import refusal
from spl_batch.airborne.products.product_table import HEIGHTS, products
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.tasks.task import Task
from spl_batch.lattice.tiles import Bounds, BoxIndex, cells_touching, shared


def client_tiles(survey: Survey) -> Iterator[Task]:
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


def contours(survey: Survey) -> Iterator[Task]:
    """Contours of the terrain, where they are asked for."""
    interval = survey.workflow.outputs.contour_interval
    if interval is not None and "dtm" in survey.of("mosaic"):
        yield Task("deliver_contours", "all", {"interval": interval}, (("mosaic", "dtm"),))


def reprojected_files(survey: Survey) -> Iterator[Task]:
    """Delivered clouds in another CRS or unit, unless these are the survey's."""
    moved = reprojection(survey.workflow.outputs, survey.inputs.crs)
    if moved is None or not moved.moves_points:
        return
    for key, receipt in sorted(survey.of("deliver_file").items()):
        name = receipt.facts["name"]
        args = {"source": f"laz/{name}", "target": f"{REPROJECTED}/laz/{name}"}
        yield Task("reproject_file", key, args, (("deliver_file", key),), receipt.points)


def reprojected_rasters(survey: Survey) -> Iterator[Task]:
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
