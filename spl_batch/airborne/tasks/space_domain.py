"""Stages ``denoise`` and ``ground``: a place with its halo, all flightlines."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.diagnostics.air_fill import float_facts
from spl_batch.airborne.diagnostics.noise_fit import P_VALUES
from spl_batch.airborne.filter import denoise as denoising
from spl_batch.airborne.filter.air import COLUMNS_NEEDED as AIR_COLUMNS
from spl_batch.airborne.filter.air import Look, facts_of, look_at_air, noise_in_air
from spl_batch.airborne.filter.drowned_surfaces import NEAR_M
from spl_batch.airborne.filter.expected_noise import noise_model
from spl_batch.airborne.filter.stray_returns import Bare, bare_cells
from spl_batch.airborne.ground import ground_bands as bands
from spl_batch.airborne.ground import ground_methods as grounding
from spl_batch.airborne.ground.multiscale.lines_apart import Lines, lines_of
from spl_batch.airborne.ground.multiscale.masks import APART
from spl_batch.airborne.ground.water.off_water import OffWater
from spl_batch.airborne.products import surface_points
from spl_batch.airborne.settings import FilterSettings
from spl_batch.airborne.store.flown_lines import read_shifts
from spl_batch.airborne.store.label_tables import (
    Marks,
    Origin,
    label_units,
    read_region,
    tile_cells,
    write_labels,
)
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.spare_memory import give_back
from spl_batch.lattice.eastings import strips_between
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import (
    Bounds,
    grow,
    inside,
    quanta,
    shared,
)

Read = Callable[[Bounds, Sequence[str]], tuple[PointTable, Origin]]
"""Gives some columns of a region's points, and where they lie."""

T = TypeVar("T")

LABELS: Final = ("noise_class", "p_value", "ground", "noise_density", "wire")
"""Columns that units give to points; the others lie in the tiles."""

_GROUND_COLUMNS = ("x", "y", "z", "flags", "afterpulse", "range_sigma")


def denoise(args: Mapping[str, Any], context: Context) -> Produced:
    """Decide which points of a block are noise, part by part where not all of it fits in memory."""
    core = Bounds(*args["core"])
    parts = [_judged(args, context, Bounds(*part)) for part in args.get("parts") or [core]]
    path = context.store.labels("noise", args["block"])
    write_labels(path, [(part.place, part.labels) for part in parts])
    kind = np.concatenate([part.labels["noise_class"] for part in parts])
    kinds, counts = np.unique(kind, return_counts=True)
    facts = {
        "core": list(core),
        "noise_class": dict(zip(map(str, kinds.tolist()), counts.tolist(), strict=True)),
        **facts_of([part.look for part in parts]),
    }
    return Produced([path], facts, len(kind))


class _Judged(NamedTuple):
    """Labels of the points of a part of a block, where they lie, and what its air is like."""

    labels: dict[str, NDArray[Any]]
    place: Origin
    look: Look


def _judged(args: Mapping[str, Any], context: Context, core: Bounds) -> _Judged:
    """Decide which points of a part of a block are noise."""
    give_back()
    workflow, cells = context.workflow, tile_cells(args["tiles"])
    # Air is looked for farther around than the filter looks, and in fewer columns.
    wide = grow(core, args["halo"])
    seen = read_region(context.store, cells, wide, AIR_COLUMNS, {}, ordered=False)[0]
    model = noise_model(
        [seen[axis] for axis in "xyz"], args["voxels"], args["beamlets"], context.store,
        workflow.noise,
    )  # fmt: skip
    look = look_at_air(seen, model, workflow, core)
    del seen
    near = grow(core, min(args["halo"], quanta(denoising.reach_m(workflow.filter))))
    table, origin = read_region(context.store, cells, near, denoising.COLUMNS_NEEDED, {})
    owned = inside(table["x"], table["y"], core)
    place = origin.of(owned)
    del origin
    by_voxel = denoising.asks_for_means(workflow.filter)
    noise = noise_in_air(
        table, np.ones(len(table), np.bool_) if by_voxel else owned, model, look.air
    )
    mean = (noise.mean[owned] if by_voxel else noise.mean).astype(np.float32)
    local, density = noise.local, noise.mean if by_voxel else noise.local
    del model, noise
    found = denoising.resolve(table, local, workflow.filter, workflow.afterpulse)
    del local
    # What has told the afterpulses and the noise is not held while the rest is judged.
    table = table.select(("x", "y", *denoising.COLUMNS_JUDGED))
    chosen = denoising.independent(table, density, owned, found, workflow.filter)
    table = table.select(denoising.COLUMNS_JUDGED)
    del density
    decided = denoising.judge(table, chosen, owned, found, workflow.filter)
    labels: dict[str, NDArray[Any]] = {
        "noise_class": decided["noise_class"],
        "p_value": decided["p_value"],
        "wire": decided["wire"],
        "noise_density": mean,
    }
    return _Judged(labels, place, look)


