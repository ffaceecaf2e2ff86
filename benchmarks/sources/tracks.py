"""[W17] 4.3: RMSE of the kept photons of MABEL-like channels against the ground below them.

Channels of a track see the same ground with photons of their own, green ones less signal and more
noise than infrared ones.
"""

from typing import Final, get_args

import numpy as np

from benchmarks.altimetry.photon_beams import Colour, Kind, labelled, lattice, scene, workflow
from benchmarks.sources.given import Figures, Given
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.altimetry.simulate import Track, simulate_track

CHANNELS: Final = 3
LENGTH_M: Final = 3000.0
"""Channels of a colour, of 16 and 8 [count], and length of a track, of about 12 km [m]."""

METHODS: Final = {
    "bayes": {"method": "published"},
    "mdbscan": {"method": "mdbscan", "mdbscan": {"scaled": False}},
    "scaled": {"method": "mdbscan", "mdbscan": {"scaled": True}},
    "ours": {"method": "likelihood"},
}
"""Section ``signal`` of each filter."""


def settings() -> dict[str, TrackWorkflow]:
    """Settings of each filter."""
    return {name: workflow(signal=signal) for name, signal in METHODS.items()}


def measure(given: Given) -> Figures:
    """RMSE [m], ``KIND.COLOUR.METHOD.mean``, ``.least`` and ``.most`` of channels."""
    found: Figures = {}
    length_m, channels = (1000.0, 1) if given.quick else (LENGTH_M, CHANNELS)
    for kind in given.some(get_args(Kind)):
        for colour in get_args(Colour):
            one = scene(kind, colour, given.seed, length_m=length_m)
            tracks = [simulate_track(one.model_copy(update={"stream": k})) for k in range(channels)]
            for name, chosen in settings().items():
                off = [_rmse_m(track, chosen) for track in tracks]
                at = f"{kind}.{colour}.{name}"
                found |= {f"{at}.mean": float(np.mean(off)), f"{at}.least": min(off)}
                found[f"{at}.most"] = max(off)
    return found


def _rmse_m(track: Track, chosen: TrackWorkflow) -> float:
    """RMSE of the photons that a filter keeps [m]."""
    kept = labelled(lattice(track.along_m, track.height_m), chosen).kept
    off = (track.height_m - track.ground_m)[kept]
    return float(np.sqrt(np.mean(off**2))) if len(off) else float("nan")
