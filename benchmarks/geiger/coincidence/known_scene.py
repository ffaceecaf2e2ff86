"""Coincidence processing against its known scene, beside what its source reports [M20 ch. 5].

``python -m benchmarks.geiger.coincidence.known_scene [--whole] [--seeds 1 2 3] [--settings NAME
...]`` simulates parts of the artificial scene of [M20], or all of it, and prints for detections and
for the points of each of :data:`SETTINGS`, as means over the seeds:

- the standard deviation and mean of heights on the spoke targets;
- the contrast of tri-bar targets, bars against the fuller gap, the lesser of both directions, by
  points and by their intensity, and the finest that is resolved with all wider ones;
- spurious points, farther than 0.5 m from anything and above the ground, for each square metre;
- completeness, the share of open surfaces seen from above with a point within one detector's
  ground size, and precision, the share of points as near to a true surface;
- the ratio of intensities of paint and bare ground; distances from the tube of the coil;
- detections a second.

With ``--picture PATH`` and ``--whole`` it draws detections and points of the first settings.
"""

import argparse
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.geiger.coincidence import accuracy
from spl_batch.engine.report import style
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.geiger.coincidence.scene_rays import Targets, painted, tube_distance
from spl_batch.geiger.coincidence.settings import CoincidenceSettings
from spl_batch.geiger.coincidence.simulate import (
    POSITIONS_M,
    TARGET_HEIGHT_M,
    SceneSettings,
    build,
    detect,
    flights,
)
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections, Frames
from spl_batch.lattice.tiles import Bounds

SETTINGS: Final[Mapping[str, Mapping[str, Any]]] = {
    "published": {"method": "published"},
    "bridge_sign": {},
    "wide_below 0": {"bridge_sign": {"wide_below": 0}},
    "wide_below 10": {"bridge_sign": {"wide_below": 10}},
    "window 7": {"bridge_sign": {"window_voxels": 7}},
}
"""Keys of ``coincidence`` that differ from their defaults."""

PARTS: Final[Mapping[str, Mapping[str, Any]]] = {
    "spokes": {"extent_m": (12.0, 12.0), "centre_m": (0.0, 0.0), "targets": ("spokes",)},
    "bars": {"extent_m": (54.0, 17.0), "centre_m": (0.0, 28.0), "targets": ("bars",)},
    "covered": {
        "extent_m": (12.0, 12.0),
        "centre_m": (0.0, -25.0),
        "targets": ("covered_spokes",),
    },
}
"""Parts of the scene around targets."""

RESOLVED = 0.5
"""Contrast from which a tri-bar counts as resolved."""

SHOWN_M = (0.10, 0.25)
"""Widths of tri-bars whose contrast is printed [m]."""

SPURIOUS_M = 0.5
MARGIN_M = 1.0
"""What is nearer to the scene's rim than this is left out [m]."""

STEP_M = 0.1
"""Step of the true points that completeness is taken of [m]."""

LARGEST = 150_000
"""Most bytes of the picture."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points from the scene's centre and ground [m], and their weights."""

    xyz: NDArray[np.float64]
    weight: NDArray[np.float64]


Numbers = dict[str, float]
"""What a cloud is worth, by name and unit."""


def fly(scene: SceneSettings) -> tuple[Frames, Detections]:
    """Frames and detections of all passes, in order."""
    targets, frames = build(scene), list(flights(scene))
    return Frames.joined(frames), Detections.joined([detect(scene, f, targets) for f in frames])


