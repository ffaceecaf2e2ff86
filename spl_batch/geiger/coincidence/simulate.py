"""The artificial scene and the flight of [M20 3.1, 3.3, Table 1]; what they leave open is ours.

The source has two sets of 36 tri-bars and names the widths 17.5, 15, 12.5, 10 and 9 cm, the last
four of them a row of four in the 16 smallest. Ours are the other widths, 100 to 1 cm, and all
positions; the extent of a canopy; the painted figure; and a square leaf of a detector's ground size
for each of the source's foliage points.

Each frame has its own random numbers, so it does not depend on the others.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, Literal, get_args

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import Field

from spl_batch.constants import QUANTA_PER_M, SPEED_OF_LIGHT_M_S
from spl_batch.engine.settings.base import Positive, Section, Share
from spl_batch.engine.verbs.simulation import Simulated, finished, scene_of
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.geiger.coincidence import files
from spl_batch.geiger.coincidence.scene_rays import Targets, expose
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.geiger.coincidence.tables import Detections, Frames

BAR_WIDTHS_M: Final = (
    *(1.00, 0.95, 0.90, 0.85, 0.80, 0.75, 0.70, 0.65, 0.60, 0.55),
    *(0.50, 0.475, 0.45, 0.425, 0.40, 0.375, 0.35, 0.325, 0.30, 0.275),
    *(0.25, 0.225, 0.20, 0.175, 0.15, 0.125),
    *(0.10, 0.09, 0.08, 0.07, 0.06, 0.05, 0.04, 0.03, 0.02, 0.01),
)
"""Widths of bars and gaps of the tri-bar targets [m]; the 16 smallest make the last row."""

TARGET_HEIGHT_M: Final = 2.0
SPOKE_RADIUS_M: Final = 5.0
SPOKES: Final = 32
_CANOPY_M: Final = 14.0
_LEAVES: Final = 49_000
_LEAF_CELL_M: Final = 0.1
_STEEPEST: Final = 0.1
"""Steepest ray that leaf cells are made for [run/rise]."""

_BAR_ROW_M: Final = 24.0
"""Length of a row of tri-bars [m]."""
_BAR_TOP_M: Final = 10.0
"""North edge of the first row, from the middle of both sets [m]."""

Target = Literal["spokes", "bars", "cube", "coil", "logo", "covered_spokes", "foliage"]

POSITIONS_M: Final[dict[Target, tuple[float, float]]] = {
    "spokes": (0.0, 0.0),
    "covered_spokes": (0.0, -25.0),
    "foliage": (-25.0, 0.0),
    "cube": (25.0, 0.0),
    "logo": (28.0, -28.0),
    "coil": (-24.7, -24.7),
    "bars": (0.0, 25.0),
}
"""Centres of the targets, east and north of the scene's [m]."""


class FlightSettings(Section):
    """How the scene is flown over and detected."""

    altitude_m: Positive = Field(3000.0, description="Above the ground [m].")
    speed_m_s: Positive = Field(100.0, description="Over ground [m/s].")
    pulse_rate_hz: Positive = Field(2000.0, description="Laser pulses, and frames [1/s].")
    sweep_rad: Positive = Field(35e-3, description="Largest angle of the sweep from nadir [rad].")
    sweeps_hz: Positive = Field(20.0, description="Sweeps from side to side [1/s].")
    headings_deg: tuple[float, ...] = Field(
        (0.0, 180.0, 270.0, 90.0), min_length=1, description="One for each pass [deg]."
    )
    efficiency: Share = Field(0.5, description="Photo-electrons per look, reflectivity 1 [count].")
    dark_rate_hz: Positive = Field(1500.0, description="Of a detector, sunlight too [1/s].")
    range_jitter_m: Positive = Field(0.05, description="Standard deviation of a range [m].")
    angle_jitter_rad: Positive = Field(10e-6, description="Of each angle of a look [rad].")
    range_bin_m: Positive = Field(0.05, description="Range bin [m].")


class SceneSettings(Section):
    """A scene: which of the targets, which part of it is flown over, and how."""

    kind: Literal["coincidence"] = Field("coincidence", description="Receiver of the scene.")
    seed: int = Field(1, ge=0, description="Seed of leaves and photons.")
    targets: tuple[Target, ...] = Field(get_args(Target), description="Targets that are there.")
    extent_m: tuple[Positive, Positive] = Field((100.0, 100.0), description="Of what is seen [m].")
    centre_m: tuple[float, float] = Field((0.0, 0.0), description="Of that, from the scene's [m].")
    origin_m: tuple[float, float, float] = Field(
        (500_000.0, 4_200_000.0, 100.0), description="Coordinates of the scene's centre [m]."
    )
    crs: str = Field("EPSG:32616", description="CRS of the coordinates.")
    ground: Share = Field(0.5, description="Reflectivity of the ground [0..1].")
    array: ArraySettings = ArraySettings()
    flight: FlightSettings = FlightSettings()


