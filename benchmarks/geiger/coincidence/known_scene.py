"""Coincidence processing against the known scene, beside what its source says [M20 ch. 5].

``python -m benchmarks.geiger.coincidence.known_scene [--folder FOLDER] [--extent 100] [--seeds 1 2
3] [--workers 2]
[--methods bridge_sign posterior]`` simulates the artificial scene of [M20] with each seed (into
folders of FOLDER, where what is there is used again), runs each method on it and prints, for
detections and for each method's points:

- the standard deviation and mean of heights on the open spoke target;
- the contrast of each tri-bar target, bars against the fuller gap, by points and by their
  intensity, and the finest that is resolved in both directions and with all wider ones;
- spurious points, farther than 0.5 m from anything and above the ground, for each square metre;
- completeness, the share of open surfaces seen from above with a point within one detector's
  ground size, and precision, the share of points as near to a true surface; the same beneath the
  canopy of the covered spoke target;
- the ratio of intensities of paint and bare ground; distances from the tube of the coil;
- speed and memory of the stage.

At the end a table has the mean over the seeds, with the least and the most.

With ``--picture PATH`` it draws detections and points of the first method on the spoke targets and
the tri-bars, from above.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import laspy
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from benchmarks.geiger.coincidence import accuracy
from spl_batch import api
from spl_batch.engine.report import style
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.geiger.coincidence.formats import l1_files
from spl_batch.geiger.coincidence.simulate import simulate
from spl_batch.geiger.coincidence.simulate.scene import (
    PLACES_M,
    TARGET_HEIGHT_M,
    SceneSettings,
    build,
)
from spl_batch.geiger.coincidence.simulate.scene_rays import Targets, painted, tube_distance

RESOLVED = 0.5
"""Contrast from which a tri-bar counts as resolved."""

SHOWN_M = (0.10, 0.30)
"""Widths of tri-bars whose contrast is printed [m]."""

SPURIOUS_M = 0.5
MARGIN_M = 1.0
"""What is nearer to the scene's rim than this is left out [m]."""

STEP_M = 0.1
"""Step of the true places that completeness is taken of [m]."""

LARGEST = 150_000
"""Most bytes of the picture."""

CANOPY_M = 7.0
"""Half the edge of a canopy [m]."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """Places from the scene's centre and ground [m], and their weights."""

    xyz: NDArray[np.float64]
    weight: NDArray[np.float64]


Numbers = dict[str, float]
"""What a cloud is worth, by name and unit."""


def main(folder: Path, scene: SceneSettings, given: argparse.Namespace) -> dict[str, Numbers]:
    """Print everything of one seed; gives the numbers of detections and of each method."""
    if not (folder / "workflow.yaml").exists():
        start = time.perf_counter()
        made = simulate(scene, folder)
        print(f"simulated {made.frames:,} frames, {made.detections:,} detections "
              f"in {time.perf_counter() - start:.0f} s")  # fmt: skip
    targets = build(scene)
    print(f"extent {scene.extent_m[0]:g} x {scene.extent_m[1]:g} m, seed {scene.seed}, "
          f"targets {', '.join(scene.targets)}")  # fmt: skip
    detections = _detections(folder, scene)
    found = {"detections": judge("detections", detections, scene, targets)}
    for method in given.methods:
        output = folder / f"out_{method}"
        result = api.run(
            folder / "workflow.yaml",
            workers=given.workers,
            overrides=(f"output={output.name}", f"coincidence.method={method}"),
        )
        points = _points(output, scene)
        found[method] = judge(method, points, scene, targets)
        if given.picture is not None and method == given.methods[0]:
            picture(given.picture, detections, points)
        for name, stage in result.report.performance.stages.items():
            print(f"  stage {name:12s} {stage.wall_s:8.1f} s in {stage.tasks} tasks, "
                  f"{stage.points_per_s or 0:10,.0f} detections/s and worker, "
                  f"peak {stage.peak_rss_mb:,.0f} MB", flush=True)  # fmt: skip
        counted = result.report.counts.detections
        for name in ("store", "points"):
            size = sum(f.stat().st_size for f in (output / name).rglob("*") if f.is_file())
            print(f"  {name:6s} {size / counted:.1f} bytes a detection", flush=True)
    return found


