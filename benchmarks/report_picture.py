"""Pictures of a report: ``python -m benchmarks.report_picture OUTPUT [FOLDER]``.

OUTPUT is the output folder of ``spl-batch quickstart``. A headless Chromium shows its report.
``report.png`` has its map with layers, ``good_enough.png`` its top with the table of requirements.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from PIL import Image

IMAGES: Final = Path("docs/images")

WIDTH_PX: Final = 1000
"""Width of the browser's window."""

MAP_PX: Final = 905
"""Height that the map takes [pixel]."""

TOP_PX: Final = (1280, 1840)
"""Window that the top of a quickstart's report fills, with all requirements and the statement."""

TOP_SCALE: Final = 0.75
"""Size of its picture, of the window's."""

COLOURS: Final = 256
"""Colours of a picture [count]."""


def main(output: Path, folder: Path) -> None:
    """Draw both pictures of a report."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no Chromium is installed")
    page = output / "report.html"
    _write(_map(browser, page), folder / "report.png")
    _write(requirements(browser, page), folder / "good_enough.png")


def requirements(browser: str, page: Path) -> Image.Image:
    """The top of a page, which says whether it is good enough."""
    seen = _seen(browser, page, "main > :not(#good-enough)", TOP_PX)
    width, height = (round(TOP_SCALE * pixels) for pixels in TOP_PX)
    return seen.resize((width, height), Image.Resampling.LANCZOS)


def _map(browser: str, page: Path) -> Image.Image:
    """The map of the page."""
    hidden = "header, footer, main > :not(#map), #map > :not(.layers)"
    return _seen(browser, page, hidden, (WIDTH_PX, MAP_PX))


def _write(picture: Image.Image, png: Path) -> None:
    picture.quantize(COLOURS).save(png, optimize=True)


def _seen(browser: str, page: Path, hidden: str, size: tuple[int, int]) -> Image.Image:
    """What a window shows of a page without its hidden parts."""
    style = f"{hidden} {{ display: none }}"
    with tempfile.TemporaryDirectory() as folder:
        copy, shot = Path(folder, "part.html"), Path(folder, "shot.png")
        text = page.read_text(encoding="utf-8")
        copy.write_text(text.replace("</head>", f"<style>{style}</style></head>"), encoding="utf-8")
        switches = ["--headless", "--no-sandbox", "--hide-scrollbars", "--disable-gpu"]
        switches += [f"--user-data-dir={folder}", "--window-size={},{}".format(*size)]
        switches += ["--virtual-time-budget=3000"]
        subprocess.run(  # noqa: S603
            [browser, *switches, f"--screenshot={shot}", copy.as_uri()],
            check=True, capture_output=True,
        )  # fmt: skip
        return Image.open(shot).convert("RGB").crop((0, 0, *size))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else IMAGES)
