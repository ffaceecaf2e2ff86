r"""Neighbours inside each point's adaptive ellipsoid [W18 Eq. 3-8; W17 Eq. 5.4-5.6, 6.3-6.5].

:mod:`~spl_batch.airborne.filter.ellipsoid.ellipsoid_shape` has shape, symbols and deviations. Also
here: k, ``count``, is the peers inside without the query point; rho v, ``expected``, is noise
density times the volume of the capped ellipsoid. Where spacings are given, only peers count
(:mod:`spl_batch.airborne.filter.ellipsoid.spacing`).

With ``tie`` the score puts a point between the tails of its count and of the next, by where the
outermost of the k inside lies. For points strewn evenly in an ellipsoid

.. math:: s = P(K > k) + u\,P(K = k), \quad u = (\max_i f_i)^{3 k / 2}

is uniform, with f the flags of Eq. 5; a signal's are nearer the middle.

How strongly a neighbourhood speaks against noise is the :class:`Evidence` by which
:mod:`~spl_batch.airborne.filter.ellipsoid.ellipsoid_test` decides, and which
:mod:`~spl_batch.airborne.filter.ellipsoid.null_distribution` draws under the null.

Counting stops at the critical count. Most points reach it among the neighbours that shaped the
ellipsoid, without walking the tree.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import (
    Bodies,  # noqa: F401 - named in signatures.json
    Shape,
    fit,
    lone_body,
    no_bodies,
    offsets,
    shape_of,
)
from spl_batch.airborne.filter.ellipsoid.spacing import Spacing, measure, walk
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import (
    LEAF,
    U0,
    U1,
    U2,
    U3,
    U4,
    U5,
    KdTree,
    build,
    check_cap,
    leaf_of,
    leaf_slots,
    search_room,
)
from spl_batch.numerics.neighbours.nearest import edges_of_leaves, neighbours_of_leaves
from spl_batch.numerics.poisson import critical_by_logs, tail_by_logs
from spl_batch.numerics.simd import (
    LANES,
    UL,
    ascending,
    greater,
    greatest,
    load,
    number,
    spread,
    store,
    where,
)

CHUNK: Final = 2048
"""Leaves whose neighbours are kept at a time, with their spacings [count]."""

LOGS: Final = 256
"""Factorials whose logarithms are kept [count]."""


class Evidence(NamedTuple):
    """What is known about n points."""

    #: (n,): small means unlikely to be noise; 1 where not asked. See :func:`count_inside`.
    score: NDArray[np.float64]
    #: (n,): neighbours counted, at most the critical count [count]; empty where not wanted.
    inside: NDArray[np.int32]
    #: (n,): noise points expected inside the ellipsoid [count]; empty where not wanted.
    expected: NDArray[np.float64]
    #: (n,): squared spacing of the points asked for, and of some others, by slot of the tree;
    #: negative where it is not known; all zero for the published test [quanta2].
    spacing: NDArray[np.float64]
    tree: KdTree


def evidence(
    xyz: NDArray[np.int32],
    density: NDArray[np.float64],
    asked: NDArray[np.bool_],
    settings: FilterSettings,
    stop: float | NDArray[np.float64],
    *,
    at_most: float = 1.0,
    scores_only: bool = False,
    tree: KdTree | None = None,
) -> Evidence:
    """Scores of the points asked for, in canonical order [quanta; noise 1/m3].

    The published test counts every neighbour, the calibrated one peers only, and breaks the ties of
    counts. Counting stops once the score is no larger than ``stop``, or ``at_most`` if less.
    """
    spacing = np.full(len(xyz), 0.0 if settings.test == "published" else -1.0)
    tree = build(xyz) if tree is None else tree
    count, expected, score = count_inside(
        xyz,
        tree,
        asked,
        density,
        shape_of(settings, settings.neighbours, settings.radius_m),
        alpha=stop,
        at_most=at_most,
        unit=QUANTA_PER_M,
        spacing=spacing,
        rule=Spacing(settings.spacing_neighbours, quanta(settings.spacing_cap_m)),
        peer_ratio=settings.peer_ratio,
        tie=settings.test == "calibrated",
        scores_only=scores_only,
    )
    return Evidence(score, count, expected, spacing, tree)


def count_inside(
    xyz: NDArray[np.int32],
    tree: KdTree,
    query: NDArray[np.bool_],
    density: NDArray[np.float64],
    shape: Shape,
    *,
    alpha: float | NDArray[np.float64],
    at_most: float = math.inf,
    unit: int = 1,
    spacing: NDArray[np.float64] | None = None,
    rule: Spacing = Spacing(1, 1),  # noqa: B008 - a tuple
    peer_ratio: float = 1.0,
    tie: bool = False,
    scores_only: bool = False,
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Count neighbours inside adaptive ellipsoids, up to the critical count.

    ``xyz, tree, query, density``: points (n, 3) in canonical order [quanta], those to count for,
    and the noise [1/unit3]. Counting stops at the smallest k >= 1 with P(K >= k | lambda) <= alpha
    of the point, or ``at_most`` if that is less; an alpha above 1 is that k itself. ``spacing``
    (n,): squared spacing at each slot of the tree [quanta2], without which every neighbour is a
    peer; unknown ones are negative, and filled in where needed, at query points at least.

    Three (n,): min(k, critical count); lambda; P(K >= count | lambda), 1 for others, or with
    ``tie`` the score s below the critical count. The first two are empty with ``scores_only``.
    """
    check_cap(shape.neighbour_cap)
    check_cap(rule.cap)
    wanted = 0 if scores_only else len(xyz)
    count, expected = np.zeros(wanted, dtype=np.int32), np.zeros(wanted, dtype=np.float64)
    tail = np.ones(len(xyz), dtype=np.float64)
    if spacing is None:
        spacing = np.zeros(len(xyz), dtype=np.float64)
    if len(xyz):
        ratio2 = peer_ratio * peer_ratio
        limit = np.broadcast_to(np.asarray(alpha, dtype=np.float64), (len(xyz),))
        limit = np.ascontiguousarray(limit)
        _count_all(
            *tree, edges_of_leaves(tree), query, density, float(unit) ** 3, shape, limit, at_most,
            spacing, rule, ratio2, tie, no_bodies(), search_room(rule.neighbours + 1), count,
            expected, tail,
        )  # fmt: skip
    return count, expected, tail


