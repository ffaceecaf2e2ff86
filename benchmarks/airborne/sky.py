"""What a real sky and stray light do to the result, and whether the run says so.

Run ``python -m benchmarks.airborne.sky [FOLDER] [--only NAME ...] [--times 0.5 1 2]``.

Each row is a small survey with one effect that the model of the noise does not know, run with the
default settings; :mod:`benchmarks.airborne.sky_figures` has the figures. An effect is ``held``
where none is worse than that of the base by more than :data:`HELD` allows. Else it is ``told`` if
the run has a finding that the scene without the effect has not, and of a code that says what is off
(:data:`SAYS`), or ``SILENT``; ``--say`` prints the new warnings, ``--fit`` how the run judges its
own fit.

``--before CHECKOUT``: another version of this repository runs on the same files; its row stands
above this one's.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.airborne.other_version import OUT, run_by
from benchmarks.airborne.sky_figures import measure
from benchmarks.airborne.told import new_warnings, telling, told_by
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import parse_scene
from spl_batch.engine.verbs.running import run

BASE: dict[str, Any] = {
    "name": "base",
    "extent_m": [110, 110],
    "seed": 11,
    "terrain": {"relief_m": 8, "wavelength_m": 100},
    "buildings": {"count": 3},
    "trees": {"cover": 0.25},
    "wires": [
        {"kind": "transmission", "points_m": [[-60, 75], [170, 95]], "height_m": 24, "sag_m": 4,
         "returns_per_m": 0.8},
    ],
    "flights": [
        {"heading_deg": 0, "offset_m": 300, "speed_m_s": 110},
        {"heading_deg": 90, "offset_m": -280, "speed_m_s": 110},
    ],
    "sky": {"background_per_m3": 0.05},
    "acquisition": {"prf_hz": 25_000, "gate_m": 250},
}  # fmt: skip


def haze(times: float, base_m: float, top_m: float, cover: float = 0.5) -> dict[str, Any]:
    """A layer in patches that drift."""
    layer = {"base_m": base_m, "top_m": top_m, "times_noise": times, "cover": cover,
             "patch_m": 60, "drift_m_s": [3, 1]}  # fmt: skip
    return {"sky": {"haze": [layer]}}


def tapering(times: float) -> dict[str, Any]:
    """A closed layer that is dense in its middle alone."""
    (layer,) = haze(times, 52, 64, 1.0)["sky"]["haze"]
    return {"sky": {"haze": [{**layer, "edge_m": 12}]}}


def sheet(times: float, base_m: float, thick_m: float) -> dict[str, Any]:
    """A layer thinner than those that are told by how they fill blocks."""
    (layer,) = haze(times, base_m, base_m + thick_m, 0.7)["sky"]["haze"]
    return {"sky": {"haze": [{**layer, "edge_m": 0.2}]}}


def swinging(times: float) -> dict[str, Any]:
    """Recorded positions swing within half a second."""
    return {"flights": [{**flight, "jitter_m": 0.2 * times} for flight in BASE["flights"]]}


def small_patches(times: float) -> dict[str, Any]:
    """The same in patches half as large that drift faster."""
    (layer,) = haze(50 * times, 30, 50, 0.4)["sky"]["haze"]
    return {"sky": {"haze": [{**layer, "patch_m": 30, "drift_m_s": [4, -2]}]}}


def tail(times: float) -> dict[str, Any]:
    """One return in four is followed by an afterpulse, some of them late by a power law."""
    late = {"share": min(0.4 * times, 1.0), "scale_m": 2.0, "power": 2.0}
    return {"detector": {"afterpulse_probability": 0.25, "afterpulse_lag_max_m": 15, "tail": late}}


def two_exponentials(times: float) -> dict[str, Any]:
    """The same, the late ones by an exponential law of their own."""
    late = {"share": min(0.4 * times, 1.0), "scale_m": 4.0}
    return {"detector": {"afterpulse_probability": 0.25, "afterpulse_lag_max_m": 15, "tail": late}}


def apart(times: float) -> dict[str, Any]:
    """The second flightline is recorded off."""
    first, second = BASE["flights"]
    return {"flights": [first, {**second, "strip_offset_m": [0.3 * times, 0, 0.2 * times]}]}


def dark_lake(times: float) -> dict[str, Any]:
    """A lake that hardly sends anything back."""
    ring = [[20, 15], [80, 15], [80, 60], [20, 60]]
    return {"water": [{"ring_m": ring, "reflectance": 0.002 / times}]}


def two_clouds(times: float) -> dict[str, Any]:
    """Two layers of patches, one above the other."""
    layers = [
        {**layer, "patch_m": patch_m, "drift_m_s": [4, -2]}
        for patch_m, of in (
            (50, haze(25 * times, 40, 55, 0.6)),
            (80, haze(15 * times, 80, 100, 0.7)),
        )
        for layer in of["sky"]["haze"]
    ]
    return {"sky": {"haze": layers}}


def long_lags(times: float) -> dict[str, Any]:
    """Most afterpulses come late, by a power law that hardly ends."""
    late = {"share": min(0.6 * times, 1.0), "scale_m": 1.0, "power": 1.3}
    return {"detector": {"afterpulse_probability": 0.2, "afterpulse_lag_max_m": 40, "tail": late}}


def city(times: float) -> dict[str, Any]:
    """High houses in fog."""
    return {"buildings": {"count": 14, "eave_m": [20, 60]}, "trees": {"cover": 0.05},
            "sky": {"fog": [{"times_noise": 40 * times, "scale_m": 3}]}}  # fmt: skip


def unlike(**second: Any) -> dict[str, Any]:
    """The second flightline is unlike the first."""
    first, usual = BASE["flights"]
    return {"flights": [first, {**usual, **second}]}


def all_from(altitude_m: float, nearer: float = 1.0) -> dict[str, Any]:
    """Both flightlines at another height, and nearer to the scene."""
    flights = [
        {**flight, "altitude_agl_m": altitude_m, "offset_m": nearer * flight["offset_m"]}
        for flight in BASE["flights"]
    ]
    return {"flights": flights}


def snow(_: float) -> dict[str, Any]:
    """Bright ground, and a lake with waves."""
    ring = [[20, 15], [80, 15], [80, 60], [20, 60]]
    return {"terrain": {"reflectance": 0.8}, "water": [{"ring_m": ring, "waves_m": 0.3}]}


EFFECTS: dict[str, Any] = {
    "base": lambda _: {},
    "by tile, no ids": lambda _: {"delivery": {"tile_m": 40, "point_source_id": False}},
    "no channel numbers": lambda _: {},
    "haze 60-100 m, 5 x": lambda t: haze(5 * t, 60, 100),
    "haze 60-100 m, 20 x": lambda t: haze(20 * t, 60, 100),
    "haze 25-45 m, 30 x": lambda t: haze(30 * t, 25, 45),
    "closed cloud 70-110 m, 20 x": lambda t: haze(20 * t, 70, 110, 1.0),
    "tapering cloud 46-70 m, 20 x": lambda t: tapering(20 * t),
    "fog, 1.5 m, 60 x": lambda t: {"sky": {"fog": [{"times_noise": 60 * t, "scale_m": 1.5}]}},
    "noise falls along the gate": lambda t: {"sky": {"gate_fall": 0.4 * t}},
    "afterpulses, tail of 40 %": tail,
    "afterpulses, two exponentials": two_exponentials,
    "ranging noise 15 cm": lambda t: {"detector": {"range_sigma_m": 0.15 * t}},
    "strips 0.3 m east, 0.2 m up": apart,
    "the same strips, aligned": apart,
    "lake, 0.2 % reflected": dark_lake,
    "noise 0.3 per m3": lambda t: {"sky": {"background_per_m3": 0.3 * t}},
    "times rounded to 100 us": lambda t: {"delivery": {"time_step_us": 100 * t}},
    "haze 30-50 m, 50 x": small_patches,
    "thin haze 20-30 m, 30 x": lambda t: haze(30 * t, 20, 30, 0.7),
    "thinner haze 8-14 m, 20 x": lambda t: haze(20 * t, 8, 14),
    "sheet of 2 m at 30 m, 40 x": lambda t: sheet(40 * t, 30, 2),
    "sheet of 1 m at 15 m, 40 x": lambda t: sheet(40 * t, 15, 1),
    "sheet of 2 m at 55 m, 20 x": lambda t: sheet(20 * t, 55, 2),
    "sheet of 2 m at 70 m, 40 x": lambda t: sheet(40 * t, 70, 2),
    "sheet of 1 m at 90 m, 40 x": lambda t: sheet(40 * t, 90, 1),
    "two clouds": two_clouds,
    "long lags": long_lags,
    "boresight roll 0.02 deg": lambda t: unlike(boresight_roll_deg=0.02 * t),
    "range walk 0.3 m": lambda t: {"detector": {"range_walk_m": 0.3 * t}},
    "range walk 0.6 m": lambda t: {"detector": {"range_walk_m": 0.6 * t}},
    "positions swing by 0.2 m": swinging,
    "city in fog": city,
    "second gate 350 m": lambda _: unlike(gate_m=350),
    "second file in another CRS": lambda _: unlike(crs="EPSG:32616"),
    "second line from 1800 m": lambda _: unlike(altitude_agl_m=1800),
    "both lines from 1800 m": lambda _: all_from(1800),
    "both lines from 600 m": lambda t: all_from(600 / t, 0.25 / t),
    "snow, waves": snow,
    "60 kHz, times to 10 us": lambda _: {
        "acquisition": {"prf_hz": 60_000},
        "delivery": {"time_step_us": 10},
    },
    "cm, us, user_data": lambda _: {
        "delivery": {"channel_dimension": "user_data", "scale_m": 0.01, "time_step_us": 1}
    },
}
"""Effects by name: what strength makes of the base."""

_AIR = ("N02", "N03", "N04", "N07")
SAYS: dict[str, tuple[str, ...]] = {
    "base": (), "by tile, no ids": (), "no channel numbers": ("I04",),
    "haze 60-100 m, 5 x": _AIR, "haze 60-100 m, 20 x": _AIR, "haze 25-45 m, 30 x": _AIR,
    "closed cloud 70-110 m, 20 x": _AIR, "tapering cloud 46-70 m, 20 x": _AIR,
    "fog, 1.5 m, 60 x": _AIR, "noise falls along the gate": ("N02",),
    "afterpulses, tail of 40 %": ("A01",),
    "afterpulses, two exponentials": ("A01",), "ranging noise 15 cm": ("A01",),
    "strips 0.3 m east, 0.2 m up": ("S01",), "the same strips, aligned": ("S01",),
    "lake, 0.2 % reflected": ("G01", "G02"), "noise 0.3 per m3": ("N02", "G01"),
    "times rounded to 100 us": ("T01",), "haze 30-50 m, 50 x": _AIR,
    "thin haze 20-30 m, 30 x": _AIR, "thinner haze 8-14 m, 20 x": _AIR, "two clouds": _AIR,
    "long lags": ("A01",), "boresight roll 0.02 deg": ("S01",), "range walk 0.3 m": ("A01",),
    "sheet of 2 m at 30 m, 40 x": _AIR, "sheet of 1 m at 15 m, 40 x": _AIR,
    "sheet of 2 m at 55 m, 20 x": _AIR, "sheet of 2 m at 70 m, 40 x": _AIR,
    "sheet of 1 m at 90 m, 40 x": _AIR, "range walk 0.6 m": ("A01",),
    "positions swing by 0.2 m": ("A01",), "both lines from 600 m": (),
    "city in fog": _AIR, "second gate 350 m": (),
    "second file in another CRS": ("F01",), "second line from 1800 m": (),
    "both lines from 1800 m": (),
    "snow, waves": (), "cm, us, user_data": (), "60 kHz, times to 10 us": (),
}  # fmt: skip
"""Codes of findings that say what is off, by effect."""

ONCE: tuple[str, ...] = (
    "base", "by tile, no ids", "no channel numbers", "second gate 350 m",
    "second file in another CRS", "second line from 1800 m", "both lines from 1800 m",
    "snow, waves", "cm, us, user_data", "60 kHz, times to 10 us",
)  # fmt: skip
"""Those that have no strength."""

SETTINGS: dict[str, list[str]] = {
    "no channel numbers": ["survey.channel_dimension=null"],
    "60 kHz, times to 10 us": ["acquisition.prf_hz=null"],
    "the same strips, aligned": ["survey.align=vertical"],
}
"""Settings that an effect is run with."""

HELD: dict[str, float] = {
    "noise removed": -1.0, "far noise kept": 0.2, "afterpulses": -3.0, "ground": -0.5,
    "roof": -1.0, "vegetation": -1.0, "wire": -2.0, "ground found": -1.0,
    "DSM > 1 m": 0.3, "DTM rmse": 0.03,
}  # fmt: skip
"""By how much a figure may be higher, or lower, than the base's [%, m]."""

