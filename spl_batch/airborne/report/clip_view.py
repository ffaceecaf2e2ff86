"""A square of the survey that can be turned in the report, with its points as they were labelled.

It holds the only script of the page, which begins when a reader asks for it. Where there is no
WebGL, where scripts may not run and in print there is a still picture from the same place.
"""

import base64
import hashlib
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from spl_batch.airborne.context import Context
from spl_batch.airborne.report.profile_strips import labelled_points, tallest_strip
from spl_batch.constants import (
    CLASS_GROUND,
    NOISE_AFTERPULSE,
    NOISE_BACKGROUND,
    NOISE_SIGNAL,
    QUANTUM_M,
)
from spl_batch.engine.report.number_format import number
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.rasters.parts import Part
from spl_batch.lattice.tiles import Bounds, quanta

EDGE_M: Final = 100.0
"""Edge of the square [m]."""

WHOLE: Final = 0.9
"""Share of its edge that points must fill for the square to be called one of that edge."""

AROUND_M: Final = 30.0
"""Noise is shown so far below and above the signal: the gate is longer [m]."""

MOST: Final = 150_000
"""Points that the page holds; of more an even share, 7 bytes each [count]."""

STILL_PX: Final = (1600, 800)
"""Width and height of the still picture."""

CAMERA: Final = {"azimuth": 0.5, "tilt": 1.1, "near": 1.3, "east": 0.0, "up": 0.0}
"""Where the square is first seen from: turned and tilted [rad], half the view's height in radii of
the points, inverted, and shifted [m]."""

SCRIPT: Final = files(__package__ or "").joinpath("clip_view.js").read_text(encoding="utf-8")
"""What turns the points. It is the same in every report: nothing of a file is in it."""

SCRIPT_HASH: Final = "sha256-" + base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
"""Names that script to the browser, which runs no other one of the page."""

KINDS: Final = (
    ("ground", "#a5793f"),
    ("other signal", "#2b8cc4"),
    ("background noise", "#e07b54"),
    ("afterpulses", "#c2189b"),
    ("not assessed", "#888888"),
)
"""What points were taken for, and their colours on light and dark."""

NOISE_KINDS: Final = (2, 3)
"""Those of :data:`KINDS` that are noise."""


@dataclass(frozen=True, slots=True)
class Clip:
    """Points of a square, near its signal.

    Parameters
    ----------
    xyz_m : (n, 3) float64
        Metres from the south-western corner, and height [m].
    kind : (n,) uint8
        Index into :data:`KINDS`.
    corner_m : (float, float)
        Easting and northing of that corner [m].
    of : int
        Points of the square and these heights; the page may hold fewer [count].
    """

    xyz_m: NDArray[np.float64]
    kind: NDArray[np.uint8]
    corner_m: tuple[float, float]
    of: int


def cut_clip(
    height: Part | None, done: Mapping[str, Mapping[str, Receipt]], context: Context
) -> Clip | None:
    """Square around the strip that the profile shows; None where there are no points.

    Parameters
    ----------
    height : Part or None
        Overview of the CHM, which tells where to cut.
    done : mapping of str to mapping of str to Receipt
        Finished tasks by kind and name.
    context : Context
        The run.
    """
    if height is None:
        return None
    strip = tallest_strip(height)
    south = (strip.ymin + strip.ymax - quanta(EDGE_M)) // 2
    square = Bounds(strip.xmin, south, strip.xmin + quanta(EDGE_M), south + quanta(EDGE_M))
    table = labelled_points(square, ("x", "y", "z"), done, context, ordered=False)
    signal = table["noise_class"] == NOISE_SIGNAL
    if not len(table):
        return None
    around = quanta(AROUND_M)
    heights = table["z"][signal] if signal.any() else table["z"]
    low, high = (int(z) for z in np.percentile(heights, [0.1, 99.9]))
    near = np.flatnonzero((table["z"] >= low - around) & (table["z"] <= high + around))
    shown = near[np.linspace(0, len(near) - 1, min(len(near), MOST)).astype(np.int64)]
    table = table.take(shown)
    origin = np.array([square.xmin, square.ymin, 0])
    xyz = np.column_stack([table[axis] for axis in "xyz"]) - origin
    kind = _kinds(table["noise_class"], table["classification"])
    corner_m = (square.xmin * QUANTUM_M, square.ymin * QUANTUM_M)
    return Clip(xyz * QUANTUM_M, kind, corner_m, len(near))


