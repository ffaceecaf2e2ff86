r"""Decision which afterpulse candidates are afterpulses, by the returns around them.

Domain: space. The source gives up on vegetation and loses the bottom of water [W17 7.6]: a true
second return has the same signature as an afterpulse. *Other* beamlets distinguish them. For a
candidate at lag :math:`l` two rates per metre of beamlet compete:

- :math:`\lambda_a = p \sum f(l)`, afterpulses: column ``afterpulse_rate``, by the flightline's law
  (:mod:`~spl_batch.airborne.afterpulse.afterpulse_law`);
- :math:`\lambda_t = \rho\, r / n`, true returns: :math:`\rho` is the density of returns around it
  [1/m3] (:mod:`~spl_batch.airborne.afterpulse.foliage`). :math:`n / r`, expected noise density over
  the beamlet's noise rate, is the length of beamlets per volume that listened [m/m3].

The probability is :math:`\lambda_a / (\lambda_a + \lambda_t)`. Returns count in :math:`\rho` by the
time domain's probability that they are true.

A surface is hard where returns without a parent make a plane, and next to nothing lies at the
candidate's depth. Behind it a candidate is an afterpulse, unless other beamlets' returns fill a
flat ellipsoid parallel to the plane: then there is a surface, such as the bottom of water. Within
water polygons fewer of them do.

A budget :math:`B` is the share of true returns that may go. At constant rates, odds of at least
:math:`\theta` mean lags up to :math:`s \ln(p / (s \theta \lambda_t))`. The share of true returns
within them is at most :math:`p / (e \theta)`, where :math:`s \lambda_t / p = 1 / (e \theta)`. So
:math:`\theta = p / (e B)` keeps the budget in any foliage; in clumps smaller odds keep it.

In crowns the two rates are of one size. ``docs/evidence/afterpulses.md`` has
removed against lost beside the best that the simulation's laws allow.
"""

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import foliage
from spl_batch.airborne.afterpulse.hard_surfaces import SHARP
from spl_batch.airborne.afterpulse.returns_behind_planes import behind_plane, parents_of
from spl_batch.airborne.afterpulse.shot_evidence import AFTERPULSE_MIN
from spl_batch.airborne.afterpulse.weighted_counts import UNIT, weigh_around
from spl_batch.airborne.beams.dependent_returns import LAG_M, dependents
from spl_batch.airborne.beams.shot_runs import Beamlets
from spl_batch.airborne.settings import AfterpulseSettings
from spl_batch.lattice.lattice_columns import columns, most_around
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import EXCLUDED, ROWS_AT_ONCE, PointFlag, PointTable
from spl_batch.lattice.tiles import quanta

COLUMNS_NEEDED: Final = (
    "x", "y", "z", "gps_time", "channel", "flags", "line_density", "afterpulse", "afterpulse_rate",
    "afterpulse_share", "range_sigma",
)  # fmt: skip

WIDE_M: Final = foliage.KERNELS_M[0][0]
"""How far a count of returns looks, and how far aside a parent is sought [m]."""

REACH_M: Final = foliage.REACH_M
"""How far a decision looks: parents around it, what follows them, and counts around both [m]."""

SURFACE_MAX: Final = 0.35
"""A candidate behind a hard surface on land is a surface itself below this; in water polygons it is
below :data:`~spl_batch.airborne.afterpulse.shot_evidence.AFTERPULSE_MIN`. Half and twice move 30 +
13 and 257 + 171 labels."""

PLANE_M: Final = (0.8, 1.0)
"""Radius and least half-height of the cylinder around a parent in which a plane is sought [m]."""

SPREADS: Final = (4.0, 7.0)
"""Vertical radius of the ellipsoid that finds surfaces behind hard ones, and half-height of the
cylinder where that is more [ranging spreads]; a plane is :data:`SHARP` thick to either side."""

PLANE_SHARE: Final = 0.7
PLANE_LEAST: Final = 8
"""Returns in the cylinder that lie on the plane: their least share, and least number [count]. Half
and twice move 219 + 439 and 508 + 377 labels for the first, 210 + 218 and 187 + 204 for the second.
With 6 1.71 instead of 1.58 % of true returns of clumps are lost."""

CLUMPED_ODDS: Final = 0.3
"""Odds in clumps over odds at constant rates: about as much of the budget is then lost in clumps as
in evenly turbid crowns. Half and twice move 2 + 41 and 3 + 31 labels; at 1, 59 instead of 71 % of
the afterpulses in clumps are removed."""


class Chances(NamedTuple):
    """Probabilities of the time domain's candidates, by their neighbourhood."""

    #: (m,): candidates where noise is expected, so that the beamlets that listened are known; in
    #: no particular order.
    rows: NDArray[np.intp]
    chance: NDArray[np.float64]  #: (m,): probability that each is an afterpulse.
    #: (m,): whether it lies behind a hard surface, of its shot or of all flightlines.
    hard: NDArray[np.bool_]
    #: (m,): whether the leaves around it hang evenly, 0, or in clumps, towards 1.
    clumped: NDArray[np.float64]
    #: (m,): whether its parent is too far in front for it to share the parent's label.
    far: NDArray[np.bool_]


