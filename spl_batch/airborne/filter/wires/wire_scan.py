"""Directional scan with voting: conductors too thin for a test of single points.

Domain: space. Most of the 15 nearest neighbours of a conductor with 0.1-0.3 returns per metre and
flightline are noise. What it has is length. The scan

1. leaves out what a surface explains: returns whose surrounding 3 m cube holds at least
   ``surface_returns`` and twice the noise expected there;
2. looks through each remaining point for the fullest tube among nearly horizontal directions
   (:mod:`~spl_batch.airborne.filter.wires.line_hough`), and half as long again where enough was
   found: p = directions tried x P(K >= k | lambda of the tube);
3. counts the tubes that agree: those that prolong it over ``stretch`` times its half-length and
   those of conductors beside it (:mod:`~spl_batch.airborne.filter.wires.tubes`). Each is
   worth :data:`AGREES` powers of ten;
4. drops tubes that cross others on their line, or lie in a sheet of returns;
5. keeps points in at least ``votes`` tubes that are significant with all of this. A chance tube
   keeps :data:`MEMBERS` points at once, so alpha is divided by that;
6. on request calls points conductors that :data:`SURE_VOTES` significant tubes hold closely. These
   tubes are filled from end to end and free: beside, above and below them is next to nothing but
   noise and a few lines alongside. Edges of roofs, walls, fences and crowns are not.

Tubes shrink where more than :data:`CROWD` noise points would be met. A hash of their coordinates
draws the points to start from; all others are counted and voted for.

Nothing here needs the verdict of the ellipsoid test, so the reaches of the two do not add.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from spl_batch.airborne.filter.cube_counts import cube_counts
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.filter.wires.line_hough import fullest
from spl_batch.airborne.filter.wires.tubes import (
    PARTS,
    Tubes,
    agreeing,
    refine,
    surroundings,
    vote,
)
from spl_batch.airborne.settings import WireSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.lattice_columns import Columns, columns
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.poisson import noise_tail_probability

CELL_M: Final = 1.0
"""Cell of the density that shows a surface [m]; 27 of them are counted. Half and twice move 107 +
81 and 28 + 24 labels."""

CROWD: Final = 100.0
"""Noise points in the double cone of the first look from which on tubes get shorter [count]."""

LOOKS: Final = (1.0, 1.5)
"""Length of tubes in the first and in the second look [length of the first]. Half and twice move 30
+ 33 and 193 + 125 labels."""

SCREEN: Final = (0.1, 0.1)
"""Share of pure noise that may pass each of them. Half and twice move 4 + 13 and 16 + 5 labels."""

DIRECTIONS: Final = 0.16
"""Independent directions per (r/L)^2 of azimuth times slope, from uniform noise. Half and twice
move 26 + 11 and 5 + 16 labels."""

LEAST_M: Final = 1.5
"""Nearest neighbour that gives a direction [m]. Half and twice move 2 + 8 and 17 + 22 labels."""

AGREES: Final = 0.6
"""Powers of ten that one agreeing tube is worth, in line or beside. Without those beside 89 instead
of 91 % of weak wires are kept; those in line may be worth twice as much, and nothing moves."""

TURN_MAX: Final = 0.05
"""Largest difference of agreeing directions [rad, rise/run]. Half and twice move 4 + 11 and 18 + 34
labels."""

BESIDE_M: Final = 6.0
"""Farthest conductor of the same line, across and upwards [m]. Half moves 0 + 1 labels, twice
nothing."""

MEMBERS: Final = 8.0
"""Points that a chance tube keeps per point started from; divides alpha. Half and twice move 9 + 4
and 2 + 4 labels."""

SURE_VOTES: Final = 3
SURE_RADIUS: Final = 0.6
"""Free tubes that give a point its class: how many must hold it, and within which part of their
half-width. With a third and twice of the first 99.3 and 97.5 instead of 98.9 % of a wire have it
over water, with half of the second 82 %."""

RINGS_M: Final = (0.4, 0.8, 2.0)
"""Distances off the line of a tube: its own returns, its nearest surroundings, and all that must be
free but for the conductors beside it [m]."""

BESIDE_MOST: Final = (0.15, 2.0)
"""Most returns beyond noise, per return of the line, from the first to the second of these
distances, and from there to the third."""


class Found(NamedTuple):
    """Result of the scan for the m points asked for."""

    signal: NDArray[np.bool_]  #: (m,): kept by the scan.
    #: (m,): sure enough to be classified as a conductor; all False where that is not asked for.
    wire: NDArray[np.bool_]
    #: (m,): of the point's own tube and its agreeing ones; alpha for points voted for, NaN without
    #: a tube.
    p_value: NDArray[np.float32]


def reach_m(settings: WireSettings) -> float:
    """How far the scan of a point looks [m]."""
    if not settings.enabled:
        return 0.0
    # Its line moves only across, where its flanks lie too: little is added to its length.
    tube = settings.half_length_m + 3.0 * settings.radius_m
    agreeing_m = math.hypot(settings.stretch * settings.half_length_m, BESIDE_M)
    # A voting tube, one that agrees with it, that one's returns, their cubes.
    return 2.0 * tube + agreeing_m + 2.0 * CELL_M


def scan(cloud: Cloud, settings: WireSettings) -> Found:
    """Look for conductors among the points that no surface explains, for those asked for.

    The cloud is right in its halo as far as :func:`reach_m`.
    """
    n = len(cloud.xyz)
    signal, wire = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    p_value = np.full(n, np.nan, dtype=np.float32)
    free = np.flatnonzero(~_explained(cloud, settings))
    if settings.enabled and cloud.asked.any() and len(free):
        made = columns(cloud.xyz, free, cloud.anchor, _first_look(settings))
        tubes = _tubes(cloud, made, free, settings)
        score = MEMBERS * _score(tubes, cloud.anchor, settings)
        strong = score <= settings.alpha
        votes = _votes(made, tubes, strong, n, settings, 1.0)
        signal = votes >= settings.votes
        p_value[signal] = settings.alpha
        own = tubes.row[strong]
        p_value[own] = np.where(signal[own], score[strong], np.nan)
        if settings.classify:
            sure = strong.copy()
            sure[sure] = _free(cloud, tubes, sure, settings)
            wire = _votes(made, tubes, sure, n, settings, SURE_RADIUS) >= SURE_VOTES
            wire &= signal
    return Found(signal[cloud.asked], wire[cloud.asked], p_value[cloud.asked])


def _explained(cloud: Cloud, settings: WireSettings) -> NDArray[np.bool_]:
    """Points of dense surfaces: (n,) bool."""
    count = cube_counts(cloud.xyz, cloud.anchor, quanta(CELL_M))
    noise = 27.0 * CELL_M**3 * cloud.density
    dense: NDArray[np.bool_] = count >= settings.surface_returns + 2.0 * noise
    return dense


def _tubes(cloud: Cloud, made: Columns, free: NDArray[np.intp], settings: WireSettings) -> Tubes:
    """Fullest tubes of the points to start from, those worth keeping."""
    margin = quanta((1.0 + settings.stretch) * settings.half_length_m + BESIDE_M + 2.0)
    near = cloud.around(margin, (0, 1))[free]
    row = free[near][_drawn(cloud, free[near], settings.seed_share)]
    cone = 4.0 / 3.0 * np.pi * settings.slope_max
    seed = np.empty(len(cloud.xyz), np.int32)
    for factor, screen in zip(LOOKS, SCREEN, strict=True):
        seed[:] = -1
        seed[row] = np.arange(len(row), dtype=np.int32)
        density = cloud.density[row]
        short_m = np.minimum(
            settings.half_length_m / LOOKS[1], np.cbrt(CROWD / (cone * np.maximum(density, 1e-9)))
        )
        length = np.maximum(short_m, 2.0 * LEAST_M) * factor * QUANTA_PER_M
        tried = _directions(settings, factor * settings.half_length_m / LOOKS[1])
        count = np.zeros(len(row), np.int32)
        azimuth, slope, expected = (np.zeros(len(row)) for _ in range(3))
        fullest(
            made, seed, length,
            density / QUANTA_PER_M**3, _largest_expected(tried, screen),
            settings.radius_m * QUANTA_PER_M, LEAST_M * QUANTA_PER_M, settings.slope_max,
            _bend(settings), count, azimuth, slope, expected,
        )  # fmt: skip
        kept = count > 0
        row, length, count = row[kept], length[kept], count[kept]
        azimuth, slope, expected = azimuth[kept], slope[kept], expected[kept]
    tried = _directions(settings, settings.half_length_m)
    p = np.minimum(1.0, tried * noise_tail_probability(count, expected))
    tubes = Tubes(row, np.zeros((len(row), 3)), azimuth, slope, length, p)
    return _refined(cloud, made, tubes, settings)


def _refined(cloud: Cloud, made: Columns, tubes: Tubes, settings: WireSettings) -> Tubes:
    """Tubes with their lines laid through the returns inside."""
    tubes.middle[:] = cloud.xyz[tubes.row]
    flank = np.zeros(len(tubes.row), np.int32)
    refine(made, tubes, settings.radius_m * QUANTA_PER_M, _bend(settings), flank)
    return tubes._replace(p=np.where(flank > 0, 1.0, tubes.p))


def _score(
    tubes: Tubes, anchor: tuple[int, int, int], settings: WireSettings
) -> NDArray[np.float64]:
    """Probability of each tube with those that agree with it, if all is noise: (m,) float64."""
    agree, against = (np.zeros(len(tubes.row), np.int32) for _ in range(2))
    if len(tubes.row):
        places = np.rint(tubes.middle).astype(np.int32)
        made = columns(places, np.arange(len(places)), anchor, _first_look(settings))
        agreeing(
            made, tubes, settings.stretch, settings.radius_m * QUANTA_PER_M,
            BESIDE_M * QUANTA_PER_M, TURN_MAX, _bend(settings), agree, against,
        )  # fmt: skip
    score = tubes.p * 10.0 ** (-AGREES * agree)
    return np.where(against > 0, 1.0, score)


def _free(
    cloud: Cloud, tubes: Tubes, chosen: NDArray[np.bool_], settings: WireSettings
) -> NDArray[np.bool_]:
    """Chosen tubes that go on from end to end with little beside their line: (m,) bool.

    Most of their parts hold returns of the line.
    """
    m = int(np.count_nonzero(chosen))
    count, held = np.zeros((m, len(RINGS_M)), np.int32), np.zeros((m, PARTS), np.bool_)
    length = tubes.length[chosen]
    if m:
        made = columns(cloud.xyz, np.arange(len(cloud.xyz)), cloud.anchor, _first_look(settings))
        rings = np.array(RINGS_M) * QUANTA_PER_M
        surroundings(made, tubes.take(chosen), rings, _bend(settings), count, held)
    area = (2.0 * np.array(RINGS_M)) ** 2
    along = 2.0 * length / QUANTA_PER_M * cloud.density[tubes.row[chosen]]
    noise = along[:, None] * area
    own = np.maximum(count[:, 0] - noise[:, 0], 1.0)
    free: NDArray[np.bool_] = held.sum(axis=1) > (~held).sum(axis=1)
    for ring, most in enumerate(BESIDE_MOST, start=1):
        expected = noise[:, ring] - noise[:, 0]
        beside = count[:, ring] - count[:, 0]
        free &= beside <= most * own + expected + np.sqrt(expected)
    return free


def _votes(
    made: Columns,
    tubes: Tubes,
    chosen: NDArray[np.bool_],
    n: int,
    settings: WireSettings,
    part: float,
) -> NDArray[np.int32]:
    """Chosen tubes that hold each point within a part of their half-width: (n,) int32."""
    votes = np.zeros(n, np.int32)
    radius = part * settings.radius_m * QUANTA_PER_M
    vote(made, tubes.take(chosen), radius, _bend(settings), votes)
    return votes


def _first_look(settings: WireSettings) -> int:
    """Half-length of a tube in the first look [quanta]; the edge of columns too, for speed only."""
    return quanta(settings.half_length_m / LOOKS[1])


def _bend(settings: WireSettings) -> float:
    """Parabola of the typical conductor, z = x^2 / (2 c), in 1/quanta."""
    return 0.5 / (settings.catenary_m * QUANTA_PER_M)


def _directions(settings: WireSettings, length_m: float) -> float:
    """Independent directions that are tried."""
    solid = np.pi * 2.0 * settings.slope_max
    return float(max(1.0, DIRECTIONS * solid * (length_m / settings.radius_m) ** 2))


def _largest_expected(tried: float, screen: float) -> NDArray[np.float64]:
    """Largest lambda at which k returns still pass: tried x P(K >= k) = screen; by k."""
    count = np.arange(1, 256)
    return np.concatenate([[-1.0], gammaincinv(count, min(screen / tried, 1.0))])


def _drawn(cloud: Cloud, rows: NDArray[np.intp], share: float) -> NDArray[np.bool_]:
    """Points to start from, by a hash of the absolute coordinates: (m,) bool."""
    mixed = np.zeros(len(rows), dtype=np.uint64)
    for axis in range(3):
        absolute = cloud.xyz[rows, axis].astype(np.int64) + cloud.anchor[axis]
        mixed = (mixed ^ absolute.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    drawn: NDArray[np.bool_] = (mixed >> np.uint64(32)) < share * 2.0**32
    return drawn
