"""A small flight over a part of the artificial Geiger-mode scene, and bounds of that part."""

from functools import cache

import numpy as np

from spl_batch.geiger.coincidence.simulate import SceneSettings, build, detect, flights
from spl_batch.geiger.coincidence.tables import Detections, Frames
from spl_batch.lattice.tiles import Bounds

SMALL = SceneSettings(
    seed=5,
    targets=("spokes",),
    extent_m=(3.0, 2.0),
    centre_m=(4.2, 0.5),
    array={"rows": 16, "columns": 32},
    flight={
        "headings_deg": (0.0, 90.0),
        "speed_m_s": 25.0,
        "sweep_rad": 2e-3,
        "pulse_rate_hz": 1000,
    },
)
"""Spokes and ground beside them, seen by a sixteenth of the source's array."""


@cache
def flown() -> tuple[Frames, Detections]:
    frames = list(flights(SMALL))
    found = [detect(SMALL, seen, build(SMALL)) for seen in frames]
    return Frames.joined(frames), Detections.joined(found)


def region(scene: SceneSettings = SMALL) -> Bounds:
    """The part that is looked at, on the lattice."""
    centre = np.array(scene.origin_m[:2]) + scene.centre_m
    half = np.array(scene.extent_m) / 2
    low, high = (np.rint(v * 1000).astype(int).tolist() for v in (centre - half, centre + half))
    return Bounds(*low, *high)


def local(xyz: np.ndarray) -> np.ndarray:
    """Points from the scene's centre and ground [m]."""
    return xyz / 1000 - np.array(SMALL.origin_m)