def measure(
    scene: SceneSettings, names: Sequence[str], picture: Path | None = None
) -> dict[str, Numbers]:
    """Numbers of the detections of a scene, and of the points of some settings."""
    frames, detections = fly(scene)
    targets = build(scene)
    before = _inside(detections.xyz, np.ones(len(detections)), scene)
    found = {"detections": judge(before, scene, targets)}
    half = np.array(scene.extent_m) / 2
    centre = np.array(scene.origin_m[:2]) + scene.centre_m
    low, high = (np.rint(1000 * v).astype(int).tolist() for v in (centre - half, centre + half))
    for name in names:
        chosen, start = CoincidenceSettings.model_validate(SETTINGS[name]), time.process_time()
        points = coincide.coincide(frames, detections, Bounds(*low, *high), chosen, scene.array)
        rate = len(detections) / (time.process_time() - start)
        after = _inside(points.xyz, points.intensity.astype(np.float64), scene)
        found[name] = judge(after, scene, targets) | {"detections, 1/CPU s": rate}
        if picture is not None and name == names[0]:
            draw(picture, before, after)
    return found


def _inside(xyz: NDArray[np.int64], weight: NDArray[np.float64], scene: SceneSettings) -> Cloud:
    local = xyz / 1000 - np.array(scene.origin_m)
    low, high = _limits(scene)
    rows = ((local[:, :2] >= low) & (local[:, :2] < high)).all(axis=1)
    return Cloud(local[rows], weight[rows])