def bars(centre_m: tuple[float, float]) -> list[tuple[float, bool, NDArray[np.float64]]]:
    """Tri-bar targets around a point: three bars, two gaps of the same width, five widths long.

    Width [m] of each; whether its bars run north; (3, 5) west, south, east, north, height [m].
    """
    found = []
    for north, side in ((True, -1.0), (False, 1.0)):
        x0 = centre_m[0] + (side - 1.0) * 0.5 * _BAR_ROW_M + side * 1.0
        x, y, tallest = x0, centre_m[1] + _BAR_TOP_M, 0.0
        for width in BAR_WIDTHS_M:
            size = 5.0 * width
            if x + size > x0 + _BAR_ROW_M:
                x, y, tallest = x0, y - tallest - 0.5, 0.0
            tallest = max(tallest, size)
            first = np.arange(3) * 2.0 * width
            plates = np.full((3, 5), TARGET_HEIGHT_M)
            plates[:, 0] = x + (first if north else 0.0)
            plates[:, 1] = y - size + (0.0 if north else first)
            plates[:, 2:4] = plates[:, :2] + ((width, size) if north else (size, width))
            found.append((width, north, plates))
            x += size + 0.5
    return found


def build(scene: SceneSettings) -> Targets:
    """Arrays of a scene; leaves are drawn from its seed."""
    there = {name: POSITIONS_M[name] for name in scene.targets}
    plates = [p for _, _, p in bars(there["bars"])] if "bars" in there else []
    wheels = [
        [*there[name], SPOKE_RADIUS_M, TARGET_HEIGHT_M, SPOKES]
        for name in ("spokes", "covered_spokes")
        if name in there
    ]
    x, y = POSITIONS_M["cube"]
    cubes = [[x - 1, y - 1, 0, x + 1, y + 1, 2]] if "cube" in there else []
    # Two loops of 1.5 m across, 5 m tall with the tube.
    turn = np.linspace(0.0, 2.0, 97) if "coil" in there else np.empty(0)
    (x, y), angle = POSITIONS_M["coil"], 2 * np.pi * turn
    coil = np.stack([x + 0.75 * np.cos(angle), y + 0.75 * np.sin(angle), 0.25 + 2.25 * turn], -1)
    logo = [*POSITIONS_M["logo"], 16.0 if "logo" in there else 0.0, 2.0]
    leaf_m = scene.flight.altitude_m * scene.array.ifov_rad
    leaves = _draw_leaves(scene)
    return Targets(
        np.concatenate([np.empty((0, 5)), *plates]),
        np.array(wheels, np.float64).reshape(-1, 5),
        np.array(cubes, np.float64).reshape(-1, 6),
        coil,
        0.25,
        np.array(logo, np.float64),
        leaves,
        leaf_m,
        *_leaf_lists(leaves, leaf_m),
        scene.ground,
        1.0,
    )


def _draw_leaves(scene: SceneSettings) -> NDArray[np.float64]:
    """Leaves of the canopies, from the highest down."""
    parts = [np.empty((0, 5))]
    for k, name in enumerate(("covered_spokes", "foliage")):
        if name in scene.targets:
            rng = np.random.default_rng([scene.seed, k, _LEAVES])
            drawn = rng.random((_LEAVES, 5))
            drawn[:, :2] = (drawn[:, :2] - 0.5) * _CANOPY_M + POSITIONS_M[name]
            drawn[:, 2] += 4.5
            parts.append(drawn)
    leaves = np.concatenate(parts)
    return leaves[np.argsort(-leaves[:, 2], kind="stable")]


