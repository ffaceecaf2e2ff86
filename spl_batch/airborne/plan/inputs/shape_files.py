"""Files of shapes that a workflow names: polygons, breaklines, tiles of a client.

All of them are read once, before anything starts.
"""

import glob
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS

from spl_batch.airborne.context import reprojection, tiles_follow
from spl_batch.airborne.plan.inputs.file_positions import ASTRAY, beside, boxes_of
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import InputError, WorkflowError, as_input_fault
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.geoid import grid_file
from spl_batch.formats.las.convert import copied_format
from spl_batch.formats.las.copc import copc_fault
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.named_areas import NamedArea, read_named_areas
from spl_batch.formats.units import Units
from spl_batch.formats.vector_files import check_polygons, shapes_keep_degrees

TILES_KEY: Final = "outputs.client_tiles.polygons"
"""Key of the file with a client's tiles."""


def shape_files(workflow: Workflow) -> dict[str, str]:
    """Names of the files of shapes by their keys."""
    tiles = workflow.outputs.client_tiles
    given = {key: getattr(workflow, key) for key in ("aoi", "water", "breaklines")}
    given[TILES_KEY] = None if tiles is None else tiles.polygons
    return {key: name for key, name in given.items() if name is not None}


def read_shapes(
    workflow: Workflow, base: Path, crs: CRS | None, files: Sequence[LasFacts]
) -> tuple[tuple[NamedArea, ...], list[Finding]]:
    """Read every polygon and breakline once: whatever is wrong is reported here, of all files.

    Gives the tiles that a client names. They, or an area of interest, beyond the points would hold
    none, or mark all of them as outside, and are a fault; water there has no effect, and is a
    warning.
    """
    faults: list[str] = []
    warnings: list[Finding] = []
    areas: tuple[NamedArea, ...] = ()
    survey = boxes_of(files)
    for key, name in shape_files(workflow).items():
        path, tiles = base / name, workflow.outputs.client_tiles
        try:
            with as_input_fault(path):
                if key == TILES_KEY and tiles is not None:
                    areas = tuple(read_named_areas(path, crs, tiles.name))
                    shapes = np.array([one.shape for one in areas])
                elif key == "breaklines":
                    shapes = np.array([water.area for water in read_breaklines(path, crs)])
                else:
                    shapes = check_polygons(path, crs)
        except InputError as fault:
            faults.append(f"{key}: {fault}")
            continue
        apart = beside(shapes, survey, Units.of(crs))
        if apart and key in {"aoi", TILES_KEY}:
            faults.append(f"{key}: {path}: {ASTRAY.format(**apart)}")
        elif apart:
            values = {
                "kind": "shapes", "key": key, "shapes": apart["shapes"], "points": apart["points"]
            }  # fmt: skip
            warnings.append(Finding("I05", values, name))
    if faults:
        raise WorkflowError("; ".join(faults))
    return areas, warnings


def refuse_uncut(
    workflow: Workflow, base: Path, crs: CRS | None, files: Sequence[LasFacts]
) -> None:
    """Refuse tiles of a client that clouds cannot be cut into."""
    tiles, outputs = workflow.outputs.client_tiles, workflow.outputs
    if tiles is None:
        return
    # Clouds in another unit have one scale, whatever the input's.
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


def kept_degrees(workflow: Workflow, base: Path, crs: CRS | None) -> Iterator[Finding]:
    """Files of shapes that come to the survey's CRS in another way than the best."""
    for key, name in shape_files(workflow).items():
        for way in shapes_keep_degrees(base / name, crs):
            yield Finding("I05", {"kind": "grid", "key": key, "what": way}, name)


def checksums(workflow: Workflow, base: Path, crs: CRS | None) -> Iterator[tuple[str, str]]:
    """Key and checksum of each file beside the points, with the way of shapes to the survey's CRS.

    That way changes what comes of them, and with it what is done again, once a grid is there.
    """
    named = shape_files(workflow)
    files = {key: base / name for key, name in named.items()}
    geoid = workflow.outputs.geoid
    if geoid is not None and (grid := grid_file(geoid.grid, base / geoid.grid)) is not None:
        files["outputs.geoid.grid"] = grid
    for key, path in files.items():
        # A shapefile's corners, table and CRS lie in files of the same stem.
        parts = path.parent.glob(f"{glob.escape(path.stem)}.*")
        whole = sorted(parts) if path.suffix.lower() == ".shp" else [path]
        ways = shapes_keep_degrees(path, crs) if key in named else []
        yield key, " ".join([*(checksum(part) for part in whole), *ways])
