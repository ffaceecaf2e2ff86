"""Colours, type and the way from a matplotlib figure to a small PNG.

Figures are made with the object interface and an Agg canvas, and none outlives its picture. All
text is in DejaVu Sans, which matplotlib brings along: pictures are the same on every machine.
Colour-blind readers can separate the colours: ramps grow steadily in lightness, the diverging one
runs from blue to red.
"""

import io
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from PIL import Image

from spl_batch.engine.report.picture import Picture

INK: Final = "#1d2733"
MUTED: Final = "#5c6b7a"
RULE: Final = "#d5dbe1"
VOID: Final = "#eceff2"

GROUND: Final = "#8a5a1c"
SIGNAL: Final = "#0b6fa4"
NOISE: Final = "#e0684b"
AFTERPULSE: Final = "#c2189b"
RAW: Final = "#4a5562"

WIDTH_IN: Final = 10.5
DPI: Final = 200
"""Two pixels of a picture for one of the page's layout, which is as wide as it gets [1/in]."""
LARGEST_PNG: Final = 420_000
"""A picture above this is reduced to fewer colours, then to fewer pixels [bytes]."""

DEFLATE: Final = 6
"""zlib's level: 9, Pillow's ``optimize``, takes several times as long for hardly fewer bytes."""

_SETTINGS: Final = threading.RLock()

TYPE: Final[Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.titlepad": 8.0,
    "axes.labelsize": 8.5,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "path.simplify": True,
    "text.hinting": "none",
    "text.usetex": False,
    "axes.unicode_minus": True,
}


def _ramp(name: str, *colours: str) -> Colormap:
    ramp = LinearSegmentedColormap.from_list(name, colours, N=256)
    return ramp.with_extremes(bad=VOID)


TERRAIN: Final = _ramp("spl_terrain", "#1f4a4c", "#3f7a63", "#8fab74", "#d9c893", "#f6efe4")
CANOPY: Final = _ramp("spl_canopy", "#f7f5ea", "#c5dba0", "#6fae6b", "#24786a", "#0d3b4c")
DENSITY: Final = _ramp("spl_density", "#0f2a47", "#2c5d86", "#5f97a8", "#a9c7b0", "#f3efc7")
SKY: Final = _ramp("spl_sky", "#fdf6e9", "#f6cf9b", "#e9935f", "#b9474b", "#571c3f")
DIFFERENCE: Final = _ramp(
    "spl_difference", "#0b3c74", "#4a8cc2", "#b7d5e8", "#f7f7f5", "#f3c3a8", "#d1664e", "#7c1128"
)


def figure(
    width_in: float, height_in: float, *, layout: Literal["constrained"] | None = "constrained"
) -> Figure:
    """Empty figure; use it inside :func:`type_context`."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, layout=layout)


@contextmanager
def type_context() -> Iterator[None]:
    """Context in which figures take the report's type and colours.

    matplotlib keeps its settings for the whole process: one thread at a time.
    """
    with _SETTINGS, mpl.rc_context(TYPE):
        yield


def picture(drawn: Figure, title: str, caption: str) -> Picture:
    """A figure as a picture of the report."""
    png, width, height = to_png(drawn)
    return Picture(title, caption, f"{title}. {caption}", png, width, height)


def to_png(drawn: Figure, largest: int = LARGEST_PNG) -> tuple[bytes, int, int]:
    """PNG of a figure, and its size.

    Parameters
    ----------
    largest : int
        Bytes that the PNG should not exceed.

    Returns
    -------
    png : bytes
        Without time or software, so that the same figure gives the same bytes.
    width_px, height_px : int
        Size before a possible reduction: what the page lays out.
    """
    canvas: Any = FigureCanvasAgg(drawn)
    with type_context():
        canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    width, height = image.size
    png = _encode(image)
    for colours, scale in ((256, 1.0), (64, 1.0), (64, 0.75), (32, 0.5)):
        if len(png) <= largest:
            break
        shown = image.resize((round(width * scale), round(height * scale)))
        png = _encode(shown.quantize(colours, dither=Image.Dither.NONE))
    return png, width, height


def _encode(image: Image.Image) -> bytes:
    stream = io.BytesIO()
    image.save(stream, format="PNG", compress_level=DEFLATE)
    return stream.getvalue()