@njit()
def _flags(near, member, found, quadrics):  # type: ignore[no-untyped-def]
    """Flags of a member's neighbours as a row of ``near``, and of what lies behind them."""
    q0, q1, q2 = quadrics[U0, member], quadrics[U1, member], quadrics[U2, member]
    q3, q4, q5 = quadrics[U3, member], quadrics[U4, member], quadrics[U5, member]
    for i in range(U0, np.uint64(found), UL):
        dx, dy = load(near, (member, U0, i)), load(near, (member, U1, i))
        dz = load(near, (member, U2, i))
        square = spread(q0) * dx * dx + spread(q3) * dy * dy + spread(q5) * dz * dz
        mixed = spread(q1) * dx * dy + spread(q2) * dx * dz + spread(q4) * dy * dz
        store(near, (member, U3, i), square + spread(2.0) * mixed)


@njit()
def _spacings(near, member, found, others, at, space):  # type: ignore[no-untyped-def]
    """Spacings of the neighbours behind their flags; whether any inside is unknown."""
    for i in range(found):
        near[member, U4, i] = space[np.uint64(others[at, i])]
    end, unknown = np.uint64(found), U0
    for i in range(U0, end, UL):
        inside = (load(near, (member, U3, i)) < spread(1.0)) & (ascending(i) < spread(end))
        unknown += number(inside & (load(near, (member, U4, i)) < spread(0.0)))
    return unknown > U0


@njit()
def _learn(points, boxes, depth, near, member, found, others, at, space, rule, scratch):  # type: ignore[no-untyped-def]
    """Find out the spacings of the neighbours inside."""
    for i in range(found):
        if near[member, U3, i] < 1.0 and near[member, U4, i] < 0.0:
            other = np.uint64(others[at, i])
            if space[other] < 0.0:
                measure(points, boxes, depth, other, space, rule, scratch)
            near[member, U4, i] = space[other]


@njit()
def _among(near, member, found, least, ratio2, outer):  # type: ignore[no-untyped-def]
    """Peers inside among the neighbours that shaped the ellipsoid."""
    end, count, none = np.uint64(found), U0, spread(0.0)
    outermost = none
    for i in range(U0, end, UL):
        flags = load(near, (member, U3, i))
        inside = (flags < spread(1.0)) & (ascending(i) < spread(end))
        inside = inside & (load(near, (member, U4, i)) * spread(ratio2) >= spread(least))
        count += number(inside)
        outermost = greater(where(inside, flags, none), outermost)
    outer[0] = greatest(outermost)
    return np.int64(count)


@njit()
def _score(inside, mean, outermost, tie, stop, least, log_mean, logs):  # type: ignore[no-untyped-def]
    """Tail of a count; with ``tie``, between it and the next by the outermost point inside.

    ``least`` is the tail of ``stop``, which is more than ``inside``.
    """
    tail = tail_by_logs(inside, mean, log_mean, logs)
    if not tie or inside == 0:
        return tail
    more = least if inside + 1 == stop else tail_by_logs(inside + 1, mean, log_mean, logs)
    return more + outermost ** (1.5 * inside) * (tail - more)


@njit()
def _neighbours(  # type: ignore[no-untyped-def]
    points, boxes, edges, depth, leaves, asked, shape, space, rule, others, found, last
):
    """Neighbours of the points asked for of some leaves, with their spacings.

    ``asked`` (m,), ``others`` (m, k), ``found`` (m,) and ``last`` (m,), the slots of the
    neighbours, their number and the squared distance of the farthest, count from the first leaf's
    first slot on.
    """
    n = np.uint64(points.shape[1])
    wide = np.float64(rule.cap) * np.float64(rule.cap)
    shared = rule.neighbours <= shape.neighbours and rule.cap <= shape.neighbour_cap
    few = np.empty(len(asked))
    neighbours_of_leaves(
        points, boxes, edges, depth, leaves, asked, shape.neighbours, shape.neighbour_cap,
        rule.neighbours if shared else 0, others, found, last, few,
    )  # fmt: skip
    low, _ = leaf_slots(leaves[0], depth, n)
    _, high = leaf_slots(leaves[1] - U1, depth, n)
    for slot in range(low, high):
        if shared and asked[slot - low] and space[slot] < 0.0:
            space[slot] = min(few[slot - low], wide) if few[slot - low] >= 0.0 else wide


