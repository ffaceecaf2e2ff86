"""A simulated twin of the source's water surface experiments beside its published figures [G15].

``python -m benchmarks.geiger.water.water_surface [--seeds 1 2 3] [--acquisitions 20]`` prints

- the spread of a flat target's ranges by the number of frames [G15 Fig. 2.13],
- what the calibration of each twin gives [G15 3.4.3, 3.4.4],
- errors of a flat hard target [G15 table 4.2] and of calm water [G15 table 4.4]: published, the
  source's way on the twin, ours on the same frames,
- the same for waves, and how far the ends of rays through 6.2 m of water lie from the true ones:
  without refraction, with that of a level surface, with that of the surface found.

What the source states is taken from there: array, bins, frames, rates, distances, angles, dead
pixels, its spread of single hits. What it does not state was chosen so that its own way comes near
its own figures: the beam's width and brightness on the array (brighter and narrower over water),
the delays of the pixels, an error of 1 cm in the calibration's distances, the depth of 1 cm from
which light comes back. Each seed is another instrument with a calibration of its own.
"""

import argparse
from collections.abc import Iterator, Sequence
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from spl_batch.engine.report import style
from spl_batch.geiger.water.accuracy import (
    PIXEL_SUMS,
    FloorError,
    floor_error,
    middle,
    pixel_maps,
    pixel_sums,
    surface_error,
)
from spl_batch.geiger.water.pixel_geometry import View, floor_points, refracted, view_of
from spl_batch.geiger.water.ranges import (
    Calibration,
    Hits,
    Observation,
    add_up,
    dead_pixels,
    faults_of,
    find_gate,
    fit,
    histogram,
    observation,
    used_pixels,
)
from spl_batch.geiger.water.settings import (
    CalibrationSettings,
    CameraSettings,
    GateSettings,
    MountSettings,
    PixelSettings,
    SurfaceSettings,
)
from spl_batch.geiger.water.simulate import (
    Acquisition,
    Instrument,
    Target,
    Wave,
    acquisitions,
)
from spl_batch.geiger.water.surface import (
    Surface,
    make_surface,
    ranges,
)

CAMERA = CameraSettings()
PIXELS = PixelSettings()
USED = used_pixels(CAMERA)
FRAMES = 200

HARD_VIEW = view_of(CAMERA, MountSettings(off_nadir_deg=0.0))
WATER_DOWN_M = 0.81915
WATER_VIEW = view_of(CAMERA, MountSettings(position_m=(-4.013, -0.3376, WATER_DOWN_M - 3.1)))

HARD = Target(down_m=3.3)
CALM = Target(down_m=WATER_DOWN_M, penetration_m=0.01)
WAVES = Target(
    down_m=WATER_DOWN_M,
    penetration_m=0.01,
    waves=(
        Wave(amplitude_m=0.07, length_m=2.0, heading_deg=20.0, phase_deg=10.0),
        Wave(amplitude_m=0.01, length_m=0.5, heading_deg=-60.0, phase_deg=100.0),
        Wave(amplitude_m=0.003, length_m=0.25, heading_deg=70.0),
    ),
)
"""15 cm from trough to crest, as the source's wave maker gave, with shorter waves on it."""

ON_WATER: dict[str, Any] = {"peak_photoelectrons": 2.0, "beam_px": 11.5}
"""The beam over water."""

SOURCE_WAY = SurfaceSettings(method="windowed")
OURS = SurfaceSettings()

FRAME_COUNTS = (1, 23, 200, 1000, 5000, 10000)
PUBLISHED_SPREAD_CM = (15.1, 8.2, 2.9, 1.5, 1.1, 1.0)
PUBLISHED_HARD = (7.0, 13.87, 82.33, 5.54)
PUBLISHED_CALM = (6.12, 134.0, 240.0, 11.196)

TABLES = ("hard", "calm", "waves", "floor")

DISTANCES_M = np.linspace(2.0, 5.5, 8)
TARGET_FRAMES = 2000
TAPE_M = 0.01
PATH_M = 6.2
INDEX = 1.33

