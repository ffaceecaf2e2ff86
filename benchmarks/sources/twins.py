"""Simulated twins of the sources' set-ups.

Each function gives a scene for :func:`spl_batch.airborne.simulate.simulate`; the seed turns lines
and flights, moves towers, and draws relief, roofs and trees anew. What a source reports of its
set-up is in the table. Background and returns per metre of wire, which none reports, follow from
the link budget [W17 2.2]: the sun is that at noon of the day, wires have their diameters. Speed or
pulse energy give the density of returns that the source reports. Positions, heights and diameters
are ours.

===========  =========================================  ====================================
twin         source                                     reported there
===========  =========================================  ====================================
easton       [W18] 2.1, [W17] 6.3                       three lines, 3.5 km, 9 deg, 60 kHz,
                                                        gate 300 m, 18 returns/m2 and line
lufkin       [W18] 2.1 ([W17] 6.3 has 12 deg)           three lines, 2 km, 15 deg, 50 kHz,
                                                        gate 85 m, 20 returns/m2 and line
houston      [W17] 7.3                                  4.2 km, 30 returns/m2, 80-100 of
                                                        100 beamlets of most shots return,
                                                        20 regions of 75 m2 on roofs
canopy       [W17] 5.3                                  HRQLS, 3.5 km, 12 returns/m2; roofs,
                                                        bare ground, tree tops
===========  =========================================  ====================================
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.held.scenes import Place, across, flights
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene

Wire = dict[str, Any]

DARK_ROOF, BRIGHT_ROOF = 0.08, 0.8
"""Reflectance of the darkest and brightest roof of the Houston twin."""


SHAPES = ("flat", "gable", "shed")
"""Shapes of the roofs of twins, in turn."""

FEWER_AFTERPULSES = 0.04
"""Afterpulses per detection of the twins of matched ratio [1]."""


def easton(seed: int, share: float = 1.0) -> Scene:
    """Twin of [W18]'s Easton, 10 November: a line of three cables, a distribution line, roofs.

    The cables of either line hang above each other, so that the region of 7 m x 7 m holds them.
    ``share``: part of the edges that is flown; a part has one flightline of the three.
    """
    rng = np.random.default_rng(seed)
    extent_m = 100.0 * share, 70.0
    towers = across(rng, extent_m, 0.68 * extent_m[1], 200.0)
    poles = across(rng, extent_m, 0.25 * extent_m[1], 50.0)
    cables = [_cable("transmission", towers, 26.0 + up, 0.03, sag_m=5.0) for up in (0.0, 2.2, 4.4)]
    # the lowest wire of the distribution line is the thickest [W18 3.1-3.2]
    thin = [
        _cable("distribution", poles, 9.0 + up, diameter, sag_m=0.7)
        for up, diameter in ((0.0, 0.02), (1.2, 0.01), (2.4, 0.012))
    ]
    return _scene(
        "Easton's twin",
        seed,
        {
            "extent_m": list(extent_m),
            "terrain": {"relief_m": 5.0},
            "buildings": {"list": _row_of_roofs(rng, extent_m, 0.46)},
            "trees": {"cover": 0.15},
            "wires": cables + thin,
            "flights": flights(
                rng, 3 if share == 1.0 else 1, altitude_agl_m=3500.0, offset_m=250.0, speed_m_s=72.0
            ),
            "sensor_overrides": {"half_cone_deg": 9.0},
            "sky": {"zenith_deg": 56.0},
            "acquisition": {"prf_hz": 60_000.0, "gate_m": 300.0},
            "reference": {"density_per_m2": 25.0},
        },
    )


EASTON_PER_M3, LUFKIN_PER_M3, CANOPY_PER_M3 = 0.0073, 0.0045, 0.12
"""Background at which the corridors hold 8.0, 5.8 and 11 returns of wire for one of noise, as many
as the source's did if its VSAES kept the share of noise that it keeps on the twins by the link
budget, and that of the canopy's twin [1/m3]."""


def easton_matched(seed: int, share: float = 1.0) -> Scene:
    """Easton's twin with as much wire for one of noise in its corridors as the source had."""
    return _matched(easton(seed, share), EASTON_PER_M3)


def lufkin(seed: int, share: float = 1.0) -> Scene:
    """Twin of [W18]'s Lufkin, 23 February: three wires on top, one in the middle, one below."""
    rng = np.random.default_rng(seed)
    extent_m = 120.0 * share, 60.0
    poles = across(rng, extent_m, 0.5 * extent_m[1], 55.0)
    wires = [
        {**_cable("distribution", poles, 12.5, 0.015, sag_m=0.8), "conductors": 3},
        _cable("distribution", poles, 10.9, 0.01, sag_m=0.8),
        _cable("distribution", poles, 9.3, 0.02, sag_m=0.8),
    ]
    return _scene(
        "Lufkin's twin",
        seed,
        {
            "extent_m": list(extent_m),
            "terrain": {"relief_m": 6.0},
            "trees": {"cover": 0.3},
            "wires": wires,
            "flights": flights(rng, 3, altitude_agl_m=2000.0, offset_m=250.0),
            "sensor_overrides": {"pulse_energy_uj": 30.0},
            "sky": {"zenith_deg": 41.0},
            "acquisition": {"prf_hz": 50_000.0, "gate_m": 85.0},
        },
    )


def lufkin_matched(seed: int, share: float = 1.0) -> Scene:
    """Lufkin's twin with as much wire for one of noise in its corridor as the source had."""
    return _matched(lufkin(seed, share), LUFKIN_PER_M3)


