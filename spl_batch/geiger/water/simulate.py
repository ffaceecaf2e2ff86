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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import ndtr, ndtri

from spl_batch.engine.settings.base import Positive, Section
from spl_batch.engine.verbs.simulation import Simulated, finished, scene_of
from spl_batch.geiger.water.formats import FrameTruth, write_frames
from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS, Floats, View, view_of
from spl_batch.geiger.water.settings import CameraSettings, MountSettings

GRAVITY_M_S2 = 9.81


@dataclass(frozen=True, slots=True)
class Wave:
    """One sinusoid of deep water, travelling."""

    #: Half of crest to trough, and crest to crest [m].
    amplitude_m: float
    length_m: float
    heading_deg: float = 0.0  #: Where it goes, from north over east [deg].
    phase_deg: float = 0.0  #: At the origin at time 0 [deg].


@dataclass(frozen=True, slots=True)
class Target:
    """What the array looks at: a level surface, or waves about it."""

    down_m: float  #: Of the level surface in the local frame [m].
    waves: tuple[Wave, ...] = ()  #: Added up; none for a flat target.
    #: Mean length of the way in water of light that comes back [m]; 0 for a hard target.
    penetration_m: float = 0.0

    def surface(
        self, north: Floats, east: Floats, time_s: Floats | float
    ) -> tuple[Floats, Floats, Floats]:
        """Down [m], and its slopes along north and east, at places and times."""
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


@dataclass(frozen=True, slots=True)
class Instrument:
    """The array as it really is; the defaults are a twin of the source's."""

    peak_photoelectrons: float = 0.4  #: Expected of an echo in the middle of the beam [count].
    #: float, (float, float): 1/e2 radius of the beam on the array, and its middle: row, column
    #: [pixel].
    beam_px: float = 22.0
    beam_centre_px: tuple[float, float] = (14.0, 15.5)
    sensitivity_spread: float = 0.1  #: Relative spread of the pixels' efficiency.
    #: Standard deviations of the laser's pulse and of the avalanche's delay [ns].
    pulse_ns: float = 1.0
    jitter_ns: float = 0.085
    noise_hz: float = 700.0  #: Dark counts and background of a pixel [1/s].
    #: Clock: measured = scale x actual + offset [ns].
    scale: float = 1.02379235588971
    offset_ns: float = 82.3525317669176
    #: Delay of the pixels: standard deviation of a part of its own for each, and of a part that
    #: changes smoothly over the array [ns].
    delay_ns: float = 0.05
    pattern_ns: float = 0.018
    dead: int = 150  #: Dead pixels, most of them in the last three rows [count].
    hot: int = 0  #: Pixels that fire in most frames by themselves [count].
    seed: int = 1  #: Of what is fixed to the instrument.

    def dimmed(self, factor: float) -> "Instrument":
        """The same instrument with another share of the light."""
        return replace(self, peak_photoelectrons=factor * self.peak_photoelectrons)


@dataclass(frozen=True)
class Array:
    """Properties of one instrument's pixels: (rows, cols) each."""

    photoelectrons: Floats  #: Expected of an echo [count].
    delay_ns: Floats  #: Of the pixel [ns].
    noise_hz: Floats  #: Dark counts and background [1/s].
    dead: NDArray[np.bool_] = field(repr=False)  #: Pixels that never fire.


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
    noise = np.full(shape, instrument.noise_hz)
    noise.ravel()[order[~last][instrument.dead :][: instrument.hot]] = 1e6
    return Array(instrument.peak_photoelectrons * beam * gain, delay, noise, dead)


def _pattern(rng: np.random.Generator, row: Floats, col: Floats) -> Floats:
    """Smooth, of mean 0 and standard deviation 1: a sum of a few long waves over the array."""
    total = np.zeros_like(row)
    for _ in range(6):
        angle, turns, phase = rng.uniform(0, 2 * math.pi), rng.uniform(0.3, 1.2), rng.uniform(0, 1)
        along = math.cos(angle) * row + math.sin(angle) * col
        total += np.sin(2 * math.pi * (turns * along + phase))
    smooth: Floats = (total - total.mean()) / total.std()
    return smooth


