"""Frames of a Geiger-mode array over a hard target, calm or wavy water, with their truth.

Each pixel of each frame is drawn by the law of detection itself. The photo-electrons of an echo are
a Poisson process in time: the first comes when its cumulative intensity reaches an exponential
variate, :math:`n F(t) = E`. Dark counts and background light, a steady process from the moment of
arming, compete with it, and only the earlier of both is recorded: one hit for each pixel and frame.
Range walk, and the blinding by noise in front of the gate, follow from that. Then come the jitter
of the avalanche, the delay of the pixel, the clock and its bins.

Left out: crosstalk and afterpulses (the array is gated once a frame and rests between), glint, and
the size of a pixel's footprint on a slope.
"""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import ndtri
from scipy.stats import exponnorm

from spl_batch.engine.settings.base import Positive, Section
from spl_batch.engine.verbs.simulation import Simulated, finished, scene_of
from spl_batch.geiger.water.formats import FrameTruth, write_frames
from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS, Floats, View, view_of
from spl_batch.geiger.water.settings import CameraSettings, MountSettings

GRAVITY_M_S2 = 9.81
NotNegative = Annotated[float, Field(ge=0)]


class Wave(Section):
    """One sinusoid of deep water, travelling."""

    amplitude_m: float = Field(description="Half of crest to trough [m].")
    length_m: Positive = Field(description="Crest to crest [m].")
    heading_deg: float = Field(0.0, description="Where it goes, from north over east [deg].")
    phase_deg: float = Field(0.0, description="At the origin at time 0 [deg].")


class Target(Section):
    """What the array looks at: a level surface, or waves about it."""

    down_m: float = Field(description="Of the level surface in the local frame [m].")
    waves: tuple[Wave, ...] = Field((), description="Added up; none for a flat target.")
    penetration_m: NotNegative = Field(0.0, description="Mean way of echoes in water [m].")

    def surface(
        self, north: Floats, east: Floats, time_s: Floats | float
    ) -> tuple[Floats, Floats, Floats]:
        """Down [m], and its slopes along north and east, at points and times."""
        down = np.full(np.broadcast_shapes(north.shape, np.shape(time_s)), self.down_m)
        by_north, by_east = np.zeros_like(down), np.zeros_like(down)
        for wave in self.waves:
            k = 2.0 * math.pi / wave.length_m
            kn = k * math.cos(math.radians(wave.heading_deg))
            ke = k * math.sin(math.radians(wave.heading_deg))
            turn = kn * north + ke * east - math.sqrt(GRAVITY_M_S2 * k) * time_s
            turn = turn + math.radians(wave.phase_deg)
            down += wave.amplitude_m * np.sin(turn)
            slope = wave.amplitude_m * np.cos(turn)
            by_north += kn * slope
            by_east += ke * slope
        return down, by_north, by_east

    def meet(self, view: View, time_s: Floats | float) -> tuple[Floats, Floats]:
        """Range of each pixel's line of sight (..., rows, cols) [m], and unit normal of the water.

        ``view``: not level. ``time_s``: float or (n, 1, 1) float64 [s].
        """
        look = view.look
        length = (self.down_m - view.origin_m[2]) / look[..., 2] + 0.0 * np.asarray(time_s)
        for _ in range(30 if self.waves else 1):
            north = view.origin_m[0] + length * look[..., 0]
            east = view.origin_m[1] + length * look[..., 1]
            down, by_north, by_east = self.surface(north, east, time_s)
            above = down - view.origin_m[2] - length * look[..., 2]
            closing = look[..., 2] - by_north * look[..., 0] - by_east * look[..., 1]
            step = above / closing
            length = length + step
            if np.abs(step).max() < 1e-9:
                break
        normals = np.stack([by_north, by_east, -np.ones_like(down)], axis=-1)
        return length, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


