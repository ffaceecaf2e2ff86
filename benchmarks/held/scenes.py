"""Content of the scenes that are simulated."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

Content = dict[str, Any]
Place = tuple[float, float]


def _two_lines(speed_m_s: float = 110) -> list[Content]:
    return [
        {"heading_deg": 0, "offset_m": 300, "speed_m_s": speed_m_s},
        {"heading_deg": 90, "offset_m": -280, "speed_m_s": speed_m_s},
    ]


THIRD: Final = {"heading_deg": 200, "offset_m": 350, "speed_m_s": 110, "sky": 1.3}

# Haze and fog over two flightlines

SKY: Final[Content] = {
    "extent_m": [110, 110],
    "seed": 11,
    "terrain": {"relief_m": 8, "wavelength_m": 100},
    "buildings": {"count": 3},
    "trees": {"cover": 0.25},
    "wires": [
        {"kind": "transmission", "points_m": [[-60, 75], [170, 95]], "height_m": 24, "sag_m": 4,
         "returns_per_m": 0.8},
    ],
    "flights": _two_lines(),
    "sky": {"background_per_m3": 0.05},
    "acquisition": {"prf_hz": 25_000, "gate_m": 250},
}  # fmt: skip


def _haze(times: float, base_m: float, top_m: float, cover: float = 0.5, **edge: float) -> Content:
    """A layer in patches that drift."""
    layer = {"base_m": base_m, "top_m": top_m, "times_noise": times, "cover": cover,
             "patch_m": 60, "drift_m_s": [3, 1], **edge}  # fmt: skip
    return {"haze": [layer]}


SKIES: Final[Mapping[str, Content]] = {
    "base": {},
    "haze 60-100 m, 20 x": _haze(20, 60, 100),
    "haze 25-45 m, 30 x": _haze(30, 25, 45),
    "closed cloud 70-110 m, 20 x": _haze(20, 70, 110, 1.0),
    "thinner haze 8-14 m, 20 x": _haze(20, 8, 14),
    "sheet of 2 m at 30 m, 40 x": _haze(40, 30, 32, 0.7, edge_m=0.2),
    "fog, 1.5 m, 60 x": {"fog": [{"times_noise": 60, "scale_m": 1.5}]},
}
"""Part ``sky`` of a scene by name."""


def sky(name: str) -> Content:
    """Two flightlines under a sky of :data:`SKIES`."""
    return {**SKY, "name": f"{name}, 1", "sky": {**SKY["sky"], **SKIES[name]}}


# Afterpulses


def _afterpulses(name: str, seed: int, **parts: Any) -> Content:
    return {
        "name": name,
        "extent_m": [100, 100],
        "seed": seed,
        "terrain": {"relief_m": 8},
        "flights": [*_two_lines(), THIRD],
        "sky": {"background_per_m3": 0.08},
        "acquisition": {"prf_hz": 30_000, "gate_m": 150},
        **parts,
    }


LAW: Final = {"afterpulse_probability": 0.15, "afterpulse_scale_m": 0.7}

CLUMPS: Final = {"cover": 0.85, "height_m": [3, 16], "radius_m": [0.3, 0.5], "crown_share": 0.06,
                 "extinction_per_m": 2.0, "gaps": 0.0, "understory": 0.0}  # fmt: skip
"""Leaves in clumps about 0.8 m across, two along a vertical path, with air between them."""

ROOFS: Final = _afterpulses("roofs", 4, sensor_overrides=LAW, buildings={"count": 8},
                            trees={"cover": 0.15}, extent_m=[120, 120])  # fmt: skip
CANOPIES: Final = (
    _afterpulses("canopy", 1, sensor_overrides=LAW, trees={"cover": 0.6}),
    _afterpulses("clumps of leaves", 16, sensor_overrides=LAW, trees=CLUMPS, extent_m=[45, 45]),
)
LAGS: Final[Mapping[str, Content]] = {
    "power law, 0.25, 15 m": {"share": 1.0, "scale_m": 0.5, "power": 1.5},
    "two exponentials, 0.25, 15 m": {"share": 0.4, "scale_m": 4.0},
}
"""Long tails of lags."""


def lags(tail: Content | None) -> Content:
    """Two roofs and some trees, whose lags have a tail; None: without afterpulses."""
    houses = [
        {"centre_m": [18, 20], "size_m": [18, 12], "heading_deg": 20, "roof": "gable"},
        {"centre_m": [50, 48], "size_m": [14, 12], "roof": "flat"},
    ]
    detector: Content = {"afterpulse_probability": 0.0 if tail is None else 0.25}
    # without any the tail of the first law, which draws as many random numbers
    detector |= {"afterpulse_lag_max_m": 15.0, "tail": tail or LAGS["power law, 0.25, 15 m"]}
    return _afterpulses(
        "lags", 5, extent_m=[70, 70], terrain={"relief_m": 6}, buildings={"list": houses},
        trees={"cover": 0.15}, detector=detector,
    )  # fmt: skip


# Wires


def wires(name: str, seed: int) -> Content:
    """Two transmission lines and a distribution line, from bright to faint; roofs, trees.

    Weak ones return 0.1 to 0.3 times a metre and flightline, two returns in five being noise,
    ordinary ones 0.7 to 1 times.
    """
    rates, background = {"weak": ((0.3, 0.2, 0.1), 0.16), "ordinary": ((1.0, 0.85, 0.7), 0.13)}[
        name
    ]
    rng = np.random.default_rng(seed)
    extent_m = (160.0, 100.0)
    east, north = extent_m
    high, mid, low = rates
    lines = [
        {
            "kind": "transmission", "points_m": across(rng, extent_m, 0.75 * north, 170.0),
            "height_m": float(rng.uniform(22, 32)), "sag_m": 5.0, "conductors": 3,
            "spacing_m": 4.0, "shield": True, "returns_per_m": high,
        },
        {
            "kind": "transmission", "points_m": across(rng, extent_m, 0.5 * north, 150.0),
            "height_m": float(rng.uniform(14, 20)), "sag_m": 3.0, "conductors": 2,
            "spacing_m": 3.0, "shield": False, "returns_per_m": mid,
        },
        {
            "kind": "distribution", "points_m": across(rng, extent_m, 0.2 * north, 45.0),
            "height_m": float(rng.uniform(8, 11)), "sag_m": 0.7, "conductors": 3,
            "spacing_m": 1.0, "shield": False, "diameter_m": 0.015, "returns_per_m": low,
        },
    ]  # fmt: skip
    return {
        "name": f"{name} wires",
        "seed": seed,
        "extent_m": [east, north],
        "terrain": {"relief_m": float(rng.uniform(5, 20))},
        "buildings": {"count": 3},
        "trees": {"cover": 0.15},
        "wires": lines,
        "flights": flights(rng, 3, altitude_agl_m=2500.0, offset_m=330.0),
        "sky": {"background_per_m3": background},
        "acquisition": {"prf_hz": 50_000.0, "gate_m": 250.0},
    }


def across(rng: np.random.Generator, extent_m: Place, north_m: float, span_m: float) -> list[Place]:
    """Towers from beyond the west to beyond the east side, a little askew."""
    lean = math.radians(float(rng.uniform(-6, 6)))
    start = -float(rng.uniform(0.3, 0.9)) * span_m
    count = math.ceil((extent_m[0] - start) / span_m + 0.3) + 1
    middle = extent_m[0] / 2
    return [
        (x, north_m + math.tan(lean) * (x - middle)) for x in (start + span_m * np.arange(count))
    ]


def flights(
    rng: np.random.Generator, count: int, *, altitude_agl_m: float, offset_m: float,
    speed_m_s: float = 90.0,
) -> list[dict[str, float]]:  # fmt: skip
    """Flightlines at different headings, the scene beside the track."""
    first = float(rng.uniform(0, 360))
    return [
        {
            "heading_deg": (first + k * 360.0 / count + float(rng.uniform(-15, 15))) % 360.0,
            "altitude_agl_m": altitude_agl_m,
            "offset_m": offset_m * (-1.0) ** k * float(rng.uniform(0.8, 1.2)),
            "speed_m_s": speed_m_s,
        }
        for k in range(count)
    ]


# Terrain

WOODS: Final[Mapping[str, Content]] = {
    "hill": {
        "terrain": {"relief_m": 90, "wavelength_m": 200},
        "buildings": {"count": 8},
        "trees": {"cover": 0.6},
    },
    "town": {
        "terrain": {"relief_m": 12, "wavelength_m": 120},
        "buildings": {"count": 14, "list": [
            {"centre_m": (95, 105), "size_m": (60, 36), "heading_deg": 20, "eave_m": 7.0}]},
        "trees": {"cover": 0.25},
        "water": [{"ring_m": [(150, 20), (185, 15), (190, 50), (160, 55)]}],
    },
    "mountain": {
        "terrain": {"relief_m": 220, "wavelength_m": 260, "roughness_m": 0.1},
        "buildings": {"count": 2},
        "trees": {"cover": 0.6, "height_m": (15, 35), "radius_m": (1.5, 4.0),
                  "extinction_per_m": 0.6, "understory": 0.5},
        "flights": [
            {"heading_deg": 45, "altitude_agl_m": 2200, "speed_m_s": 110},
            {"heading_deg": 135, "altitude_agl_m": 2200, "speed_m_s": 110, "offset_m": 200},
        ],
        "acquisition": {"prf_hz": 50_000, "gate_m": 400, "dead_channels": [53]},
    },
}  # fmt: skip


def woods(name: str) -> Content:
    """A scene of 200 m, in whose middle four ground cells meet."""
    common = {
        "origin_m": (272_100.0, 3_290_100.0, 140.0),
        "extent_m": (200, 200),
        "flights": [*_two_lines(), THIRD],
        "sky": {"background_per_m3": 0.08},
        "acquisition": {"prf_hz": 30_000, "gate_m": 300, "dead_channels": [53]},
    }
    return {**common, **WOODS[name], "name": name, "seed": 11}


TREES: Final = {"cover": 0.6, "height_m": (10, 25), "radius_m": (1.5, 4.0), "understory": 0.4}


def _form(slope_deg: float, *rings: tuple[float, list[Place]]) -> Content:
    """Landforms by height."""
    forms = [{"ring_m": ring, "height_m": high, "slope_deg": slope_deg} for high, ring in rings]
    return {"landforms": forms}


STEEP: Final[Mapping[str, tuple[Content, Content]]] = {
    "ridges 50 deg, trees": (
        _form(50, (30, [(-60, 20), (180, 50), (180, 52), (-60, 22)]),
              (-30, [(-60, 80), (180, 105), (180, 107), (-60, 82)])),
        {"trees": TREES},
    ),
    "cliff 15 m, trees": (
        _form(90, (15, [(-70, -70), (55, -70), (65, 30), (50, 60), (-70, 75)])),
        {"trees": TREES},
    ),
    "dam and terrace, 60 deg": (
        _form(60, (8, [(-70, 88), (190, 94), (190, 98), (-70, 92)]),
              (6, [(-70, -70), (190, -70), (190, 42), (-70, 36)]),
              (6, [(-70, -70), (190, -70), (190, 36), (-70, 30)])),
        {},
    ),
    "bridge over a valley": (
        _form(40, (-18, [(50, -80), (60, -80), (75, 200), (65, 200)])),
        {"trees": {"cover": 0.2}, "bridges": [{"ends_m": [(28, 62), (100, 58)], "width_m": 9}]},
    ),
}  # fmt: skip
"""Part ``terrain``, and further parts of the scene."""


def steep(name: str) -> Content:
    """A scene of 120 m."""
    terrain, parts = STEEP[name]
    return {
        "extent_m": (120, 120),
        "terrain": {"relief_m": 6, "wavelength_m": 100, "roughness_m": 0.05, **terrain},
        "flights": _two_lines(),
        "sky": {"background_per_m3": 0.05},
        "acquisition": {"prf_hz": 25_000, "gate_m": 300},
        "name": name,
        "seed": 11,
        **parts,
    }


# Flightlines that lie apart

SHIFTS: Final = ((0.0, 0.0, 0.05), (0.3, -0.2, 0.2))
"""East, north and up of the second flightline [m]."""


def shifted(shift: tuple[float, float, float]) -> Content:
    """Three flightlines over hills, houses and trees, the second recorded off by a shift."""
    return {
        "extent_m": [120, 120],
        "seed": 11,
        "terrain": {"relief_m": 6, "wavelength_m": 70},
        "buildings": {"count": 5},
        "trees": {"cover": 0.15},
        "sky": {"background_per_m3": 0.02},
        "acquisition": {"prf_hz": 30_000, "gate_m": 100, "margin_m": 2},
        "flights": [
            {"heading_deg": 0, "speed_m_s": 100, "offset_m": 250},
            {"heading_deg": 90, "speed_m_s": 100, "offset_m": 150, "strip_offset_m": list(shift)},
            {"heading_deg": 200, "speed_m_s": 100, "offset_m": 300},
        ],
    }


# Reflectance


def reflectances(seed: int = 11, extent_m: float = 80.0, roofs: int = 16) -> Content:
    """Ground and roofs of many reflectances under flightlines of three altitudes."""
    rng = np.random.default_rng(seed)
    side = int(np.sqrt(roofs))
    step = extent_m / side
    bright = rng.permutation(np.geomspace(0.05, 0.8, roofs))
    houses = [
        {
            "centre_m": [(k % side + 0.5) * step, (k // side + 0.5) * step],
            "size_m": [0.45 * step, 0.35 * step],
            "heading_deg": float(rng.uniform(0, 180)),
            "eave_m": float(rng.uniform(4, 9)),
            "roof": ("flat", "gable", "shed")[k % 3],
            "pitch_deg": float(rng.uniform(25, 45)),
            "reflectance": float(bright[k]),
        }
        for k in range(roofs)
    ]
    edge, heading = np.tan(np.radians(15.0)), float(rng.uniform(0, 360))
    lines = [
        {"heading_deg": heading, "altitude_agl_m": 2500.0, "offset_m": 300.0},
        {"heading_deg": heading + 90, "altitude_agl_m": 1800.0, "offset_m": 1800.0 * edge},
        {"heading_deg": heading + 200, "altitude_agl_m": 3300.0, "offset_m": -3300.0 * edge},
    ]
    channels = rng.permutation(np.arange(1, 101))
    return {
        "name": f"intensity, seed {seed}",
        "seed": seed,
        "extent_m": [extent_m, extent_m],
        "terrain": {"relief_m": 25.0, "wavelength_m": 100.0, "reflectance_variation": 0.4},
        "buildings": {"list": houses},
        "flights": [{"speed_m_s": 100.0, **line} for line in lines],
        "sky": {"background_per_m3": 0.08},
        "acquisition": {
            "prf_hz": 50_000.0,
            "gate_m": 250.0,
            "dead_channels": channels[:8].tolist(),
            "weak_channels": {int(c): 0.2 for c in channels[8:14]},
        },
    }
