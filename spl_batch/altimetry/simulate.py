"""Profiles like MABEL's with truth for every photon: mountain or flat, green or infrared.

Not a link budget (that is :mod:`spl_batch.airborne.simulate`): photons per metre of track and noise
per square metre are given, since these decide what a filter along a profile can do. Signal of
one-minute flights at 20 km is about one photon per metre in the green and a few in the
infrared; noise follows sky, albedo and slope and steps up over bright ground, as [W17]
Fig. 4-5 shows it between 8 and 9 km. The gate follows a coarse terrain model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import ndimage

from spl_batch.altimetry.formats.mabel import write_mabel
from spl_batch.altimetry.formats.track_csv import to_text
from spl_batch.engine.settings.base import Positive, Section
from spl_batch.engine.verbs.simulation import Simulated, finished, scene_of
from spl_batch.formats.files.atomic import write_bytes

PIECE_M: Final = 4.0
"""Track of one noise rate: 0.02 s at 200 m/s [m]."""

SPEED_M_S: Final = 200.0
GROUND: Final = 1
CANOPY: Final = 2
_START_S: Final = 1000.0
_NORTH_M_PER_DEG: Final = 110_574.0
"""Metres of a degree of latitude at the equator, where tracks run north along Greenwich."""


class Light(Section):
    """What a channel detects."""

    signal_per_m: Positive = Field(1.5, description="Mean signal photons per metre [1/m].")
    noise_per_m2: float = Field(0.02, ge=0, description="Median noise density [1/m2].")


class TrackScene(Light):
    """What a simulated track looks like."""

    seed: int = Field(1, ge=0, description="Of all random numbers.")
    stream: int = Field(0, ge=0, description="Another number gives other photons, same ground.")
    length_m: Positive = Field(4000.0, description="Length of the track [m].")
    relief_m: float = Field(500.0, ge=0, description="Highest less lowest ground [m].")
    noise_spread: float = Field(0.35, ge=0, description="Of ln noise, per wave of three.")
    patch: float = Field(3.0, ge=1, description="Factor of the noise over a bright patch.")
    patch_share: float = Field(
        0.15, ge=0, lt=1, description="Length of the patch over the track's."
    )
    canopy: float = Field(0.0, ge=0, le=1, description="Share of the track that is wooded.")
    above_m: Positive = Field(700.0, description="Gate above the coarse terrain [m].")
    below_m: Positive = Field(500.0, description="Gate below it [m].")
    spread_m: Positive = Field(0.4, description="SD of a ground return in height [m].")


class SceneFile(Section):
    """A scene file of ``kind: altimetry``: one track, seen by several channels."""

    kind: Literal["altimetry"] = Field(description="Receiver that the scene is for.")
    name: str = Field("simulated track", description="Title of the report.")
    track: TrackScene = TrackScene()
    channels: dict[str, Light] = Field(
        {
            "channel006": Light(),
            "channel043": Light(signal_per_m=4.0, noise_per_m2=0.01),
        },
        description="What each channel detects; a green and an infrared one by default.",
    )


@dataclass(frozen=True, slots=True)
class Track:
    """Simulated photons in the order of their shots, with truth."""

    #: (n,): photons [m].
    along_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    truth: NDArray[np.uint8]  #: (n,): 0 noise, 1 ground, 2 canopy.
    ground_m: NDArray[np.float64]  #: (n,): height of the ground below each photon [m].
    #: (m, 2): along-track distance and height of the ground, every metre [m].
    reference_m: NDArray[np.float64]


def simulate_track(scene: TrackScene) -> Track:
    """Draw a track's photons; the same scene gives the same photons."""
    reference = _terrain(np.random.default_rng([scene.seed, 0]), scene)
    rng = np.random.default_rng([scene.seed, 1, scene.stream])
    coarse = ndimage.uniform_filter1d(reference[:, 1], 1001, mode="nearest")
    start = np.arange(0.0, scene.length_m, PIECE_M)
    density = _noise_density(rng, scene, start)
    gate = scene.above_m + scene.below_m
    many = rng.poisson(density * PIECE_M * gate)
    along = np.repeat(start, many) + rng.uniform(0.0, PIECE_M, many.sum())
    height = np.interp(along, reference[:, 0], coarse)
    height += rng.uniform(-scene.below_m, scene.above_m, len(along))
    bright = scene.signal_per_m * np.exp(
        0.4 * np.sin(2 * np.pi * start / 700 + rng.uniform(0, 6))
        + 0.3 * rng.standard_normal(len(start))
    )
    few = rng.poisson(bright * PIECE_M)
    signal = np.repeat(start, few) + rng.uniform(0.0, PIECE_M, few.sum())
    above, truth = _canopy(rng, scene, signal)
    surface = np.interp(signal, *reference.T) + above
    surface += rng.normal(0.0, scene.spread_m, len(signal))
    along = np.concatenate([along, signal])
    order = np.argsort(along, kind="stable")
    along = along[order]
    return Track(
        along,
        np.concatenate([height, surface])[order],
        np.concatenate([np.zeros(many.sum(), np.uint8), truth])[order],
        np.interp(along, *reference.T),
        reference,
    )