def table(found: Sequence[dict[str, Numbers]]) -> None:
    """Print means over seeds with the least and the most."""
    columns = list(found[0])
    print(
        "\n| mean, least to most | " + " | ".join(columns) + " |\n|" + "---|" * (len(columns) + 1)
    )
    for name in dict.fromkeys(k for one in found[0].values() for k in one):
        cells = []
        for column in columns:
            values = [one[column][name] for one in found if name in one[column]]
            spread = f" ({min(values):,.2f} to {max(values):,.2f})" if len(values) > 1 else ""
            cells.append(f"{np.mean(values):,.2f}{spread}" if values else "")
        print(f"| {name} | " + " | ".join(cells) + " |")


def picture(path: Path, before: Cloud, after: Cloud) -> None:
    """Draw the spoke targets and the tri-bars from above, detections over points."""
    x, y = PLACES_M["bars"]
    parts = (
        ("open spokes", (-5.5, 5.5, -5.5, 5.5)),
        ("beneath leaves", (-5.5, 5.5, -30.5, -19.5)),
        ("tri-bars of 25 to 10 cm, running north", (x - 25.3, x - 15.4, y - 4.5, y - 2.8)),
    )
    with style.type_context():
        drawn = style.figure(7.0, 9.5)
        rows = drawn.add_gridspec(4, 2, height_ratios=(1, 1, 0.33, 0.33))
        for k, (name, cloud) in enumerate((("detections", before), ("points", after))):
            places = (rows[k, 0], rows[k, 1], rows[2 + k, :])
            for (title, view), place in zip(parts, places, strict=True):
                panel = drawn.add_subplot(place)
                _from_above(panel, cloud, view)
                panel.set_title(f"{title}: {name}")
        write_bytes(path, style.to_png(drawn, LARGEST)[0])


def _from_above(panel: Axes, cloud: Cloud, view: tuple[float, float, float, float]) -> None:
    """Draw what lies at the targets' height."""
    (west, east, south, north), (x, y, z) = view, cloud.xyz.T
    shown = np.abs(z - TARGET_HEIGHT_M) < accuracy.BAND_M
    shown &= (x > west) & (x < east) & (y > south) & (y < north)
    panel.scatter(x[shown], y[shown], s=0.35, c=style.SIGNAL, lw=0, rasterized=True)
    panel.set(aspect="equal", xlim=(west, east), ylim=(south, north), xticks=(), yticks=())


def _detections(folder: Path, scene: SceneSettings) -> Cloud:
    parts = [
        part.xyz / 1000
        for path in sorted((folder / "l1").glob("*_detections.parquet"))
        for part in l1_files.detections_in_order(path, scene.array)
    ]
    return _inside(np.concatenate(parts) - np.array(scene.origin_m), None, scene)


def _points(output: Path, scene: SceneSettings) -> Cloud:
    parts, weights = [], []
    for path in sorted((output / "points").glob("*.laz")):
        las = laspy.read(path)
        parts.append(np.stack([las.x, las.y, las.z], axis=-1))
        weights.append(np.asarray(las["detection_share"], np.float64))
    xyz = np.concatenate(parts) - np.array(scene.origin_m)
    return _inside(xyz, np.concatenate(weights), scene)


def _inside(
    xyz: NDArray[np.float64], weight: NDArray[np.float64] | None, scene: SceneSettings
) -> Cloud:
    low, high = _limits(scene)
    rows = ((xyz[:, :2] >= low) & (xyz[:, :2] < high)).all(axis=1)
    return Cloud(xyz[rows], np.ones(int(rows.sum())) if weight is None else weight[rows])


