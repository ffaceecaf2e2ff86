"""The gallery's picture of a report: ``python -m benchmarks.report_picture OUTPUT [PNG]``.

OUTPUT is the output folder of ``spl-batch quickstart``. A headless Chromium shows two parts of its
report, the map with its layers and the square that can be turned; one is put above the other.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from PIL import Image

PNG: Final = Path("docs/images/report.png")

WIDTH_PX: Final = 1000
"""Width of the browser's window."""

PARTS: Final = {".layers": 905, "#clip": 560}
"""What is shown of the page, and the height that it takes [pixel]."""

COLOURS: Final = 256
"""Colours of the picture [count]."""


def main(output: Path, png: Path) -> None:
    """Draw both parts of the page, and put them together."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no Chromium is installed")
    whole = Image.new("RGB", (WIDTH_PX, sum(PARTS.values())))
    top = 0
    for part, height in PARTS.items():
        whole.paste(_seen(browser, output / "report.html", part, height), (0, top))
        top += height
    whole.quantize(COLOURS).save(png, optimize=True)


def _seen(browser: str, page: Path, part: str, height: int) -> Image.Image:
    """What a window shows of one part of a page."""
    style = f"header, footer, main > :not(#map), #map > :not({part}) {{ display: none }}"
    with tempfile.TemporaryDirectory() as folder:
        copy, shot = Path(folder, "part.html"), Path(folder, "shot.png")
        text = page.read_text(encoding="utf-8")
        copy.write_text(text.replace("</head>", f"<style>{style}</style></head>"), encoding="utf-8")
        switches = ["--headless", "--no-sandbox", "--hide-scrollbars", "--disable-gpu"]
        switches += [f"--user-data-dir={folder}", f"--window-size={WIDTH_PX},{height}"]
        switches += ["--enable-unsafe-swiftshader", "--virtual-time-budget=3000"]
        subprocess.run(  # noqa: S603
            [browser, *switches, f"--screenshot={shot}", copy.as_uri()],
            check=True, capture_output=True,
        )  # fmt: skip
        return Image.open(shot).convert("RGB").crop((0, 0, WIDTH_PX, height))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else PNG)