def ground(args: Mapping[str, Any], context: Context) -> Produced:
    """Find the ground of a cell, strip by strip where not all of it fits in memory."""
    core, cells = Bounds(*args["core"]), tile_cells(args["tiles"])
    units, shifts = label_units(args["noise"]), read_shifts(args, context.store)
    chances = _Chances(context.workflow.filter, args["lines"]["columns"])

    def read(part: Bounds, columns: Sequence[str]) -> tuple[PointTable, Origin]:
        labels = {name: units for name in ("noise_class", *columns) if name in LABELS}
        return read_region(
            context.store, cells, part, [name for name in columns if name not in labels], labels,
            ordered=False, shifts=shifts,
        )  # fmt: skip

    region = grow(core, args["halo"])
    parts = strips_between(region, args.get("cuts", {}).get("ground", ()))

    def points(part: Bounds, bare: Bare | None, off: Marks) -> bands.Band:
        table, usable, origin = _standing(part, region, read, bare, chances.with_them(part))
        usable &= ~off.holds(origin)
        mine = inside(table["x"], table["y"], shared(core, part))
        lines, table = _lines(chances.counted(table, mine, bare, part), args)
        return bands.Band(table, usable, mine, origin, lines)

    if len(parts) == 1:
        table, origin = read(region, chances.with_them(region))
        bare = bare_cells(lambda: (table,))
        usable = surface_points.holds_ground(table, bare)
        owned = inside(table["x"], table["y"], core)
        table = chances.counted(table, owned, bare, region)
        lines, table = _lines(table, args)
        mask = grounding.ground_labels(table, usable, context.workflow.ground, owned, lines)
        found = [_owned((bands.Band(table, usable, owned, origin), mask))]
    else:
        bare = bare_cells(lambda: (read(part, ("x", "y", "z"))[0] for part in parts))
        wet = strips_between(region, args["cuts"].get("water", ()))
        off = Marks() if context.workflow.water is None else _off_water(wet, region, read, bare)
        given = partial(points, bare=bare, off=off)
        give_back()
        found = list(map(_owned, bands.ground_in_bands(lambda: map(given, parts))))
    path = context.store.labels("ground", args["cell"])
    write_labels(path, found)
    labels = [part["ground"] for _, part in found]
    facts = {"ground": int(sum(map(np.count_nonzero, labels))), "core": list(core)}
    facts["apart"] = int(sum(np.count_nonzero(part == APART) for part in labels))
    facts |= chances.facts()
    facts |= {} if bare is None else float_facts(bare, core)
    return Produced([path], facts, sum(map(len, labels)))


class _Chances:
    """P-values of noise below all surfaces, counted as points pass: nothing else needs them."""

    def __init__(self, settings: FilterSettings, further: Sequence[str]) -> None:
        self._columns = (*_GROUND_COLUMNS, *further)
        self._asked = settings.method == "vsaes" and settings.test == "calibrated"
        self._counts = np.zeros(len(P_VALUES) + 1, np.int64)
        self._seen: set[Bounds] = set()

    def with_them(self, part: Bounds) -> tuple[str, ...]:
        """Columns of the ground, and what is to be counted of a part: each is read again."""
        wanted = self._asked and part not in self._seen
        return (*self._columns, "p_value") if wanted else self._columns

    def counted(
        self, table: PointTable, mine: NDArray[np.bool_], bare: Bare | None, part: Bounds
    ) -> PointTable:
        """The table of a part without them; those of its points that are mine count, once."""
        if bare is not None and "p_value" in table:
            bare.count_chances(table, mine, P_VALUES, self._counts)
        self._seen.add(part)
        return table.select([name for name in table.columns if name != "p_value"])

    def facts(self) -> dict[str, list[int]]:
        """``p_values``: returns by p-value; nothing where there are none."""
        return {"p_values": self._counts.tolist()} if self._counts.any() else {}


def _lines(table: PointTable, args: Mapping[str, Any]) -> tuple[Lines | None, PointTable]:
    """Flightlines of the points of a table, where the survey has several, and it without them."""
    told_by, lines = args["lines"]["columns"], None
    if told_by:
        time_s = table["gps_time"] if "gps_time" in told_by else None
        lines = lines_of(table["point_source_id"], time_s, args["lines"]["span_s"])
    return lines, table.select([name for name in table.columns if name not in told_by])


def _standing(
    part: Bounds, region: Bounds, read: Read, bare: Bare | None, columns: Sequence[str]
) -> tuple[PointTable, NDArray[np.bool_], Origin]:
    """Points of a strip and around it, which of those in it are signal, and where they lie.

    Neighbours in the next strip count, as far as the cell reads.
    """
    table, origin = read(shared(grow(part, quanta(NEAR_M)), region), columns)
    usable = surface_points.stands(table, bare)
    return table, usable & inside(table["x"], table["y"], part), origin


def _off_water(parts: Sequence[Bounds], region: Bounds, read: Read, bare: Bare | None) -> Marks:
    """What in the water polygons of a cell no terrain may rest on, strip by strip."""
    waters, columns = OffWater(), ("x", "y", "z", "flags")

    def look(part: Bounds) -> None:
        waters.look(*_standing(part, region, read, bare, columns)[:2])

    def judge(part: Bounds) -> tuple[Origin, NDArray[np.int32]]:
        table, usable, origin = _standing(part, region, read, bare, columns)
        found = waters.judge(table, usable)
        return origin.of(found.rows), found.layer

    for part in parts:
        look(part)
    found = map(judge, parts) if waters.seen else ()
    return Marks([origin.of(waters.off(layer)) for origin, layer in list(found)])


def _owned(
    found: tuple[bands.Band, NDArray[np.uint8]],
) -> tuple[Origin, dict[str, NDArray[np.uint8]]]:
    """Where the points of a band lie that its cell owns, and their labels."""
    band, mask = found
    return band.origin.of(band.asked), {"ground": mask[band.asked]}