class Instrument(Section):
    """The array as it really is; the defaults are a twin of the source's."""

    peak_photoelectrons: Positive = Field(0.4, description="Of an echo in mid-beam [count].")
    beam_px: Positive = Field(22.0, description="1/e2 radius of the beam on the array [pixel].")
    beam_centre_px: tuple[float, float] = Field((14.0, 15.5), description="Row, column [pixel].")
    sensitivity_spread: NotNegative = Field(0.1, description="Of the pixels' efficiency [1].")
    pulse_ns: Positive = Field(1.0, description="Standard deviation of the laser's pulse [ns].")
    jitter_ns: NotNegative = Field(0.085, description="Of the avalanche's delay [ns].")
    noise_hz: NotNegative = Field(700.0, description="Dark counts and background of a pixel [1/s].")
    scale: Positive = Field(1.02379235588971, description="Measured over actual time [1].")
    offset_ns: float = Field(82.3525317669176, description="Delay of the electronics [ns].")
    delay_ns: NotNegative = Field(0.05, description="Spread of each pixel's own delay [ns].")
    pattern_ns: NotNegative = Field(0.018, description="Of a delay smooth over the array [ns].")
    dead: int = Field(150, ge=0, description="Dead pixels, most in the last three rows [count].")
    seed: int = Field(1, ge=0, description="Of what is fixed to the instrument.")

    def dimmed(self, factor: float) -> "Instrument":
        """The same instrument with another share of the light."""
        light = factor * self.peak_photoelectrons
        return self.model_copy(update={"peak_photoelectrons": light})


class Array(NamedTuple):
    """Properties of one instrument's pixels: (rows, cols) each."""

    photoelectrons: Floats  #: Expected of an echo [count].
    delay_ns: Floats  #: Of the pixel [ns].
    dead: NDArray[np.bool_]  #: Pixels that never fire.


def build_array(instrument: Instrument, camera: CameraSettings) -> Array:
    """Draw an instrument's pixels; the same for every amount of light."""
    rng = np.random.default_rng((instrument.seed, 0))
    shape = camera.rows, camera.cols
    row, col = np.mgrid[0 : camera.rows, 0 : camera.cols].astype(np.float64)
    away = np.hypot(row - instrument.beam_centre_px[0], col - instrument.beam_centre_px[1])
    beam = np.exp(-2.0 * (away / instrument.beam_px) ** 2)
    gain = np.maximum(1.0 + instrument.sensitivity_spread * rng.standard_normal(shape), 0.1)
    delay = instrument.delay_ns * rng.standard_normal(shape)
    delay += instrument.pattern_ns * _pattern(rng, row / camera.rows, col / camera.cols)
    order = rng.permutation(camera.rows * camera.cols)
    last = row.ravel()[order] >= camera.rows - 3
    # Nine in ten of the dead ones lie in the last three rows, as far as there is room.
    many = min(round(0.9 * instrument.dead), int(last.sum()))
    chosen = np.concatenate([order[last][:many], order[~last][: instrument.dead - many]])
    dead = np.zeros(shape, dtype=np.bool_)
    dead.ravel()[chosen] = True
    return Array(instrument.peak_photoelectrons * beam * gain, delay, dead)


def _pattern(rng: np.random.Generator, row: Floats, col: Floats) -> Floats:
    """Smooth, of mean 0 and standard deviation 1: a sum of a few long waves over the array."""
    total = np.zeros_like(row)
    for _ in range(6):
        angle, turns, phase = rng.uniform(0, 2 * math.pi), rng.uniform(0.3, 1.2), rng.uniform(0, 1)
        along = math.cos(angle) * row + math.sin(angle) * col
        total += np.sin(2 * math.pi * (turns * along + phase))
    return np.asarray((total - total.mean()) / total.std())


