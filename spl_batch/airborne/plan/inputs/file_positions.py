"""Whether the files of a survey lie where files of one survey can lie, as far as headers show."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray
from pyproj import CRS

from spl_batch.engine.findings import Finding
from spl_batch.errors import InputError, grouped, named
from spl_batch.formats.crs import like_degrees, look_like_degrees
from spl_batch.formats.las.reader import LasFacts, inspect
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


def extent(places_m: ArrayLike, units: Units = METRES) -> str:
    """Box around places, (n, 2) [m], in words: in the unit of ``units``, metres beside."""
    (name, unit_m), places = units.of_places, np.asarray(places_m)
    if unit_m != 1.0:
        return f"{_box(places / unit_m, name)} ({_box(places, 'm')})"
    return _box(places, name)


def _box(places: NDArray[np.float64], unit: str) -> str:
    west, south, east, north = map(grouped, (*places.min(axis=0), *places.max(axis=0)))
    return f"{west} to {east} {unit} E, {south} to {north} {unit} N"


def boxes_of(files: Iterable[LasFacts]) -> NDArray[Any]:
    """Boxes around the points of files that hold some: (n,) polygons [m]."""
    ends = [[*f.mins_m[:2], *f.maxs_m[:2]] for f in files if f.n_points]
    boxes: NDArray[Any] = shapely.box(*np.transpose(ends))
    return boxes


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


def usable(
    files: Iterable[LasFacts], fault_of: Callable[[LasFacts], str | Sequence[str] | None]
) -> tuple[list[LasFacts], list[InputError]]:
    """Files that can be used, and what is wrong with the others."""
    faults = [(facts, fault_of(facts)) for facts in files]
    bad = [InputError(str(facts.path), fault) for facts, fault in faults if fault]
    return [facts for facts, fault in faults if not fault], bad


def inspected(paths: Iterable[Path]) -> tuple[list[LasFacts], list[InputError]]:
    """Facts of the files whose headers can be read, and what is wrong with the others."""
    good: list[LasFacts] = []
    bad: list[InputError] = []
    for path in paths:
        try:
            good.append(inspect(path))
        except InputError as error:
            bad.append(error)
    return good, bad


def without_degrees(
    files: Sequence[LasFacts], stated: str | None
) -> tuple[list[LasFacts], list[InputError]]:
    """Files but those without a CRS that look like degrees, and a fault of each of these.

    With a ``stated`` CRS every file is taken at the user's word.
    """
    silent = [f for f in files if stated is None and f.crs is None and f.n_points]
    found, corners = _in_degrees(silent)
    text = like_degrees(corners, "survey.crs") if found else ""
    return usable(files, lambda facts: text if facts.path in found else None)


def _in_degrees(files: Sequence[LasFacts]) -> tuple[set[Path], list[Sequence[float]]]:
    """Files with points whose coordinates look like degrees, and corners of all that may be."""
    alike = [facts for facts in files if look_like_degrees(facts.mins_m, facts.maxs_m)]
    corners: list[Sequence[float]] = [
        corner[:2] for facts in alike for corner in (facts.mins_m, facts.maxs_m)
    ]
    return {f.path for f in alike if look_like_degrees(f.mins_m, f.maxs_m, corners)}, corners


def degrees_as_metres(files: Sequence[tuple[str, LasFacts]]) -> Iterator[Finding]:
    """Files whose coordinates look like degrees but are taken as metres.

    ``files``: sequence of (str, LasFacts), name and header of each file that the survey takes.
    """
    found, _ = _in_degrees([facts for _, facts in files if facts.n_points])
    yield from (Finding("I05", {"kind": "degrees"}, name) for name, f in files if f.path in found)


def far_positions(files: Sequence[tuple[str, LasFacts]]) -> Iterator[Finding]:
    """Points far from the rest of a survey, the farthest first.

    Two kinds: a file whose own points span more than a flight does, and files that lie
    farther from all others than any file is long.

    ``files``: sequence of (str, LasFacts), name and header of each file.
    """
    held = [(name, facts) for name, facts in files if facts.n_points]
    if not held:
        return
    boxes = np.array([(*facts.mins_m[:2], *facts.maxs_m[:2]) for _, facts in held])
    points = np.array([facts.n_points for _, facts in held], np.float64)
    length_m = _sides(boxes).max(axis=1)
    astray = np.flatnonzero(_too_wide(boxes, points)).tolist()
    wide = sorted(astray, key=lambda k: -float(length_m[k]))
    for k in wide:
        values = {"kind": "wide", "points": int(points[k]), "km": float(length_m[k] / 1000)}
        yield Finding("I05", values, held[k][0], badness=float(length_m[k]))
    rest = [k for k in range(len(held)) if k not in set(wide)]
    yield from _distant([held[k][0] for k in rest], boxes[rest], points[rest])


def _too_wide(boxes: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Files whose boxes are so large for their points that some must lie far from the others."""
    sides = np.maximum(_sides(boxes), 1.0)
    length, per_m2 = sides.max(axis=1), points / sides.prod(axis=1)
    wide = (length > LONGEST_M) | (points < FEWEST_PER_M * length)
    if len(boxes) > 2:  # of two, the other may be the odd one
        wide |= per_m2 < THINNEST * float(np.median(per_m2))
    found: NDArray[np.bool_] = wide & (length > FAR_M)
    return found


