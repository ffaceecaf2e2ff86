"""Upright cylinder around each point [W17 3.2.2, Eq. 3.2, after Cossio 2009].

Domain: space. The points with a height difference below D1 / 2 and a squared horizontal distance
below D2 are counted. The source gives neither D1, D2 nor the least count: the defaults are ours.
"""

from typing import Final

from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.filter.published.neighbour_volumes import cylinder_counts
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.neighbours.kdtree import build

DOMAIN: Final = "space"


def reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks [m]."""
    return settings.cylinder.radius_m


def judge(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for; there is no p-value."""
    cylinder = settings.cylinder
    count = cylinder_counts(
        build(cloud.xyz),
        cloud.asked,
        quanta(cylinder.radius_m),
        quanta(cylinder.height_m),
        cylinder.count,
    )
    return without_p(count[cloud.asked] >= cylinder.count)
