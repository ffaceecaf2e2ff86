"""Context of a run on an airborne survey."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.tasks.context import RunContext
from spl_batch.formats.units import Units
from spl_batch.formats.vector_files import contains, read_polygons
from spl_batch.lattice.tiles import quanta


@dataclass(frozen=True, slots=True)
class Context(RunContext[Workflow]):
    """What a run on an airborne survey is."""

    @property
    def units(self) -> Units:
        """Units of the survey's CRS: of what is read and delivered; work is done in metres."""
        return Units.of(self.crs)

    @property
    def rasters(self) -> Path:
        """Raster cells of the working store; other cell sizes are kept apart."""
        edges = self.workflow.ground.cell_m, self.workflow.products.cell_m
        return self.store.path("rasters_{}_{}.zarr".format(*map(quanta, edges)))

    def within(self, name: str, x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which places, (n,) each [quanta], lie in the polygons of a file of the workflow."""
        return contains(read_polygons(self.resolve(name), self.crs), x, y)