def houston(seed: int, share: float = 1.0) -> Scene:
    """Twin of [W17] 7.3: a campus of 20 roofs from dark to bright, flat, shed and gable.

    One flightline gives the source's 30 returns per m2 once most beamlets see the ground, as 7.5
    says they do; the pulse energy represents that brightness.
    """
    rng = np.random.default_rng(seed)
    extent_m = 160.0 * share, 150.0 * share
    bright = rng.permutation(np.linspace(DARK_ROOF, BRIGHT_ROOF, 20))
    roofs = [_roof(rng, k, extent_m, float(bright[k]), share) for k in range(20)]
    return _scene(
        "Houston's twin",
        seed,
        {
            "extent_m": list(extent_m),
            "terrain": {"relief_m": 3.0},
            "buildings": {"list": roofs},
            "trees": {"cover": 0.1},
            "flights": flights(rng, 1, altitude_agl_m=4200.0, offset_m=600.0),
            "sensor_overrides": {"pulse_energy_uj": 1500.0},
            "sky": {"zenith_deg": 39.0},
            "acquisition": {"prf_hz": 60_000.0, "gate_m": 250.0},
        },
    )


def houston_deep(seed: int, share: float = 1.0) -> Scene:
    """A part of Houston's twin with lags as long as [W17] Fig. 7-6 shows terrain to be off: 5 m."""
    content = houston(seed, 0.6 * share).model_dump(mode="json", by_alias=True)
    content["detector"] |= {"afterpulse_scale_m": 2.0, "afterpulse_lag_max_m": 5.0}
    return parse_scene(content, "houston_deep")


def canopy(seed: int, share: float = 1.0) -> Scene:
    """Twin of [W17] 5.3: HRQLS over five roofs (three tilted), lawns and a grove."""
    rng = np.random.default_rng(seed)
    extent_m = 130.0 * share, 130.0 * share
    roofs = [
        {
            **roof,
            "size_m": [16.0 * share, 13.0 * share],
            "reflectance": float(rng.uniform(0.4, 0.7)),
        }
        for roof in _row_of_roofs(rng, extent_m, 0.16)
    ]
    return _scene(
        "Easton's twin, HRQLS",
        seed,
        {
            "extent_m": list(extent_m),
            "terrain": {"relief_m": 6.0},
            "buildings": {"list": roofs},
            "trees": {"cover": 0.35},
            "flights": flights(rng, 1, altitude_agl_m=3500.0, offset_m=350.0),
            "sensor": "hrqls",
            "sensor_overrides": {"pulse_energy_uj": 200.0},
            "sky": {"zenith_deg": 21.0},
            "acquisition": {"prf_hz": 25_000.0, "gate_m": 300.0},
        },
    )


def canopy_matched(seed: int, share: float = 1.0) -> Scene:
    """The canopy's twin with background near roofs in place of most afterpulses."""
    return _matched(canopy(seed, share), CANOPY_PER_M3)


TWINS: Mapping[str, Callable[..., Scene]] = MappingProxyType(
    {
        "easton matched": easton_matched,
        "lufkin matched": lufkin_matched,
        "canopy matched": canopy_matched,
        "easton": easton,
        "lufkin": lufkin,
        "houston": houston,
        "houston deep": houston_deep,
        "canopy": canopy,
    }
)
"""Scene by name, of a seed and of the part of its edges that is flown."""


def _scene(name: str, seed: int, content: dict[str, Any]) -> Scene:
    return parse_scene({"name": name, "seed": seed, **content}, name)


def _matched(scene: Scene, background_per_m3: float) -> Scene:
    """A twin of another background and fewer afterpulses."""
    content = scene.model_dump(mode="json", by_alias=True)
    content["sky"]["background_per_m3"] = background_per_m3
    content["detector"]["afterpulse_probability"] = FEWER_AFTERPULSES
    return parse_scene(content, scene.name)


def _cable(
    kind: str, towers: list[Place], height_m: float, diameter_m: float, *, sag_m: float
) -> Wire:
    """One cable of a line; its companions are lines of their own at the same towers."""
    return {
        "kind": kind, "points_m": towers, "height_m": height_m, "diameter_m": diameter_m,
        "sag_m": sag_m, "conductors": 1, "spacing_m": 0.9, "shield": False,
    }  # fmt: skip


def _row_of_roofs(rng: np.random.Generator, extent_m: Place, at: float) -> list[dict[str, Any]]:
    """Five roofs side by side, three of them tilted, at a part of the way north."""
    east, north = extent_m
    return [
        {
            "centre_m": [(0.14 + 0.18 * k) * east, at * north], "size_m": [12.0, 11.0],
            "heading_deg": float(rng.uniform(0, 180)), "eave_m": float(rng.uniform(4, 10)),
            "roof": SHAPES[k % 3], "pitch_deg": float(rng.uniform(15, 30)),
        }
        for k in range(5)
    ]  # fmt: skip


def _roof(
    rng: np.random.Generator, k: int, extent_m: Place, reflectance: float, share: float
) -> dict[str, Any]:
    """The k-th roof on a grid of five by four; the source's regions are parts of larger roofs."""
    column, row = k % 5, k // 5
    return {
        "centre_m": [(column + 0.5) / 5 * extent_m[0], (row + 0.5) / 4 * extent_m[1]],
        "size_m": [share * float(rng.uniform(18, 24)), share * float(rng.uniform(13, 18))],
        "heading_deg": float(rng.uniform(0, 180)),
        "eave_m": float(rng.uniform(4, 15)),
        "roof": SHAPES[k % 3],
        "pitch_deg": float(rng.uniform(10, 35)),
        "reflectance": reflectance,
    }