def _terrain(rng: np.random.Generator, scene: TrackScene) -> NDArray[np.float64]:
    """Ground as a sum of waves whose heights fall with the square of their number."""
    x = np.arange(-1000.0, scene.length_m + 1000.0)
    number = np.arange(1, 67)
    height = rng.rayleigh(1.0, len(number)) / number**2.0
    phase = rng.uniform(0.0, 2 * np.pi, len(number))
    z = sum(
        h * np.sin(2 * np.pi * n * x / 4000.0 + p)
        for n, h, p in zip(number, height, phase, strict=True)
    )
    z = np.asarray(z)
    z = (z - z.min()) / np.ptp(z) * scene.relief_m + 100.0
    return np.stack([x, z], axis=1)


def _noise_density(
    rng: np.random.Generator, scene: TrackScene, start: NDArray[np.float64]
) -> NDArray[np.float64]:
    log = np.zeros(len(start))
    for wave_m in (3000.0, 1200.0, 500.0):
        log += scene.noise_spread * np.sin(2 * np.pi * start / wave_m + rng.uniform(0, 2 * np.pi))
    density = scene.noise_per_m2 * np.exp(log)
    first = rng.uniform(0.1, 0.9 - scene.patch_share) * scene.length_m
    inside = (start >= first) & (start < first + scene.patch_share * scene.length_m)
    density[inside] *= scene.patch
    return density


def _canopy(
    rng: np.random.Generator, scene: TrackScene, along: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Height above ground of each signal photon, and whether it is of the canopy."""
    plots = int(scene.length_m / 50.0) + 2
    wooded = rng.uniform(size=plots) < scene.canopy
    tops = rng.uniform(8.0, 22.0, int(scene.length_m / 10.0) + 2)
    leaf = wooded[(along / 50.0).astype(np.int64)] & (rng.uniform(size=len(along)) < 0.7)
    top = tops[(along / 10.0).astype(np.int64)]
    above = np.where(leaf, top * rng.beta(4.0, 2.0, len(along)), 0.0)
    return above, np.where(leaf, CANOPY, GROUND).astype(np.uint8)


def simulate_file(
    scene: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Simulate the track of a scene file: ``track.h5``, ``reference.csv``, ``workflow.yaml``."""
    return simulate(scene_of(SceneFile, scene), out, progress=progress)


def simulate(
    scene: SceneFile, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Simulate a track that several channels see; ``progress`` receives the share done, 0..1."""
    channels: dict[str, dict[str, NDArray[Any]]] = {}
    reference = np.empty((0, 2))
    for stream, (name, light) in enumerate(scene.channels.items()):
        track = simulate_track(
            scene.track.model_copy(update={**light.model_dump(), "stream": stream})
        )
        latitude = track.along_m / _NORTH_M_PER_DEG
        channels[name] = {
            "delta_time": _START_S + track.along_m / SPEED_M_S,
            "elev": track.height_m.astype(np.float32),
            "latitude": latitude,
            "longitude": np.zeros(len(latitude)),
            "truth": track.truth,
        }
        reference = track.reference_m
        if progress is not None:
            progress((stream + 1) / len(scene.channels))
    write_mabel(out / "track.h5", channels)
    write_bytes(
        out / "reference.csv", to_text({"along_track": reference[:, 0], "height": reference[:, 1]})
    )
    workflow = {
        "kind": "altimetry",
        "track": {"name": scene.name, "photons": "track.h5"},
        "reference": {"points": "reference.csv"},
        "output": "out",
    }
    return finished(out, workflow, {k: len(v["elev"]) for k, v in channels.items()})