def late_photon(share: Floats, decay: float) -> Floats:
    """Time at which a share of an echo, 0 to 1, has come, in standard deviations of the pulse.

    ``decay``: mean of the exponential that light from below the surface adds, in the same unit.
    """
    if decay <= 0.0:
        hard: Floats = ndtri(share)
        return hard
    # Normal and exponential together, inverted by a table: ndtr(t) less its late part.
    t = np.linspace(-8.0, 8.0 + 40.0 * decay, 8001)
    late = np.exp(0.5 / decay**2 - t / decay + np.log(np.maximum(ndtr(t - 1.0 / decay), 1e-300)))
    cumulative = np.maximum.accumulate(np.clip(ndtr(t) - late, 0.0, 1.0))
    rising = np.concatenate([[True], np.diff(cumulative) > 1e-15])
    delayed: Floats = np.interp(share, cumulative[rising], t[rising])
    return delayed


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
    never = np.inf
    reached = rng.standard_exponential(shape) / array.photoelectrons
    signal = np.full(shape, never)
    comes = reached < 1.0
    share = np.clip(reached[comes], 1e-12, 1.0 - 1e-12)
    # An echo has the pulse's width; where its middle lies depends on the frame.
    signal[comes] = actual_ns[comes] + instrument.pulse_ns * late_photon(
        share, decay_ns / instrument.pulse_ns
    )
    measured = instrument.scale * signal + instrument.offset_ns
    noise = rng.standard_exponential(shape) / (array.noise_hz * 1e-9)
    first = np.minimum(measured, noise)
    first = first + instrument.jitter_ns * rng.standard_normal(shape) + array.delay_ns
    fired = np.isfinite(first) & (first < camera.bin_ns * (camera.bins + 1)) & ~array.dead
    bins = np.zeros(shape, dtype=np.uint16)
    bins[fired] = np.clip(first[fired] // camera.bin_ns, 1, camera.bins).astype(np.uint16)
    return bins


@dataclass(frozen=True, slots=True)
class Acquisition:
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
        middle = float(times.mean())
        true_range, true_normals = target.meet(view, middle)
        if target.waves:
            range_m, _ = target.meet(view, times[:, None, None])
        else:
            range_m = np.broadcast_to(true_range, (frames, *true_range.shape))
        drawn = draw_frames(array, instrument, camera, range_m / HALF_C_M_NS, decay_ns, rng)
        down = view.places(true_range)[..., 2]
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
    tape_m: float = Field(
        0.0, ge=0, description="Standard deviation of the error of a distance [m]."
    )


class WaterScene(Section):
    """A water surface to be simulated."""

    kind: Literal["water_surface"] = Field(description="Receiver that the scene is for.")
    name: str = Field("water", description="Title, and name of the files.")
    seed: int = Field(1, ge=0, description="Every photon follows from it.")
    camera: CameraSettings = CameraSettings()
    mount: MountSettings = Field(
        MountSettings(position_m=(0.0, 0.0, -3.1)), description="Where the lens is."
    )
    target: Target = Field(Target(0.0), description="Surface: down_m, waves, penetration_m.")
    instrument: Instrument = Field(Instrument(), description="The array as it really is.")
    files: int = Field(1, ge=1, le=10_000, description="Files of frames [count].")
    acquisitions: int = Field(10, ge=1, description="Acquisitions of each file [count].")
    frames_per_acquisition: int = Field(200, ge=1, description="Frames of each [count].")
    calibration: TargetFrames | None = TargetFrames()
    format: Literal["h5", "zarr"] = Field("h5", description="HDF5 or Zarr.")
    in_water_m: float = Field(0.0, ge=0, description="Way in water of the workflow's rays [m].")


def simulate_file(
    path: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Simulate the scene of a file; see :func:`simulate`."""
    return simulate(scene_of(WaterScene, path), out, progress=progress)


def simulate(
    scene: WaterScene, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Write the files of a scene.

    ``progress`` receives the share of the files that is written, 0..1.
    """
    for k in range(scene.files):
        _water(scene, k, out / "frames" / f"{scene.name}_{k:02d}.{scene.format}")
        if progress is not None:
            progress((k + 1) / (scene.files + (scene.calibration is not None)))
    listed = _targets(scene, scene.calibration, out) if scene.calibration else []
    if progress is not None:
        progress(1.0)
    frames = scene.files * scene.acquisitions * scene.frames_per_acquisition
    targets = len(listed) * scene.calibration.frames if scene.calibration else 0
    return finished(out, _workflow(scene, listed), {"frames": frames, "frames of targets": targets})


def _water(scene: WaterScene, k: int, path: Path) -> None:
    view, per = view_of(scene.camera, scene.mount), scene.frames_per_acquisition
    what = (scene.target, scene.instrument, scene.camera, view)
    made = list(acquisitions(*what, scene.acquisitions, per, (scene.seed, k)))
    truth = FrameTruth(
        np.stack([a.true_down_m for a in made]), np.stack([a.true_normals for a in made])
    )
    _write(scene, path, np.concatenate([a.frames for a in made]), truth)


def _write(scene: WaterScene, path: Path, frames: Any, truth: FrameTruth | None = None) -> None:
    described = {"bin_ns": scene.camera.bin_ns, "prf_hz": scene.camera.prf_hz}
    write_frames(path, frames, described, truth, scene.frames_per_acquisition)


def _targets(scene: WaterScene, wanted: TargetFrames, out: Path) -> list[dict[str, Any]]:
    """Frames of a flat target across the axis, at distances that are known with an error."""
    rng = np.random.default_rng((scene.seed, 1_000_000))
    view = view_of(scene.camera, MountSettings(off_nadir_deg=0.0))
    listed: list[dict[str, Any]] = []
    for distance in wanted.distances_m:
        measured = float(distance + wanted.tape_m * rng.standard_normal())
        for light in wanted.lights:
            seed = (scene.seed, 1_000_001 + len(listed))
            what = (Target(distance), scene.instrument.dimmed(light), scene.camera, view)
            (made,) = acquisitions(*what, 1, wanted.frames, seed)
            name = f"calibration/{distance:g}m_{light:g}.{scene.format}"
            _write(scene, out / name, made.frames)
            listed.append({"frames": name, "distance_m": measured})
    return listed


def _workflow(scene: WaterScene, listed: list[dict[str, Any]]) -> dict[str, Any]:
    camera = scene.camera.model_dump(mode="json", exclude_defaults=True)
    mount = scene.mount.model_dump(mode="json", exclude_defaults=True)
    content: dict[str, Any] = {
        "kind": "water_surface",
        "survey": {"name": scene.name, "frames": f"frames/*.{scene.format}"},
        "output": "out",
        "surface": {"frames_per_acquisition": scene.frames_per_acquisition},
        "path": {"in_water_m": scene.in_water_m},
    }
    given = {"camera": camera, "mount": mount, "calibration": listed and {"frames": listed}}
    return content | {key: value for key, value in given.items() if value}
