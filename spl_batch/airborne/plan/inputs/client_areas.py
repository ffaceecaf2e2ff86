"""Tiles that a client names by polygons: read once, before anything starts."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS

from spl_batch.airborne.context import reprojection, tiles_follow
from spl_batch.airborne.plan.inputs.file_positions import ASTRAY, beside, boxes_of
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import InputError, WorkflowError, as_input_fault
from spl_batch.formats.las.convert import copied_format
from spl_batch.formats.las.copc import copc_fault
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.named_areas import NamedArea, read_named_areas
from spl_batch.formats.units import Units

TILES_KEY: Final = "outputs.client_tiles.polygons"
"""Key of the file with a client's tiles."""


def tiles_file(workflow: Workflow) -> dict[str, str]:
    """Name of the file with a client's tiles by its key, if there is one."""
    tiles = workflow.outputs.client_tiles
    return {} if tiles is None else {TILES_KEY: tiles.polygons}


def client_tiles(
    workflow: Workflow, base: Path, crs: CRS | None, files: Sequence[LasFacts]
) -> tuple[NamedArea, ...]:
    """Tiles that a client names; refused where none can have points, or clouds cannot be cut."""
    tiles = workflow.outputs.client_tiles
    if tiles is None:
        return ()
    path = base / tiles.polygons
    # Clouds in another unit have one scale, whatever the input's.
    outputs = workflow.outputs
    kept = tiles.format == "copc" and not tiles_follow(outputs, reprojection(outputs, crs))
    for facts in files:
        scales = facts.scales if kept else (QUANTUM_M,) * 3
        if copc_fault(copied_format(facts.point_format), scales) is not None:
            raise WorkflowError(
                f"outputs.client_tiles: {name_below(facts.path, base)}: point format "
                f"{facts.point_format} with scales {', '.join(f'{s:g}' for s in facts.scales)} "
                f"cannot be cut into {tiles.format}: that takes formats without waveforms, and "
                "octrees one scale; leave the key out, or write the file otherwise"
            )
    try:
        with as_input_fault(path):
            areas = read_named_areas(path, crs, tiles.name)
    except InputError as fault:
        raise WorkflowError(f"{TILES_KEY}: {fault}") from None
    shapes = np.array([one.shape for one in areas])
    if apart := beside(shapes, boxes_of(files), Units.of(crs)):
        raise WorkflowError(f"{TILES_KEY}: {path}: {ASTRAY.format(**apart)}")
    return tuple(areas)
