"""[G15] Fig. 2.13 and 3.14-3.16, Tables 4.2 and 4.4 on a twin of the water tank.

Beam, delays, errors of the calibration's distances and the depth that light comes back from were
chosen so that the source's own way comes near its figures of Fig. 2.13 and of the tables. Gates and
times were not.
"""

import time
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.geiger.water import water_surface as water
from benchmarks.sources.given import Figures, Given
from spl_batch.geiger.water.ranges import Calibration, Gate, add_up, find_gate, histogram
from spl_batch.geiger.water.settings import GateSettings
from spl_batch.geiger.water.simulate import Instrument, acquisitions
from spl_batch.geiger.water.surface import make_surface, ranges

ACQUISITIONS: Final = 20
WAYS: Final = {"source": "the source's way", "ours": "ours"}
OFF_BINS: Final = 13
"""By so much the source's improper gate of Fig. 3.15 lies too low [count]."""


def measure(given: Given) -> Figures:
    """Spread by frames, by gate; errors by target and way; time of an acquisition."""
    instrument = Instrument(seed=given.seed)
    ways, dead = water.calibrated_ways(instrument, given.seed)
    wet = instrument.model_copy(update=water.ON_WATER)
    count = 1 if given.quick else ACQUISITIONS
    found = _gates(instrument, ways["the source's way"][0], dead)
    chosen = [ways[name] for name in WAYS.values()]
    for name, target, receiver, view in (
        ("hard", water.HARD, instrument, water.HARD_VIEW),
        ("calm", water.CALM, wet, water.WATER_VIEW),
    ):
        made = list(water.surfaces(target, receiver, view, dead, chosen, count, 50 + given.seed))
        for k, way in enumerate(WAYS):
            means = np.mean([water.errors(a, surfaces[k]) for a, surfaces in made], axis=0)
            for what, value in zip(("bias", "variance", "mse", "normal"), means, strict=False):
                found[f"{name}.{way}.{what}"] = float(value)
    frames = made[0][0].frames
    for k, way in enumerate(WAYS):
        start = time.process_time()
        for _ in range(5):
            surface = chosen[k][0], water.WATER_VIEW, water.CAMERA, water.PIXELS, chosen[k][1]
            make_surface(water.gated(frames), dead, *surface)
        found[f"{way}.ms"] = 1e3 * (time.process_time() - start) / 5
    return found


def _gates(instrument: Instrument, known: Calibration, dead: NDArray[np.bool_]) -> Figures:
    """Spread [cm] and mean square error [cm2] of a flat target, without gate, off it, and in it."""
    drawn = acquisitions(water.HARD, instrument, water.CAMERA, water.HARD_VIEW, 1, 5000, 77)
    frames = next(iter(drawn)).frames
    proper = find_gate(histogram(frames, water.USED, water.CAMERA.bins), GateSettings())
    assert proper is not None
    off = Gate(proper.low - OFF_BINS, proper.high - OFF_BINS)
    found: Figures = {}
    for name, gate in (("none", Gate(1, water.CAMERA.bins + 1)), ("off", off), ("proper", proper)):
        hits = add_up(frames[: water.FRAMES], gate)
        down = ranges(hits, dead, known, water.CAMERA, water.PIXELS) / water.HARD_VIEW.norm
        found[f"gate {name}.spread"] = 100 * float(np.nanstd(down))
        found[f"gate {name}.mse"] = 1e4 * float(np.nanmean((down - water.HARD.down_m) ** 2))
        found[f"gate {name}.spread_m"] = found[f"gate {name}.spread"] / 1e2
        found[f"gate {name}.mse_m2"] = found[f"gate {name}.mse"] / 1e4
    for count in (1, 200, 5000):
        hits = add_up(frames[:count], proper)
        down = ranges(hits, dead, known, water.CAMERA, water.PIXELS) / water.HARD_VIEW.norm
        found[f"{count} frames"] = 100 * float(np.nanstd(down))
    return found
