"""What window and threshold of the Bridge Sign filter do, on two parts of the known scene.

``python -m benchmarks.coincidence_settings [--seed 1]`` prints, for each setting: on 12 x 12 m
around the open spoke target the standard deviation and mean of its heights, precision and
completeness within one detector's ground size, points per square metre; on 28 x 11 m around the
tri-bars the contrast of some widths by number of points, the lesser of the two directions.
"""

import argparse
import time

import numpy as np

from spl_batch.geiger.coincidence import accuracy, stages
from spl_batch.geiger.coincidence.settings import CoincidenceSettings
from spl_batch.geiger.coincidence.simulate.flight import fly
from spl_batch.geiger.coincidence.simulate.scene import SceneSettings, build
from spl_batch.tiling import Bounds, inside

WINDOWS = (5, 7, 9)
THRESHOLDS = (0.03, 0.04, 0.05)
WIDTHS_M = (0.25, 0.20, 0.175, 0.15, 0.125, 0.10)
PIXEL_M = 0.09


def main(seed: int) -> None:
    """Print a line for each setting."""
    wheel = SceneSettings(seed=seed, targets=("spokes",), extent_m=(12.0, 12.0))
    bars = SceneSettings(seed=seed, targets=("bars",), extent_m=(28.0, 11.0), centre_m=(0.0, 25.0))
    flown = [(scene, *fly(scene)) for scene in (wheel, bars)]
    heights = 100 * accuracy.spoke_heights(_local(flown[0][2].xyz, wheel))
    print(f"detections: spoke heights SD {heights.std():.2f} cm, mean {heights.mean():+.2f} cm")
    detected = sum(_count(d.xyz, _part(s)) for s, _, d in flown)
    names = "  ".join(f"{100 * w:5g}" for w in WIDTHS_M)
    print(f"window thresh  SD cm  mean   prec %  compl %  1/m2   bars of {names} cm  1/CPU s")
    for window in WINDOWS:
        for threshold in THRESHOLDS:
            sign = {"window_voxels": window, "threshold": threshold}
            chosen = CoincidenceSettings.model_validate({"bridge_sign": sign})
            start = time.process_time()
            found = [
                _local(stages.coincide(f, d, _part(s), chosen, s.array).xyz, s) for s, f, d in flown
            ]
            spent = time.process_time() - start
            print(f"{window:4d}   {threshold:.3f} {_wheel(found[0], wheel)}   "
                  f"        {_bars(found[1])}  {detected / spent:12,.0f}", flush=True)  # fmt: skip


def _part(scene: SceneSettings) -> Bounds:
    centre = np.array(scene.origin_m[:2]) + scene.centre_m
    half = np.array(scene.extent_m) / 2
    low, high = (np.rint(v * 1000).astype(int).tolist() for v in (centre - half, centre + half))
    return Bounds(*low, *high)


def _count(xyz: np.ndarray, part: Bounds) -> int:
    """Detections in a part."""
    return int(inside(xyz[:, 0], xyz[:, 1], part).sum())


def _local(xyz: np.ndarray, scene: SceneSettings) -> np.ndarray:
    return xyz / 1000 - np.array(scene.origin_m)


def _wheel(xyz: np.ndarray, scene: SceneSettings) -> str:
    targets = build(scene)
    half = np.array(scene.extent_m) / 2 - 0.3
    truth = accuracy.seen_from_above(targets, -half, half, 0.05)
    heights = 100 * accuracy.spoke_heights(xyz)
    precision = 100 * (accuracy.distance_m(xyz, targets) < PIXEL_M).mean()
    complete = 100 * accuracy.completeness(truth, xyz, PIXEL_M)
    return (f"{heights.std():6.2f} {heights.mean():+6.2f} {precision:7.2f} {complete:8.2f} "
            f"{len(xyz) / np.prod(scene.extent_m):6.0f}")  # fmt: skip


def _bars(xyz: np.ndarray) -> str:
    found = accuracy.tri_bars(xyz)
    least = [min(f.contrast for f in found if f.width_m == w) for w in WIDTHS_M]
    return "  ".join(f"{contrast:5.2f}" for contrast in least)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seed", type=int, default=1)
    main(parser.parse_args().seed)