CLOSER: dict[str, dict[str, float]] = {
    "strips 0.3 m east, 0.2 m up": {"afterpulses": -1.0},
    "the same strips, aligned": {"afterpulses": -1.0},
}
"""Figures of an effect that may be worse by less."""


def scene(name: str, times: float) -> dict[str, Any]:
    """Content of a scene file."""
    merged = {k: dict(v) if isinstance(v, dict) else v for k, v in BASE.items()}
    for key, value in EFFECTS[name](times).items():
        merged[key] = {**merged.get(key, {}), **value} if isinstance(value, dict) else value
    return merged | {"name": f"{name}, {times:g}"}


def main() -> None:
    """Simulate, run, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--only", nargs="+", choices=list(EFFECTS), default=list(EFFECTS))
    parser.add_argument("--times", nargs="+", type=float, default=[1.0])
    parser.add_argument("--without", action="store_true", help="noise.haze: false")
    parser.add_argument("--say", action="store_true", help="print the warnings")
    parser.add_argument("--fit", action="store_true", help="print p-values")
    parser.add_argument("--before", type=Path, metavar="CHECKOUT", help="another version")
    given = parser.parse_args()
    folder = given.folder or Path(tempfile.mkdtemp())
    settings = ["noise.haze=false"] if given.without else []
    rows = [
        (name, times)
        for name in dict.fromkeys(("base", *given.only))
        for times in ([1.0] if name in ONCE else given.times)
    ]
    surveys = [simulated(folder, *row) for row in rows]
    overrides = [[*settings, *SETTINGS.get(name, ())] for name, _ in rows]
    versions = ["out"]
    if given.before:
        versions.insert(0, OUT)
        workflows = [survey / "workflow.yaml" for survey in surveys]
        run_by(given.before, [*zip(workflows, (SETTINGS.get(n, ()) for n, _ in rows), strict=True)])
    usual: dict[str, tuple[dict[str, float], list[str]]] = {}
    for (name, times), survey, changed in zip(rows, surveys, overrides, strict=True):
        run(survey / "workflow.yaml", workers=0, overrides=changed)
        for out in versions:
            figures = measure(survey, out)
            said = told_by(json.loads((survey / out / "report.json").read_text()))
            if name == "base":
                if not usual:
                    print(f"{'':34s}" + "".join(f"{key:>15s}" for key in figures))
                usual[out] = figures, said
            title = f"{name:30s}{times:4g}" if out == versions[0] else ""
            _print(name, title, figures, said, usual[out], say=given.say)
        if given.fit:
            print(f"    {fit(survey)}")


def simulated(folder: Path, name: str, times: float) -> Path:
    """Folder of a survey with an effect, made where it is not there."""
    survey = folder / f"{name}_{times:g}".replace(" ", "_").replace(",", "")
    if not (survey / "workflow.yaml").exists():
        simulate(parse_scene(scene(name, times), name), survey)
    return survey


def _print(
    name: str,
    title: str,
    figures: dict[str, float],
    said: Sequence[str],
    usual: tuple[dict[str, float], list[str]],
    *,
    say: bool,
) -> None:
    """One survey by one version: figures, verdict, and codes of new findings."""
    base, known = usual
    new = new_warnings(said, known)
    told = bool(telling(new, SAYS[name]))
    words = verdict(figures, base, told=told, held=HELD | CLOSER.get(name, {}))
    row = "".join(f"{value:15.2f}" for value in figures.values())
    listed = f" [{', '.join(dict.fromkeys(new))}]" if new else ""
    print(f"{title:34s}{row} {words}{listed}", flush=True)
    for text in new if say else []:
        print(f"    {text}")


def fit(survey: Path) -> str:
    """How this version judges its own fit: p-values below all surfaces."""
    said = json.loads((survey / "out" / "report.json").read_text())["noise"]["fit"]
    return f"{said['p_value_times']:.2f} times as many p-values as uniform ones"


def verdict(
    figures: dict[str, float], base: dict[str, float], *, told: bool,
    held: Mapping[str, float] = HELD,
) -> str:  # fmt: skip
    """Held, told or silent, and the figures that are worse than is held."""
    worse = [
        f"{key} {figures[key] - base[key]:+.2f}"
        for key, most in held.items()
        if (figures[key] - base[key]) * math.copysign(1, most) > abs(most)
    ]
    if not worse:
        return "held"
    return f"{'told' if told else 'SILENT'}: {', '.join(worse)}"


if __name__ == "__main__":
    main()