def _distant(
    names: Sequence[str], boxes: NDArray[np.float64], points: NDArray[np.float64]
) -> Iterator[Finding]:
    """Parts of a survey that lie farther from the main one than files are long."""
    if not len(boxes):
        return
    longest_m = float(_sides(boxes).max())
    parts = _parts(boxes, max(longest_m, FAR_M))
    main = max(parts, key=lambda part: (points[part].sum(), len(part), -part[0]))
    for part in parts:
        if part is main:
            continue
        gap_m = min(float(_gaps(boxes[main], boxes[k]).min()) for k in part)
        values = {
            "kind": "far", "km": gap_m / 1000, "main": named([names[k] for k in main], 1),
            "length_m": math.ceil(longest_m),
        }  # fmt: skip
        yield from (Finding("I05", values, names[k], badness=gap_m) for k in part)


def saved_again(files: Sequence[tuple[str, LasFacts]]) -> Iterator[Finding]:
    """Files with as many points as another in the same box, by another scale.

    Their coordinates are rounded differently, so no point is recognised as a copy of another.
    """
    seen: dict[tuple[int, ...], list[tuple[str, LasFacts]]] = {}
    for name, facts in files:
        corner = (facts.n_points, *(round(value) for value in facts.mins_m[:2]))
        for other, like in seen.setdefault(corner, []):
            unit = np.maximum(facts.scales, like.scales)
            corners = np.subtract([facts.mins_m, facts.maxs_m], [like.mins_m, like.maxs_m])
            if facts.n_points and facts.scales != like.scales and (np.abs(corners) <= unit).all():
                values = {"kind": "saved", "points": facts.n_points}
                yield Finding("I03", values, f"{name} and {other}", badness=facts.n_points)
        seen[corner].append((name, facts))


def _sides(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    sides: NDArray[np.float64] = boxes[:, 2:] - boxes[:, :2]
    return sides


def _gaps(boxes: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Straight distance of each box from another, 0 where they touch [m]."""
    apart = np.maximum(boxes[:, :2] - other[2:], other[:2] - boxes[:, 2:])
    gaps: NDArray[np.float64] = np.hypot(*np.maximum(apart, 0.0).T)
    return gaps


def _parts(boxes: NDArray[np.float64], gap_m: float) -> list[list[int]]:
    """Places of the boxes that are joined over gaps of no more than this, part by part."""
    left = np.arange(len(boxes))
    parts = []
    while len(left):
        front, left, part = [int(left[0])], left[1:], list[int]()
        while front:
            k = front.pop()
            part.append(k)
            near = _gaps(boxes[left], boxes[k]) <= gap_m
            front += left[near].tolist()
            left = left[~near]
        parts.append(sorted(part))
    return parts
