"""Haze and cloud of a whole survey: those that touch are one, and the largest is named."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.noise.haze import CUBE_M, WINDOW
from spl_batch.airborne.report.fit.places import Box, Terrain, around, joined, within
from spl_batch.airborne.report.noise_model import Haze
from spl_batch.constants import CLASS_HIGH_NOISE, CLASS_LOW_NOISE, QUANTUM_M
from spl_batch.engine.report.number_format import as_ascii, significant
from spl_batch.engine.report.run_record import Receipts
from spl_batch.lattice.tiles import quanta

TOLD: Final = 1.25
"""Times more noise than expected that is told; the model is within 1.03 in all strata that were
simulated."""

LEAST_M2: Final = 500.0
"""Area from which haze is told [m2]."""

EDGES: Final = (0.05, 0.95)
"""Shares of the returns that lie below the lower and the upper end of a cloud."""


class Piece(NamedTuple):
    """Air over one place, between two heights."""

    box: Box
    low: int  #: Heights between which nine tenths of its returns lie [quanta].
    high: int
    squares: int  #: Cubes, seen from above [count].
    cubes: int
    returns: int
    expected: float  #: Returns by the model [count].
    ground_m: float | None  #: Median terrain below it.


class Cloud(NamedTuple):
    """Pieces that touch and overlap in height."""

    pieces: Sequence[Piece]

    def total(self, key: str) -> float:
        """Sum over all pieces."""
        return float(sum(getattr(piece, key) for piece in self.pieces))

    @property
    def area_m2(self) -> float:
        """Area that it covers; where one piece hangs above another it counts once [m2]."""
        held: dict[tuple[int, int], list[int]] = {}
        for piece in self.pieces:
            west, south = (side // quanta(WINDOW * CUBE_M) for side in piece.box[:2])
            held.setdefault((west, south), []).append(piece.squares)
        squares = sum(max(*some, min(sum(some), WINDOW**2)) for some in held.values())
        return squares * CUBE_M**2


def haze(done: Receipts, context: Context) -> Haze | None:
    """Largest haze of the whole survey, and how much more there is; None where there is none.

    Cubes around a clump of noise at the edge of a swath hold no more than the model expects.
    """
    parts = [r.facts["air"] for r in done.get("denoise", {}).values() if r.facts.get("air")]
    if sum(part["squares"] for part in parts) * CUBE_M**2 < LEAST_M2:
        return None
    terrain = Terrain(context.output)
    pieces = [piece for part in parts for piece in _pieces(part, terrain)]
    clouds = [cloud for cloud in _clouds(pieces) if _is_told(cloud)]
    if max((cloud.area_m2 for cloud in clouds), default=0.0) < LEAST_M2:
        return None
    clouds.sort(key=lambda cloud: (-cloud.area_m2, tuple(cloud.pieces[0].box)))
    return _described(clouds[0], clouds[1:])


def haze_warning(found: Haze | None) -> Iterator[str]:
    """Sentence that names haze, its place and its consequence."""
    if found is None or found.low_m is None or found.high_m is None or found.extent_m is None:
        return
    west, east, south, north = (round((side or 0.0) / QUANTUM_M) for side in found.extent_m)
    base, top = found.above_ground_m, found.top_above_ground_m
    means = "haze or cloud; its returns are class 18, and weak signals among them are lost"
    if base is None or top is None:
        where = f"between heights of {found.low_m:.0f} and {found.high_m:.0f} m"
    elif found.noise_class == CLASS_LOW_NOISE:
        where = f"between {max(round(-top), 0)} and {round(-base)} m below ground"
        means = "no haze, for that lies above; its returns are class 7"
    else:
        where = f"between {max(round(base), 0)} and {round(top)} m above ground"
    times = "more than" if found.times_expected is None else f"{found.times_expected:.1f} times"
    yield as_ascii(
        f"noise {where} is {times} what the model of the noise expects, over "
        f"{significant(found.area_km2, 2)} km2 {within([[west, south, east, north]])}: "
        f"{means}{_more(found)}"
    )


def _more(found: Haze) -> str:
    """What is told of other clouds."""
    if not found.others:
        return ""
    area = significant(found.others_area_km2, 2)
    if found.others == 1:
        return f". There is 1 more such place, of {area} km2"
    return f". There are {found.others} more such places, {area} km2 in all"


def _is_told(cloud: Cloud) -> bool:
    return cloud.total("returns") >= TOLD * cloud.total("expected")


def _pieces(part: Mapping[str, Any], terrain: Terrain) -> Iterator[Piece]:
    """Air of a block by place; of a receipt that knows no places as a whole."""
    edge = quanta(CUBE_M)
    found = [
        ([side * edge for side in box], low * edge, (high + 1) * edge, *counts)
        for *box, low, high, squares, cubes, returns, expected in part.get("places", ())
        for counts in [(squares, cubes, returns, expected)]
    ] or [
        (
            part["box"],
            *(part[k] for k in ("low", "high", "squares", "cubes", "returns", "expected")),
        )
    ]
    middles = [(low + high) * QUANTUM_M / 2 for _, low, high, *_ in found]
    below = terrain.below([one[0] for one in found], middles)
    for one, ground_m in zip(found, below, strict=True):
        yield Piece(*one, ground_m)


def _clouds(pieces: Sequence[Piece]) -> Iterator[Cloud]:
    """Pieces in places that touch, and whose heights overlap or meet."""

    def alike(i: int, j: int) -> bool:
        return pieces[i].low <= pieces[j].high and pieces[j].low <= pieces[i].high

    place = quanta(WINDOW * CUBE_M)
    places = [
        [side // place * place for side in piece.box[:2]]
        + [-(-side // place) * place for side in piece.box[2:]]
        for piece in pieces
    ]
    for group in joined(places, alike):
        yield Cloud([pieces[k] for k in group])


def _described(cloud: Cloud, others: Sequence[Cloud]) -> Haze:
    """The entry of the report."""
    pieces = cloud.pieces
    returns, expected = cloud.total("returns"), cloud.total("expected")
    west, south, east, north = (side * QUANTUM_M for side in around([p.box for p in pieces]))
    weights = np.array([piece.returns for piece in pieces])
    ends = np.array([[piece.low, piece.high] for piece in pieces]) * QUANTUM_M
    low, high = _ends(ends, weights)
    ground = np.array([np.nan if p.ground_m is None else p.ground_m for p in pieces])
    known = np.isfinite(ground)
    base = top = kind = None
    if known.any():
        above = ends[known] - ground[known, np.newaxis]
        base, top = _ends(above, weights[known], (0.5, 0.5))
        over = weights[known][above.sum(axis=1) > 0.0].sum()
        kind = CLASS_HIGH_NOISE if 2 * over >= weights[known].sum() else CLASS_LOW_NOISE
    return Haze(
        low_m=low,
        high_m=high,
        above_ground_m=base,
        top_above_ground_m=top,
        noise_class=kind,
        area_km2=cloud.area_m2 * 1e-6,
        extent_m=(west, east, south, north),
        returns=int(returns),
        mean_per_m3=returns / (cloud.total("cubes") * CUBE_M**3),
        times_expected=returns / expected if expected else None,
        others=len(others),
        others_area_km2=sum(other.area_m2 for other in others) * 1e-6 if others else None,
    )


def _ends(
    ends: NDArray[np.float64], weights: NDArray[np.int64], shares: tuple[float, float] = EDGES
) -> tuple[float, float]:
    """Lower and upper end of all: so many of the returns lie in pieces with a lower one."""
    found = []
    for values, share in zip(ends.T, shares, strict=True):
        order = np.argsort(values, kind="stable")
        below = np.cumsum(weights[order]) / weights.sum()
        found.append(float(values[order[np.searchsorted(below, share)]]))
    return found[0], found[1]