Floats = NDArray[np.float64]


def gated(frames: NDArray[np.uint16]) -> Hits:
    """Hits within the gate that the frames' histogram shows."""
    gate = find_gate(histogram(frames, USED, CAMERA.bins), GateSettings())
    assert gate is not None
    return add_up(frames, gate)


def observations(instrument: Instrument, seed: int) -> tuple[list[Observation], NDArray[np.bool_]]:
    """Frames of a target at eight distances, dim and as bright as ever, some brighter still."""
    rng = np.random.default_rng((seed, 1))
    hits: list[Hits] = []
    distances: list[float] = []
    for k, distance in enumerate(DISTANCES_M):
        dim = 0.015 / instrument.peak_photoelectrons
        for light in (dim, 1.0, *((0.3, 3.0, 8.0) if k % 3 == 0 else ())):
            target = Target(down_m=float(distance))
            drawn = acquisitions(
                target,
                instrument.dimmed(light),
                CAMERA,
                HARD_VIEW,
                1,
                TARGET_FRAMES,
                1000 * seed + len(hits),
            )
            hits.append(gated(next(iter(drawn)).frames))
            distances.append(float(distance + TAPE_M * rng.standard_normal()))
    dead = dead_pixels(reduce(add, hits), USED, PIXELS)
    made = [
        observation(h, dead, HARD_VIEW.norm, d, CAMERA.bin_ns)
        for h, d in zip(hits, distances, strict=True)
    ]
    return made, dead


def calibrated(seen: Sequence[Observation], settings: CalibrationSettings) -> Calibration:
    """A fit that must succeed."""
    faults = faults_of(seen, settings)
    assert not faults, faults
    return fit(seen, settings)


Ways = dict[str, tuple[Calibration, SurfaceSettings]]
"""Calibration and method of each way, by what it is called."""


def calibrated_ways(instrument: Instrument, seed: int) -> tuple[Ways, NDArray[np.bool_]]:
    """The ways that are compared, calibrated from the same frames; and the dead pixels."""
    seen, dead = observations(instrument, seed)
    source = CalibrationSettings(range_walk="exponential", pixel_offsets=False)
    theirs, ours = calibrated(seen, source), calibrated(seen, CalibrationSettings())
    ways = {
        "the source's way": (theirs, SOURCE_WAY),
        "its planes, our ranges": (ours, SOURCE_WAY),
        "ours": (ours, OURS),
    }
    return ways, dead


def surfaces(
    target: Target,
    instrument: Instrument,
    view: View,
    dead: NDArray[np.bool_],
    ways: Sequence[tuple[Calibration, SurfaceSettings]],
    count: int,
    seed: int,
) -> Iterator[tuple[Acquisition, list[Surface]]]:
    """Each acquisition, and what each way makes of it."""
    for acquired in acquisitions(target, instrument, CAMERA, view, count, FRAMES, seed):
        hits = gated(acquired.frames)
        yield acquired, [make_surface(hits, dead, c, view, CAMERA, PIXELS, s) for c, s in ways]


def errors(acquired: Acquisition, surface: Surface) -> list[float]:
    """Bias [mm], variance and MSE [mm2], angle of the mean normal, mean of the pixels' [deg]."""
    pairs = (surface.points_m, surface.normals, acquired.true_down_m, acquired.true_normals)
    made, _, _ = surface_error(*(values[USED.any(axis=1)] for values in pairs))
    lengths = [abs(made.bias_m) * 1e3, made.variance_m2 * 1e6, made.mse_m2 * 1e6]
    return [*lengths, made.normal_deg, made.pixel_normal_deg]


def floor_errors(acquired: Acquisition, surface: Surface, view: View) -> FloorError:
    """Ends of the rays of the green beam's pixels."""
    footprint = middle((CAMERA.rows, CAMERA.cols), 16)
    true = view.points(acquired.true_range_m)[footprint], acquired.true_normals[footprint]
    found = surface.points_m[footprint], surface.normals[footprint]
    return floor_error(view.look[footprint], found, true, PATH_M, INDEX)