def _limits(scene: SceneSettings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    half = np.array(scene.extent_m) / 2 - MARGIN_M
    return np.array(scene.centre_m) - half, np.array(scene.centre_m) + half


def judge(cloud: Cloud, scene: SceneSettings, targets: Targets) -> Numbers:
    """What a cloud is worth."""
    low, high = _limits(scene)
    area, xyz = float(np.prod(high - low)), cloud.xyz
    away = accuracy.distance_m(xyz, targets)
    pixel = scene.flight.altitude_m * scene.array.ifov_rad
    truth = accuracy.seen_from_above(targets, low, high, STEP_M)
    within = f"within {100 * pixel:.0f} cm"
    weighted = np.ptp(cloud.weight) > 0
    found: Numbers = {
        "points": len(xyz),
        "spurious above ground, 1/m2": ((away > SPURIOUS_M) & (xyz[:, 2] > SPURIOUS_M)).sum()
        / area,
        f"precision {within}, %": 100 * (away < pixel).mean(),
        f"completeness {within} of open surfaces, %": 100
        * accuracy.completeness(truth, xyz, pixel),
    }
    if "spokes" in scene.targets:
        found |= _heights("open spokes", 100 * accuracy.spoke_heights(xyz))
    if "covered_spokes" in scene.targets:
        found |= _covered(xyz, scene, pixel)
    if "logo" in scene.targets and weighted:
        found["paint over ground, intensity"] = _paint(cloud, targets)
    if "coil" in scene.targets:
        found["coil, upper loop, SD, cm"] = _coil(xyz, targets)
    if "bars" in scene.targets:
        found |= _bars("by number", accuracy.tri_bars(xyz))
        if weighted:
            found |= _bars("by intensity", accuracy.tri_bars(xyz, cloud.weight))
    return found


def _heights(name: str, heights: NDArray[np.float64]) -> Numbers:
    return {f"{name}, height SD, cm": heights.std(), f"{name}, height mean, cm": heights.mean()}


def _coil(xyz: NDArray[np.float64], targets: Targets) -> float:
    """How well the upper loop's top is round: distances of points from the tube's surface."""
    near = np.hypot(*(xyz[:, :2] - np.array(POSITIONS_M["coil"])).T) < 1.5
    rows = np.flatnonzero(near & (xyz[:, 2] > 2.75))
    axis, radius = targets.coil, targets.coil_radius
    away = np.array([tube_distance(x, y, z, axis, radius) for x, y, z in xyz[rows]])
    return float(100 * away[np.abs(away) < radius].std())


def _covered(xyz: NDArray[np.float64], scene: SceneSettings, pixel: float) -> Numbers:
    """The spoke target beneath the canopy: heights, completeness of what is opaque."""
    bare = build(scene.model_copy(update={"targets": ("covered_spokes",)}))
    bare = bare._replace(leaves=np.empty((0, 5)))
    centre = np.array(POSITIONS_M["covered_spokes"])
    truth = accuracy.seen_from_above(bare, centre - 5, centre + 5, STEP_M)
    found = _heights("spokes beneath leaves", 100 * accuracy.spoke_heights(xyz, "covered_spokes"))
    complete = 100 * accuracy.completeness(truth[truth[:, 2] > 1], xyz, pixel)
    return found | {"spokes beneath leaves, completeness, %": complete}


def _bars(how: str, found: Sequence[accuracy.Resolution]) -> Numbers:
    least: dict[float, float] = {}
    for one in found:
        least[one.width_m] = min(one.contrast, least.get(one.width_m, 1.0))
    finest = 0.0
    for width, contrast in sorted(least.items(), reverse=True):
        if contrast < RESOLVED:
            break
        finest = width
    shown = {
        f"contrast {how}, bars of {100 * width:g} cm": contrast
        for width, contrast in least.items()
        if SHOWN_M[0] <= width <= SHOWN_M[1]
    }
    return {f"tri-bars resolved {how}, cm": 100 * finest} | shown


def _paint(cloud: Cloud, targets: Targets) -> float:
    """Intensity of paint over that of bare ground; true is 1.78."""
    ground = np.abs(cloud.xyz[:, 2]) < accuracy.BAND_M
    near = np.hypot(*(cloud.xyz[:, :2] - targets.logo[:2]).T) < targets.logo[2] + 4
    rows = np.flatnonzero(ground & near)
    paint = np.array([painted(x, y, targets.logo) for x, y in cloud.xyz[rows, :2]], np.bool_)
    return float(cloud.weight[rows][paint].mean() / cloud.weight[rows][~paint].mean())


def draw(path: Path, before: Cloud, after: Cloud) -> None:
    """Draw the spoke targets and the tri-bars from above, detections over points."""
    x, y = POSITIONS_M["bars"]
    parts = (
        ("open spokes", (-5.5, 5.5, -5.5, 5.5)),
        ("beneath leaves", (-5.5, 5.5, -30.5, -19.5)),
        ("tri-bars of 25 to 10 cm, running north", (x - 25.3, x - 15.4, y - 4.5, y - 2.8)),
    )
    with style.type_context():
        drawn = style.figure(7.0, 9.5)
        rows = drawn.add_gridspec(4, 2, height_ratios=(1, 1, 0.33, 0.33))
        for k, (name, cloud) in enumerate((("detections", before), ("points", after))):
            level = cloud.xyz[np.abs(cloud.xyz[:, 2] - TARGET_HEIGHT_M) < accuracy.BAND_M]
            panels = (rows[k, 0], rows[k, 1], rows[2 + k, :])
            for (title, (west, east, south, north)), spec in zip(parts, panels, strict=True):
                panel = drawn.add_subplot(spec)
                east_m, north_m = level[:, 0], level[:, 1]
                panel.scatter(east_m, north_m, s=0.35, c=style.SIGNAL, lw=0, rasterized=True)
                panel.set(aspect="equal", xlim=(west, east), ylim=(south, north))
                panel.set(xticks=(), yticks=(), title=f"{title}: {name}")
        write_bytes(path, style.to_png(drawn, LARGEST)[0])


def table(found: Sequence[dict[str, Numbers]]) -> None:
    """Print means over seeds."""
    columns = list(found[0])
    print("| | " + " | ".join(columns) + " |\n|" + "---|" * (len(columns) + 1))
    for name in dict.fromkeys(k for one in found[0].values() for k in one):
        cells = [
            f"{np.mean([one[column][name] for one in found]):,.2f}"
            if name in found[0][column]
            else ""
            for column in columns
        ]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--whole", action="store_true")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS))
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    for title, part in ({"whole scene": {}} if given.whole else PARTS).items():
        print(f"\n{title}, seeds {', '.join(map(str, given.seeds))}\n")
        scenes = [SceneSettings(seed=seed, **part) for seed in given.seeds]
        table([measure(scene, given.settings, given.picture) for scene in scenes])
