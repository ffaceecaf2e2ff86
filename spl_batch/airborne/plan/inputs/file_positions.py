"""Whether the files of a survey lie where files of one survey can lie, as far as headers show."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.engine.findings import Finding
from spl_batch.errors import grouped, named
from spl_batch.formats.crs import like_degrees, look_like_degrees
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.trajectory.positions import ELSEWHERE_M
from spl_batch.formats.trajectory.records import Records
from spl_batch.formats.units import COMMON, METRES, Units, in_words

FAR_M: Final = 10_000.0
"""Gap up to which parts belong to a survey however short its files are [m]: groups of flightlines
and sample plots lie some kilometres apart."""

LONGEST_M: Final = 300_000.0
"""Extent of a file beyond which some of its points lie astray, however many it holds [m]."""

FEWEST_PER_M: Final = 1.0
"""Points per metre of a long file below which some of them lie astray [1/m]."""

THINNEST: Final = 1e-3
"""The same for points over the bounding box, as a share of the other files' median; and for points
of a tile, as a share of the tile of most points."""


OUTWARD: Final = np.array([-1.0, -1.0, 1.0, 1.0])
"""Which way the ends of a box move as it grows: west, south, east, north."""


def extent(places_m: ArrayLike, units: Units = METRES) -> str:
    """Box around places, (n, 2) [m], in words: in the unit of ``units``, metres beside."""
    (name, unit_m), places = units.of_places, np.asarray(places_m)
    if unit_m != 1.0:
        return f"{_box(places / unit_m, name)} ({_box(places, 'm')})"
    return _box(places, name)


def _box(places: NDArray[np.float64], unit: str) -> str:
    west, south, east, north = map(grouped, (*places.min(axis=0), *places.max(axis=0)))
    return f"{west} to {east} {unit} E, {south} to {north} {unit} N"


def beside(shapes: NDArray[Any], survey: NDArray[Any], units: Units = METRES) -> dict[str, str]:
    """Extents of shapes and of a survey's boxes, where none of the shapes meets one; else empty.

    ``units``: of the survey; shapes and boxes are in metres.
    """
    if not len(survey) or shapely.STRtree(survey).query(shapes, "intersects").size:
        return {}
    both = {"shapes": shapes, "points": survey}
    return {name: extent(shapely.get_coordinates(some), units) for name, some in both.items()}


ASTRAY: Final = (
    "none of its polygons meets the survey: they lie within {shapes}, its points within {points}; "
    "check its CRS and the order of its axes"
)
"""Remedy for polygons that :func:`beside` has extents of."""


def in_other_unit(first: Records, crs: CRS | None, survey: NDArray[Any]) -> str:
    """Fault of a trajectory without a CRS that lies by the survey in another unit than its.

    By its ``first`` records: where these lie far from ``survey``, (n,) boxes [m], as they are read,
    and near in another unit, all do.
    """
    _, position = first
    flown = np.concatenate([position[:, :2].min(axis=0), position[:, :2].max(axis=0)])
    whole = shapely.box(*shapely.total_bounds(survey))

    def away_m(unit_m: float) -> float:
        return float(shapely.distance(shapely.box(*flown * unit_m), whole))

    units = Units.of(crs)
    near = [unit for unit, unit_m in COMMON.items() if away_m(unit_m) <= ELSEWHERE_M]
    if not near or away_m(units.horizontal_m) <= ELSEWHERE_M:
        return ""
    return (
        f"its first positions lie by the survey where they are in {in_words(near[0])}, and not in "
        f"{in_words(units.horizontal)} as the survey's: name their CRS in survey.trajectory_crs"
    )


def leave_out_degrees(files: Files) -> None:
    """Leave out files without a CRS whose coordinates look like degrees."""
    found, corners = _in_degrees([facts for facts in files.holding if facts.crs is None])
    text = like_degrees(corners, "survey.crs") if found else ""
    files.leave_out(lambda facts: text if facts.path in found else None)


def _in_degrees(files: Sequence[LasFacts]) -> tuple[set[Path], list[Sequence[float]]]:
    """Files with points whose coordinates look like degrees, and corners of all that may be."""
    alike = [facts for facts in files if look_like_degrees(facts.mins_m, facts.maxs_m)]
    corners: list[Sequence[float]] = [
        corner[:2] for facts in alike for corner in (facts.mins_m, facts.maxs_m)
    ]
    return {f.path for f in alike if look_like_degrees(f.mins_m, f.maxs_m, corners)}, corners


def degrees_as_metres(files: Files) -> Iterator[Finding]:
    """Files that the survey takes as metres although their coordinates look like degrees."""
    found, _ = _in_degrees(files.holding)
    alike = (facts for facts in files.usable if facts.path in found)
    yield from (Finding("I05", {"kind": "degrees"}, files.name(facts)) for facts in alike)


def far_positions(files: Files) -> Iterator[Finding]:
    """Points far from the rest of a survey, the farthest first.

    Two kinds: a file whose own points span more than a flight does, and files that lie
    farther from all others than any file is long.
    """
    if not files.holding:
        return
    boxes, names = files.boxes, np.array([files.name(facts) for facts in files.holding], object)
    points = np.array([facts.n_points for facts in files.holding], np.float64)
    length_m = _sides(boxes).max(axis=1)
    wide = _too_wide(boxes, points)
    for k in sorted(np.flatnonzero(wide).tolist(), key=lambda k: -float(length_m[k])):
        values = {"kind": "wide", "points": int(points[k]), "km": float(length_m[k] / 1000)}
        yield Finding("I05", values, names[k], badness=float(length_m[k]))
    yield from _distant(names[~wide], boxes[~wide], points[~wide])


def _too_wide(boxes: NDArray[Any], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Files whose boxes are so large for their points that some must lie far from the others."""
    sides = np.maximum(_sides(boxes), 1.0)
    length, per_m2 = sides.max(axis=1), points / sides.prod(axis=1)
    wide = (length > LONGEST_M) | (points < FEWEST_PER_M * length)
    if len(boxes) > 2:  # of two, the other may be the odd one
        wide |= per_m2 < THINNEST * float(np.median(per_m2))
    found: NDArray[np.bool_] = wide & (length > FAR_M)
    return found


