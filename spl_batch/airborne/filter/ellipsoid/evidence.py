"""Scores of adaptive ellipsoids: how strongly each return's neighbourhood speaks against noise.

Domain: space. :mod:`~spl_batch.airborne.filter.ellipsoid.ellipsoid_test` decides by them, and
:mod:`~spl_batch.airborne.filter.ellipsoid.null_distribution` draws them under the null.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.ellipsoid_counts import count_inside
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import Shape
from spl_batch.airborne.filter.ellipsoid.spacing import Spacing
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.neighbours.kdtree import KdTree, build

DOMAIN: Final = "space"


class Evidence(NamedTuple):
    """What is known about n points."""

    #: (n,): small means unlikely to be noise; 1 where not asked. See
    #: :func:`~spl_batch.airborne.filter.ellipsoid.ellipsoid_counts.count_inside`.
    score: NDArray[np.float64]
    #: (n,): neighbours counted, at most the critical count [count]; empty where not wanted.
    inside: NDArray[np.int32]
    #: (n,): noise points expected inside the ellipsoid [count]; empty where not wanted.
    expected: NDArray[np.float64]
    #: (n,): squared spacing of the points asked for, and of some others, by slot of the tree;
    #: negative where it is not known; all zero for the published test [quanta2].
    spacing: NDArray[np.float64]
    tree: KdTree


def shape_of(settings: FilterSettings, neighbours: int, radius_m: float) -> Shape:
    """How neighbours become an ellipsoid, in quanta."""
    return Shape(
        neighbours=neighbours,
        radius=float(quanta(radius_m)),
        floor=float(quanta(settings.eigen_floor_m)),
        axis_cap=float(quanta(settings.axis_cap_m)),
        neighbour_cap=quanta(settings.neighbour_cap_m),
        power=1.0 if settings.axis_power == "eigenvalue" else 0.5,
    )


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