class Echoes(NamedTuple):
    """Afterpulses, and returns that depend on another one: two (n,) bool."""

    echo: NDArray[np.bool_]
    dependent: NDArray[np.bool_]


def resolve(
    table: PointTable,
    density: NDArray[np.float64],
    settings: AfterpulseSettings,
    beamlets: Beamlets,
) -> Echoes:
    """Decide about the time domain's candidates.

    Parameters
    ----------
    table : PointTable
        Points of a block and its halo in canonical order. Without ``afterpulse`` there are no
        candidates; as published the time domain decides alone.
    density : (n,) float64
        Expected noise at each point [1/m3].
    beamlets : Beamlets
        Of the table.
    """
    found = believed(table)
    if "afterpulse" not in table or settings.method == "published":
        return found
    dependent = dependents(table)
    rows, chance, hard, clumped, far = probability(table, density, beamlets)
    spared = np.where(table.has(PointFlag.WATER)[rows], AFTERPULSE_MIN, SURFACE_MAX)
    enough = _enough(table, rows, clumped, settings)
    # A return as likely an afterpulse as not is no evidence, and has no label to share.
    enough = np.where(far, np.minimum(enough, AFTERPULSE_MIN), enough)
    found.echo[rows] = chance >= np.where(hard, spared, enough)
    dependent[rows] = chance >= AFTERPULSE_MIN
    return Echoes(found.echo, dependent & ~found.echo & ~table.has(EXCLUDED))


def _enough(
    table: PointTable, rows: NDArray[np.intp], clumped: NDArray[np.float64],
    settings: AfterpulseSettings,
) -> NDArray[np.float64]:  # fmt: skip
    """Probability from which a candidate is believed to keep the budget: (m,) float64."""
    share = table["afterpulse_share"][rows].astype(np.float64)
    odds = share / (math.e * settings.vegetation_loss) * CLUMPED_ODDS**clumped**3
    return odds / (1.0 + odds)


def believed(table: PointTable) -> Echoes:
    """The time domain's word alone, for clouds that are not filtered."""
    echo = np.zeros(len(table), np.bool_)
    if "afterpulse" in table:
        echo = (table["afterpulse"] >= AFTERPULSE_MIN) & ~table.has(EXCLUDED)
    return Echoes(echo, np.zeros(len(table), np.bool_))


def probability(table: PointTable, density: NDArray[np.float64], beamlets: Beamlets) -> Chances:
    """Probability that each candidate is an afterpulse, by its neighbourhood.

    ``table, density, beamlets``: as in :func:`resolve`, points in canonical order.
    """
    if not len(table):
        none = np.empty(0, np.bool_)
        return Chances(np.empty(0, np.intp), np.empty(0), none, np.empty(0), none)
    usable = ~table.has(EXCLUDED)
    known = (table["afterpulse_rate"] > 0) & usable & (density > 0) & (table["line_density"] > 0)
    places = _Places(table)
    rows, at = places.in_turn(np.flatnonzero(known))
    true = places.listed(_weights(table, usable))
    hard = table["afterpulse"][rows] >= AFTERPULSE_MIN
    per_metre = table["line_density"][rows].astype(np.float64) / density[rows]
    rate = table["afterpulse_rate"][rows].astype(np.float64)
    alone = places.listed(usable & (table["afterpulse_rate"] == 0))
    sigma = table["range_sigma"][rows].astype(np.float64)
    parents = places.parents(rows, beamlets)
    behind, tilt = places.behind_plane(at, parents, alone, sigma)
    hard |= behind
    clumping = places.clumping(rows, parents[~hard & (parents >= 0)], true)
    returns = np.zeros(len(rows))
    # A sphere would hold the surface itself; a level ellipsoid that of a steep roof.
    for spread, own in _alike(sigma, hard):
        flat_m = (WIDE_M, SPREADS[0] * spread)
        flat = places.around(at[own], true, (flat_m,), tilt[own])[:, 0]
        returns[own] = flat / UNIT**2 / foliage.volume_m3(*flat_m)
    open_ = np.flatnonzero(~hard)
    for first in range(0, len(open_), ROWS_AT_ONCE):
        some = open_[first : first + ROWS_AT_ONCE]
        counts = places.around(at[some], true, foliage.KERNELS_M, own=foliage.OWN)
        returns[some] = foliage.density(counts / UNIT**2, clumping[some])
    chance = rate / (rate + returns * per_metre)
    return Chances(rows, chance, hard, foliage.clumped(clumping), parents < 0)


