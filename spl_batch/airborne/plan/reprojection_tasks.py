"""Tasks that write what is delivered once more, in the CRS that ``outputs.crs`` names."""

from collections.abc import Iterator

from spl_batch.airborne.plan.space_tasks import knows_reflectance
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.products.product_table import HEIGHTS, products
from spl_batch.engine.tasks.task import Task
from spl_batch.formats.reprojection import Reprojection


def files(survey: Survey) -> Iterator[Task]:
    """Delivered clouds, unless that CRS is the survey's."""
    named = survey.workflow.outputs.crs
    if named is None or not Reprojection(survey.inputs.crs, named).moves_points:
        return
    for key, receipt in sorted(survey.of("deliver_file").items()):
        name = receipt.facts["name"]
        args = {"source": f"laz/{name}", "target": f"reprojected/laz/{name}"}
        yield Task("reproject_file", key, args, (("deliver_file", key),), receipt.points)


def rasters(survey: Survey) -> Iterator[Task]:
    """Delivered rasters."""
    if survey.workflow.outputs.crs is None:
        return
    for made in products(reflectance=knows_reflectance(survey)):
        if made.delivered and made.name in survey.of("mosaic"):
            args = {
                "source": f"{made.name}.tif",
                "target": f"reprojected/{made.name}.tif",
                "above_datum": made.name in HEIGHTS,
                "meaning": made.meaning,
                "unit": made.unit,
            }
            yield Task("reproject_raster", made.name, args, (("mosaic", made.name),))
