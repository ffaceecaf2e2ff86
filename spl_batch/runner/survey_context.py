"""Context of a run on an airborne survey."""

from dataclasses import dataclass
from pathlib import Path

from spl_batch.runner.context import RunContext
from spl_batch.tiling import quanta
from spl_batch.workflow import Workflow


@dataclass(frozen=True, slots=True)
class Context(RunContext[Workflow]):
    """What a run on an airborne survey is."""

    @property
    def rasters(self) -> Path:
        """Raster cells of the working store."""
        workflow = self.workflow
        return self.store.rasters(quanta(workflow.ground.cell_m), quanta(workflow.products.cell_m))