def _distant(
    names: NDArray[Any], boxes: NDArray[Any], points: NDArray[np.float64]
) -> Iterator[Finding]:
    """Parts of a survey that lie farther from the main one than files are long."""
    if not len(boxes):
        return
    longest_m = float(_sides(boxes).max())
    west, south, east, north = (shapely.bounds(boxes) + max(longest_m, FAR_M) / 2 * OUTWARD).T
    parts = shapely.get_parts(shapely.union_all(shapely.box(west, south, east, north)))
    part = shapely.STRtree(parts).query(boxes, "intersects")[1]  # each lies in one of them
    total, files = np.bincount(part, points), np.bincount(part)
    main = max(range(len(parts)), key=lambda k: (total[k], files[k], -int(np.argmax(part == k))))
    rest, first = shapely.STRtree(boxes[part == main]), named(names[part == main].tolist(), 1)
    for other in set(part.tolist()) - {main}:
        _, gaps_m = rest.query_nearest(boxes[part == other], return_distance=True)
        gap_m = float(gaps_m.min())
        values = {
            "kind": "far", "km": gap_m / 1000, "main": first, "length_m": math.ceil(longest_m),
        }  # fmt: skip
        for name in names[part == other].tolist():
            yield Finding("I05", values, name, badness=gap_m)


def saved_again(files: Files) -> Iterator[Finding]:
    """Files with as many points as another in the same box, by another scale.

    Their coordinates are rounded differently, so no point is recognised as a copy of another.
    """
    seen: dict[tuple[int, ...], list[LasFacts]] = {}
    for facts in files.holding:
        corner = (facts.n_points, *(round(value) for value in facts.mins_m[:2]))
        for like in seen.setdefault(corner, []):
            unit = np.maximum(facts.scales, like.scales)
            corners = np.subtract([facts.mins_m, facts.maxs_m], [like.mins_m, like.maxs_m])
            if facts.scales != like.scales and (np.abs(corners) <= unit).all():
                both = f"{files.name(facts)} and {files.name(like)}"
                values = {"kind": "saved", "points": facts.n_points}
                yield Finding("I03", values, both, badness=facts.n_points)
        seen[corner].append(facts)


def _sides(boxes: NDArray[Any]) -> NDArray[np.float64]:
    """Edges of boxes along both axes: (n, 2) [m]."""
    ends = shapely.bounds(boxes)
    sides: NDArray[np.float64] = ends[:, 2:] - ends[:, :2]
    return sides