def water_normals(_: Path, count: int = 8) -> Figure:
    """Ends of rays under waves, and the error of each pixel's normal on calm water."""
    instrument = Instrument(seed=1)
    ways, dead = calibrated_ways(instrument, 1)
    chosen = {name: ways[name] for name in ("the source's way", "ours")}
    wet = instrument.model_copy(update=ON_WATER)
    colours = dict(zip(chosen, (style.NOISE, style.SIGNAL), strict=True))
    drawn = style.figure(9.2, 3.1)
    left, *right = drawn.subplots(1, 3)
    made = surfaces(WAVES, wet, WATER_VIEW, dead, list(chosen.values()), count, 51)
    footprint = middle((CAMERA.rows, CAMERA.cols), 16)
    beam, up = WATER_VIEW.look[footprint], np.array([0.0, 0.0, -1.0])
    for k, (acquired, results) in enumerate(made):
        point = WATER_VIEW.points(acquired.true_range_m)[footprint]
        true = floor_points(point, refracted(beam, acquired.true_normals[footprint], INDEX), PATH_M)
        level = floor_points(point, refracted(beam, up, INDEX), PATH_M)
        _scatter(left, level - true, style.MUTED, "level surface" if k == 0 else None)
        for (name, colour), found in zip(colours.items(), results, strict=True):
            ray = refracted(beam, found.normals[footprint], INDEX)
            ends = floor_points(found.points_m[footprint], ray, PATH_M)
            _scatter(left, ends - true, colour, name if k == 0 else None)
    left.set(title="Ends of rays [cm]", xlabel="east", ylabel="north", aspect="equal")
    left.set(xlim=(-60, 60), ylim=(-50, 70))
    left.legend(markerscale=5, handletextpad=0.1, loc="upper left")
    sums = np.zeros((len(chosen), len(PIXEL_SUMS), CAMERA.rows, CAMERA.cols))
    made = surfaces(CALM, wet, WATER_VIEW, dead, list(chosen.values()), count, 52)
    for acquired, results in made:
        truth = acquired.true_down_m, acquired.true_normals
        sums += [pixel_sums(*surface_error(f.points_m, f.normals, *truth)[1:]) for f in results]
    for axes, name, total in zip(right, chosen, sums, strict=True):
        normals = pixel_maps(total)["normal_deg"][USED.any(axis=1)]
        shown = axes.imshow(normals, cmap=style.SKY, vmin=0, vmax=25)
        axes.set(title=name[0].upper() + name[1:], xlabel="column", ylabel="row")
    drawn.colorbar(shown, ax=right, label="normals off the truth [deg]", shrink=0.8)
    return drawn


def _scatter(axes: Axes, off_m: Floats, colour: str, label: str | None) -> None:
    east, north = 100 * off_m[..., 1].ravel(), 100 * off_m[..., 0].ravel()
    axes.plot(east, north, ".", ms=1.5, mew=0, color=colour, label=label)


def print_errors(title: str, published: Sequence[float] | None, rows: dict[str, Floats]) -> None:
    """One row for each way; mean and standard deviation of the seeds' means."""
    print(f"\n{title}")
    heads = ("|bias| mm", "variance mm2", "MSE mm2", "mean normal deg", "pixel normals deg")
    print(f"{'':26s}" + "".join(f"{h:>20s}" for h in heads))
    if published:
        print(f"{'published':26s}" + "".join(f"{v:20.2f}" for v in published) + f"{'-':>20s}")
    for name, values in rows.items():
        mean, spread = values.mean(axis=0), values.std(axis=0, ddof=min(len(values) - 1, 1))
        cells = [f"{m:.2f} +- {s:.2f}" for m, s in zip(mean, spread, strict=True)]
        print(f"{name:26s}" + "".join(f"{c:>20s}" for c in cells))