def _leaf_lists(
    leaves: NDArray[np.float64], leaf_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Grid of columns, and the leaves that rays through each may meet."""
    if not len(leaves):
        return np.array([0.0, 0.0, 1.0, 0.0, 0.0]), np.zeros((1, 2), np.int64), np.empty(0, int)
    low, high = leaves[:, 2].min(), leaves[:, 2].max()
    margin = 0.5 * leaf_m + _STEEPEST * (high - low)
    corner = leaves[:, :2].min(axis=0) - margin
    nx, ny = np.ceil((leaves[:, :2].max(axis=0) + margin - corner) / _LEAF_CELL_M).astype(int)
    first = np.floor((leaves[:, :2] - margin - corner) / _LEAF_CELL_M).astype(int)
    width = math.ceil(2 * margin / _LEAF_CELL_M) + 1
    step = np.stack(np.meshgrid(np.arange(width), np.arange(width), indexing="ij"), -1)
    cells = np.minimum(first[:, None] + step.reshape(-1, 2), [nx - 1, ny - 1])
    key = (cells[..., 1] * nx + cells[..., 0]).ravel()
    item = np.repeat(np.arange(len(leaves)), width * width)
    pair = np.unique(key * len(leaves) + item)
    starts = np.searchsorted(pair // len(leaves), np.arange(nx * ny + 1))
    table = np.empty((ny, nx + 1), np.int64)
    table[:, :-1] = starts[:-1].reshape(ny, nx)
    table[:, -1] = starts[nx::nx]
    return np.array([*corner, _LEAF_CELL_M, low, high]), table, pair % len(leaves)


def simulate_file(
    path: Path, out: Path, *, progress: Callable[[float], None] | None = None
) -> Simulated:
    """Fly over the scene of a file, into ``l1/`` and ``workflow.yaml`` below a folder.

    ``progress`` receives the share of the passes that is flown, 0..1.
    """
    scene, notify = scene_of(SceneSettings, path), progress or (lambda _: None)
    targets, passes = build(scene), len(scene.flight.headings_deg)
    counts = Counter[str]()
    for k, seen in enumerate(flights(scene), start=1):
        found = detect(scene, seen, targets)
        for name, table in (("frames", seen), ("detections", found)):
            files.write(out / "l1" / f"pass_{k}_{name}.parquet", table)
            counts[name] += len(table)
        notify(k / passes)
    workflow = {
        "kind": "coincidence",
        "survey": {
            "name": "Synthetic Geiger-mode scene",
            "crs": scene.crs,
            "frames": "l1/*_frames.parquet",
            "detections": "l1/*_detections.parquet",
        },
        "array": scene.array.model_dump(mode="json"),
        "output": "out",
    }
    made = yaml.safe_dump(scene.model_dump(mode="json"), sort_keys=False)
    write_bytes(out / "scene.yaml", made.encode())
    return finished(out, workflow, counts)


def flights(scene: SceneSettings) -> Iterator[Frames]:
    """Frames of each pass that look at the scene's part."""
    flight, array = scene.flight, scene.array
    half = 0.5 * np.array([array.rows, array.columns]) * array.ifov_rad * flight.altitude_m
    reach = 0.5 * math.hypot(*scene.extent_m) + float(half.max()) + flight.speed_m_s
    n = math.ceil(2 * reach / flight.speed_m_s * flight.pulse_rate_hz)
    for pass_number, heading_deg in enumerate(flight.headings_deg, start=1):
        rng = np.random.default_rng([scene.seed, pass_number])
        time = np.arange(n) / flight.pulse_rate_hz
        phase = (time * flight.sweeps_hz + 2.0 * rng.random()) % 2.0
        roll = flight.sweep_rad * (2.0 * np.abs(phase - 1.0) - 1.0)
        heading = np.full(n, math.radians(heading_deg))
        nose = np.array([math.sin(heading[0]), math.cos(heading[0]), 0.0])
        origin = nose * (flight.speed_m_s * time - reach)[:, None]
        origin = np.array([*scene.centre_m, flight.altitude_m]) + origin
        attitude = np.stack([heading, roll, np.zeros(n)], axis=-1)
        # Ten million numbers for each pass: no two passes share one.
        number = pass_number * 10_000_000 + np.arange(n)
        frames = Frames(number, origin + np.array(scene.origin_m), attitude)
        turn = frames.turn
        axis = -turn[:, :, 2]
        ground = origin - axis * (origin[:, 2] / axis[:, 2])[:, None]
        # The image lies along the flight, which runs along an axis or slants across.
        lies = np.abs(turn[:, :2, 0]) * half[0] + np.abs(turn[:, :2, 1]) * half[1]
        away = np.abs(ground[:, :2] - scene.centre_m) - 0.5 * np.array(scene.extent_m)
        yield frames.take((away <= lies + 0.5).all(axis=1))


def detect(scene: SceneSettings, frames: Frames, targets: Targets) -> Detections:
    """What the detectors record in :func:`flights`: at most one detection of each in a frame.

    In order of frame and detector; positions by each detector's own line of sight.
    """
    array, flight = scene.array, scene.flight
    tangent = math.tan(array.ifov_rad)
    gate = np.array([array.gate_start_m, array.gate_stop_m])
    jitter = np.array([flight.range_jitter_m, flight.angle_jitter_rad])
    dark_per_m = flight.dark_rate_hz * 2.0 / SPEED_OF_LIGHT_M_S
    row, column = np.indices((array.rows, array.columns))
    across, along = row - 0.5 * (array.rows - 1), column - 0.5 * (array.columns - 1)
    looks = np.stack([across * tangent, along * tangent, -np.ones(row.shape)], -1).reshape(-1, 3)
    looks /= np.linalg.norm(looks, axis=1)[:, None]
    image = np.empty(row.shape)
    parts = [Detections.joined([])]
    for number, origin, turn in zip(frames.number, frames.origin_m, frames.turn, strict=True):
        rng = np.random.default_rng([scene.seed, int(number)])
        expose(
            *(rng, origin - np.array(scene.origin_m), turn, targets, tangent, gate),
            *(flight.efficiency, dark_per_m, jitter, flight.range_bin_m, image),
        )
        fired = np.flatnonzero(np.isfinite(image.ravel()))
        position = origin + image.ravel()[fired, None] * (looks[fired] @ turn.T)
        xyz = np.rint(position * QUANTA_PER_M).astype(np.int64)
        parts.append(Detections(np.full(len(fired), number), fired.astype(np.int32), xyz))
    return Detections.joined(parts)
