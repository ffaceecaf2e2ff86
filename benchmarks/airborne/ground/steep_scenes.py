"""Scenes of steep ground and bridges, for :mod:`benchmarks.airborne.ground.steep`."""

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

EDGE_M: Final = 120
"""Edge of a survey [m]."""

COMMON: Final[Mapping[str, Any]] = {
    "extent_m": (EDGE_M, EDGE_M),
    "terrain": {"relief_m": 6, "wavelength_m": 100, "roughness_m": 0.05},
    "flights": [
        {"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
        {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110},
    ],
    "sky": {"background_per_m3": 0.05},
    "acquisition": {"prf_hz": 25_000, "gate_m": 300},
}
TREES: Final = {"cover": 0.6, "height_m": (10, 25), "radius_m": (1.5, 4.0), "understory": 0.4}

Terrain = Callable[[float], dict[str, Any]]
"""Part of a scene file by strength."""


def _ridges(slope_deg: float) -> Terrain:
    """A ridge, and a gorge beside it."""

    def made(times: float) -> dict[str, Any]:
        forms = [
            {"ring_m": [(-60, 20), (180, 50), (180, 52), (-60, 22)], "height_m": 30 * times},
            {"ring_m": [(-60, 80), (180, 105), (180, 107), (-60, 82)], "height_m": -30 * times},
        ]
        return {"landforms": [{**form, "slope_deg": slope_deg} for form in forms]}

    return made


def _cliff(slope_deg: float = 90, **relief: float) -> Terrain:
    """A plateau of 15 m."""
    ring = [(-70, -70), (55, -70), (65, 30), (50, 60), (-70, 75)]
    form = {"ring_m": ring, "slope_deg": slope_deg}
    return lambda times: {**relief, "landforms": [{**form, "height_m": 15 * times}]}


def _mound(slope_deg: float) -> Terrain:
    """A plateau of 12 m that is steep on all sides."""
    ring = [(40, 40), (80, 40), (80, 80), (40, 80)]
    form = {"ring_m": ring, "slope_deg": slope_deg}
    return lambda times: {"landforms": [{**form, "height_m": 12 * times}]}


def _valley(depth_m: float, slope_deg: float) -> Terrain:
    """A valley below a bridge."""
    ring = [(50, -80), (60, -80), (75, 200), (65, 200)]
    form = {"ring_m": ring, "slope_deg": slope_deg}
    return lambda times: {"landforms": [{**form, "height_m": -depth_m * times}]}


def _strips(slope_deg: float) -> Terrain:
    """A dam of 8 m with a crest of 4 m, and a terrace of 5 m between two walls of 6 m."""

    def made(times: float) -> dict[str, Any]:
        dam = [(-70, 88), (190, 94), (190, 98), (-70, 92)]
        lower = [(-70, -70), (190, -70), (190, 42), (-70, 36)]
        upper = [(-70, -70), (190, -70), (190, 36), (-70, 30)]
        forms = [{"ring_m": dam, "height_m": 8 * times}]
        forms += [{"ring_m": ring, "height_m": 6 * times} for ring in (lower, upper)]
        return {"landforms": [{**form, "slope_deg": slope_deg} for form in forms]}

    return made


def _round(place: tuple[float, float], radius_m: float) -> list[tuple[float, float]]:
    """Ring of twelve corners."""
    turns = 2 * np.pi * np.arange(12) / 12
    return [
        (place[0] + radius_m * float(np.cos(a)), place[1] + radius_m * float(np.sin(a)))
        for a in turns
    ]


def _spots(radius_m: float, height_m: float, slope_deg: float) -> Terrain:
    """Nine rocks or hollows."""
    at = [(x + 0.1 * y, y) for x in (20, 55, 90) for y in (25, 60, 95)]
    rings = [{"ring_m": _round(place, radius_m), "slope_deg": slope_deg} for place in at]
    return lambda times: {
        "landforms": [{**ring, "height_m": height_m * times} for ring in rings]
    }  # fmt: skip


class Case(NamedTuple):
    """What a small survey is of.

    ``deck_m`` are the ends of a bridge and how far they move, ``width_m`` is its width [m], and
    ``skew_m`` how much farther north its east end lies. ``small``: of forms of some metres.
    """

    terrain: Terrain
    trees: Mapping[str, Any] | None = None
    deck_m: tuple[float, float, float] | None = None
    width_m: float = 9
    skew_m: float = -4
    small: bool = False
    houses: int = 0


SCENES: Final[Mapping[str, Case]] = {
    "ridges 45 deg": Case(_ridges(45)),
    "ridges 45 deg, trees": Case(_ridges(45), TREES),
    "ridges 50 deg": Case(_ridges(50)),
    "ridges 50 deg, trees": Case(_ridges(50), TREES),
    "ridges 60 deg": Case(_ridges(60)),
    "ridges 60 deg, trees": Case(_ridges(60), TREES),
    "cliff 15 m": Case(_cliff()),
    "cliff 15 m, trees": Case(_cliff(), TREES),
    "cliff on a slope, trees": Case(_cliff(80, relief_m=60, wavelength_m=130), TREES),
    "mound of 40 m, 55 deg": Case(_mound(55)),
    "mound of 40 m, 70 deg": Case(_mound(70)),
    "mound of 40 m, 80 deg": Case(_mound(80)),
    "dam and terrace, 60 deg": Case(_strips(60), small=True),
    "dam and terrace, 60 deg, trees": Case(_strips(60), TREES, small=True),
    "dam and terrace, 80 deg": Case(_strips(80), small=True),
    "rocks of 12 m, 60 deg": Case(_spots(6, 10, 60), small=True),
    "rocks of 12 m, 60 deg, trees": Case(_spots(6, 10, 60), TREES, small=True),
    "rocks of 12 m, 75 deg": Case(_spots(6, 10, 75), small=True),
    "craters, trees": Case(_spots(3, -5, 55), TREES, small=True),
    "shafts, trees": Case(_spots(3, -8, 85), TREES, small=True),
    "bridge over a valley": Case(_valley(18, 40), {"cover": 0.2}, (28, 100, 21)),
    "bridge over a gorge": Case(_valley(15, 85), {"cover": 0.2}, (45, 84, 2)),
    "wide bridge": Case(_valley(12, 35), {"cover": 0.2}, (32, 96, 16), 18, 10),
    "overpass": Case(_valley(5, 45), {"cover": 0.2}, (50, 80, 5), 25, 6),
    "mountain, trees": Case(lambda t: {"relief_m": 130 * t, "wavelength_m": 180}, TREES),
    "town": Case(lambda t: {"relief_m": 8 * t}, {"cover": 0.2}, houses=14),
    "level": Case(lambda _: {}, TREES),
}
"""Surveys by name."""


def content(name: str, seed: int, times: float) -> dict[str, Any]:
    """Content of a scene file."""
    of = SCENES[name]
    made = {**COMMON, "terrain": {**COMMON["terrain"], **of.terrain(times)}, "name": name}
    if of.trees:
        made["trees"] = of.trees
    if of.houses:
        made["buildings"] = {"count": of.houses}
    if of.deck_m:
        west, east, more = of.deck_m
        more *= max(times - 1, 0)
        ends = [(west - more, 62), (east + more, 62 + of.skew_m)]
        made["bridges"] = [{"ends_m": ends, "width_m": of.width_m}]
    return made | {"seed": seed}