def _kinds(noise_class: NDArray[np.uint8], classes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    kind = np.full(len(classes), 4, np.uint8)
    kind[noise_class == NOISE_SIGNAL] = 1
    kind[(noise_class == NOISE_SIGNAL) & (classes == CLASS_GROUND)] = 0
    kind[noise_class == NOISE_BACKGROUND] = 2
    kind[noise_class == NOISE_AFTERPULSE] = 3
    return kind


class Kind(NamedTuple):
    """Points of one kind, in the legend."""

    number: int
    name: str
    colour: str
    points: int


@dataclass(frozen=True, slots=True)
class ClipView:
    """What the page shows of a square; its template is ``clip_view.html.j2``."""

    points: int
    #: Points as base64: (n, 3) uint16 shares of the extent, then (n,) uint8 kinds.
    packed: str
    extent_m: list[float]
    kinds: list[Kind]
    still: Picture
    colours: tuple[str, ...] = tuple(colour for _, colour in KINDS)
    camera: Mapping[str, float] = field(default_factory=lambda: CAMERA)
    script: str = SCRIPT


def view_of(clip: Clip) -> ClipView:
    """What the page shows of a square."""
    low, high = clip.xyz_m.min(axis=0), clip.xyz_m.max(axis=0)
    extent = np.maximum(high - low, 1.0)
    corner = (low + high - extent) / 2  # a square of one point has it in the middle
    whole = np.rint((clip.xyz_m - corner) / extent * 65_535).astype("<u2")
    counts = np.bincount(clip.kind, minlength=len(KINDS)).tolist()
    kinds = [Kind(k, *KINDS[k], n) for k, n in enumerate(counts) if n]
    shown = len(clip.kind)
    caption = (
        f"{number(shown)}{f' of {number(clip.of)}' if clip.of > shown else ''} points of "
        f"{_place(clip, low, high)}, around the profile; heights {number(round(low[2]))} to "
        f"{number(round(high[2]))} m. Noise farther above and below is left out."
    )
    title = "The points, seen from above at an angle"
    alt = f"{title}: {', '.join(f'{number(kind.points)} {kind.name}' for kind in kinds)}."
    still = Picture(title, caption, alt, _still(whole / 65_535 * extent, extent, clip.kind),
                    *STILL_PX)  # fmt: skip
    packed = base64.b64encode(whole.tobytes() + clip.kind.tobytes()).decode("ascii")
    return ClipView(shown, packed, [round(float(e), 3) for e in extent], kinds, still)


def _place(clip: Clip, low: NDArray[np.float64], high: NDArray[np.float64]) -> str:
    """Where the points are: in the square, or in the part of it that a small survey has."""
    east, north = clip.corner_m
    across = np.ceil(high - low)[:2]
    if across.max() > WHOLE * EDGE_M:
        return f"a square of {EDGE_M:.0f} m from {number(east)} E, {number(north)} N"
    sides = " \N{MULTIPLICATION SIGN} ".join(f"{side:.0f} m" for side in across)
    west, south = np.floor(low[:2] + clip.corner_m)
    return f"{sides} from {number(west)} E, {number(south)} N"


def _still(
    xyz_m: NDArray[np.float64], extent: NDArray[np.float64], kind: NDArray[np.uint8]
) -> bytes:
    """PNG of the points from where the script first shows them.

    Noise is drawn first, so that it hides nothing; of all else the near hides the far.
    """
    width, height = STILL_PX
    (s, st), (c, ct) = ([f(CAMERA[k]) for k in ("azimuth", "tilt")] for f in (np.sin, np.cos))
    turn = np.array([[c, -s, 0.0], [s * ct, c * ct, st], [-s * st, -c * st, ct]])
    seen = (xyz_m - extent / 2) @ turn.T
    order = np.lexsort((seen[:, 2], ~np.isin(kind, NOISE_KINDS)))
    per_m = height / 2 * CAMERA["near"] / (float(np.linalg.norm(extent)) / 2)
    column = (width / 2 + seen[order, 0] * per_m).astype(np.int64)
    row = (height / 2 - seen[order, 1] * per_m).astype(np.int64)
    # Each is a square of three pixels; of those on one pixel the last, which is the nearest, stays.
    columns = column[:, None] + np.tile([-1, 0, 1], 3)
    rows = row[:, None] + np.repeat([-1, 0, 1], 3)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    pixels = np.zeros((height, width), np.uint8)
    pixels[rows[inside], columns[inside]] = np.repeat(kind[order] + 1, 9)[inside.ravel()]
    image = Image.fromarray(pixels, "P")
    image.putpalette(b"\0\0\0" + b"".join(bytes.fromhex(colour[1:]) for _, colour in KINDS))
    stream = io.BytesIO()
    image.save(stream, format="PNG", transparency=0)
    return stream.getvalue()
