"""Scenes of :mod:`benchmarks.airborne.afterpulse.afterpulses`."""

from typing import Any

RING = [[20, 20], [80, 25], [85, 75], [30, 80]]
FLIGHTS: list[dict[str, Any]] = [
    {"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
    {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110},
    {"heading_deg": 200, "offset_m": 350, "speed_m_s": 110, "sky": 1.3},
]


def scene(name: str, seed: int, law: tuple[float, float], **parts: Any) -> dict[str, Any]:
    """Content of a scene file; ``law`` is afterpulses per detection and their scale [m]."""
    return {
        "name": name,
        "extent_m": [100, 100],
        "seed": seed,
        "terrain": {"relief_m": 8},
        "flights": FLIGHTS,
        "sky": {"background_per_m3": 0.08},
        "acquisition": {"prf_hz": 30_000, "gate_m": 150},
        "sensor_overrides": {"afterpulse_probability": law[0], "afterpulse_scale_m": law[1]},
        **parts,
    }


def trees(**keys: float) -> dict[str, Any]:
    """A canopy of 60 % cover, its crowns evenly turbid."""
    return {"cover": 0.6, **keys}


def clumps(across_m: float = 0.8, **keys: float) -> dict[str, Any]:
    """Leaves in clumps about so far across, two along a vertical path, with air between them."""
    return {"cover": 0.85, "height_m": [3, 16],
            "radius_m": [0.375 * across_m, 0.625 * across_m], "crown_share": 0.075 * across_m,
            "extinction_per_m": 2.0, "gaps": 0.0, "understory": 0.0, **keys}  # fmt: skip


CANOPIES = (
    scene("canopy", 1, (0.15, 0.7), trees=trees()),
    scene("canopy, another seed", 21, (0.15, 0.7), trees=trees()),
    scene("open crowns", 2, (0.15, 0.7), trees=trees(extinction_per_m=0.2)),
    scene("dense crowns, p 0.2, 0.4 m", 3, (0.2, 0.4), trees=trees(extinction_per_m=0.6)),
    scene("p 0.1, 1.0 m", 11, (0.1, 1.0), trees=trees()),
    scene("p 0.2, 0.3 m", 14, (0.2, 0.3), trees=trees()),
    scene("dim leaves", 12, (0.15, 0.7), trees=trees(reflectance=0.12)),
    scene("dark ground", 15, (0.15, 0.7), trees=trees(), terrain={"reflectance": 0.08}),
    scene("one flightline", 13, (0.15, 0.7), trees=trees(), flights=FLIGHTS[:1]),
    scene("clumps of leaves", 16, (0.15, 0.7), trees=clumps(), extent_m=[45, 45]),
    scene("clumps, p 0.2, 0.3 m", 17, (0.2, 0.3), trees=clumps(), extent_m=[45, 45]),
    scene("clumps, one flightline", 18, (0.15, 0.7), trees=clumps(), extent_m=[45, 45],
          flights=FLIGHTS[:1]),
    scene("clumps, two flightlines", 41, (0.15, 0.7), trees=clumps(), extent_m=[45, 45],
          flights=FLIGHTS[:2]),
    scene("clumps, four flightlines", 42, (0.15, 0.7), trees=clumps(), extent_m=[45, 45],
          flights=[*FLIGHTS, {"heading_deg": 290, "offset_m": -250, "speed_m_s": 110}]),
    scene("clumps of 0.4 m", 43, (0.15, 0.7), trees=clumps(0.4), extent_m=[45, 45]),
    scene("clumps of 1.5 m", 44, (0.15, 0.7), trees=clumps(1.5), extent_m=[45, 45]),
    scene("clumps, extinction 1 /m", 45, (0.15, 0.7), trees=clumps(extinction_per_m=1.0),
          extent_m=[45, 45]),
    scene("clumps, extinction 4 /m", 46, (0.15, 0.7), trees=clumps(extinction_per_m=4.0),
          extent_m=[45, 45]),
)  # fmt: skip

CLUMP_EXTINCTION = 2.0
BOUNDS = (
    *(((p, 0.7), extinction) for extinction in (0.15, 0.35, 0.7) for p in (0.1, 0.15, 0.2)),
    *(((p, scale), 0.35) for scale in (0.3, 1.0) for p in (0.1, 0.15, 0.2)),
    *(((p, 0.7), CLUMP_EXTINCTION) for p in (0.1, 0.15, 0.2)),
    *(((0.15, scale), CLUMP_EXTINCTION) for scale in (0.3, 1.0)),
)
"""Law, and extinction of crowns or of clumps of leaves [1/m], of the bound's table."""

PULSE_UJ = 83.0
"""Energy of the preset's pulse [uJ]."""


def lit(name: str, seed: int, light: float, trees: dict[str, Any], side: float) -> dict[str, Any]:
    """A canopy that sends so much of the usual light; dim ones are larger, to have as many."""
    side += 10 if light < 0.3 else 0
    content = scene(f"{name}, {light:g} of the light", seed, (0.15, 0.7), trees=trees,
                    extent_m=[side, side])  # fmt: skip
    content["sensor_overrides"]["pulse_energy_uj"] = PULSE_UJ * light
    return content


def easton(name: str, seed: int, p: float, trees: dict[str, Any], side: float) -> dict[str, Any]:
    """A canopy seen as [W18] 2.1 saw Easton: 18 returns per m2 and line, as in the twin."""
    content = scene(f"{name}, Easton, p {p:g}", seed, (p, 0.7), trees=trees, extent_m=[side, side],
                    acquisition={"prf_hz": 60_000, "gate_m": 300})  # fmt: skip
    content["flights"] = [{**f, "altitude_agl_m": 3500.0, "speed_m_s": 72.0} for f in FLIGHTS]
    content["sensor_overrides"]["half_cone_deg"] = 9.0
    return content


def lufkin(name: str, seed: int, trees: dict[str, Any], side: float) -> dict[str, Any]:
    """A canopy seen as [W18] 2.1 saw Lufkin: 20 returns per m2 and line, as in the twin."""
    content = scene(f"{name}, Lufkin", seed, (0.15, 0.7), trees=trees, extent_m=[side, side],
                    acquisition={"prf_hz": 50_000, "gate_m": 85})  # fmt: skip
    content["flights"] = [{**f, "altitude_agl_m": 2000.0, "speed_m_s": 90.0} for f in FLIGHTS]
    content["sensor_overrides"]["pulse_energy_uj"] = 30.0
    return content


def campus(name: str, seed: int, trees: dict[str, Any], side: float) -> dict[str, Any]:
    """A canopy in the light of [W17] 7.5, where 80-100 of 100 beamlets return, as in the twin."""
    content = scene(f"{name}, campus", seed, (0.15, 0.7), trees=trees, extent_m=[side, side],
                    acquisition={"prf_hz": 60_000, "gate_m": 250})  # fmt: skip
    content["flights"] = [{**f, "altitude_agl_m": 4200.0, "speed_m_s": 90.0} for f in FLIGHTS]
    content["sensor_overrides"]["pulse_energy_uj"] = 1500.0
    return content


LIGHTS = (
    *(lit("clumps", 71 + k, light, clumps(), 45) for k, light in enumerate((1, 0.5, 0.25, 0.125))),
    lit("round clumps", 90, 1, clumps(height_m=[10, 23], crown_share=0.05), 45),
    *(lit("turbid", 81 + k, light, trees(), 70) for k, light in enumerate((1, 0.5, 0.25, 0.125))),
    *(easton("clumps", 75 + k, p, clumps(), 35) for k, p in ((1, 0.15), (2, 0.2))),
    *(easton("turbid", 85 + k, p, trees(), 50) for k, p in ((1, 0.15), (2, 0.2))),
    lufkin("clumps", 78, clumps(), 35),
    lufkin("turbid", 88, trees(), 50),
    campus("clumps", 79, clumps(), 35),
    campus("turbid", 89, trees(), 50),
)
"""Canopies by light: the share of the preset's pulse energy, and that of published surveys
(:mod:`benchmarks.airborne.published.twins`)."""

WATERS = (
    scene("lake of 2 m", 5, (0.15, 0.7), trees={"cover": 0.1}, water=[
        {"ring_m": RING, "depth_m": 2.0, "bank_slope": 0.15, "bottom_reflectance": 0.2}]),
    scene("bright surface, 1.2 m", 6, (0.15, 0.7), trees={"cover": 0.1}, water=[
        {"ring_m": RING, "depth_m": 1.2, "reflectance": 0.15, "bottom_reflectance": 0.1}]),
    scene("brighter, 3 m, turbid", 7, (0.2, 0.5), trees={"cover": 0.1}, water=[
        {"ring_m": RING, "depth_m": 3.0, "reflectance": 0.2, "bottom_reflectance": 0.15,
         "attenuation_per_m": 0.25}]),
)  # fmt: skip

ROOFS = scene("roofs", 4, (0.15, 0.7), buildings={"count": 8}, trees={"cover": 0.15},
              extent_m=[120, 120])  # fmt: skip
