"""Files of shapes that a workflow names: polygons, breaklines, tiles of a client.

All of them are read once, before anything starts.
"""

import glob
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.airborne.plan.inputs.file_positions import ASTRAY, beside
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.findings import Finding
from spl_batch.errors import InputError, WorkflowError, as_input_fault
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.named_areas import NamedArea, read_named_areas
from spl_batch.formats.units import Units
from spl_batch.formats.vector_files import check_polygons, shapes_keep_degrees

TILES_KEY: Final = "outputs.client_tiles.polygons"
"""Key of the file with a client's tiles."""


class Shapes(NamedTuple):
    """What the files of shapes hold."""

    areas: list[NamedArea]  #: Tiles that a client names.
    #: Key of each file, and what it holds: checksums of its parts, and in which other way than the
    #: best its shapes come to the survey's CRS. Once PROJ has the grid for that, work is done anew.
    checksums: list[tuple[str, str]]
    findings: list[Finding]


def shape_files(workflow: Workflow) -> dict[str, str]:
    """Names of the files of shapes by their keys."""
    tiles = workflow.outputs.client_tiles
    given = {key: getattr(workflow, key) for key in ("aoi", "water", "breaklines")}
    given[TILES_KEY] = None if tiles is None else tiles.polygons
    return {key: name for key, name in given.items() if name is not None}


def read_shapes(workflow: Workflow, base: Path, crs: CRS | None, files: Files) -> Shapes:
    """Read every polygon and breakline once: whatever is wrong is reported here, of all files.

    A client's tiles, or an area of interest, beyond the points would hold none, or mark all of them
    as outside, and are a fault; water there has no effect, and is a warning.
    """
    faults: list[str] = []
    found = Shapes([], [], [])
    for key, name in shape_files(workflow).items():
        path = base / name
        try:
            with as_input_fault(path):
                shapes = _shapes(key, path, crs, workflow, found.areas)
                ways = shapes_keep_degrees(path, crs)
        except InputError as fault:
            faults.append(f"{key}: {fault}")
            continue
        # A shapefile's corners, table and CRS lie in files of the same stem.
        parts = path.parent.glob(f"{glob.escape(path.stem)}.*")
        whole = sorted(parts) if path.suffix.lower() == ".shp" else [path]
        found.checksums.append((key, " ".join([*map(checksum, whole), *ways])))
        for way in ways:
            found.findings.append(Finding("I05", {"kind": "grid", "key": key, "what": way}, name))
        apart = beside(shapes, files.boxes, Units.of(crs))
        if apart and key in {"aoi", TILES_KEY}:
            faults.append(f"{key}: {path}: {ASTRAY.format(**apart)}")
        elif apart:
            values = {
                "kind": "shapes", "key": key, "shapes": apart["shapes"], "points": apart["points"]
            }  # fmt: skip
            found.findings.append(Finding("I05", values, name))
    if faults:
        raise WorkflowError("; ".join(faults))
    return found


def _shapes(
    key: str, path: Path, crs: CRS | None, workflow: Workflow, areas: list[NamedArea]
) -> NDArray[Any]:
    """Shapes of a file, (n,); ``areas``: gets those that a client names."""
    tiles = workflow.outputs.client_tiles
    if key == TILES_KEY and tiles is not None:
        areas += read_named_areas(path, crs, tiles.name)
        return np.array([one.shape for one in areas])
    if key == "breaklines":
        return np.array([water.area for water in read_breaklines(path, crs)])
    return check_polygons(path, crs)