def _alike(
    sigma: NDArray[np.float64], chosen: NDArray[np.bool_]
) -> Iterator[tuple[float, NDArray[np.intp]]]:
    """Chosen rows by ranging spread: each flightline has one, and few surveys have many."""
    for spread in np.unique(sigma[chosen]):
        yield round(float(spread), 4), np.flatnonzero(chosen & (sigma == spread))


def _weights(table: PointTable, usable: NDArray[np.bool_]) -> NDArray[np.int16]:
    """Weights of returns, by the time domain's probability that they are true: (n,), :data:`UNIT`.

    What a parent alone gives is capped below :data:`AFTERPULSE_MIN`, and free of that here.
    """
    echo = np.minimum(table["afterpulse"].astype(np.float64) / AFTERPULSE_MIN, 1.0)
    return np.where(usable, np.rint((1.0 - echo) * UNIT), 0.0).astype(np.int16)


class _Places:
    """Points of a table, listed so that weighted counts around them are quick."""

    def __init__(self, table: PointTable) -> None:
        self._table = table
        self._xyz = np.empty((len(table), 3), dtype=np.int32)
        for axis, name in enumerate("xyz"):
            self._xyz[:, axis] = table[name] - table[name].min()
        self._made = columns(self._xyz, np.arange(len(table)), (0, 0, 0), quanta(WIDE_M))
        self._order = self._made.points[3]
        self._time, self._channel = table["gps_time"][self._order], table["channel"][self._order]
        self._place = np.empty(len(table), np.int32)
        self._place[self._order] = np.arange(len(table), dtype=np.int32)

    def in_turn(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
        """Rows in the order of their places, so that neighbours share memory; and the places."""
        place = self._place[rows]
        turn = lexicographic_order([place])
        return rows[turn], place[turn]

    def listed(self, values: NDArray[Any]) -> NDArray[Any]:
        """A column of the table by place."""
        found: NDArray[Any] = values[self._order]
        return found

    def around(
        self,
        places: NDArray[np.int32],
        true: NDArray[np.int16],
        radii_m: tuple[tuple[float, float], ...],
        tilt: NDArray[np.float64] | None = None,
        own: float = 0.0,
    ) -> NDArray[np.int64]:
        """True returns around places, by kernel: (m, k) int64 [count / :data:`UNIT` ** 2].

        ``true``: weights by place. ``own``: what one of the same beamlet above the place counts.
        """
        sums = np.empty((len(places), len(radii_m)), dtype=np.int64)
        weigh_around(
            self._made, self._time, self._channel, true, places,
            np.array([[quanta(r) for r in pair] for pair in radii_m], dtype=np.int64),
            np.zeros((len(places), 2)) if tilt is None else tilt, round(own * UNIT), sums,
        )  # fmt: skip
        return sums

    def clumping(
        self, rows: NDArray[np.intp], parents: NDArray[np.int32], true: NDArray[np.int16]
    ) -> NDArray[np.float64]:
        """How much leaves hang in clumps around rows, by places of parents: (m, k - 1) float64."""
        parents = np.sort(parents)
        counts = self.around(parents, true, foliage.KERNELS_M)
        x, y = self._table["x"], self._table["y"]
        named = self._order[parents].astype(np.intp)
        return foliage.clumping(x, y, named, true[parents], counts, rows)

    def parents(self, rows: NDArray[np.intp], beamlets: Beamlets) -> NDArray[np.int32]:
        """Places of the returns in front of some rows in their beamlets, -1 for none."""
        chosen = np.zeros(len(self._table), np.bool_)
        chosen[rows] = True
        found = np.empty(len(chosen), np.int32)
        parents_of(*beamlets, self._xyz, chosen, quanta(LAG_M), quanta(WIDE_M), found)
        return np.where(found[rows] >= 0, self._place[found[rows]], np.int32(-1))

    def behind_plane(
        self, places: NDArray[np.int32], parents: NDArray[np.int32], alone: NDArray[np.bool_],
        sigma: NDArray[np.float64],
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:  # fmt: skip
        """Which places lie behind a hard surface around their parents (m,), and its slopes (m, 2).

        ``alone`` goes by place: returns without a parent, which make it. ``sigma`` is the ranging
        spread [m]. Without a surface slopes are 0.
        """
        out, tilt = np.empty(len(places), dtype=np.bool_), np.empty((len(places), 2))
        room = np.empty((3, most_around(self._made)))
        for spread, own in _alike(sigma, np.ones(len(places), np.bool_)):
            wide, high = (quanta(m) for m in PLANE_M)
            high, thick = max(high, quanta(SPREADS[1] * spread)), quanta(SHARP * spread)
            found, slopes = out[own], tilt[own]
            behind_plane(
                self._made, alone, places[own], parents[own], (wide, high, thick), PLANE_SHARE,
                PLANE_LEAST, found, slopes, room,
            )  # fmt: skip
            out[own], tilt[own] = found, slopes
        return out, tilt