def print_spread(instrument: Instrument, calibration: Calibration, dead: NDArray[np.bool_]) -> None:
    """Spread of a flat target's ranges by frames [cm]."""
    drawn = next(
        iter(acquisitions(HARD, instrument, CAMERA, HARD_VIEW, 1, FRAME_COUNTS[-1], 77))
    ).frames
    found = []
    for count in FRAME_COUNTS:
        down = ranges(gated(drawn[:count]), dead, calibration, CAMERA, PIXELS) / HARD_VIEW.norm
        found.append(100 * float(np.nanstd(down)))
    row = "".join(f"{c:>9d}" for c in FRAME_COUNTS)
    print(f"\nSpread of a flat target, cm\n{'frames':26s}{row}")
    print(f"{'published':26s}" + "".join(f"{v:9.2f}" for v in PUBLISHED_SPREAD_CM))
    print(f"{'twin':26s}" + "".join(f"{v:9.2f}" for v in found))


def main(seeds: Sequence[int], count: int) -> None:
    """Simulate, calibrate, make surfaces and print."""
    print(f"settings: seeds {list(seeds)}, {count} acquisitions of {FRAMES} frames each")
    tables: dict[str, dict[str, list[Floats]]] = {n: {} for n in TABLES}
    for seed in seeds:
        instrument = Instrument(seed=seed)
        ways, dead = calibrated_ways(instrument, seed)
        (theirs, _), (ours, _) = ways["the source's way"], ways["ours"]
        if seed == seeds[0]:
            print_spread(instrument, theirs, dead)
            print(
                "\nCalibration, published: scale 1.0238, offset 82.353 ns, walk 0.0219 exp(4.589 I)"
            )
        s, o = theirs.settings, ours.settings
        print(
            f"seed {seed}: scale {s.scale:.4f}, offset {s.offset_ns:.3f} ns, walk {s.walk_ns:.4f} "
            f"exp({s.walk_exponent:.3f} I); ours: scale {o.scale:.4f}, "
            f"offset {o.offset_ns:.3f} ns, echo {o.pulse_ns:.3f} ns, "
            f"{int((dead & USED).sum())} dead pixels in use"
        )
        wet = instrument.model_copy(update=ON_WATER)
        for name, target, receiver, view in (
            ("hard", HARD, instrument, HARD_VIEW),
            ("calm", CALM, wet, WATER_VIEW),
            ("waves", WAVES, wet, WATER_VIEW),
        ):
            found: dict[str, list[list[float]]] = {way: [] for way in ways}
            floor: dict[str, list[tuple[float, ...]]] = {way: [] for way in ways}
            chosen = list(ways.values())
            made = surfaces(target, receiver, view, dead, chosen, count, 50 + seed)
            for acquired, results in made:
                for way, surface in zip(ways, results, strict=True):
                    found[way].append(errors(acquired, surface))
                    floor[way].append(floor_errors(acquired, surface, view))
            for way in ways:
                tables[name].setdefault(way, []).append(np.mean(found[way], axis=0))
                if name == "waves":
                    tables["floor"].setdefault(way, []).append(np.mean(floor[way], axis=0))
    stacked = {t: {w: np.array(v) for w, v in rows.items()} for t, rows in tables.items()}
    print_errors("Flat hard target [table 4.2]", PUBLISHED_HARD, stacked["hard"])
    print_errors("Calm water [table 4.4]", PUBLISHED_CALM, stacked["calm"])
    print_errors("Waves", None, stacked["waves"])
    print(f"\nEnds of rays after {PATH_M} m of water under waves, distance to the truth, cm")
    heads = ("straight", "level", "surface", "beam straight", "beam level", "beam surface")
    print(f"{'':26s}" + "".join(f"{h:>16s}" for h in heads))
    for name, values in stacked["floor"].items():
        print(f"{name:26s}" + "".join(f"{100 * v:16.2f}" for v in values.mean(axis=0)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--acquisitions", type=int, default=20)
    options = parser.parse_args()
    main(options.seeds, options.acquisitions)
