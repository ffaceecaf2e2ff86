"""Stages ``denoise`` and ``ground``: a cell with its margin, all flightlines."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from spl_batch.airborne.context import Context
from spl_batch.airborne.diagnostics.air_fill import float_facts
from spl_batch.airborne.diagnostics.noise_fit import P_VALUES
from spl_batch.airborne.diagnostics.noise_layers import layer_facts
from spl_batch.airborne.filter import denoise as denoising
from spl_batch.airborne.filter.expected_noise import (
    COLUMNS_OF_AIR,
    NoiseInAir,
    air_facts,
    look_at_air,
    noise_model,
)
from spl_batch.airborne.filter.stray_returns import bare_cells
from spl_batch.airborne.ground import ground_methods as grounding
from spl_batch.airborne.products import surface_points
from spl_batch.airborne.store.label_tables import Cell, write_labels
from spl_batch.airborne.store.voxel_parts import stored_by_line
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.spare_memory import give_back
from spl_batch.lattice.tiles import grow, inside, quanta

_GROUND_COLUMNS: Final = ("x", "y", "z", "flags", "afterpulse", "range_sigma", "noise_class")


def denoise(args: Mapping[str, Any], context: Context) -> Produced:
    """Decide which points of a cell are noise."""
    give_back()
    cell, workflow = Cell.of(args, context), context.workflow
    core = cell.core
    # Air is looked for farther around than the filter looks, and in fewer columns.
    seen = cell.read(grow(core, args["halo"]), COLUMNS_OF_AIR)[0]
    shares = stored_by_line(context.store, args["voxels"])
    model = noise_model([seen[axis] for axis in "xyz"], shares, args["beamlets"], workflow.noise)
    look = look_at_air(seen, model, workflow, core)
    facts = {"core": list(core), "air": air_facts(look), "layers": layer_facts(look, model)}
    noise = NoiseInAir(model, look.air)
    del seen, look
    near = grow(core, min(args["halo"], quanta(denoising.reach_m(workflow.filter))))
    points, origin = cell.read(near, denoising.COLUMNS_NEEDED, ordered=True)
    owned = inside(points["x"], points["y"], core)
    place = origin.of(owned)
    mean = noise.mean(points.select("xyz").take(owned)).astype(np.float32)
    # Given up here, so that what is judged is not held beside what decided on the afterpulses.
    given = [points]
    del points, origin
    by_voxel = denoising.asks_for_means(workflow.filter)
    decided = denoising.denoise(
        density=noise.local(given[0]),
        tested=noise.mean(given[0]) if by_voxel else None,
        table=given.pop(),
        query=owned,
        settings=workflow.filter,
        afterpulse=workflow.afterpulse,
    )
    labels = {**decided, "noise_density": mean}
    path = context.store.table("denoise", args["cell"])
    write_labels(path, place, labels)
    return Produced([path], facts, len(mean))


def ground(args: Mapping[str, Any], context: Context) -> Produced:
    """Find the ground of a cell."""
    cell, settings = Cell.of(args, context), context.workflow.filter
    chances = settings.method == "vsaes" and settings.test == "calibrated"
    columns = (*_GROUND_COLUMNS, *("p_value",) * chances)
    table, origin = cell.read(grow(cell.core, args["halo"]), columns)
    bare = bare_cells(table)
    usable = surface_points.holds_ground(table, bare)
    owned = inside(table["x"], table["y"], cell.core)
    facts: dict[str, Any] = {"core": list(cell.core)}
    if bare is not None:
        facts |= float_facts(bare, cell.core)
    if bare is not None and chances:
        counts = np.zeros(len(P_VALUES) + 1, np.int64)
        bare.count_chances(table["p_value"], owned, P_VALUES, counts)
        facts |= {"p_values": counts.tolist()} if counts.any() else {}
    table = table.select(_GROUND_COLUMNS)
    mask = grounding.ground_mask(table, usable, context.workflow.ground, owned)[owned]
    mask = mask.astype(np.uint8)
    path = context.store.table("ground", args["cell"])
    write_labels(path, origin.of(owned), {"ground": mask})
    facts["ground"] = int(np.count_nonzero(mask))
    return Produced([path], facts, len(mask))