def late_photon(share: Floats, decay: float) -> Floats:
    """Time at which a share of an echo, 0 to 1, has come, in standard deviations of the pulse.

    ``decay``: mean of the exponential that light from below the surface adds, in the same unit.
    """
    if decay <= 0.0:
        return np.asarray(ndtri(share))
    t = np.linspace(-8.0, 8.0 + 40.0 * decay, 8001)
    return np.asarray(np.interp(share, exponnorm.cdf(t, decay), t))


def draw_frames(
    array: Array,
    instrument: Instrument,
    camera: CameraSettings,
    actual_ns: Floats,
    decay_ns: float,
    rng: np.random.Generator,
) -> NDArray[np.uint16]:
    """Time bins of frames: (n, rows, cols) uint16, bins; 0 is no hit.

    ``actual_ns``: (n, rows, cols) float64, actual time of flight to the surface in each frame [ns].
    ``decay_ns``: mean delay of light from below the surface [ns].
    """
    shape = actual_ns.shape
    reached = rng.standard_exponential(shape) / array.photoelectrons
    # An echo has the pulse's width; where its middle lies depends on the frame.
    signal, comes = np.full(shape, np.inf), reached < 1.0
    share, pulse_ns = np.clip(reached[comes], 1e-12, 1.0 - 1e-12), instrument.pulse_ns
    signal[comes] = actual_ns[comes] + pulse_ns * late_photon(share, decay_ns / pulse_ns)
    waits, rate = rng.standard_exponential(shape), instrument.noise_hz * 1e-9
    noise = waits / rate if rate else np.full(shape, np.inf)
    first = np.minimum(instrument.scale * signal + instrument.offset_ns, noise)
    first = first + instrument.jitter_ns * rng.standard_normal(shape) + array.delay_ns
    fired = np.isfinite(first) & (first < camera.bin_ns * (camera.bins + 1)) & ~array.dead
    bins = np.zeros(shape, dtype=np.uint16)
    bins[fired] = np.clip(first[fired] // camera.bin_ns, 1, camera.bins).astype(np.uint16)
    return bins


class Acquisition(NamedTuple):
    """Frames of one acquisition and what is true in its middle."""

    frames: NDArray[np.uint16]  #: (n, rows, cols): bins; 0 is no hit.
    #: (rows, cols): along each line of sight [m].
    true_range_m: Floats
    true_down_m: Floats
    true_normals: Floats  #: (rows, cols, 3): unit vectors out of the water.


def acquisitions(
    target: Target,
    instrument: Instrument,
    camera: CameraSettings,
    view: View,
    count: int,
    frames: int,
    seed: int | tuple[int, ...],
) -> Iterator[Acquisition]:
    """Acquisitions one behind the other; the surface moves on from frame to frame.

    ``seed``: of the photons; the instrument has its own.
    """
    array = build_array(instrument, camera)
    seeds = (seed,) if isinstance(seed, int) else seed
    # The way down and up, at the speed of light in water.
    decay_ns = target.penetration_m * 1.33 / (2.0 * HALF_C_M_NS)
    for k in range(count):
        rng = np.random.default_rng((*seeds, k))
        times = (k * frames + np.arange(frames)) / camera.prf_hz
        true_range, true_normals = target.meet(view, float(times.mean()))
        range_m = target.meet(view, times[:, None, None])[0]
        drawn = draw_frames(array, instrument, camera, range_m / HALF_C_M_NS, decay_ns, rng)
        down = view.points(true_range)[..., 2]
        yield Acquisition(drawn, true_range, down, true_normals)


class TargetFrames(Section):
    """Frames of a flat target for calibration, at several distances and amounts of light."""

    distances_m: tuple[Positive, ...] = Field(
        (2.0, 3.0, 4.0, 5.0), min_length=2, description="Of the target along the axis [m]."
    )
    lights: tuple[Positive, ...] = Field(
        (0.04, 0.3, 1.0, 4.0), min_length=1, description="Shares of the light of the beam."
    )
    frames: int = Field(1000, ge=1, description="Frames at each distance and light [count].")
    tape_m: NotNegative = Field(0.0, description="Standard error of a distance [m].")


class WaterScene(Section):
    """A water surface to be simulated."""

    kind: Literal["water_surface"] = Field(description="Receiver that the scene is for.")
    name: str = Field("water", description="Title, and name of the files.")
    seed: int = Field(1, ge=0, description="Every photon follows from it.")
    camera: CameraSettings = CameraSettings()
    mount: MountSettings = MountSettings(position_m=(0.0, 0.0, -3.1))
    target: Target = Target(down_m=0.0)
    instrument: Instrument = Instrument()
    files: int = Field(1, ge=1, le=10_000, description="Files of frames [count].")
    acquisitions: int = Field(10, ge=1, description="Acquisitions of each file [count].")
    frames_per_acquisition: int = Field(200, ge=1, description="Frames of each [count].")
    calibration: TargetFrames | None = TargetFrames()
    format: Literal["h5", "zarr"] = Field("h5", description="HDF5 or Zarr.")
    in_water_m: NotNegative = Field(0.0, description="Way in water of the workflow's rays [m].")


def simulate_file(
    path: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Make the files of a scene's file, into ``frames/``, ``calibration/`` and ``workflow.yaml``.

    ``progress`` receives the share of the files that is written, 0..1.
    """
    scene, notify = scene_of(WaterScene, path), progress or (lambda _: None)
    view, per = view_of(scene.camera, scene.mount), scene.frames_per_acquisition
    what = scene.target, scene.instrument, scene.camera, view, scene.acquisitions, per
    described = {"bin_ns": scene.camera.bin_ns, "prf_hz": scene.camera.prf_hz}
    for k in range(scene.files):
        made = list(acquisitions(*what, (scene.seed, k)))
        down, normals = np.stack([a.true_down_m for a in made]), [a.true_normals for a in made]
        name = f"frames/{scene.name}_{k:02d}.{scene.format}"
        frames = np.concatenate([a.frames for a in made])
        write_frames(out / name, frames, described, FrameTruth(down, np.stack(normals)), per)
        notify((k + 1) / (scene.files + (scene.calibration is not None)))
    listed = []
    for target, seen in _targets(scene, scene.calibration) if scene.calibration else ():
        write_frames(out / target["frames"], seen, described)
        listed.append(target)
    notify(1.0)
    camera, mount = (
        section.model_dump(mode="json", exclude_defaults=True)
        for section in (scene.camera, scene.mount)
    )
    given = {"camera": camera, "mount": mount, "calibration": listed and {"frames": listed}}
    workflow = {
        "kind": "water_surface",
        "survey": {"name": scene.name, "frames": f"frames/*.{scene.format}"},
        "output": "out",
        "surface": {"frames_per_acquisition": per},
        "path": {"in_water_m": scene.in_water_m},
        **{key: value for key, value in given.items() if value},
    }
    counts = {"frames": scene.files * scene.acquisitions * per}
    counts["frames of targets"] = len(listed) * scene.calibration.frames if scene.calibration else 0
    return finished(out, workflow, counts)


def _targets(
    scene: WaterScene, wanted: TargetFrames
) -> Iterator[tuple[dict[str, Any], NDArray[np.uint16]]]:
    """Frames of a flat target across the axis, and what a workflow has of them.

    Distances are known with an error.
    """
    rng = np.random.default_rng((scene.seed, 1_000_000))
    view, number = view_of(scene.camera, MountSettings(off_nadir_deg=0.0)), 1_000_001
    for distance in wanted.distances_m:
        measured = float(distance + wanted.tape_m * rng.standard_normal())
        for light in wanted.lights:
            what = (Target(down_m=distance), scene.instrument.dimmed(light), scene.camera, view)
            (made,) = acquisitions(*what, 1, wanted.frames, (scene.seed, number))
            name = f"calibration/{distance:g}m_{light:g}.{scene.format}"
            yield {"frames": name, "distance_m": measured}, made.frames
            number += 1
