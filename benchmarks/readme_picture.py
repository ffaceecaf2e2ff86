"""The README's first picture: ``python -m benchmarks.readme_picture OUTPUT [PNG]``.

OUTPUT is the output folder of ``spl-batch quickstart``. The profile, the terrain and the surface
are taken from its report as they are, and put together.
"""

import base64
import io
import re
import sys
from pathlib import Path
from typing import Final

from PIL import Image

from spl_batch.formats.files.atomic import write_bytes

PNG: Final = Path("docs/images/quickstart.png")

WIDTH: Final = 1300
"""Width of the picture [pixel]."""

COLOURS: Final = 96
"""Colours of the picture [count]."""

_IMAGE: Final = re.compile(r'<img src="data:image/png;base64,([^"]+)" alt="([^"]+)"')


def compose(html: str) -> Image.Image:
    """The profile above, terrain and surface side by side beneath it.

    Parameters
    ----------
    html : str
        A report of an airborne survey.

    Returns
    -------
    PIL.Image.Image
        Of few colours.

    Raises
    ------
    KeyError
        If one of the three is not in it.
    """
    found = {alt.split(".")[0]: data for data, alt in _IMAGE.findall(html)}
    profile = _scaled(found["Vertical profile, before and after"], WIDTH)
    models = [_scaled(found[name], WIDTH // 2) for name in ("Terrain (DTM)", "Surface (DSM)")]
    high = max(model.height for model in models)
    whole = Image.new("RGB", (WIDTH, profile.height + high), "white")
    whole.paste(profile, (0, 0))
    for k, model in enumerate(models):
        whole.paste(model, (k * WIDTH // 2, profile.height))
    return whole.quantize(COLOURS)


def _scaled(data: str, width: int) -> Image.Image:
    """A picture of the report, as wide as it is to be."""
    picture = Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")
    high = round(picture.height * width / picture.width)
    return picture.resize((width, high), Image.Resampling.LANCZOS)


def main(output: Path, png: Path = PNG) -> None:
    """Draw and write the picture."""
    drawn = io.BytesIO()
    compose((output / "report.html").read_text(encoding="utf-8")).save(drawn, "PNG", optimize=True)
    write_bytes(png, drawn.getvalue())
    print(f"{png}: {len(drawn.getvalue()):,} bytes")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