def _limits(scene: SceneSettings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    half = np.array(scene.extent_m) / 2 - MARGIN_M
    return np.array(scene.centre_m) - half, np.array(scene.centre_m) + half


def judge(label: str, cloud: Cloud, scene: SceneSettings, targets: Targets) -> Numbers:
    """Print what a cloud is worth."""
    low, high = _limits(scene)
    area = float(np.prod(high - low))
    xyz = cloud.xyz
    away = accuracy.distance_m(xyz, targets)
    pixel = scene.flight.altitude_m * scene.array.ifov_rad
    near_canopy = _under(xyz, ("covered_spokes", "foliage"), scene)
    print(f"\n{label}: {len(xyz):,} in {area:,.0f} m2")
    spurious = int(((away > SPURIOUS_M) & (xyz[:, 2] > SPURIOUS_M)).sum())
    truth = accuracy.seen_from_above(targets, low, high, STEP_M)
    within = f"within {100 * pixel:.0f} cm"
    found: Numbers = {
        "points": len(xyz),
        "spurious above ground, 1/m2": spurious / area,
        f"precision {within}, %": 100 * (away < pixel).mean(),
        f"precision {within} outside canopies, %": 100 * (away[~near_canopy] < pixel).mean(),
        f"completeness {within} of open surfaces, %": 100
        * accuracy.completeness(truth, xyz, pixel),
    }
    if "spokes" in scene.targets:
        found |= _heights("open spokes", 100 * accuracy.spoke_heights(xyz))
    if "covered_spokes" in scene.targets:
        found |= _covered(xyz, scene, pixel)
    if "logo" in scene.targets and np.ptp(cloud.weight) > 0:
        found["paint over ground, intensity"] = _paint(cloud, targets)
    if "coil" in scene.targets:
        found |= _coil(xyz, targets)
    if "bars" in scene.targets:
        found |= _bars("by number", accuracy.tri_bars(xyz))
        if np.ptp(cloud.weight) > 0:
            found |= _bars("by intensity", accuracy.tri_bars(xyz, cloud.weight))
    for name, value in found.items():
        print(f"  {name:48s} {value:,.4g}")
    return found


def _heights(name: str, heights: NDArray[np.float64]) -> Numbers:
    return {f"{name}, height SD, cm": heights.std(), f"{name}, height mean, cm": heights.mean()}


def _coil(xyz: NDArray[np.float64], targets: Targets) -> Numbers:
    """How well the upper loop's top is round: distances of points from the tube's surface."""
    near = np.hypot(*(xyz[:, :2] - np.array(PLACES_M["coil"])).T) < 1.5
    rows = np.flatnonzero(near & (xyz[:, 2] > 2.75))
    axis, radius = targets.coil, targets.coil_radius
    away = np.array([tube_distance(x, y, z, axis, radius) for x, y, z in xyz[rows]])
    away = 100 * away[np.abs(away) < radius]
    return {"coil, upper loop, SD, cm": away.std(), "coil, upper loop, mean, cm": away.mean()}


def _under(
    xyz: NDArray[np.float64], names: Sequence[str], scene: SceneSettings
) -> NDArray[np.bool_]:
    """Which places lie within the square of a canopy that is there."""
    found = np.zeros(len(xyz), np.bool_)
    for name in names:
        if name in scene.targets:
            away = np.abs(xyz[:, :2] - np.array(PLACES_M[name])).max(axis=1)
            found |= away < CANOPY_M
    return found


def _covered(xyz: NDArray[np.float64], scene: SceneSettings, pixel: float) -> Numbers:
    """The spoke target beneath the canopy: heights, completeness of what is opaque."""
    bare = build(scene.model_copy(update={"targets": ("covered_spokes",)}))
    bare = bare._replace(leaves=np.empty((0, 5)))
    centre = np.array(PLACES_M["covered_spokes"])
    truth = accuracy.seen_from_above(bare, centre - 5, centre + 5, STEP_M)
    spokes = truth[truth[:, 2] > 1]
    found = _heights("spokes beneath leaves", 100 * accuracy.spoke_heights(xyz, "covered_spokes"))
    complete = 100 * accuracy.completeness(spokes, xyz, pixel)
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


def parse() -> argparse.Namespace:
    """Arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--extent", type=float, default=100.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--methods", nargs="+", default=["bridge_sign", "posterior"])
    parser.add_argument("--picture", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    given = parse()
    with tempfile.TemporaryDirectory() as temporary:
        top, all_found = given.folder or Path(temporary), []
        for seed in given.seeds:
            flown = SceneSettings(seed=seed, extent_m=(given.extent, given.extent))
            all_found.append(main(top / f"seed_{seed}", flown, given))
            given.picture = None
        table(all_found)
