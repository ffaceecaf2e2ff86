"""Coincidence processing against the known scene, beside what its source says [M20 ch. 5].

``python -m benchmarks.coincidence [--folder FOLDER] [--extent 100] [--seed 1] [--workers 2]
[--methods bridge_sign posterior]`` simulates the artificial scene of [M20] (into FOLDER, where
what is there is used again), runs each method on it and prints, for detections and for each
method's points:

- the standard deviation and mean of heights on the open spoke target;
- the contrast of each tri-bar target, bars against the fuller gap, by points and by their
  intensity, and the finest that is resolved in both directions and with all wider ones;
- spurious points, farther than 0.5 m from anything and above the ground, for each square metre;
- completeness, the share of open surfaces seen from above with a point within one detector's
  ground size, and precision, the share of points as near to a true surface; the same beneath the
  canopy of the covered spoke target;
- the ratio of intensities of paint and bare ground; distances from the tube of the coil;
- speed and memory of the stage.

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
from numpy.typing import NDArray

from spl_batch import api
from spl_batch.geiger.coincidence import accuracy, io
from spl_batch.geiger.coincidence.kernels.scene import Targets, painted, tube_distance
from spl_batch.geiger.coincidence.simulate import simulate
from spl_batch.geiger.coincidence.simulate.scene import PLACES_M, SceneSettings, build
from spl_batch.io.atomic import write_bytes
from spl_batch.report import style

RESOLVED = 0.5
"""Contrast from which a tri-bar counts as resolved."""

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


def main(
    folder: Path,
    scene: SceneSettings,
    methods: Sequence[str],
    workers: int,
    drawn: Path | None = None,
) -> None:
    """Print everything."""
    if not (folder / "workflow.yaml").exists():
        start = time.perf_counter()
        made = simulate(scene, folder)
        print(f"simulated {made.frames:,} frames, {made.detections:,} detections "
              f"in {time.perf_counter() - start:.0f} s")  # fmt: skip
    targets = build(scene)
    print(f"extent {scene.extent_m[0]:g} x {scene.extent_m[1]:g} m, seed {scene.seed}, "
          f"targets {', '.join(scene.targets)}")  # fmt: skip
    detections = _detections(folder, scene)
    judge("detections", detections, scene, targets)
    for method in methods:
        output = folder / f"out_{method}"
        result = api.run(
            folder / "workflow.yaml",
            workers=workers,
            overrides=(f"output={output.name}", f"coincidence.method={method}"),
        )
        points = _points(output, scene)
        judge(method, points, scene, targets)
        if drawn is not None and method == methods[0]:
            picture(drawn, detections, points)
        for name, stage in result.report.performance.stages.items():
            print(f"  stage {name:12s} {stage.wall_s:8.1f} s in {stage.tasks} tasks, "
                  f"{stage.points_per_s or 0:10,.0f} detections/s and worker, "
                  f"peak {stage.peak_rss_mb:,.0f} MB")  # fmt: skip


def picture(path: Path, before: Cloud, after: Cloud) -> None:
    """Draw the spoke targets and the tri-bars from above, detections over points."""
    x, y = PLACES_M["bars"]
    parts = (
        ("open spokes", (-5.5, 5.5, -5.5, 5.5)),
        ("beneath leaves", (-5.5, 5.5, -30.5, -19.5)),
        ("tri-bars of 50 to 5 cm, running north", (x - 13.5, x - 0.5, y - 1.7, y + 4.5)),
    )
    with style.type_context():
        drawn = style.figure(9.0, 5.0)
        panels = drawn.subplots(2, 3, gridspec_kw={"width_ratios": (1, 1, 1.35)})
        for column, (title, (west, east, south, north)) in enumerate(parts):
            for row, cloud in enumerate((before, after)):
                axes, (px, py, pz) = panels[row, column], cloud.xyz.T
                level = np.abs(pz - accuracy.TARGET_HEIGHT_M) < accuracy.BAND_M
                shown = level & (px > west) & (px < east) & (py > south) & (py < north)
                axes.scatter(px[shown], py[shown], s=0.35, c=style.SIGNAL, lw=0, rasterized=True)
                axes.set(
                    aspect="equal", xlim=(west, east), ylim=(south, north), xticks=(), yticks=()
                )
            panels[0, column].set_title(title)
        for row, name in enumerate(("detections", "points")):
            panels[row, 0].set_ylabel(name)
        write_bytes(path, style.to_png(drawn, LARGEST)[0])


def _detections(folder: Path, scene: SceneSettings) -> Cloud:
    parts = [
        io.read_detections(path, scene.array).xyz / 1000
        for path in sorted((folder / "l1").glob("*_detections.parquet"))
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


def judge(label: str, cloud: Cloud, scene: SceneSettings, targets: Targets) -> None:
    """Print what a cloud is worth."""
    low, high = _limits(scene)
    area = float(np.prod(high - low))
    xyz = cloud.xyz
    away = accuracy.distance_m(xyz, targets)
    pixel = scene.flight.altitude_m * scene.array.ifov_rad
    near_canopy = _under(xyz, ("covered_spokes", "foliage"), scene)
    print(f"\n{label}: {len(xyz):,} in {area:,.0f} m2")
    spurious = int(((away > SPURIOUS_M) & (xyz[:, 2] > SPURIOUS_M)).sum())
    print(f"  spurious above ground      {spurious} = {spurious / area:.6f} /m2")
    print(f"  precision within {100 * pixel:.0f} cm    {100 * (away < pixel).mean():.2f} %, "
          f"outside canopies {100 * (away[~near_canopy] < pixel).mean():.2f} %")  # fmt: skip
    truth = accuracy.seen_from_above(targets, low, high, STEP_M)
    found = 100 * accuracy.completeness(truth, xyz, pixel)
    print(f"  completeness within {100 * pixel:.0f} cm {found:.2f} % of open surfaces")
    if "spokes" in scene.targets:
        heights = 100 * accuracy.spoke_heights(xyz)
        print(f"  spoke heights              SD {heights.std():.2f} cm, "
              f"mean {heights.mean():+.2f} cm, n {len(heights):,}")  # fmt: skip
    if "covered_spokes" in scene.targets:
        _covered(xyz, scene, pixel)
    if "bars" in scene.targets:
        _bars("by number", accuracy.tri_bars(xyz))
        if np.ptp(cloud.weight) > 0:
            _bars("by intensity", accuracy.tri_bars(xyz, cloud.weight))
    if "logo" in scene.targets and np.ptp(cloud.weight) > 0:
        _paint(cloud, targets)
    if "coil" in scene.targets:
        _coil(xyz, targets)


def _coil(xyz: NDArray[np.float64], targets: Targets) -> None:
    """How well the upper loop's top is round: distances of points from the tube's surface."""
    near = np.hypot(*(xyz[:, :2] - np.array(PLACES_M["coil"])).T) < 1.5
    rows = np.flatnonzero(near & (xyz[:, 2] > 2.75))
    axis, radius = targets.coil, targets.coil_radius
    away = np.array([tube_distance(x, y, z, axis, radius) for x, y, z in xyz[rows]])
    away = 100 * away[np.abs(away) < radius]
    print(f"  upper loop of the coil     {len(away):,} points, from its surface mean "
          f"{away.mean():+.1f} cm, SD {away.std():.1f} cm")  # fmt: skip


def _under(
    xyz: NDArray[np.float64], names: Sequence[str], scene: SceneSettings
) -> NDArray[np.bool_]:
    """Which places lie within the square of a canopy that is there."""
    found = np.zeros(len(xyz), np.bool_)
    for name in names:
        if name in scene.targets:
            away = np.abs(xyz[:, :2] - np.array(PLACES_M[name])).max(axis=1)  # type: ignore[index]
            found |= away < CANOPY_M
    return found


def _covered(xyz: NDArray[np.float64], scene: SceneSettings, pixel: float) -> None:
    """The spoke target beneath the canopy: heights, completeness of what is opaque."""
    heights = 100 * accuracy.spoke_heights(xyz, "covered_spokes")
    bare = build(scene.model_copy(update={"targets": ("covered_spokes",)}))
    bare = bare._replace(leaves=np.empty((0, 5)))
    centre = np.array(PLACES_M["covered_spokes"])
    truth = accuracy.seen_from_above(bare, centre - 5, centre + 5, STEP_M)
    spokes = truth[truth[:, 2] > 1]
    found = 100 * accuracy.completeness(spokes, xyz, pixel)
    print(f"  spokes beneath leaves      SD {heights.std():.2f} cm, {found:.1f} % complete")


def _bars(how: str, found: Sequence[accuracy.Resolution]) -> None:
    by_width: dict[float, list[float]] = {}
    for one in found:
        by_width.setdefault(one.width_m, []).append(one.contrast)
    finest = 0.0
    for width, contrasts in sorted(by_width.items(), reverse=True):
        if min(contrasts) < RESOLVED:
            break
        finest = width
    shown = "  ".join(
        f"{100 * width:g}: {min(c):.2f}" for width, c in sorted(by_width.items(), reverse=True)
    )
    print(f"  tri-bars {how:13s}     resolved to {100 * finest:g} cm; contrast {shown}")


def _paint(cloud: Cloud, targets: Targets) -> None:
    ground = np.abs(cloud.xyz[:, 2]) < accuracy.BAND_M
    near = np.hypot(*(cloud.xyz[:, :2] - targets.logo[:2]).T) < targets.logo[2] + 4
    rows = np.flatnonzero(ground & near)
    paint = np.array([painted(x, y, targets.logo) for x, y in cloud.xyz[rows, :2]], np.bool_)
    ratio = cloud.weight[rows][paint].mean() / cloud.weight[rows][~paint].mean()
    expected = np.expm1(-0.5) / np.expm1(-0.25)
    print(f"  paint over ground          intensity x {ratio:.2f} (true {expected:.2f})")


def parse() -> argparse.Namespace:
    """Arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--extent", type=float, default=100.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--methods", nargs="+", default=["bridge_sign", "posterior"])
    parser.add_argument("--picture", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    given = parse()
    flown = SceneSettings(seed=given.seed, extent_m=(given.extent, given.extent))
    with tempfile.TemporaryDirectory() as temporary:
        main(given.folder or Path(temporary), flown, given.methods, given.workers, given.picture)