@njit()
def _count_all(  # type: ignore[no-untyped-def]
    points, boxes, depth, edges, query, density, volume, shape, alpha, at_most, space, rule,
    ratio2, tie, bodies, spare, count, expected, tail,
):  # fmt: skip
    """Every query point in tree order, so that the cache stays warm."""
    n, depth = np.uint64(points.shape[1]), np.uint64(depth)
    leaves, chunk, logs = U1 << depth, np.uint64(CHUNK), np.empty(LOGS)
    for i in range(LOGS):
        logs[i] = math.lgamma(i + 1.0)
    room = min(chunk, leaves) * np.uint64(LEAF)
    others = np.empty((room, shape.neighbours), dtype=np.int32)
    found, last = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.float64)
    asked, noise, level = np.empty(room, np.bool_), np.empty(room), np.empty(room)
    counted, mean, score = np.empty(room, np.int32), np.empty(room), np.empty(room)
    for begin in range(leaves, leaves + leaves, chunk):
        end = min(begin + chunk, leaves + leaves)
        low, _ = leaf_slots(begin, depth, n)
        _, high = leaf_slots(end - U1, depth, n)
        # Rows lie far apart in memory: many are fetched, and put back, at a time.
        for at in range(high - low):
            row = points[U3, low + at]
            asked[at], noise[at] = query[row], density[row] / volume
            level[at] = min(alpha[row], at_most)
        _neighbours(
            points, boxes, edges, depth, (begin, end), asked, shape, space, rule, others, found,
            last,
        )  # fmt: skip
        _count_some(
            points, boxes, depth, (low, high), asked, noise, shape, level, space, rule, ratio2,
            tie, bodies, spare, logs, others, found, last, counted, mean, score,
        )  # fmt: skip
        for at in range(high - low):
            if asked[at]:
                row = points[U3, low + at]
                tail[row] = score[at]
                if len(count):
                    count[row], expected[row] = counted[at], mean[at]


@njit()
def _count_some(  # type: ignore[no-untyped-def]  # noqa: C901
    points, boxes, depth, slots, asked, density, shape, alpha, space, rule, ratio2, tie, bodies,
    spare, logs, others, found, last, count, expected, tail,
):  # fmt: skip
    """Points asked for of a range of slots; all arrays but the tree's start at the first."""
    n = np.uint64(points.shape[1])
    near = np.zeros((LANES, 5, shape.neighbours + LANES))
    members, held = np.empty(LANES, np.uint64), U0
    stack, quadric, vectors = np.empty(64, np.uint64), np.empty(6), np.empty((3, 3))
    axes, half, outer = np.empty(3), np.empty(3), np.empty(1)
    known, level, stop, least, log_mean = -1.0, -1.0, 1, 1.0, 0.0
    for last_slot in range(slots[0], slots[1]):
        at = last_slot - slots[0]
        if asked[at]:
            offsets(points, last_slot, others, at, found[at], near, held, bodies.moments)
            bodies.found[held], members[held] = found[at], last_slot
            held += U1
        # Eight are shaped at a time.
        if held == U0 or (held < UL and last_slot + U1 < slots[1]):
            continue
        fit(bodies, shape)
        for member in range(held):
            slot = members[member]
            at = slot - slots[0]
            if space[slot] < 0.0:
                measure(points, boxes, depth, slot, space, rule, spare)
            mean = density[at] * bodies.volume[member]
            if mean != known or alpha[at] != level:
                known, level = mean, alpha[at]
                log_mean = math.log(mean) if mean > 0.0 else 0.0
                if level <= 1.0:
                    stop, least = critical_by_logs(mean, level, stop, log_mean, logs)
                else:
                    stop, least = int(level), 1.0
            _flags(near, member, found[at], bodies.quadrics)
            if _spacings(near, member, found[at], others, at, space):
                _learn(
                    points, boxes, depth, near, member, found[at], others, at, space, rule, spare
                )
            inside = _among(near, member, found[at], space[slot], ratio2, outer)
            reach = float(shape.neighbour_cap)
            if found[at] == shape.neighbours:
                reach = math.sqrt(last[at])
            if inside < stop and bodies.axes[U0, member] > reach:
                lone_body(bodies, member, quadric, vectors, axes, half)
                inside = walk(
                    points, boxes, depth, leaf_of(slot, depth, n), slot, quadric, vectors, axes,
                    half, stop, stack, space, rule, ratio2, spare, outer,
                )  # fmt: skip
            count[at], expected[at], tail[at] = min(inside, stop), mean, least
            if inside < stop:
                tail[at] = _score(inside, mean, outer[0], tie, stop, least, log_mean, logs)
        held = U0
