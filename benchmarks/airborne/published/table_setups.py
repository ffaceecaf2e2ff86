"""Set-ups of the twins as they fly; called by :mod:`benchmarks.airborne.published.tables`.

Altitude, half cone, pulse rate, gate and the number of flightlines stand in the scenes; returns are
counted in the first seed's survey, above the scene's extent: per m2 and flightline without
background, as the sources give theirs, and background of all flightlines per m3 of the gate.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.airborne.filter import methods
from benchmarks.airborne.filter.methods import BACKGROUND
from benchmarks.airborne.published.twins import TWINS
from spl_batch.airborne.simulate.scene.scene_file import Scene

SAID: Mapping[str, tuple[str, str]] = {
    "easton": ("[W18] 2.1", "3.5 km, 9 deg, 60 kHz, 300 m, three lines, 18/m2 and line"),
    "lufkin": ("[W18] 2.1", "2 km, 15 deg, 50 kHz, 85 m, three lines, 20/m2 and line"),
    "houston": ("[W17] 7.3", "4.2 km, 30/m2"),
    "canopy": ("[W17] 5.3", "HRQLS, 3.5 km, 12/m2"),
}
"""What the sources say of each twin's set-up."""


class SetUp(NamedTuple):
    """How a twin is flown.

    Parameters
    ----------
    lines : int
        Flightlines [count].
    altitude_m : float
        Above the mean ground [m].
    half_cone_deg : float
        Between the beam and the wedge's axis [deg].
    prf_hz : float
        Shots per second [Hz].
    gate_m : float
        Slant length of the range gate [m].
    speed_m_s : float
        Over ground [m/s].
    zenith_deg : float
        Of the sun [deg].
    """

    lines: int
    altitude_m: float
    half_cone_deg: float
    prf_hz: float
    gate_m: float
    speed_m_s: float
    zenith_deg: float


def set_up(scene: Scene) -> SetUp:
    """Set-up of a twin, all of whose flightlines are flown alike."""
    (altitude, speed), *others = {(f.altitude_agl_m, f.speed_m_s) for f in scene.flights}
    if others:
        raise ValueError(f"{scene.name}: flightlines differ in altitude or speed")
    return SetUp(
        len(scene.flights), altitude, scene.instrument.half_cone_deg, scene.acquisition.prf_hz,
        scene.acquisition.gate_m, speed, scene.sky.zenith_deg,
    )  # fmt: skip


def setup_table(folder: Path, seeds: Sequence[int]) -> dict[str, tuple[SetUp, float, float]]:
    """Print the table of the first seed; set-up, returns per m2 and line, background per m3."""
    names = ("lines", "AGL m", "cone deg", "PRF kHz", "gate m", "m/s", "sun deg", "1/m2", "1/m3")
    print("\nSet-ups of the twins; returns per m2 and line, background per m3")
    print(f"{'':10s}" + "".join(f"{n:>9s}" for n in names) + "  as said")
    found = {}
    for name, (source, said) in SAID.items():
        scene = TWINS[name](seeds[0])
        survey = methods.make_survey(scene, folder / f"{name}_{seeds[0]}")
        flown = set_up(scene)
        points = methods.load_truth(survey)
        east, north = (points[a] - o for a, o in zip("xy", scene.origin_m, strict=False))
        inside = (east > 0) & (east < scene.extent_m[0]) & (north > 0) & (north < scene.extent_m[1])
        noise = int((inside & (points["kind"] == BACKGROUND)).sum())
        area = float(np.prod(scene.extent_m))
        density = (int(inside.sum()) - noise) / area / flown.lines
        background = noise / area / (flown.gate_m * math.cos(math.radians(flown.half_cone_deg)))
        found[name] = (flown, density, background)
        values = (
            flown.lines, flown.altitude_m, flown.half_cone_deg, flown.prf_hz / 1000.0,
            flown.gate_m, flown.speed_m_s, flown.zenith_deg,
        )  # fmt: skip
        print(
            f"{name:10s}" + "".join(f"{v:9g}" for v in values)
            + f"{density:9.1f}{background:9.3f}  {source}: {said}"
        )  # fmt: skip
    return found
