"""Context of a run on an airborne survey."""

from dataclasses import dataclass
from pathlib import Path

from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.tasks.context import RunContext
from spl_batch.lattice.tiles import quanta


@dataclass(frozen=True, slots=True)
class Context(RunContext[Workflow]):
    """What a run on an airborne survey is."""

    @property
    def rasters(self) -> Path:
        """Raster cells of the working store."""
        workflow = self.workflow
        return self.store.rasters(quanta(workflow.ground.cell_m), quanta(workflow.products.cell_m))
