"""Context of a run on an airborne survey."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.airborne.settings import OutputSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.tasks.context import RunContext
from spl_batch.formats.reprojection import Reprojection
from spl_batch.formats.units import Units
from spl_batch.formats.vector_files import contains, read_polygons


@dataclass(frozen=True, slots=True)
class Context(RunContext[Workflow]):
    """What a run on an airborne survey is."""

    @property
    def units(self) -> Units:
        """Units of the survey's CRS: of what is read and delivered; work is done in metres."""
        return Units.of(self.crs)

    @property
    def shown_units(self) -> Units:
        """Those of what is delivered: of ``outputs.units``, where it names one.

        Places stay those of the survey's CRS where ``outputs.crs`` names another.
        """
        outputs = self.workflow.outputs
        if outputs.units is None:
            return self.units
        return self.units.shown_in(outputs.units, horizontal=outputs.crs is None)

    def within(self, name: str, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which places, (n,) each [quanta], lie in the polygons of a file of the workflow."""
        return contains(read_polygons(self.resolve(name), self.crs), x, y)


def reprojection(outputs: OutputSettings, crs: CRS | None) -> Reprojection | None:
    """How clouds and rasters are written once more; None where they would be as they are.

    Raises
    ------
    WorkflowError
        As :class:`~spl_batch.formats.reprojection.Reprojection` does.
    """
    if outputs.crs is None and outputs.units is None and outputs.cell is None:
        return None
    found = _between(crs, outputs.crs, outputs.units)
    same = outputs.crs is None and outputs.cell is None and not found.moves_points
    return None if same else found


@lru_cache(maxsize=8)
def _between(crs: CRS | None, named: str | None, unit: str | None) -> Reprojection:
    """The one of a run: tasks share it, as PROJ takes 10 to 200 ms to name its CRS."""
    return Reprojection(crs, named, unit)


def tiles_follow(outputs: OutputSettings, moved: Reprojection | None) -> bool:
    """Whether a client's tiles are cut out of clouds of :func:`reprojection`, so in its unit.

    Polygons are in the survey's CRS: in another one tiles are not made.
    """
    return outputs.crs is None and moved is not None and moved.moves_points
