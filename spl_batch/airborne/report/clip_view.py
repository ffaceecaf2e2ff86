"""A page on which a square of the survey can be turned, with its points as they were labelled.

It is one file beside the report, opens without a network, and holds the only script that a run
writes: the report itself has none. Where there is no WebGL the page shows the report's profile.
"""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.report import CLIP_PAGE
from spl_batch.airborne.report.profile_strips import labelled_points, tallest_strip
from spl_batch.constants import (
    CLASS_GROUND,
    NOISE_AFTERPULSE,
    NOISE_BACKGROUND,
    NOISE_SIGNAL,
    QUANTUM_M,
)
from spl_batch.engine.report.page import environment
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.formats.rasters.parts import Part
from spl_batch.lattice.tiles import Bounds, quanta

EDGE_M: Final = 100.0
"""Edge of the square [m]."""

AROUND_M: Final = 30.0
"""Noise is shown so far below and above the signal: the gate is longer [m]."""

MOST: Final = 150_000
"""Points that the page holds; of more an even share, 7 bytes each [count]."""

KINDS: Final = (
    ("ground", "#a5793f"),
    ("other signal", "#2b8cc4"),
    ("background noise", "#e07b54"),
    ("afterpulses", "#c2189b"),
    ("not assessed", "#888888"),
)
"""What points were taken for, and their colours on light and dark."""


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


def render_clip(title: str, clip: Clip, still: Picture) -> str:
    """The page.

    Parameters
    ----------
    title : str
        Name of the survey.
    clip : Clip
        What can be turned.
    still : Picture
        What is shown where nothing can.
    """
    low, high = clip.xyz_m.min(axis=0), clip.xyz_m.max(axis=0)
    extent = np.maximum(high - low, 0.001)
    whole = np.rint((clip.xyz_m - low) / extent * 65_535).astype("<u2")
    data = base64.b64encode(whole.tobytes() + clip.kind.tobytes()).decode("ascii")
    counts = np.bincount(clip.kind, minlength=len(KINDS)).tolist()
    return (
        environment(__package__ or "")
        .get_template("clip_view.html.j2")
        .render(
            title=title,
            data=data,
            points=len(clip.kind),
            of=clip.of,
            extent=[round(float(e), 3) for e in extent],
            heights=(float(low[2]), float(high[2])),
            corner=clip.corner_m,
            kinds=[(*kind, n) for kind, n in zip(KINDS, counts, strict=True) if n],
            colours=[colour for _, colour in KINDS],
            still=still,
        )
    )


def write_clip(out: Path, title: str, clip: Clip | None, still: Picture) -> None:
    """Write the page into an output folder, if there is anything to show."""
    if clip is not None:
        write_bytes(out / CLIP_PAGE, render_clip(title, clip, still).encode())
