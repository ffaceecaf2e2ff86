"""What window and thresholds of the Bridge Sign filter do, on small parts of the known scene.

``python -m benchmarks.geiger.coincidence.filter_settings [--seeds 1 2]`` prints, for each setting
and as means
over the seeds: on 6 x 6 m of the open spoke target the standard deviation and mean of its heights,
precision and completeness within one detector's ground size, points per square metre; on as much of
the one beneath leaves the completeness of the spokes; on two strips of 10 x 2.4 m with the tri-bars
of 25 to 10 cm the contrast by number of points, the lesser of the two directions.
"""

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.geiger.coincidence import accuracy
from spl_batch.geiger.coincidence.settings import CoincidenceSettings
from spl_batch.geiger.coincidence.simulate.flight import fly
from spl_batch.geiger.coincidence.simulate.scene import SceneSettings, build
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections, Frames
from spl_batch.lattice.tiles import Bounds

WIDTHS_M = (0.25, 0.225, 0.20, 0.175, 0.15, 0.125, 0.10)
PIXEL_M = 0.09
STEP_M = 0.05
RIM_M = 0.3
"""What is nearer to a part's rim than this is left out [m]."""

PARTS: dict[str, dict[str, Any]] = {
    "open": {"targets": ("spokes",), "extent_m": (6.0, 6.0), "centre_m": (2.0, 0.0)},
    "covered": {"targets": ("covered_spokes",), "extent_m": (6.0, 6.0), "centre_m": (2.0, -25.0)},
    "north": {"targets": ("bars",), "extent_m": (10.0, 2.4), "centre_m": (-20.4, 21.4)},
    "east": {"targets": ("bars",), "extent_m": (10.0, 2.4), "centre_m": (5.6, 21.4)},
}

Flown = tuple[SceneSettings, Frames, Detections]
Places = dict[str, NDArray[np.float64]]
"""Places of each part, from the scene's centre and ground [m]."""


def main(seeds: Sequence[int]) -> None:
    """Print a line for each setting."""
    flown = [
        {name: _fly(SceneSettings(seed=seed, **part)) for name, part in PARTS.items()}
        for seed in seeds
    ]
    detections = sum(len(d) for parts in flown for _, _, d in parts.values())
    names = "  ".join(f"{100 * w:5g}" for w in WIDTHS_M)
    print(f"seeds {', '.join(map(str, seeds))}; {detections:,} detections")
    print(f"{'setting':34s}  SD cm  mean   prec %  compl %   1/m2  leaves %  bars of "
          f"{names} cm    1/CPU s")  # fmt: skip
    _print(
        "detections", flown, [{k: _local(d.xyz, s) for k, (s, _, d) in p.items()} for p in flown]
    )
    for setting in SETTINGS:
        chosen = CoincidenceSettings.model_validate({"bridge_sign": setting})
        start = time.process_time()
        points = [{k: _points(part, chosen) for k, part in parts.items()} for parts in flown]
        spent = time.process_time() - start
        name = ", ".join(f"{k} {v:g}" for k, v in setting.items()) or "defaults"
        _print(name, flown, points, detections / spent)


def _print(
    name: str, flown: Sequence[dict[str, Flown]], points: Sequence[Places], rate: float = 0.0
) -> None:
    """One line: means over seeds."""
    rows = [_row(found, parts) for found, parts in zip(points, flown, strict=True)]
    shown = np.mean(rows, axis=0)
    print(f"{name:34s} {shown[0]:6.2f} {shown[1]:+6.2f} {shown[2]:7.2f} {shown[3]:8.2f} "
          f"{shown[4]:6.0f} {shown[5]:9.2f}          "
          f"{'  '.join(f'{v:5.2f}' for v in shown[6:])}  {rate:12,.0f}",
          flush=True)  # fmt: skip


def _fly(scene: SceneSettings) -> Flown:
    return scene, *fly(scene)


def _points(flown: Flown, chosen: CoincidenceSettings) -> NDArray[np.float64]:
    """Points of a part, from the scene's centre and ground [m]."""
    scene, frames, detections = flown
    centre = np.array(scene.origin_m[:2]) + scene.centre_m
    half = np.array(scene.extent_m) / 2
    low, high = (np.rint(v * 1000).astype(int).tolist() for v in (centre - half, centre + half))
    found = coincide.coincide(frames, detections, Bounds(*low, *high), chosen, scene.array)
    return _local(found.xyz, scene)


def _local(xyz: NDArray[np.int64], scene: SceneSettings) -> NDArray[np.float64]:
    """Places within a part."""
    local: NDArray[np.float64] = xyz / 1000 - np.array(scene.origin_m)
    away = np.abs(local[:, :2] - scene.centre_m) < np.array(scene.extent_m) / 2
    return local[away.all(axis=1)]


def _row(points: Places, parts: dict[str, Flown]) -> list[float]:
    """Numbers of one setting and seed."""
    scene = parts["open"][0]
    targets, (low, high) = build(scene), _within(scene)
    xyz = points["open"]
    heights = 100 * accuracy.spoke_heights(xyz)
    precision = 100 * (accuracy.distance_m(xyz, targets) < PIXEL_M).mean()
    truth = accuracy.seen_from_above(targets, low, high, STEP_M)
    complete = 100 * accuracy.completeness(truth, xyz, PIXEL_M)
    density = len(xyz) / float(np.prod(scene.extent_m))
    bars = accuracy.tri_bars(np.concatenate([points["north"], points["east"]]))
    least = [min(f.contrast for f in bars if f.width_m == w) for w in WIDTHS_M]
    leaves = _beneath_leaves(points["covered"], parts["covered"][0])
    return [heights.std(), heights.mean(), precision, complete, density, leaves, *least]


def _beneath_leaves(xyz: NDArray[np.float64], scene: SceneSettings) -> float:
    bare = build(scene)._replace(leaves=np.empty((0, 5)))
    truth = accuracy.seen_from_above(bare, *_within(scene), STEP_M)
    return 100 * accuracy.completeness(truth[truth[:, 2] > 1.0], xyz, PIXEL_M)


def _within(scene: SceneSettings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    half = np.array(scene.extent_m) / 2 - RIM_M
    return np.array(scene.centre_m) - half, np.array(scene.centre_m) + half


SETTINGS: tuple[dict[str, float], ...] = (
    {},
    {"edge_share": 0.0},
    {"edge_share": 0.6},
    {"threshold": 0.04},
    {"threshold": 0.04, "edge_share": 0.0},
    {"detections_min": 3},
    {"window_voxels": 7},
    {"window_voxels": 9},
)
"""Keys of ``coincidence.bridge_sign`` that differ from their defaults."""


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    main(parser.parse_args().seeds)
